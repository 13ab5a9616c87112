"""How well a contact can be read at all: the Cramér-Rao bound at every receptor."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.camera.camera_motion import (
    MARKED,
    MOUNTS,
    MOVED_SDS,
    CameraMotion,
    MountTolerance,
    tabulate_camera_motion,
)
from phytac_design.engine.stage import Context, Stage, write_arrays, write_facts
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.cramer_rao import (
    ContactSignals,
    CramerRaoBound,
    cell_prior,
    contact_signals,
)
from phytac_design.simulation.linear_response import motion_responses
from phytac_design.simulation.scenario.scene_scope import scope_of
from phytac_design.simulation.turned_places import pixel_turns, repeated_markers, sectors_of
from phytac_design.stages.response_stage import decoder_shell
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

RIM_SHARE = 0.125
"""Share of the height next to each rim that is reported apart (15-105 mm of 120)."""


def _medians(bound: CramerRaoBound, middle: BoolArray) -> dict[str, float]:
    """Figures over all receptors, and over those (n,) in the middle of the sensor."""
    return {
        "force_N_median_middle": float(np.median(bound.force_N[middle])),
        "force_N_median": float(np.median(bound.force_N)),
        "force_N_worst": float(bound.force_N.max()),
        "force_known_place_N_median": float(np.median(bound.force_known_N)),
        "along_mm_median": float(np.median(bound.along_mm)),
        "around_mm_median": float(np.median(bound.around_mm)),
    }


def camera_motions(context: Context, views: Mapping[str, Any]) -> dict[str, CameraMotion]:
    """Motion of the cameras by mount and, where the design has them, with reference marks.

    Coordinates are those of all markers in each camera.
    """
    cameras, count = context.sensor.cameras, context.markers.count
    reader = np.repeat(np.arange(len(cameras)), count)
    heads = np.tile(context.markers.tip_mm, (len(cameras), 1))
    table = tabulate_camera_motion(cameras, reader, heads, MOUNTS["bench"])
    table = table.masked(np.repeat(np.asarray(views["seen_by"]).ravel(), 2))
    out: dict[str, CameraMotion] = {
        mount: replace(table, sd=np.tile(tolerance.sd, len(cameras)))
        for mount, tolerance in MOUNTS.items()
    }
    marks = context.sensor.reference_marks
    if marks.count:
        # Each rim is before a camera of its own, or the only camera sees it.
        ends = context.design.camera.end_numbers
        reader = np.array([ends.index(end) if end in ends else 0 for end in marks.end.tolist()])
        seen = tabulate_camera_motion(cameras, reader, marks.point_mm, MARKED)
        noise = context.design.camera.noise_centroid_px
        information = seen.first @ seen.first.T / noise**2 + seen.prior
        out["marks"] = replace(table, precision=information)
    return out


def _tolerance(tolerance: MountTolerance, factor: float) -> dict[str, float]:
    return {key: factor * value for key, value in asdict(tolerance).items()}


def run_resolution(context: Context, folder: Path) -> None:
    """Cramér-Rao bound of force and place at every receptor."""
    design, surface, markers = context.design, context.surface, context.markers
    training = design.training
    mesh, model, _ = decoder_shell(context)
    views = context.arrays("views")
    # A marker that a camera does not see has no information through it.
    slopes = np.where(views["seen_by"][:, :, None, None], views["paint_slopes"], 0.0)

    def shifts(uv: FloatArray, radius_mm: FloatArray) -> FloatArray:
        motion = motion_responses(model, mesh, surface, markers, uv=uv, radius_mm=radius_mm)
        return np.concatenate(
            [np.einsum("nij,cnj->cni", slope, motion) for slope in slopes], axis=1
        )

    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    scope = scope_of(context)
    chosen = scope.in_play(markers).nonzero()[0] if scope else np.arange(markers.count)
    alike = chosen if scope else _alike(context, model, mesh, slopes, views["camera"])
    solved, copy = np.unique(alike, return_inverse=True)
    signals = contact_signals(surface, shifts, uv=markers.uv[solved], radius_mm=radius)

    def bounds(of: ContactSignals, force_N: float, motion: CameraMotion | None) -> CramerRaoBound:
        """Bounds at all chosen receptors by those that are solved."""
        found = asdict(of.bound(force_N, noise_px=noise, prior=prior, motion=motion))
        return CramerRaoBound(**{name: value[copy] for name, value in found.items()})

    prior = cell_prior(
        surface.area_mm2(),
        markers.count,
        training.patch_radius_min_mm,
        training.patch_radius_max_mm,
    )
    noise = design.camera.noise_centroid_px
    along = surface.unwrap(markers.uv)[:, 1]
    place = ((along - along.min()) / max(float(np.ptp(along)), 1e-9))[chosen]
    middle = (place > RIM_SHARE) & (place < 1.0 - RIM_SHARE)
    middle = middle if middle.any() else np.ones_like(middle)  # one row, or one marker
    arrays: dict[str, Any] = {}
    table: dict[str, Any] = {}
    # What the decoder makes use of: each marker through the one camera that reads it.
    read = np.repeat((views["camera"] == np.arange(len(slopes))[:, None]).ravel(), 2)
    as_read = ContactSignals(shift=signals.shift[:, read], slopes=signals.slopes[:, read])
    table_read: dict[str, Any] = {}
    for force in sorted({1.0, 5.0, 10.0, 25.0, training.force_max_N}):
        bound = bounds(signals, force, None)
        for key, value in asdict(bound).items():
            # A scene knows nothing of receptors that are not in play.
            arrays[f"{key}_{force:g}"] = np.full(markers.count, np.nan)
            arrays[f"{key}_{force:g}"][chosen] = value
        table[f"{force:g} N"] = _medians(bound, middle)
        table_read[f"{force:g} N"] = _medians(bounds(as_read, force, None), middle)
    write_arrays(folder, arrays)
    # What it costs that the cameras may have moved since the rest frame.
    costs = {
        name: _medians(bounds(signals, training.force_max_N, motion), middle)
        for name, motion in camera_motions(context, views).items()
    }
    marked = context.sensor.reference_marks.count > 0
    facts = {
        "camera_motion": {
            "force_N": training.force_max_N,
            "bound": costs,
            # Frames of a camera that has moved farther are refused.
            "tolerance": _tolerance(MARKED, 1.0)
            if marked
            else _tolerance(MOUNTS["bench"], MOVED_SDS),
        },
        "bound": table,
        **({"bound_as_read": table_read} if len(slopes) > 1 else {}),
        "cameras": len(slopes),
        "noise_px": noise,
        "radius_mm": radius,
        "prior_place_mm": prior.place_mm,
        "prior_radius_mm": prior.radius_mm,
    }
    write_facts(folder, facts)


def _alike(
    context: Context, model: ShellModel, mesh: ShellMesh, slopes: FloatArray, camera: IntArray
) -> IntArray:
    """For each receptor (n,), the one with the same bound that is solved.

    Its counterpart in the first sector where shell, markers and all that cameras see of them turn
    onto themselves; else the receptor itself. Reference marks never do.

    Parameters
    ----------
    slopes : (cameras, n, 2, 6) float
        What each camera sees of the markers' motion.
    camera : (n,) int
        The camera that reads each.
    """
    markers = context.markers
    own = np.arange(markers.count)
    sectors, turn = sectors_of(model, mesh, markers)
    if turn is None or context.sensor.reference_marks.count:
        return own
    found = repeated_markers(markers, sectors)
    if not np.array_equal(camera[found], camera):
        return own
    for slope in slopes:

        def shift(motion: FloatArray, slope: FloatArray = slope) -> FloatArray:
            return np.asarray(np.einsum("nij,nj->ni", slope, motion))

        if pixel_turns(shift, markers, np.zeros_like(own), sectors, turn) is None:
            return own
    return found


RESOLUTION = Stage(
    name="resolution",
    design_fields=("mechanics", "camera.noise_centroid_px", "touch"),
    settings=("refine", "receptors"),
    depends_on=("views",),
    arrays={"views": ("paint_slopes", "seen_by", "camera")},
    scene=("regions", "reach_mm"),
    run=run_resolution,
)
