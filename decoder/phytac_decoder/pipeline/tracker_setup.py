"""What following needs of each marker, measured in one rest frame of a camera."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.io.bundle import Bundle, CameraView
from phytac_decoder.pipeline.decode import locate_in
from phytac_decoder.vision.matching import nearest_same_colour_px, neighbour_median
from phytac_decoder.vision.segmentation import Blobs, segment
from phytac_decoder.vision.switch_detection import RED_AREA_MIN_px
from phytac_decoder.vision.windows import Moments, PaintWindows
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray


@dataclass(frozen=True, kw_only=True)
class RestSettings:
    """How windows are chosen; set on rendered frames of the catalogue's designs.

    Attributes
    ----------
    rivals_max : int
        Spots of one paint that a window is cut against.
    blob_reach : float
        A blob is a marker's if it is nearer than this share of the distance to the next marker of
        its colour.
    border_weight : float
        A marker is not separable if more than this share of its paint lies on the border to
        another one.
    extent_ratio : float
        A blob that reaches this many times as far as its neighbours' holds several markers.
    extent_min_px : float
        Least distance from a marker's centre to the edge of its paint.
    stride_area_px : float
        Smaller markers are read whole whatever the stride.
    tip_half, tip_samples : float
        From a tip's centre to the edge of its window, over the root of its area, which holds tips
        up to three times as long as wide; and samples across a tip.
    """

    rivals_max: int = 8
    blob_reach: float = 0.6
    border_weight: float = 0.1
    extent_ratio: float = 1.5
    extent_min_px: float = 2.0
    stride_area_px: float = 120.0
    tip_half: float = 0.85
    tip_samples: float = 5.0


SETTINGS = RestSettings()


@dataclass(frozen=True, kw_only=True)
class RestFrame:
    """Markers that one camera shows, and its tips; arrays over m markers, t tips.

    Attributes
    ----------
    ids : (m,) int
        Markers of the bundle.
    neighbours : (m, 8) int
        As in the bundle, numbered as ``ids``; m for none.
    rest_px : (m, 2) float
        Position at rest.
    at_rest : Moments
        Paint of each in the rest frame.
    separable : (m,) bool
        Markers that can be distinguished from others of their colour at rest.
    spacing_px : (m,) float
        Distance at rest to the nearest other marker of the colour.
    rivals : (m, r) int
        Markers of the same colour nearby, nearest first; m for none.
    paint : PaintWindows
        Of the markers.
    tips : (t,) int
        Tips that can show, numbered as ``ids``.
    tip_px : (t, 2) float
        Position of each when out and nothing is deformed, minus the marker's rest position.
    red : PaintWindows
        Of the tips.
    """

    ids: IntArray
    neighbours: IntArray
    rest_px: FloatArray
    at_rest: Moments
    separable: BoolArray
    spacing_px: FloatArray
    rivals: IntArray
    paint: PaintWindows
    tips: IntArray
    tip_px: FloatArray
    red: PaintWindows


def measure_rest(
    bundle: Bundle, number: int, frame: ImageArray, *, margin_px: float, stride: int
) -> RestFrame:
    """Find all markers of a rest frame, and where, how large and how bright each is.

    Raises
    ------
    InputError
        If it is no frame of this camera, see :func:`phytac_decoder.pipeline.decode.locate_in`.
    """
    shown = bundle.shown_by(number)
    matched, _ = locate_in(bundle, number, frame)
    size = (bundle.cameras[number].width_px, bundle.cameras[number].height_px)
    ids = np.flatnonzero(np.isfinite(shown.rest_px).all(axis=1))
    colour, count = bundle.colour[ids], len(ids)
    spacing = nearest_same_colour_px(shown.rest_px[ids], colour)
    order = np.full(len(bundle.colour) + 1, count)
    order[ids] = np.arange(count)
    neighbours = order[bundle.model.neighbours[ids]]
    # Touching markers of one colour are one blob, which is matched to one of them: it then lies
    # off the position that the neighbours' motion predicts, and the other has no blob.
    off = matched.position_px[ids] - shown.rest_px[ids]
    usual = np.nan_to_num(neighbour_median(off, neighbours))
    right = np.hypot(*(off - usual).T) < 0.25 * spacing
    place = shown.rest_px[ids] + np.where(right[:, None], off, usual)
    blobs = segment(frame, bundle.colours, with_labels=True)
    xy, owner = _owned_pixels(blobs, place, colour, spacing)
    reach = _extent(xy, owner, place, neighbours)
    rivals = nearest_rivals(place, colour)
    tables = bundle.colours.coverage_tables
    paint = PaintWindows(
        half_px=reach + margin_px,
        paint=colour,
        tables=tables,
        rivals=rivals,
        size_px=size,
        stride=np.where(np.bincount(owner, minlength=count) >= SETTINGS.stride_area_px, stride, 1),
    )
    start = place
    for _ in range(4):  # until the centroids of touching markers have settled
        at_rest = paint.look(frame, place)
        moved = np.hypot(*(at_rest.centroid_px - start).T)
        sure = (at_rest.weight > 0.0) & (moved < 0.5 * np.minimum(spacing, 1e6))
        place = np.where(sure[:, None], at_rest.centroid_px, place)
    red_table = tables[bundle.colours.names.index("red")]
    tips, red = _tip_windows(shown, ids, red_table, margin_px, size)
    return RestFrame(
        ids=ids,
        neighbours=neighbours,
        rest_px=place,
        at_rest=at_rest,
        separable=_separable(paint.border_weight(frame), at_rest.weight, rivals),
        spacing_px=spacing,
        rivals=rivals,
        paint=paint,
        tips=tips,
        tip_px=shown.tips.on_px[ids[tips]] - shown.rest_px[ids[tips]],
        red=red,
    )


def _tip_windows(
    shown: CameraView, ids: IntArray, table: FloatArray, margin_px: float, size_px: tuple[int, int]
) -> tuple[IntArray, PaintWindows]:
    """Tips that can show, and the windows of their red."""
    on_px, area = shown.tips.on_px[ids], shown.tips.red_on_px[ids]
    tips = np.flatnonzero(np.isfinite(on_px[:, 0]) & (area > RED_AREA_MIN_px))
    across = np.sqrt(area[tips])
    red = np.zeros(len(tips), dtype=np.int64)
    return tips, PaintWindows(
        half_px=SETTINGS.tip_half * across + margin_px / 2.0,
        paint=red,
        tables=np.asarray(table[None], dtype=np.float32),
        rivals=nearest_rivals(on_px[tips], red),
        size_px=size_px,
        stride=np.maximum((across / SETTINGS.tip_samples).astype(np.int64), 1),
    )


def nearest_rivals(place_px: FloatArray, colour: IntArray) -> IntArray:
    """Nearest others (n, r) of the same colour, nearest first; n where there are no more."""
    square = np.sum((place_px[:, None] - place_px[None]) ** 2, axis=2)
    square[colour[:, None] != colour[None]] = np.inf
    np.fill_diagonal(square, np.inf)
    order = np.argsort(square, axis=1)[:, : SETTINGS.rivals_max]
    known = np.isfinite(np.take_along_axis(square, order, axis=1))
    return np.where(known, order, len(place_px))


def _owned_pixels(
    blobs: Blobs, place: FloatArray, colour: IntArray, spacing: FloatArray
) -> tuple[IntArray, IntArray]:
    """Painted pixels (p, 2) of blobs that belong to a marker, and the marker of each (p,)."""
    gap = np.linalg.norm(blobs.centroid_px[:, None] - place[None], axis=2)
    gap[blobs.colour[:, None] != colour[None]] = np.inf
    nearest = np.argmin(gap, axis=1)
    near = gap.min(axis=1) <= SETTINGS.blob_reach * np.minimum(spacing[nearest], 1e6)
    owner = np.append(-1, np.where(near, nearest, -1))
    labels = np.asarray(blobs.labels)
    y, x = np.nonzero(labels)
    owned = owner[labels[y, x]]
    return np.column_stack([x, y])[owned >= 0], owned[owned >= 0]


def _extent(xy: IntArray, owner: IntArray, place: FloatArray, neighbours: IntArray) -> FloatArray:
    """How far (m,) px each marker's paint reaches from its centre, in x or y."""
    reach = np.zeros(len(place))
    np.maximum.at(reach, owner, np.abs(xy - place[owner]).max(axis=1) + 0.5)
    known = np.where(reach > 0.0, reach, np.nan)
    usual = neighbour_median(known[:, None], neighbours)[:, 0]
    overall = np.nanmedian(known) if np.isfinite(known).any() else SETTINGS.extent_min_px
    usual = np.where(np.isfinite(usual), usual, overall)
    # fmin: an unknown extent is the neighbours'.
    out = np.fmin(known, SETTINGS.extent_ratio * usual)
    return np.maximum(np.where(np.isfinite(known), out, usual), SETTINGS.extent_min_px)


def _separable(border: FloatArray, weight: FloatArray, rivals: IntArray) -> BoolArray:
    """Markers (m,) that can be distinguished from others, by the paint on their borders."""
    touching = border > SETTINGS.border_weight * weight
    out = np.append(~touching, True)  # the last entry stands for "no rival"
    out[rivals[touching, 0]] = False
    return out[:-1]
