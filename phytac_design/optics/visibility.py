"""Visibility of every marker at rest: occlusion, fusion, and the red pixels of its switch."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.vision.segmentation import ColourModel, segment
from phytac_decoder.vision.switch_detection import RED_RATIO_MIN
from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.layout.cameras import camera_of, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import add_noise, render_frame
from phytac_design.optics.gaps import marker_gaps
from phytac_design.optics.paint import paints_of, resin_of
from phytac_design.optics.raster import (
    Buffers,
    marker_windows,
    owner_sums,
    pieces_by_marker,
    pixels_alone,
    points_seen,
    project_scene,
    rasterise,
)
from phytac_design.optics.render_scene import (
    BAR,
    FIRST_FIXTURE,
    FIRST_MARKER,
    NONE,
    RESIN,
    SHELL,
    RenderScene,
    build_scene,
    paint_owner,
    red_owner,
    spot_owner,
)
from phytac_design.optics.zbuffer import fill
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray

FRACTION_MIN = 0.5
PIXELS_MIN = 12
"""A marker is occluded below this visible fraction or below this many visible pixels."""


@dataclass(frozen=True, kw_only=True)
class Visibility:
    """Per marker, (n,) unless said otherwise.

    Attributes
    ----------
    visible_px : int
        Pixels whose centre sees the marker's paint.
    alone_px : int
        Pixels of its paint when its receptor is rendered alone, also beyond the image's border.
    visible_fraction : float
        Their ratio; 0 for a marker that shows no paint even alone.
    gap_same_colour_px, gap_other_colour_px : float
        Smallest distance between pixel centres of this and another marker, px; 1 = touching,
        inf = none.
    centroid_px : (n, 2) float
        Mean of the visible pixels; NaN if none.
    paint_point_mm : (n, 3) float
        Mean of the points on the paint that those pixels show, sensor frame; NaN if none.
    red_rest_px, red_on_px : int
        Visible pixels of the red tip, with all switches off and with all on.
    occluded : bool
        Visible fraction < 0.5 or fewer than 12 visible pixels.
    fused : bool
        One blob of the decoder's segmentation of a noisy frame holds this and another marker of
        its colour.
    hidden_by : int
        Part code of the main occluder (see ``occluding_parts``); ``SELF`` for visible markers.
    """

    visible_px: IntArray
    alone_px: IntArray
    visible_fraction: FloatArray
    gap_same_colour_px: FloatArray
    gap_other_colour_px: FloatArray
    centroid_px: FloatArray
    paint_point_mm: FloatArray
    red_rest_px: IntArray
    red_on_px: IntArray
    occluded: BoolArray
    fused: BoolArray
    hidden_by: IntArray

    @property
    def clear(self) -> BoolArray:
        """Markers that are visible and not fused, (n,)."""
        return ~(self.occluded | self.fused)

    @property
    def lost(self) -> BoolArray:
        """Markers without a single visible pixel, (n,)."""
        return ~np.isfinite(self.paint_point_mm[:, 0])

    @property
    def switch_unreadable(self) -> BoolArray:
        """Markers whose tip does not show ``RED_RATIO_MIN`` times its red at rest when out, (n,).

        A camera that looks straight into a hole sees the resting tip too: such a switch cannot be
        read at any threshold.
        """
        return np.asarray(self.red_on_px < self.red_needed_px)

    @property
    def red_needed_px(self) -> FloatArray:
        """Red that each tip must show when it is out, (n,)."""
        return np.asarray(RED_RATIO_MIN * self.red_rest_px + PIXELS_MIN)

    def weakest_tip(self) -> int:
        """Marker whose tip shows least red, over what it must show, when it is out."""
        return int(np.argmin(self.red_on_px / self.red_needed_px))

    def summary(self, *, switches: bool = True) -> dict[str, float]:
        """Figures of the report: numbers of failures, and the minima of visibility and gaps.

        ``switches`` says whether the sensor has some; without, their figures are left out.
        """
        figures = {
            "occluded": int(self.occluded.sum()),
            "fused": int(self.fused.sum()),
            "min_visible_fraction": float(self.visible_fraction.min(initial=1.0)),
            "min_visible_px": int(self.visible_px.min(initial=np.iinfo(np.int64).max)),
            "min_gap_px": float(self.gap_same_colour_px.min(initial=np.inf)),
            "min_gap_other_colour_px": float(self.gap_other_colour_px.min(initial=np.inf)),
        }
        if switches:
            figures |= {
                "min_red_on_px": int(self.red_on_px.min(initial=np.iinfo(np.int64).max)),
                "switch_unreadable": int(self.switch_unreadable.sum()),
                "max_red_rest_px": int(self.red_rest_px.max(initial=0)),
            }
        return figures


def check_visibility(
    sensor: Sensor,
    *,
    rng: np.random.Generator,
    camera: Camera | None = None,
    frame: ImageArray | None = None,
) -> Visibility:
    """Visibility of every marker of a design, unloaded, from ``camera`` (the only one if None).

    ``frame`` is the camera's noise-free frame, where it is known already.

    Raises
    ------
    DesignError
        If the camera cannot work.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    camera = camera or camera_of(design, surface)
    tolerance = tolerance_mm(camera, markers)
    all_on = np.ones(markers.count, dtype=bool)
    rest = build_scene(sensor, tolerance_mm=tolerance)
    on = build_scene(sensor, tolerance_mm=tolerance, switch_on=all_on)
    noise = design.camera.noise_pixel
    return measure_visibility(rest, on, camera, noise_std=noise, rng=rng, frame=frame)


def best_of(each: Sequence[Visibility]) -> tuple[Visibility, IntArray]:
    """Visibility of every marker in its best camera, and the number (n,) of that camera.

    Cameras are ranked by whether the marker is clear, then by whether its switch can be read, then
    by its visible pixels.
    """
    most = 1 + max(int(seen.visible_px.max(initial=0)) for seen in each)
    rank = [v.visible_px + most * (2 * v.clear + 1 * ~v.switch_unreadable) for v in each]
    camera = np.stack(rank).argmax(axis=0)
    markers = np.arange(len(camera))
    picked = {
        item.name: np.stack([getattr(seen, item.name) for seen in each])[camera, markers]
        for item in fields(Visibility)
    }
    return Visibility(**picked), camera


def measure_visibility(
    rest: RenderScene,
    on: RenderScene,
    camera: Camera,
    *,
    noise_std: float,
    rng: np.random.Generator,
    both: tuple[Buffers, Buffers] | None = None,
    frame: ImageArray | None = None,
) -> Visibility:
    """Visibility in a scene, which may be a moved one; ``on`` is the same with red tips out.

    ``both`` are ``rasterise`` of the two, and ``frame`` is a noise-free frame of the first, where
    they are known already.
    """
    buffers, out = both or (rasterise(rest, camera), rasterise(on, camera))
    marker = paint_owner(buffers.part)
    spots = spot_owner(buffers.part, rest.count)
    own, other = (gap[: rest.count] for gap in marker_gaps(spots, rest.spot_colour))
    visible, centroid, point = _means(buffers, marker, rest, camera)
    alone = pixels_alone(rest, camera)
    fraction = np.divide(visible, alone, out=np.zeros(len(alone)), where=alone > 0)
    red_px = [
        owner_sums(red_owner(part), rest.count)[:, 0].astype(np.int64)
        for part in (buffers.part, out.part)
    ]
    if frame is None:
        frame = render_frame(rest, camera)
    if noise_std > 0.0:
        frame = add_noise(frame, noise_std, rng)
    occluded = (fraction < FRACTION_MIN) | (visible < PIXELS_MIN)
    occluder = np.full(rest.count, SELF, dtype=np.int64)
    hidden = np.flatnonzero(fraction < FRACTION_MIN)
    occluder[hidden] = occluding_parts(rest, camera, buffers, hidden, alone)
    return Visibility(
        visible_px=visible,
        alone_px=alone,
        visible_fraction=fraction,
        gap_same_colour_px=own,
        gap_other_colour_px=other,
        centroid_px=centroid,
        paint_point_mm=point,
        red_rest_px=red_px[0],
        red_on_px=red_px[1],
        occluded=occluded,
        fused=fused_in_frame(frame, spots, rest)[: rest.count],
        hidden_by=occluder,
    )


@dataclass(frozen=True, kw_only=True)
class MarkVisibility:
    """What one camera sees of r reference marks at rest.

    Attributes
    ----------
    visible_px : (r,) int
        Pixels of each.
    centroid_px : (r, 2) float
        Their mean; NaN if none.
    clear : (r,) bool
        Marks that are seen as markers must be, and not fused with another.
    """

    visible_px: IntArray
    centroid_px: FloatArray
    clear: BoolArray


def mark_visibility(
    sensor: Sensor,
    rest: RenderScene,
    camera: Camera,
    frame: ImageArray,
    *,
    buffers: Buffers | None = None,
) -> MarkVisibility:
    """Visibility of a sensor's reference marks in a scene and its frame (BGR).

    ``buffers`` are ``rasterise`` of the scene, where they are known already.
    """
    if not rest.marks:
        none = np.zeros(0, dtype=np.int64)
        return MarkVisibility(visible_px=none, centroid_px=np.zeros((0, 2)), clear=none == 1)
    outline = sensor.reference_marks.outline_mm
    flat = camera.project(outline.reshape(-1, 3)).reshape(*outline.shape[:2], 2)
    # Shoelace formula; it also counts what lies beyond the image.
    x, y = np.moveaxis(flat, 2, 0)
    area = np.abs(np.sum(x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1), axis=1)) / 2.0
    part = (buffers or rasterise(rest, camera)).part
    spots = spot_owner(part, rest.count)
    sums = owner_sums(spots, rest.count + rest.marks)[rest.count :]
    count = sums[:, 0]
    fused = fused_in_frame(frame, spots, rest)[rest.count :]
    seen = (count >= PIXELS_MIN) & (count >= FRACTION_MIN * np.nan_to_num(area, nan=np.inf))
    return MarkVisibility(
        visible_px=count.astype(np.int64),
        centroid_px=sums[:, 1:] / np.where(count > 0.0, count, np.nan)[:, None],
        clear=seen & ~fused,
    )


def marks_advice(sensor: Sensor, clear: BoolArray, visible_px: IntArray) -> str:
    """Text on reference marks that no camera sees clearly (r,), and the fix; "" if there are none.

    Parameters
    ----------
    clear : (r,) bool
        Marks that a camera sees clearly.
    visible_px : (r,) int
        Most pixels that a camera sees of each.
    """
    hidden = np.flatnonzero(~clear)
    if not len(hidden):
        return ""
    marks = sensor.reference_marks
    ends = " and ".join(("near", "far")[end] for end in np.unique(marks.end[hidden]))
    return (
        f"no camera sees {len(hidden)} of {marks.count} reference marks clearly (on the {ends} "
        f"rim, {int(visible_px[hidden].min())} px of the worst; needed: {PIXELS_MIN} px, half of "
        "its paint, and free of markers): set reference_marks.ends to a rim before a camera, "
        "raise its gap_mm (away from markers) or diameter_mm, or change its count"
    )


def check_marks(sensor: Sensor) -> str:
    """Return why reference marks are of no use, see :func:`marks_advice`; "" if all are clear."""
    if not sensor.reference_marks.count:
        return ""
    each = []
    for camera in sensor.cameras:
        scene = build_scene(sensor, tolerance_mm=tolerance_mm(camera, sensor.markers))
        each.append(mark_visibility(sensor, scene, camera, render_frame(scene, camera)))
    clear = np.any([seen.clear for seen in each], axis=0)
    return marks_advice(sensor, clear, np.max([seen.visible_px for seen in each], axis=0))


def visibility_advice(
    design: Design, markers: Markers, occluded: IntArray, fused: IntArray, hidden_by: IntArray
) -> str:
    """Text that lists occluded and fused markers, and the usual remedies; "" if there are none.

    Parameters
    ----------
    occluded, fused : (k,) int
        Marker ids.
    hidden_by : (n,) int
        See ``Visibility``.
    """
    parts, remedies = [], []
    occluder, number = np.unique(hidden_by[occluded], return_counts=True)
    by = ", ".join(
        f"{count} {occluder_name(design, int(code))}"
        for code, count in zip(occluder, number, strict=True)
    )
    for ids, what in ((occluded, f"hidden: {by}"), (fused, "fused with another of their colour")):
        if len(ids):
            rows = np.unique(markers.row[ids])
            where = f"rows {rows[0]} to {rows[-1]}: " if markers.in_rows else ""
            shown = ", ".join(str(i) for i in ids[:5]) + (", …" if len(ids) > 5 else "")
            parts.append(f"{len(ids)} markers {what} ({where}{shown})")
    if not parts:
        return ""
    remedies += [
        f"move the fixture {fixture.name!r} out of the camera's way"
        for code, fixture in enumerate(design.fixtures, start=FIRST_FIXTURE)
        if code in occluder
    ]
    if BAR in occluder:
        remedies.append("make the light bar thinner (light.bar_radius_mm)")
    if np.any((occluder == RESIN) | (occluder == SHELL)) or len(fused):
        remedies.extend(_remedies(design, len(fused) > 0))
    if NONE in occluder:
        remedies.append("move the camera back (camera.stand_off_mm)")
    if SELF in occluder:
        remedies.append("use more camera pixels, or a camera nearby")
    fixes = ", or ".join(remedies)
    return f"the camera cannot distinguish every marker: {' and '.join(parts)}; {fixes}"


def _remedies(design: Design, fused: bool) -> list[str]:
    """Remedies against receptors that hide or touch each other in the picture."""
    layout, remedies = design.layout, []
    if heights_face(design):
        remedies.append(heights_face(design))
    if design.camera.ends == "both" and layout.heights in {"linear", "power"}:
        remedies.append('let heights grow from both ends (layout.heights = "line-of-sight")')
    if layout.kind == "straight":
        remedies.append('use layout.kind = "spiral"')
    if len(set(layout.colours)) == 1 and fused:
        remedies.append("use two colours")
    fewer = "rows or columns" if layout.kind in {"spiral", "straight"} else "markers"
    remedies.append(f"use fewer {fewer}, a narrower band_marker_mm, or more camera pixels")
    return remedies


def heights_face(design: Design) -> str:
    """Remedy for heights that do not grow away from the one camera; "" if they do."""
    layout, ends = design.layout, design.camera.ends
    if layout.heights not in {"linear", "power"} or ends == "both":
        return ""
    grows = layout.height_far_mm > layout.height_near_mm
    if grows == (ends == "near") and layout.height_far_mm != layout.height_near_mm:
        return ""
    sign = ">" if ends == "near" else "<"
    return f"let heights grow away from the camera (height_far_mm {sign} height_near_mm)"


def _means(
    buffers: Buffers, marker: NDArray[np.int32], scene: RenderScene, camera: Camera
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Visible pixels (n,), their mean (n, 2) px, and the mean (n, 3) mm of the points they show."""
    y, x = np.nonzero(marker >= 0)
    owner = marker[y, x]
    count = np.bincount(owner, minlength=scene.count).astype(np.int64)
    points = points_seen(scene, camera, buffers, y, x)
    columns = np.column_stack([x, y, points]).T
    sums = [np.bincount(owner, weights=c, minlength=scene.count) for c in columns]
    means = np.full((scene.count, 5), np.nan)
    np.divide(np.stack(sums, axis=1), count[:, None], out=means, where=count[:, None] > 0)
    return count, means[:, :2], means[:, 2:]


def fused_in_frame(frame: ImageArray, spots: NDArray[np.int32], scene: RenderScene) -> BoolArray:
    """Markers and reference marks that segmentation of ``frame`` does not separate, (n + r,)."""
    model = ColourModel.from_rgb(
        paints_of(scene.paints, scene.table), wall=resin_of(scene.paints, scene.table)
    )
    blobs = segment(model.prepared(frame), model, with_labels=True)
    paint = np.array([model.names.index(name) for name in scene.paints])
    return fused_markers(np.asarray(blobs.labels), blobs.colour, spots, paint[scene.spot_colour])


def fused_markers(
    labels: NDArray[np.int32],
    blob_colour: IntArray,
    marker: NDArray[np.int32],
    marker_colour: IntArray,
) -> BoolArray:
    """Markers that share a blob of their colour with another marker, (n,).

    Parameters
    ----------
    labels : (h, w) int
        1 + blob of each pixel, 0 outside blobs.
    blob_colour, marker_colour : (m,), (n,) int
        Colours, numbered alike.
    marker : (h, w) int32
        Marker whose paint each pixel shows, -1 for none.
    """
    # A segmented blob holds a marker if it has at least this many pixels of its paint.
    pixels_fused = 3
    both = (marker >= 0) & (labels > 0)
    blob, owner = labels[both] - 1, marker[both].astype(np.int64)
    same = blob_colour[blob] == marker_colour[owner]
    n = len(marker_colour)
    pair, pixels = np.unique(blob[same] * n + owner[same], return_counts=True)
    pair = pair[pixels >= pixels_fused]
    crowded = np.bincount(pair // n, minlength=len(blob_colour)) > 1
    fused = np.zeros(n, dtype=bool)
    fused[(pair % n)[crowded[pair // n]]] = True
    return fused


SELF = -1


def occluding_parts(
    scene: RenderScene, camera: Camera, buffers: Buffers, ids: IntArray, alone_px: IntArray
) -> IntArray:
    """Part code (k,) that covers most hidden pixels of each of the markers ``ids`` (k,).

    ``RESIN`` stands for other receptors, ``NONE`` for the border of the image, ``SELF`` for a
    marker that only its own tube hides.

    Parameters
    ----------
    buffers : Buffers
        Of the scene, see ``rasterise``.
    ids : (k,) int
        Marker numbers.
    alone_px : (n,) int
        Pixels of every marker when its receptor is rendered alone.
    """
    out = np.full(len(ids), SELF, dtype=np.int64)
    if len(ids) == 0:
        return out
    view = project_scene(scene, camera)
    chosen, starts = pieces_by_marker(scene, view)
    windows = marker_windows(view, chosen, starts, camera)
    size = np.array([camera.width_px, camera.height_px])
    for k, marker in enumerate(ids):
        left, top = np.maximum(windows[marker, :2], 0)
        right, low = np.minimum(windows[marker, :2] + windows[marker, 2:], size)
        votes = np.zeros(FIRST_MARKER, dtype=np.int64)
        code = FIRST_MARKER + 2 * int(marker)
        if right > left and low > top:
            owner = np.full((low - top, right - left), -1, dtype=np.int32)
            own = chosen[starts[marker] : starts[marker + 1]]
            fill(view, own, (int(left), int(top), 1, 0.0, 0.0), owner, np.zeros(owner.shape))
            paint = (owner >= 0) & (scene.part[owner] == code)
            seen = buffers.part[top:low, left:right][paint]
            lost = seen[seen != code]
            lost = np.where(lost >= FIRST_MARKER, RESIN, np.where(lost < 0, SHELL, lost))
            votes += np.bincount(lost, minlength=len(votes))
            votes[NONE] += alone_px[marker] - int(paint.sum())
        if votes.any():
            out[k] = int(votes.argmax())
    return out


def occluder_name(design: Design, code: int) -> str:
    """Name of a part of :func:`occluding_parts`, for messages."""
    if code >= FIRST_FIXTURE:
        return f"by the fixture {design.fixtures[code - FIRST_FIXTURE].name!r}"
    return {
        SELF: "too small in the picture or facing away",
        NONE: "by the end of the image",
        SHELL: "by the shell",
        BAR: "by the light bar",
        RESIN: "by other receptors",
    }[code]
