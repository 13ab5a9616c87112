"""What the camera sees when the sensor is pressed."""

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.layout import Markers
from phytac_design.stage import Context, Stage, write_arrays, write_facts
from phytac_design.stages.twin import MECHANICS
from shapes import Surface
from shapes.arrays import FloatArray

LADDER = (0.5, 1.0)
"""Shares of the design's greatest force at which the shell is solved; between, interpolated."""


def press_places(surface: Surface, markers: Markers, gap_px: FloatArray, count: int) -> FloatArray:
    """Chart positions (count, 2) to press at: where it is tightest, and spread over the surface.

    Candidates are all markers and the middles between nearest ones. The first half of the places
    are those nearest to the markers with the smallest gaps at rest; the others are added one by
    one, each the farthest from all so far (in space). Fewer where there are fewer candidates.
    """
    first = markers.neighbours[:, 4]
    paired = np.flatnonzero(first >= 0)
    middle = (surface.point(markers.uv[paired]) + surface.point(markers.uv[first[paired]])) / 2.0
    low, high = surface.domain.T
    between = np.clip(surface.chart(middle), low, high)
    uv = np.concatenate([markers.uv, between])
    at = surface.point(uv)
    count = min(count, len(uv))
    chosen = list(np.argsort(gap_px, kind="stable")[: (count + 1) // 2])
    distance = np.full(len(uv), np.inf)
    for k in chosen:
        distance = np.minimum(distance, np.linalg.norm(at - at[k], axis=1))
    while len(chosen) < count:
        k = int(np.argmax(distance))
        chosen.append(k)
        distance = np.minimum(distance, np.linalg.norm(at - at[k], axis=1))
    return np.asarray(uv[np.sort(np.array(chosen, dtype=np.int64))])


def motions_under(context: Context, uv: FloatArray) -> tuple[FloatArray, dict[str, Any]]:
    """Motion of the wall under every marker, (p, k, n, 6), for presses at the ladder's forces."""
    from phytac_design.mechanics.large.batch import solve_batch
    from phytac_design.mechanics.loads import patch_loads
    from phytac_design.mechanics.meshing.mesh import marker_mesh
    from phytac_design.mechanics.receptors import sensor_model, unknown_receptors

    design, surface, markers = context.design, context.surface, context.markers
    mesh = marker_mesh(
        surface,
        markers,
        thickness_mm=design.wall.thickness_mm,
        refine=context.accuracy.refine,
    )
    receptors = context.accuracy.receptors and not unknown_receptors(design)
    model = sensor_model(design, markers, mesh, receptors=receptors)
    unit = patch_loads(mesh, surface, uv, design.training.patch_radius_max_mm).toarray()
    forces = design.training.force_max_N * np.array(LADDER)
    tolerance = context.accuracy.press_tolerance
    if tolerance >= 1.0:
        linear = model.solve(unit).motion[mesh.marker_nodes]
        motions = forces[None, :, None, None] * np.moveaxis(linear, 2, 0)[:, None]
        return motions, {"theory": "linear", "not_solved": 0}
    loads = (unit[:, :, None] * forces).reshape(len(unit), -1)
    done = solve_batch(
        model,
        loads,
        workers=len(os.sched_getaffinity(0)),
        tolerance=tolerance,
        progress=lambda k, of: context.progress(
            f"under load: {k} of {of} large-displacement solves"
        ),
    )
    lost = [k for k, sample in enumerate(done) if sample.motion is None]
    motions = np.full((len(done), markers.count, 6), np.nan)
    for k, sample in enumerate(done):
        if sample.motion is not None:
            motions[k] = sample.motion[mesh.marker_nodes]
    facts = {
        "theory": "large displacement where linear is off by more than "
        f"{100.0 * tolerance:g} %: {sum(s.large for s in done)} of {len(done)} solves",
        "not_solved": len(lost),
        "flagged": sum(sample.status == "flagged" for sample in done),
        "why": done[lost[0]].reason if lost else "",
    }
    return motions.reshape(len(uv), len(forces), markers.count, 6), facts


def run_underload(context: Context, folder: Path) -> None:
    """Press at the design's greatest force all over the surface, and look."""
    from phytac_design.optics.scene import build_scene
    from phytac_design.optics.underload import press_all
    from phytac_design.optics.view import camera_of, tolerance_mm

    design, surface, markers = context.design, context.surface, context.markers
    views = context.arrays("views")
    gap = np.minimum(views["gap_same_colour_px"], views["gap_other_colour_px"])
    uv = press_places(surface, markers, gap, context.accuracy.press_places)
    motions, how = motions_under(context, uv)
    solved = np.isfinite(motions).all(axis=(1, 2, 3))
    uv, motions = uv[solved], motions[solved]
    camera = camera_of(design, surface)
    scene = build_scene(design, surface, markers, tolerance_mm=tolerance_mm(camera, markers))
    forces = design.training.force_max_N * np.array(LADDER)
    found = press_all(
        scene,
        camera,
        pivots_mm=markers.mid_mm,
        motions=motions,
        forces_N=forces,
        progress=context.progress,
    )
    write_arrays(folder, {"uv": uv, **asdict(found)})
    first = float(found.first_force_N.min(initial=np.inf))
    facts = {
        "presses": len(uv),
        "force_N": float(forces[-1]),
        "patch_radius_mm": design.training.patch_radius_max_mm,
        "hidden_most": int(found.hidden.max(initial=0)),
        "fused_most": int(found.fused.max(initial=0)),
        "first_force_N": first if np.isfinite(first) else None,
        "first_place_uv": uv[found.worst].tolist() if np.isfinite(first) else None,
        "least_visible_fraction": float(found.least_fraction.min()),
        "least_gap_same_colour_px": float(found.least_gap_same_px.min()),
        "least_gap_other_colour_px": float(found.least_gap_other_px.min()),
        "crosstalk_px": float(found.crosstalk_px.max()),
        "crosstalk_still_px": float(found.crosstalk_still_px.max()),
        "greatest_shift_px": float(found.shift_px.max(initial=0.0)),
    }
    write_facts(folder, facts | how)


def load_verdict(context: Context) -> str:
    """Say which demand of the design is not met under load; "" if all are, or none is made."""
    demand = context.design.demands.clear_force_N
    first = context.facts("underload")["first_force_N"]
    if first is None or first >= demand:
        return ""
    return (
        f"under load markers hide or fuse from {first:.2g} N on, the design demands none up to "
        f"{demand:g} N (demands.clear_force_N); space the markers wider, use more pixels, a "
        "thicker wall, or lower the demand"
    )


UNDERLOAD = Stage(
    name="underload",
    tables=(*MECHANICS, "light", "training", "demands"),
    knobs=("refine", "receptors", "press_places", "press_tolerance"),
    needs=("views",),
    gate=load_verdict,
    run=run_underload,
)
