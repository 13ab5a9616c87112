"""What the camera sees of every marker: whole or hidden, apart or fused, how many red pixels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decoder.camera import Camera
from decoder.segmentation import ColourModel, segment
from phytac_design.layout import Markers
from phytac_design.optics.frame import render_frame
from phytac_design.optics.gaps import marker_gaps
from phytac_design.optics.paint import paints_of
from phytac_design.optics.raster import Buffers, pixels_alone, points_seen, rasterise
from phytac_design.optics.scene import Scene, build_scene, paint_owner, red_owner
from phytac_design.optics.view import camera_of, refuse_swallowed, tolerance_mm
from phytac_design.spec import Design
from shapes import Surface
from shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray

FRACTION_MIN = 0.5
PIXELS_MIN = 12
"""A marker is occluded below this visible fraction or below this many visible pixels."""
RED_RATIO = 1.25
"""A switch that is on must show this many times the red that it shows at rest, plus 12 pixels."""
PIXELS_FUSED = 3
"""A segmented blob holds a marker if it has at least this many pixels of its paint."""
SAMPLES = 4
"""Samples per pixel of the frame that decides on fusion."""


@dataclass(frozen=True, kw_only=True)
class Visibility:
    """Per marker, (n,) unless said otherwise.

    Attributes
    ----------
    visible_px : int
        Pixels whose centre sees the marker's paint.
    alone_px : int
        The same if its receptor were the only thing; pixels beyond the image's edge count.
    visible_fraction : float
        Their ratio; 0 for a marker that would not show at all.
    gap_same_colour_px, gap_other_colour_px : float
        Least distance between pixel centres of this and another marker, px; 1 = touching, inf
        = none.
    centroid_px : (n, 2) float
        Mean of the visible pixels; NaN if none.
    paint_point_mm : (n, 3) float
        Mean of the points on the paint that those pixels see, sensor frame; NaN if none.
    red_rest_px, red_on_px : int
        Visible pixels of the red tip, with all switches off and with all on.
    occluded : bool
        Visible fraction < 0.5 or fewer than 12 visible pixels.
    fused : bool
        One blob of the decoder's segmentation of a noisy frame holds this and another marker of
        its colour.
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

    @property
    def switch_unreadable(self) -> BoolArray:
        """Markers whose red tip shows at rest about as much as when it is out, (n,).

        A camera that looks straight into a hole sees the resting tip too: such a switch tells
        nothing, whatever its threshold.
        """
        return np.asarray(self.red_on_px < RED_RATIO * self.red_rest_px + PIXELS_MIN)

    def summary(self) -> dict[str, float]:
        """Figures of the report: counts of failures, and the least of what has to be large."""
        return {
            "occluded": int(self.occluded.sum()),
            "fused": int(self.fused.sum()),
            "min_visible_fraction": float(self.visible_fraction.min(initial=1.0)),
            "min_visible_px": int(self.visible_px.min(initial=np.iinfo(np.int64).max)),
            "min_gap_px": float(self.gap_same_colour_px.min(initial=np.inf)),
            "min_gap_other_colour_px": float(self.gap_other_colour_px.min(initial=np.inf)),
            "min_red_on_px": int(self.red_on_px.min(initial=np.iinfo(np.int64).max)),
            "switch_unreadable": int(self.switch_unreadable.sum()),
            "max_red_rest_px": int(self.red_rest_px.max(initial=0)),
        }


def check_visibility(
    design: Design,
    surface: Surface,
    markers: Markers,
    *,
    rng: np.random.Generator,
    camera: Camera | None = None,
) -> Visibility:
    """Visibility of every marker of a design, unloaded.

    Raises
    ------
    DesignError
        If the camera cannot work or the light bar reaches a receptor.
    """
    camera = camera or camera_of(design, surface)
    refuse_swallowed(design, surface, markers)
    tolerance = tolerance_mm(camera, markers)
    all_on = np.ones(markers.count, dtype=bool)
    rest = build_scene(design, surface, markers, tolerance_mm=tolerance)
    on = build_scene(design, surface, markers, tolerance_mm=tolerance, switch_on=all_on)
    return see(rest, on, camera, noise_std=design.camera.noise_pixel, rng=rng)


def see(
    rest: Scene,
    on: Scene,
    camera: Camera,
    *,
    noise_std: float,
    rng: np.random.Generator,
) -> Visibility:
    """Visibility in a scene, which may be a moved one; ``on`` is the same with red tips out."""
    buffers = rasterise(rest, camera)
    marker = paint_owner(buffers.part)
    own, other = marker_gaps(marker, rest.colour)
    visible, centroid, point = _means(buffers, marker, rest, camera)
    alone = pixels_alone(rest, camera)[0]
    fraction = np.divide(visible, alone, out=np.zeros(len(alone)), where=alone > 0)
    frame = render_frame(rest, camera, noise_std=noise_std, rng=rng, samples=SAMPLES)
    return Visibility(
        visible_px=visible,
        alone_px=alone,
        visible_fraction=fraction,
        gap_same_colour_px=own,
        gap_other_colour_px=other,
        centroid_px=centroid,
        paint_point_mm=point,
        red_rest_px=_count(red_owner(buffers.part), rest.count),
        red_on_px=_count(red_owner(rasterise(on, camera).part), on.count),
        occluded=(fraction < FRACTION_MIN) | (visible < PIXELS_MIN),
        fused=fused_in_frame(frame, marker, rest),
    )


def visibility_advice(design: Design, markers: Markers, occluded: IntArray, fused: IntArray) -> str:
    """Say which markers cannot be seen or told apart, and what usually mends it; "" if none.

    Parameters
    ----------
    occluded, fused : (k,) int
        Marker ids.
    """
    parts = []
    for ids, what in ((occluded, "hidden"), (fused, "fused with another of their colour")):
        if len(ids):
            rows = np.unique(markers.row[ids])
            where = f"rows {rows[0]} to {rows[-1]}: " if markers.in_rows else ""
            shown = ", ".join(str(i) for i in ids[:5]) + (", …" if len(ids) > 5 else "")
            parts.append(f"{len(ids)} markers {what} ({where}{shown})")
    if not parts:
        return ""
    layout, mends = design.layout, []
    if layout.heights == "linear" and layout.height_far_mm <= layout.height_near_mm:
        mends.append("let heights grow away from the camera (height_far_mm > height_near_mm)")
    if layout.kind == "straight":
        mends.append('use layout.kind = "spiral"')
    if len(set(layout.colours)) == 1 and len(fused):
        mends.append("use two colours")
    fewer = "rows or columns" if layout.kind in {"spiral", "straight"} else "markers"
    mends.append(f"use fewer {fewer}, a narrower band_marker_mm, or more camera pixels")
    return f"the camera cannot tell every marker: {' and '.join(parts)}; {', or '.join(mends)}"


def _count(owner: NDArray[np.int32], markers: int) -> IntArray:
    """Pixels of each marker in an owner image (-1 for none), (n,)."""
    return np.bincount(owner[owner >= 0], minlength=markers).astype(np.int64)


def _means(
    buffers: Buffers, marker: NDArray[np.int32], scene: Scene, camera: Camera
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Visible pixels (n,), their mean (n, 2) px, and the mean (n, 3) mm of what they see."""
    y, x = np.nonzero(marker >= 0)
    owner = marker[y, x]
    count = np.bincount(owner, minlength=scene.count).astype(np.int64)
    points = points_seen(scene, camera, buffers, y, x)
    columns = np.column_stack([x, y, points]).T
    sums = [np.bincount(owner, weights=c, minlength=scene.count) for c in columns]
    means = np.full((scene.count, 5), np.nan)
    np.divide(np.stack(sums, axis=1), count[:, None], out=means, where=count[:, None] > 0)
    return count, means[:, :2], means[:, 2:]


def fused_in_frame(frame: ImageArray, marker: NDArray[np.int32], scene: Scene) -> BoolArray:
    """Markers that the decoder's segmentation of ``frame`` (BGR) does not tell apart, (n,)."""
    model = ColourModel.from_rgb(paints_of(scene.paints))
    blobs = segment(frame, model, with_labels=True)
    paint = np.array([model.names.index(name) for name in scene.paints])
    return fused_markers(np.asarray(blobs.labels), blobs.colour, marker, paint[scene.colour])


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
    both = (marker >= 0) & (labels > 0)
    blob, owner = labels[both] - 1, marker[both].astype(np.int64)
    same = blob_colour[blob] == marker_colour[owner]
    n = len(marker_colour)
    pair, pixels = np.unique(blob[same] * n + owner[same], return_counts=True)
    pair = pair[pixels >= PIXELS_FUSED]
    crowded = np.bincount(pair // n, minlength=len(blob_colour)) > 1
    fused = np.zeros(n, dtype=bool)
    fused[(pair % n)[crowded[pair // n]]] = True
    return fused
