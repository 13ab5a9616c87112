"""Choices of use: time and error of each against the finest, on one design."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.study.tradeoff.force import ForceError, fit_forces, rms
from phytac_shapes.arrays import FloatArray


def use(design: Design, name: str, value: Any) -> dict[str, Any]:
    """Seconds and error of a choice; see :data:`settings.SETTINGS` for names and values."""
    choices: dict[str, Callable[[Design, Any], dict[str, Any]]] = {
        "image_size": _image_size,
        "visibility": _visibility,
        "facets": _facets,
        "displacement": _displacement,
        "route": _route,
        "estimator": _estimator,
        "precision": _precision,
    }
    return choices[name](design, value)


def _timed(work: Callable[[], Any]) -> tuple[Any, dict[str, Any]]:
    wall, cpu = time.perf_counter(), time.process_time()
    found = work()
    spent = {"seconds": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    return found, spent


def _view(design: Design, facets: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Visible fraction (n,) and centroid (n, 2) px of every marker at rest, by the first camera."""
    from phytac_design.optics.raster import pixels_alone, rasterise
    from phytac_design.optics.render_scene import paint_owner
    from phytac_design.simulation.imaging.nominal_view import owner_centroids

    scene, camera = _scene(design, facets)
    owner = paint_owner(rasterise(scene, camera).part)
    seen = np.bincount(owner[owner >= 0], minlength=scene.count)
    alone = pixels_alone(scene, camera)
    fraction = np.divide(seen, alone, out=np.zeros(scene.count), where=alone > 0)
    return fraction, owner_centroids(owner, scene.count)


def _scene(design: Design, facets: float = 1.0) -> tuple[Any, Any]:
    """Scene at rest, its facets in multiples of the usual ones, and the first camera."""
    from phytac_design.layout.cameras import tolerance_mm
    from phytac_design.optics.render_scene import build_scene

    sensor = Sensor(design)
    camera = sensor.cameras[0]
    tolerance = facets * tolerance_mm(camera, sensor.markers)
    return build_scene(sensor, tolerance_mm=tolerance), camera


def _centroids(
    design: Design, finest_px: FloatArray, *, pixels: float = 1.0, facets: float = 1.0
) -> dict[str, Any]:
    """Centroid errors of a view, in pixels of the finest; ``pixels`` is its relative image size."""
    _view(design, facets)  # compiles
    (_, found), spent = _timed(lambda: _view(design, facets))
    gap = (found + 0.5) / pixels - 0.5 - finest_px
    return spent | {"error": rms(np.linalg.norm(gap[np.isfinite(gap).all(axis=1)], axis=1))}


def _image_size(design: Design, value: float) -> dict[str, Any]:
    camera = design.camera
    update = {
        "width_px": round(camera.width_px * value),
        "height_px": round(camera.height_px * value),
        "focal_px": camera.focal_px * value,
    }
    smaller = design.model_copy(update={"camera": camera.model_copy(update=update)})
    return _centroids(smaller, _view(design)[1], pixels=value)


def _visibility(design: Design, value: str) -> dict[str, Any]:
    from phytac_design.optics.sampled_visibility import sampled_fraction

    def look() -> FloatArray:
        if value == "sampled":
            return sampled_fraction(*_scene(design)).fraction
        return _view(design)[0]

    finest = _view(design)[0]
    look()  # compiles
    found, spent = _timed(look)
    return spent | {"error": rms(found - finest)}


def _facets(design: Design, value: float) -> dict[str, Any]:
    return _centroids(design, _view(design, 0.25)[1], facets=value)


def _displacement(design: Design, value: Literal["linear", "auto", "large"]) -> dict[str, Any]:
    """Forces fitted to large-displacement shifts with the shifts of a theory."""
    from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
    from phytac_design.simulation.linear_response import point_motions, turned_points

    error = ForceError(design)
    mesh, model = error.truth_shell(PRESETS["draft"].truth_refine)
    loads, kinematics = error.loads(mesh), error.kinematics(mesh)
    forces, arm = error.contacts.force_N, error.imaging.arm_mm
    shell = QuasiNewtonSolver(model)
    model.solve(loads[:, :1])  # the factorisation, which all share

    def shifts(theory: Literal["linear", "auto", "large"]) -> FloatArray:
        out = np.full((len(forces), 2 * error.sensor.markers.count), np.nan)
        for k, force in enumerate(forces):
            load, large = force * loads[:, k], False
            motion: FloatArray | None
            if theory == "linear":
                motion = shell.linear(load)
            else:
                sample = shell.solve(load, tolerance=0.01 if theory == "auto" else None)
                motion, large = sample.motion, sample.large
            if motion is not None and large:
                out[k] = error.image_shift(turned_points(kinematics.large(motion), arm))
            elif motion is not None:
                out[k] = error.image_shift(point_motions(kinematics.linear(motion), arm))
        return out

    found, spent = _timed(lambda: shifts(value))
    true = found if value == "large" else shifts("large")
    both = np.isfinite(found).all(axis=1) & np.isfinite(true).all(axis=1)
    return spent | {"error": rms(fit_forces(found[both][:, None], true[both]) - 1.0)}


def _route(design: Design, value: str, samples: int = 4) -> dict[str, Any]:
    """Shifts of a few presses, given as points or measured in rendered frames."""
    from phytac_design.datasets.samples_file import read_samples
    from phytac_design.simulation.run.job import Job
    from phytac_design.simulation.scenario.scenario_file import load_scenario, parse_scenario
    from phytac_design.workflows.simulate import simulate

    data = load_scenario("smoke").model_dump(mode="json", exclude_unset=True)
    data.setdefault("touch", {})["samples"] = samples

    def run(out: Path, route: str, noise: float) -> FloatArray:
        camera = design.camera.model_copy(update={"noise_centroid_px": noise})
        data["solve"] = data.get("solve", {}) | {"route": route, "displacement": "linear"}
        job = Job(
            design=design.model_copy(update={"camera": camera}),
            scenario=parse_scenario(data, "smoke"),
            seed=0,
            accuracy="draft",
            keep="points",
        )
        simulate(job, out, workers=0, progress=lambda _: None)
        shift = read_samples(out)[0].shift_px
        return np.zeros((0, 0, 2)) if shift is None else np.asarray(shift, dtype=np.float64)

    with tempfile.TemporaryDirectory() as folder:
        noise = design.camera.noise_centroid_px
        found, spent = _timed(lambda: run(Path(folder) / "route", value, noise))
        true = run(Path(folder) / "true", "points", 1e-6)
    gap = (found - true)[np.isfinite(found) & np.isfinite(true)]
    return spent | {"error": rms(gap), "seconds_per_sample": spent["seconds"] / samples}


def _estimator(design: Design, value: str) -> dict[str, Any]:
    """Score of an estimator in a draft build: contacts on receptors, linear shell."""
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
    return {"seconds": seconds, "cpu_s": seconds, "error": float(score["relative_error"])}


def _precision(design: Design, value: str, loops: int = 200) -> dict[str, Any]:
    """Force fits with tables of single or double precision."""
    error = ForceError(design)
    force = error.contacts.force_N
    rows = error.rows(4, receptors=True, orders=3)
    shift = np.einsum("ckn,ck->cn", rows, force[:, None] ** np.arange(1, 4))
    kept, seen = rows.astype(value), shift.astype(value)
    found, spent = _timed(lambda: [fit_forces(kept, seen) for _ in range(loops)][-1])
    reading = spent["seconds"] / (loops * len(rows))
    return spent | {"error": rms(found / force - 1.0), "seconds_per_reading": reading}
