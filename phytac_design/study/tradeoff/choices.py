"""Choices of use: time and error of each against the finest, on one design."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.spec import Design
from phytac_design.study.tradeoff.contacts import standard_contacts
from phytac_design.study.tradeoff.force import ForceError, read_forces, rms
from phytac_shapes.arrays import FloatArray

SAMPLES = 4
"""Presses that the routes are compared on."""
LOOPS = 200
"""Readings of each contact that the tables' precision is timed on."""
FINEST_FACETS = 0.25
"""Tessellation that others are held against, in times what a build takes."""
TABLE_REFINE = 4
"""Mesh of those tables."""


def use(design: Design, name: str, value: Any) -> dict[str, Any]:
    """Seconds and error of a choice; see :data:`knobs.KNOBS` for names and values."""
    work: dict[str, Callable[[Design, Any], dict[str, Any]]] = {
        "image_size": _image_size,
        "visibility": _visibility,
        "facets": _facets,
        "displacement": _displacement,
        "route": _route,
        "estimator": _estimator,
        "precision": _precision,
    }
    return work[name](design, value)


def _timed(work: Callable[[], Any]) -> tuple[Any, dict[str, Any]]:
    wall, cpu = time.perf_counter(), time.process_time()
    found = work()
    spent = {"seconds": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    return found, spent


class Look:
    """Visible fraction (n,) and centroid (n, 2) px of every marker at rest, by the first camera."""

    def __init__(self, design: Design, *, facets: float = 1.0, sampled: bool = False) -> None:
        from phytac_design.layout import make_markers
        from phytac_design.layout.cameras import cameras_of, tolerance_mm
        from phytac_design.optics.raster import pixels_alone, rasterise
        from phytac_design.optics.sampled_visibility import sampled_fraction
        from phytac_design.optics.scene import build_scene, paint_owner
        from phytac_design.simulation.imaging.nominal_view import owner_centroids

        surface = design.surface()
        markers = make_markers(design, surface)
        camera = cameras_of(design, surface)[0]
        tolerance = facets * tolerance_mm(camera, markers)
        scene = build_scene(design, surface, markers, tolerance_mm=tolerance)
        self.centroid_px = np.full((markers.count, 2), np.nan)
        if sampled:
            self.fraction = sampled_fraction(scene, camera).fraction
            return
        owner = paint_owner(rasterise(scene, camera).part)
        seen = np.bincount(owner[owner >= 0], minlength=markers.count)
        alone = pixels_alone(scene, camera)[0]
        self.fraction = np.divide(seen, alone, out=np.zeros(markers.count), where=alone > 0)
        self.centroid_px = owner_centroids(owner, markers.count)


def _centroids(
    design: Design, finest: Look, *, pixels: float = 1.0, facets: float = 1.0
) -> dict[str, Any]:
    """Errors of a look whose pixels are ``1 / pixels`` of the finest's, in the finest's."""
    Look(design, facets=facets)  # compiles
    found, spent = _timed(lambda: Look(design, facets=facets))
    gap = (found.centroid_px + 0.5) / pixels - 0.5 - finest.centroid_px
    gap = np.linalg.norm(gap[np.isfinite(gap).all(axis=1)], axis=1)
    worst = float(np.abs(found.fraction - finest.fraction).max())
    return spent | {"error": rms(gap), "worst_fraction": worst}


def _image_size(design: Design, value: float) -> dict[str, Any]:
    camera = design.camera
    update = {
        "width_px": round(camera.width_px * value),
        "height_px": round(camera.height_px * value),
        "focal_px": camera.focal_px * value,
    }
    smaller = design.model_copy(update={"camera": camera.model_copy(update=update)})
    return _centroids(smaller, Look(design), pixels=value)


def _visibility(design: Design, value: str) -> dict[str, Any]:
    finest = Look(design).fraction
    Look(design, sampled=value == "sampled")  # compiles
    found, spent = _timed(lambda: Look(design, sampled=value == "sampled").fraction)
    return spent | {"error": rms(found - finest)}


def _facets(design: Design, value: float) -> dict[str, Any]:
    return _centroids(design, Look(design, facets=FINEST_FACETS), facets=value)


def _displacement(design: Design, value: Literal["linear", "auto", "large"]) -> dict[str, Any]:
    """Forces that linear or judged motion would be read as, the large ones' shifts being true."""
    from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
    from phytac_design.simulation.receptor_kinematics import ReceptorKinematics
    from phytac_design.simulation.response import point_motions, turned_points

    error = ForceError(design)
    mesh, model, loads = error.loaded(REFINE_OF_TWIN)
    feet = ReceptorKinematics(
        mesh, error.surface, error.markers.uv, design.receptor.diameter_outer_mm / 2.0
    )
    forces, see = error.contacts.force_N, error.see
    shell = QuasiNewtonSolver(model)
    model.solve(loads[:, :1])  # factors, which all have in common

    def shifts(how: Literal["linear", "auto", "large"]) -> FloatArray:
        out = np.full((len(forces), 2 * error.markers.count), np.nan)
        for k, force in enumerate(forces):
            large = False
            motion: FloatArray | None
            if how == "linear":
                motion = shell.linear(force * loads[:, k])
            else:
                sample = shell.solve(
                    force * loads[:, k], tolerance=0.01 if how == "auto" else None
                ).sample
                motion, large = sample.motion, sample.large
            if motion is None:
                continue
            moved = (
                turned_points(feet.large(motion), see.arm_mm)
                if large
                else point_motions(feet.linear(motion), see.arm_mm)
            )
            out[k] = (see.readers.project(see.watched + moved) - see.rest).ravel()
        return out

    found, spent = _timed(lambda: shifts(value))
    true = found if value == "large" else shifts("large")
    both = np.isfinite(found).all(axis=1) & np.isfinite(true).all(axis=1)
    return spent | {"error": rms(read_forces(found[both][:, None], true[both]) - 1.0)}


REFINE_OF_TWIN = PRESETS["draft"].truth_refine


def _route(design: Design, value: str) -> dict[str, Any]:
    """Shifts of a few presses, given as points or read in rendered frames, against true ones."""
    from phytac_design.datasets.samples_reader import read_samples
    from phytac_design.simulation.run.job import Job
    from phytac_design.simulation.scenario.scenario_file import load_scenario, parse_scenario
    from phytac_design.workflows.simulate import simulate

    data = load_scenario("smoke").model_dump(mode="json", exclude_unset=True)
    data.setdefault("touch", {})["samples"] = SAMPLES

    def run(folder: str, route: str, noise: float) -> FloatArray:
        camera = design.camera.model_copy(update={"noise_centroid_px": noise})
        data["solve"] = data.get("solve", {}) | {"route": route, "displacement": "linear"}
        job = Job(
            design=design.model_copy(update={"camera": camera}),
            scenario=parse_scenario(data, "smoke"),
            seed=0,
            accuracy="draft",
            keep="points",
        )
        simulate(job, Path(folder) / f"{route}-{noise:g}", workers=0, progress=lambda _: None)
        samples, _ = read_samples(Path(folder) / f"{route}-{noise:g}")
        shift = samples.shift_px
        return np.zeros((0, 0, 2)) if shift is None else np.asarray(shift, dtype=np.float64)

    with tempfile.TemporaryDirectory() as folder:
        found, spent = _timed(lambda: run(folder, value, design.camera.noise_centroid_px))
        true = run(folder, "points", 1e-6)
    gap = (found - true)[np.isfinite(found) & np.isfinite(true)]
    return spent | {"error": rms(gap), "seconds_per_sample": spent["seconds"] / SAMPLES}


def _estimator(design: Design, value: str) -> dict[str, Any]:
    """What a draft build's report says of an estimator, contacts on receptors, linear shell."""
    from phytac_design.stages.build import run_stages, select_stages

    context, _, _ = run_stages(
        design,
        select_stages(["decoder"]),
        accuracy="draft",
        seed=0,
        force=True,
        progress=lambda _: None,
    )
    score = context.facts("decoder")["test"][value]
    seconds = float(score["milliseconds_per_frame"]) / 1e3
    return {
        "seconds": seconds,
        "cpu_s": seconds,
        "error": float(score["relative_error"]),
    }


def _precision(design: Design, value: str) -> dict[str, Any]:
    """Reading forces off tables of one or the other precision."""
    error = ForceError(design)
    rows = error.rows(TABLE_REFINE, receptors=True, orders=3).shift_px
    shift = np.einsum("ckn,ck->cn", rows, error.contacts.force_N[:, None] ** np.arange(1, 4))
    kept = rows.astype(value)
    seen = shift.astype(value)

    def read() -> FloatArray:
        for _ in range(LOOPS - 1):
            read_forces(kept, seen)
        return read_forces(kept, seen)

    found, spent = _timed(read)
    readings = LOOPS * len(standard_contacts(design, error.surface).uv)
    error_is = rms(found / error.contacts.force_N - 1.0)
    return spent | {"error": error_is, "seconds_per_reading": spent["seconds"] / readings}
