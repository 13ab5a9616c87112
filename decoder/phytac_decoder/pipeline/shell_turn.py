"""Turn of the shell about the sensor's axis: lattices that a turn maps onto themselves.

A shell that sits turned by such a step shows every marker where another one is expected: without
reference marks nobody can know. The unique mark shows the step, and the decoder then is that of the
turned shell: in its frame the camera has turned the other way, and the image of marker i is that
which the design has of the marker π(i) in its place.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.camera_motion import MOUNTS, tabulate_camera_motion
from phytac_decoder.estimation.contact_fit import MarkerNoise
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.sensor_limits import axial_rotation, markers_in_play
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_decoder.vision.segmentation import segment
from phytac_decoder.vision.switch_detection import TipModel
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError


def oriented(bundle: Bundle, frames: Sequence[ImageArray]) -> Bundle:
    """Return the decoder of the shell as it sits, by the reference marks in its rest frames.

    Raises
    ------
    InputError
        If the marks do not show how the shell sits, or this decoder cannot be turned with it.
    """
    turns = bundle.symmetric_turns
    if len(turns) == 1 or not bundle.marks.count:
        return bundle
    seen = [_marks_seen(bundle, frames, step) for step in range(len(turns))]
    best, second = np.argsort(seen)[::-1][:2]
    # A wrong step misses the unique mark, and expects one more in the gap beside it.
    if seen[best] < bundle.marks.count / 2 or seen[best] < seen[second] + 2:
        raise InputError(
            "orientation-unknown",
            f"the reference marks do not show how the shell sits: {seen[best]} of "
            f"{bundle.marks.count} are found at one turn and {seen[second]} at another; clean "
            "them, see that nothing hides mark 0, and take a new rest frame",
        )
    return turned(bundle, int(best)) if best else bundle


def _marks_seen(bundle: Bundle, frames: Sequence[ImageArray], step: int) -> int:
    """Number of marks that show their paint where they are after a number of steps."""
    marks, count = bundle.marks, 0
    points = marks.point_mm @ axial_rotation(step / len(bundle.symmetric_turns)).T
    for number, (camera, frame) in enumerate(zip(bundle.cameras, frames, strict=True)):
        own = np.flatnonzero(marks.read_by == number)
        if not len(own):
            continue
        blobs = segment(frame, bundle.colours)
        shown = bundle.shown_by(number).rest_px[bundle.colour == marks.colour[own[0]]]
        rest = marks.rest_px[own]
        gap = np.linalg.norm(rest[:, None] - rest[None], axis=2)
        np.fill_diagonal(gap, np.inf)
        beside = np.linalg.norm(rest[:, None] - shown[None], axis=2)
        reach = min(0.35 * np.nanmin(gap), 0.5 * np.nanmin(beside))
        place = camera.project(points[own])
        paint = blobs.centroid_px[blobs.colour == marks.colour[own[0]]]
        off = np.linalg.norm(place[:, None] - paint[None], axis=2)
        count += int(np.count_nonzero(off.min(axis=1, initial=np.inf) < reach))
    return count


def turned(bundle: Bundle, step: int) -> Bundle:
    """Return the decoder of a shell that sits turned by a number of symmetric steps.

    Raises
    ------
    InputError
        If it was fitted to one print, or made for a part of the surface: that does not turn.
    """
    order = bundle.symmetric_turns[step]
    share = step / len(bundle.symmetric_turns)
    turn_deg = 360.0 * share if share <= 0.5 else 360.0 * (share - 1.0)
    locator, learnt = bundle.model.locator, bundle.model.measured or bundle.model.receptors
    if bundle.notes.get("scene") or learnt or (locator and locator.correction):
        raise InputError(
            "shell-turned",
            f"the shell sits turned by {turn_deg:g} degrees, and this decoder was trained or made "
            f"for one orientation; turn the shell by {-turn_deg:g} degrees about its axis, seen "
            "along +z, and take a new rest frame",
        )
    turn = axial_rotation(share)
    cameras = tuple(
        replace(each, position_mm=each.position_mm @ turn, rotation=each.rotation @ turn)
        for each in bundle.cameras
    )
    tips = _tips(bundle.tips, order)
    out = replace(
        bundle,
        cameras=cameras,
        read_by=bundle.read_by[order],
        rest_px=bundle.rest_px[order],
        tip_bias_px=bundle.tip_bias_px[order],
        covers=bundle.covers.seen_in(order),
        tips=tips,
        shown=tuple(
            replace(view, rest_px=view.rest_px[order], tips=_tips(view.tips, order))
            for view in bundle.shown
        ),
        marks=replace(bundle.marks, rest_px=_marks_px(bundle, cameras)),
        # It may have been turned before.
        turned_deg=180.0 - (180.0 - bundle.turned_deg - turn_deg) % 360.0,
    )
    model = _model(bundle.model, order)
    if locator:
        blind = tips.blind(markers_in_play(bundle))
        model = replace(model, locator=replace(_locator(locator, order, turn), blind=blind))
    if bundle.model.camera_motion:
        table = tabulate_camera_motion(cameras, out.read_by, out.head_mm, MOUNTS["bench"])
        motion = bundle.model.camera_motion
        table = replace(table, sd=motion.sd[: motion.motions])
        model = model.with_camera_motion(table, bundle.noise_centroid_px)
    return replace(out, model=model)


def _marks_px(bundle: Bundle, cameras: Sequence[Camera]) -> FloatArray:
    """Expected positions (r, 2) of the marks in other cameras."""
    marks = bundle.marks
    each = np.stack([camera.project(marks.point_mm) for camera in cameras])
    return np.asarray(each[marks.read_by, np.arange(marks.count)])


def _tips(tips: TipModel, order: IntArray) -> TipModel:
    return TipModel(
        on_px=tips.on_px[order],
        red_rest_px=tips.red_rest_px[order],
        red_on_px=tips.red_on_px[order],
        gradual=None if tips.gradual is None else tips.gradual[order],
    )


def _pairs(rows: NDArray[Any], order: IntArray) -> NDArray[Any]:
    """Return rows (…, 2n) of (x0, y0, x1, …) by other markers."""
    return np.ascontiguousarray(
        rows.reshape(*rows.shape[:-1], -1, 2)[..., order, :].reshape(rows.shape)
    )


def _model(model: ForceModel, order: IntArray) -> ForceModel:
    compliance = _pairs(np.ascontiguousarray(model.compliance_px.T), order)[order].T
    return replace(
        model,
        shift_to_mm=model.shift_to_mm[order],
        stiffness=model.stiffness[np.ix_(order, order)],
        compliance_px=np.ascontiguousarray(compliance),
        height_z_mm=model.height_z_mm[order],
    )


def _locator(locator: ContactLocator, order: IntArray, turn: FloatArray) -> ContactLocator:
    places, noise = _places(locator.places, turn), locator.noise
    pairs = places.pairs
    if pairs is not None:
        grid = _places(pairs.grid, turn)
        pairs = replace(pairs, grid=grid, axes_px=_pairs(pairs.axes_px, order))
    shear = places.shear
    if shear is not None:
        shear = replace(_places(shear, turn), shift_px=_pairs(shear.shift_px, order))
    places = replace(places, shift_px=_pairs(places.shift_px, order), pairs=pairs, shear=shear)
    if noise.markers:
        still, moved = noise.markers.still_px, noise.markers.moved_px
        markers = MarkerNoise(still_px=_pairs(still, order), moved_px=_pairs(moved, order))
        noise = replace(noise, markers=markers)
    return replace(locator, places=places, noise=noise)


def _places(places: ResponseTable, turn: FloatArray) -> ResponseTable:
    """Return the tables of the points of the turned shell that are at the places."""
    return replace(
        places,
        point_mm=places.point_mm @ turn,
        along=places.along @ turn,
        around=places.around @ turn,
    )
