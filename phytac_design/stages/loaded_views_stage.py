"""Visibility of the markers when the sensor is pressed."""

from dataclasses import asdict, dataclass
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.engine.stage import Context, Stage, write_arrays, write_facts
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.worst_places import SAME_mm, press_places
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.mechanics.shell.compliance import column_turn
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.optics.loaded_visibility import LoadedVisibility, visibility_under_load
from phytac_design.optics.render_scene import build_scene
from phytac_design.simulation.scenario.scene_scope import scope_of
from phytac_design.stages.response_stage import decoder_shell
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

SOLVED_TOGETHER = 8
"""Presses whose large displacements are solved together."""


class PressedShell:
    """The shell of a sensor, and presses on it with the design's largest force."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self.mesh, self.model, _ = decoder_shell(context)
        markers = context.markers
        columns = markers.lattice.columns if markers.lattice else 1
        self.repeats = column_turn(self.model, self.mesh, columns) is not None

    def motions(self, uv: FloatArray, shares: tuple[float, ...]) -> tuple[FloatArray, list[Any]]:
        """Motion of the wall under every marker, (p, k, n, 6), at shares of the largest force.

        NaN without a solution. Also the large-displacement samples; none with linear theory.
        """
        context, mesh = self.context, self.mesh
        training = context.design.training
        radius = training.patch_radius_max_mm
        unit = patch_loads(mesh, context.surface, uv, radius).toarray()
        forces = training.force_max_N * np.array(shares)
        tolerance = context.accuracy.press_tolerance
        if tolerance >= 1.0:
            linear = self.model.solve(unit).motion[mesh.marker_nodes]
            return forces[None, :, None, None] * np.moveaxis(linear, 2, 0)[:, None], []
        solver, done = QuasiNewtonSolver(self.model), []
        loads = (unit[:, :, None] * forces).reshape(len(unit), -1)
        count = loads.shape[1]
        for start in range(0, count, SOLVED_TOGETHER):
            part = loads[:, start : start + SOLVED_TOGETHER]
            done += solver.together(
                [partial(solver.solve, load, tolerance=tolerance) for load in part.T]
            )
            context.progress(f"under load: {len(done)} of {count} large-displacement solves")
        motions = np.full((len(done), context.markers.count, 6), np.nan)
        for k, sample in enumerate(done):
            if sample.motion is not None:
                motions[k] = sample.motion[mesh.marker_nodes]
        return motions.reshape(len(uv), len(forces), -1, 6), done


def theory_facts(samples: list[Any], tolerance: float) -> dict[str, Any]:
    """Method of the motions."""
    if not samples:
        return {"theory": "linear", "not_solved": 0}
    lost = [sample for sample in samples if sample.motion is None]
    return {
        "theory": "large displacement where linear is off by more than "
        f"{100.0 * tolerance:g} %: {sum(s.large for s in samples)} of {len(samples)} solves",
        "not_solved": len(lost),
        "flagged": sum(sample.status == "flagged" for sample in samples),
        "why": lost[0].reason if lost else "",
    }


@dataclass(frozen=True, kw_only=True)
class Presses:
    """Presses at p places, each alone, and the visibility of the markers.

    Attributes
    ----------
    uv : (p, 2) float
        Places that were solved.
    motion : (p, n, 6) float
        Motion of the wall under every marker at the full force: mm, rad.
    found : LoadedVisibility
        Visibility.
    facts : dict
        Method; with two cameras also the losses of each.
    """

    uv: FloatArray
    motion: FloatArray
    found: LoadedVisibility
    facts: dict[str, Any]

    def shown(self) -> int:
        """Press at which a marker is lost first; the one with the largest shift if none is."""
        if np.isfinite(self.found.first_force_N).any():
            return self.found.worst
        return int(self.found.shift_px.argmax())


def see_pressed(
    context: Context, gap_px: FloatArray, camera_number: IntArray | None = None
) -> tuple[FloatArray, LoadedVisibility, dict[str, Any]]:
    """Places, visibility and method of :func:`press_and_see`."""
    done = press_and_see(context, gap_px, camera_number)
    return done.uv, done.found, done.facts


def press_and_see(
    context: Context, gap_px: FloatArray, camera_number: IntArray | None = None
) -> Presses:
    """Press all over the surface and render.

    All places are pressed with the full force; those where a marker hides or fuses also with the
    half of it, to find the force at which that starts.

    Parameters
    ----------
    gap_px : (n,) float
        Smallest gap of each marker at rest: the smallest are pressed first.
    camera_number : (n,) int, optional
        Camera that each marker is read through; the first by default.
    """
    design, surface, markers = context.design, context.surface, context.markers
    reader = np.zeros(markers.count, dtype=np.int64) if camera_number is None else camera_number
    views = [
        (
            camera,
            build_scene(context.sensor, tolerance_mm=tolerance_mm(camera, markers)),
            reader == number,
        )
        for number, camera in enumerate(context.sensor.cameras)
    ]
    force = design.training.force_max_N
    shell = PressedShell(context)
    scope = scope_of(context)
    choose = press_places if scope is None else scope.presses
    uv = choose(surface, markers, gap_px, context.accuracy.press_places, repeats=shell.repeats)

    def look(motions: FloatArray, forces_N: FloatArray) -> dict[int, LoadedVisibility]:
        return {
            number: visibility_under_load(
                scene,
                camera,
                pivots_mm=markers.mid_mm,
                motions=motions,
                forces_N=forces_N,
                counted=counted,
                progress=context.progress,
            )
            for number, (camera, scene, counted) in enumerate(views)
            if counted.any()
        }

    full, samples = shell.motions(uv, (1.0,))
    solved = np.isfinite(full).all(axis=(1, 2, 3))
    uv, full = uv[solved], full[solved]
    each = look(full, np.array([force]))
    found = merged(each)
    events = np.flatnonzero(np.isfinite(found.first_force_N))
    if samples and len(events):
        below, more = shell.motions(uv[events], (0.5,))
        samples += more
        known = np.isfinite(below).all(axis=(1, 2, 3))
        path = np.concatenate([below, full[events]], axis=1)[known]
        first = merged(look(path, force * np.array([0.5, 1.0])))
        found.first_force_N[events[known]] = first.first_force_N
        found.first_marker[events[known]] = first.first_marker
    facts = theory_facts(samples, context.accuracy.press_tolerance)
    if len(views) > 1:
        facts["cameras"] = [
            {"end": "far" if end else "near", "read": int((reader == number).sum())}
            | (figures_of(each[number], reader == number) if number in each else {})
            for number, end in enumerate(design.camera.end_numbers)
        ]
    inward = -np.einsum("pni,ni->pn", full[:, -1, :, :3], markers.normal)
    facts |= {"sector_only": shell.repeats, "dent_mm": float(inward.max(initial=0.0))}
    return Presses(uv=uv, motion=full[:, -1], found=found, facts=facts)


def merged(each: dict[int, LoadedVisibility]) -> LoadedVisibility:
    """Results of all cameras, each for the markers that it reads."""
    return reduce(lambda one, other: one.with_other(other), each.values())


def figures_of(found: LoadedVisibility, own: BoolArray) -> dict[str, Any]:
    """Figures of all presses, for some of the markers (n,)."""
    return {
        "hidden_most": int(found.hidden.max(initial=0)),
        "fused_most": int(found.fused.max(initial=0)),
        "least_visible_fraction": float(found.least_fraction[own].min()),
        "least_gap_same_colour_px": float(found.least_gap_same_px[own].min()),
        "least_gap_other_colour_px": float(found.least_gap_other_px[own].min()),
        "crosstalk_px": float(found.crosstalk_px[own].max()),
        "greatest_shift_px": float(found.shift_px.max(initial=0.0)),
    }


def run_underload(context: Context, folder: Path) -> None:
    """Press with the design's largest force all over the surface, and render."""
    markers, training = context.markers, context.design.training
    views = context.arrays("views")
    gap = np.minimum(views["gap_same_colour_px"], views["gap_other_colour_px"])
    done = press_and_see(context, gap, views["camera"])
    uv, found, how = done.uv, done.found, done.facts
    shown = done.shown() if len(uv) else 0
    # One press for the report's pictures; empty if none was solved.
    picture = {"shown_uv": uv[shown : shown + 1], "shown_motion": done.motion[shown : shown + 1]}
    write_arrays(folder, {"uv": uv, **asdict(found), **picture})
    facts: dict[str, Any] = {
        "presses": len(uv),
        "force_N": training.force_max_N,
        "patch_radius_mm": training.patch_radius_max_mm,
        "first_force_N": None,
        "first_place_uv": None,
        "crosstalk_marker": markers.name(int(found.crosstalk_px.argmax())),
        "crosstalk_still_px": float(found.crosstalk_still_px.max()),
    }
    facts |= figures_of(found, np.ones(markers.count, dtype=np.bool_))
    if len(uv) and np.isfinite(found.first_force_N).any():
        worst = found.worst
        facts |= {
            "first_force_N": float(found.first_force_N[worst]),
            "first_place_uv": uv[worst].tolist(),
            "first_place": place_in_words(context, uv[worst]),
            "first_marker": markers.name(int(found.first_marker[worst])),
        }
    write_facts(folder, facts | how | {"sentence": load_sentence(facts)})


def place_in_words(context: Context, uv: FloatArray) -> str:
    """Where a press is, by the marker it is on or nearest to: ``on (row 3, column 4)``."""
    surface, markers = context.surface, context.markers
    away = np.linalg.norm(surface.point(markers.uv) - surface.point(uv[None]), axis=1)
    nearest = int(away.argmin())
    how = "on" if away[nearest] < SAME_mm else f"{away[nearest]:.1f} mm beside"
    return f"{how} marker {markers.name(nearest)}"


def load_sentence(facts: dict[str, Any]) -> str:
    """Summary of the results as a sentence."""
    crosstalk = (
        f"the centroid of a marker is disturbed by at most {facts['crosstalk_px']:.2g} px (marker "
        f"{facts['crosstalk_marker']}; {facts['crosstalk_still_px']:.2g} px for markers that stand "
        "still)"
    )
    presses = (
        f"Pressed with up to {facts['force_N']:g} N (radius {facts['patch_radius_mm']:g} mm) at "
        f"{facts['presses']} places, one at a time: "
    )
    if facts["first_force_N"] is None:
        return f"{presses}no marker hides or fuses; {crosstalk}."
    return (
        f"{presses}from {facts['first_force_N']:.2g} N on, pressed {facts['first_place']}, marker "
        f"{facts['first_marker']} hides or fuses; at the full force up to {facts['hidden_most']} "
        f"are hidden and {facts['fused_most']} fused; {crosstalk}."
    )


def load_verdict(context: Context) -> str:
    """Demand of the design that is not met under load; "" if all are met."""
    demand = context.design.demands.clear_force_N
    first = context.facts("underload")["first_force_N"]
    if first is None or first >= demand:
        return ""
    place = context.facts("underload")["first_place"]
    return (
        f"under load markers hide or fuse from {first:.2g} N on (pressed {place}), the design "
        f"demands none up to {demand:g} N (demands.clear_force_N); space the markers wider, use "
        "more pixels, a thicker wall, or lower the demand"
    )


UNDERLOAD = Stage(
    name="underload",
    design_fields=("mechanics", "markers", "bodies", "touch", "demands"),
    settings=("refine", "receptors", "press_places", "press_tolerance"),
    depends_on=("views",),
    arrays={"views": ("gap_same_colour_px", "gap_other_colour_px", "camera")},
    scene=("regions", "reach_mm"),
    gate=load_verdict,
    run=run_underload,
)
