"""What following needs to know of each marker, learnt from one rest frame of a camera."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.io.bundle import Bundle, CameraView
from phytac_decoder.pipeline.decode import locate_in
from phytac_decoder.vision.colour_codes import Floats32, Picture, coverage_tables
from phytac_decoder.vision.matching import nearest_same_colour_px
from phytac_decoder.vision.segmentation import Blobs, segment
from phytac_decoder.vision.switch_detection import RED_AREA_MIN_px
from phytac_decoder.vision.windows import Moments, Windows, window_order
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray

RIVALS_MAX = 8
"""Most spots of one paint that a spot's window is cut against."""
REACH = 0.6
"""A blob is a marker's if it is nearer than this share of the way to the next of its colour."""
BORDER_SHARE, BORDER_ACROSS = 0.1, 0.5
"""A marker is not told from another one if more than this share of its paint lies on the border to
it, or if the border through the paint is longer than this share of the root of its area."""
EXTENT_RATIO = 1.5
"""A blob that reaches this many times as far as its neighbours' holds more than one marker."""
SKEW_SHARE = 0.2
"""A border lies at most this share of the way between two spots from the middle."""
ROUNDS = 4
"""Looks at the rest frame until markers that touch have parted."""
TIP_HALF = 0.85
"""From a tip's centre to the edge of its window, over the root of its area: all of a tip that is
less than three times as long as it is wide."""
TIP_SAMPLES = 5.0
"""Samples across a tip that tell how much of it shows."""
STRIDE_LEAST_px = 120
"""Smaller markers are read whole whatever the stride."""
MARGINS = (0.6, 1.25)
"""The margin of small, far markers and of large, near ones, over the usual one: these move more."""
LEAST_HALF_px = 2.0
DIRECTIONS = 16
"""In which a blob's reach is learnt; even."""


@dataclass(frozen=True, kw_only=True)
class Learnt:
    """Markers that one camera shows, and its tips; arrays over m markers, t tips.

    Attributes
    ----------
    ids : (m,) int
        Markers of the bundle.
    neighbours : (m, 8) int
        As in the bundle, numbered as ``ids``; m for none.
    rest_px : (m, 2) float
        Place at rest.
    at_rest : Moments
        Paint of each in the rest frame.
    parted : (m,) bool
        Markers that can be told from others of their colour at rest.
    apart_px : (m,) float
        Distance at rest to the nearest other marker of its colour.
    rivals : (m, r) int
        Markers of the same colour nearby, nearest first; m for none.
    paint : Windows
        Of the markers.
    tips : (t,) int
        Tips that can show, numbered as ``ids``.
    tip_px : (t, 2) float
        Where each is when out and nothing is deformed, less the marker's rest place.
    red : Windows
        Of the tips.
    picture : Picture
        What both look at.
    """

    ids: IntArray
    neighbours: IntArray
    rest_px: FloatArray
    at_rest: Moments
    parted: BoolArray
    apart_px: FloatArray
    rivals: IntArray
    paint: Windows
    tips: IntArray
    tip_px: FloatArray
    red: Windows
    picture: Picture


def learn(
    bundle: Bundle, number: int, frame: ImageArray, *, margin_px: float, stride: int
) -> Learnt:
    """Find all markers of a rest frame and learn where, how large and how bright each is.

    Raises
    ------
    InputError
        If it is no frame of this camera, see :func:`phytac_decoder.pipeline.decode.locate_in`.
    """
    shown = bundle.shown_by(number)
    matched, _ = locate_in(bundle, number, frame)
    size = (bundle.cameras[number].width_px, bundle.cameras[number].height_px)
    ids = np.flatnonzero(np.isfinite(shown.rest_px).all(axis=1))
    apart = nearest_same_colour_px(shown.rest_px[ids], bundle.colour[ids])
    neighbours = _numbered(bundle.model.neighbours, ids)
    place = _placed(matched.position_px[ids], shown.rest_px[ids], neighbours, apart)
    blobs = segment(frame, bundle.colours, with_labels=True)
    xy, owner = _owned(blobs, place, bundle.colour[ids], apart)
    reach = _extent(xy, owner, place, neighbours)
    area = np.bincount(owner, minlength=len(ids))
    stride_of = np.where(area >= STRIDE_LEAST_px, stride, 1)
    half = reach + margin_px * np.clip(reach / np.median(reach), *MARGINS)
    order = window_order(half, bundle.colour[ids], stride_of, size)
    # In the order of the windows from here on.
    ids, place, apart = ids[order], place[order], apart[order]
    owner = np.argsort(order)[owner]
    colour = bundle.colour[ids]
    rivals = nearest_rivals(place, colour)
    tables = coverage_tables(bundle.colours)
    picture = Picture(size)
    picture.read(frame)
    paint = Windows(
        half_px=half[order],
        reach_px=reach[order],
        paint=colour,
        tables=tables,
        rivals=rivals,
        skew_px=_skew(xy, owner, place, rivals),
        picture=picture,
        stride=stride_of[order],
    )
    place, at_rest = _settled(paint, place, apart)
    table = tables[bundle.colours.names.index("red")]
    tips, red = _red(shown, ids, table, margin_px, picture)
    picture.whole = size[0] * size[1] < paint.convert_cost + red.convert_cost
    picture.read(frame)
    return Learnt(
        ids=ids,
        neighbours=_numbered(bundle.model.neighbours, ids),
        rest_px=place,
        at_rest=at_rest,
        parted=_parted(paint.border_weight(), at_rest.weight, rivals),
        apart_px=apart,
        rivals=rivals,
        paint=paint,
        tips=tips,
        tip_px=shown.tips.on_px[ids[tips]] - shown.rest_px[ids[tips]],
        red=red,
        picture=picture,
    )


def _numbered(neighbours: IntArray, ids: IntArray) -> IntArray:
    """Neighbours (m, 8) of markers ``ids`` by their place in ``ids``; m for none."""
    number = np.full(len(neighbours) + 1, len(ids))
    number[ids] = np.arange(len(ids))
    return number[neighbours[ids]]


def _red(
    shown: CameraView, ids: IntArray, table: Floats32, margin_px: float, picture: Picture
) -> tuple[IntArray, Windows]:
    """Tips that can show, and the windows of their red."""
    on_px, area = shown.tips.on_px[ids], shown.tips.red_on_px[ids]
    tips = np.flatnonzero(np.isfinite(on_px[:, 0]) & (area > RED_AREA_MIN_px))
    across = np.sqrt(area[tips])
    half = TIP_HALF * across + margin_px / 2.0
    stride = np.maximum((across / TIP_SAMPLES).astype(np.int64), 1)
    red = np.zeros(len(tips), dtype=np.int64)
    order = window_order(half, red, stride, picture.codes.shape[::-1])
    tips = tips[order]
    rivals = nearest_rivals(on_px[tips], red)
    return tips, Windows(
        half_px=half[order],
        reach_px=across[order] / 2.0,
        paint=red,
        tables=table[None],
        rivals=rivals,
        skew_px=np.zeros(rivals.shape),
        picture=picture,
        stride=stride[order],
    )


def nearest_rivals(place_px: FloatArray, colour: IntArray) -> IntArray:
    """Nearest others (n, r) of the same colour, nearest first; n where there are no more."""
    count = len(place_px)
    square = np.sum((place_px[:, None] - place_px[None]) ** 2, axis=2)
    square[colour[:, None] != colour[None]] = np.inf
    np.fill_diagonal(square, np.inf)
    order = np.argsort(square, axis=1)[:, :RIVALS_MAX]
    known = np.isfinite(np.take_along_axis(square, order, axis=1))
    return np.where(known, order, count)


def _placed(
    found: FloatArray, expected: FloatArray, neighbours: IntArray, apart: FloatArray
) -> FloatArray:
    """Places (m, 2) to start from: where found, and elsewhere as far off as the neighbours are.

    Two markers of one colour that touch are one blob: the one that is called by its name is then
    found away from where its neighbours say, and the other not at all.
    """
    off = found - expected
    around = np.concatenate([off, np.full((1, 2), np.nan)])[neighbours]
    seen = np.isfinite(around[:, :, 0]).any(axis=1)
    usual = np.zeros_like(off)
    usual[seen] = np.nanmedian(around[seen], axis=1)
    right = np.hypot(*(off - usual).T) < 0.25 * apart
    return np.where(right[:, None], found, expected + usual)


def _owned(
    blobs: Blobs, place: FloatArray, colour: IntArray, apart: FloatArray
) -> tuple[IntArray, IntArray]:
    """Painted pixels (p, 2) of blobs that belong to a marker, and which marker's each is."""
    owner = np.full(len(blobs.colour) + 1, -1)
    for paint in np.unique(colour):
        own, pick = np.flatnonzero(colour == paint), np.flatnonzero(blobs.colour == paint)
        if len(pick) == 0:
            continue
        gap = np.linalg.norm(blobs.centroid_px[pick, None] - place[own][None], axis=2)
        nearest = np.argmin(gap, axis=1)
        near = gap[np.arange(len(pick)), nearest] <= REACH * apart[own[nearest]]
        owner[pick[near] + 1] = own[nearest[near]]
    labels = blobs.labels
    y, x = np.nonzero(labels) if labels is not None else (np.zeros(0, np.int64),) * 2
    whose = owner[labels[y, x]] if labels is not None else np.zeros(0, np.int64)
    return np.column_stack([x, y])[whose >= 0], whose[whose >= 0]


def _extent(xy: IntArray, owner: IntArray, place: FloatArray, neighbours: IntArray) -> FloatArray:
    """How far (m,) px each marker's paint reaches from its centre, in x or y."""
    reach = np.zeros(len(place))
    np.maximum.at(reach, owner, np.abs(xy - place[owner]).max(axis=1) + 0.5)
    reach[reach == 0.0] = np.nan
    around = np.append(reach, np.nan)[neighbours]
    seen = np.isfinite(around).any(axis=1)
    usual = np.full(len(place), np.nanmedian(reach) if np.isfinite(reach).any() else LEAST_HALF_px)
    usual[seen] = np.nanmedian(around[seen], axis=1)
    reach = np.where(np.isfinite(reach), reach, usual)
    return np.maximum(np.minimum(reach, EXTENT_RATIO * usual), LEAST_HALF_px)


def _skew(xy: IntArray, owner: IntArray, place: FloatArray, rivals: IntArray) -> FloatArray:
    """Half of how much farther (m, r) px markers reach towards rivals than these towards them."""
    arm = xy - place[owner]
    reach = np.zeros((DIRECTIONS, len(place) + 1))
    for row, angle in zip(reach, 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS, strict=True):
        np.maximum.at(row, owner, arm @ np.array([np.cos(angle), np.sin(angle)]))
    way = np.concatenate([place, place[-1:]])[rivals] - place[:, None]
    turn = np.arctan2(way[:, :, 1], way[:, :, 0]) * DIRECTIONS / (2.0 * np.pi)
    ahead = np.rint(turn).astype(np.int64) % DIRECTIONS
    back = (ahead + DIRECTIONS // 2) % DIRECTIONS
    skew = (reach[ahead, np.arange(len(place))[:, None]] - reach[back, rivals]) / 2.0
    limit = SKEW_SHARE * np.hypot(way[:, :, 0], way[:, :, 1])
    return np.clip(skew, -limit, limit)


def _parted(border: FloatArray, weight: FloatArray, rivals: IntArray) -> BoolArray:
    """Markers (m,) that can be told from others, by how much paint lies on the borders."""
    one = border > np.minimum(BORDER_SHARE * weight, BORDER_ACROSS * np.sqrt(weight))
    # With it the one that it is not told from; the last entry is of none.
    out = np.append(~one, True)
    out[rivals[one, 0]] = False
    return out[:-1]


def _settled(paint: Windows, place: FloatArray, apart: FloatArray) -> tuple[FloatArray, Moments]:
    """Places after a few looks, each in cells around the last."""
    start, now = place, place
    for _ in range(ROUNDS):
        found = paint.look(now)
        sure: BoolArray = (found.weight > 0.0) & (
            np.hypot(*(found.centroid_px - start).T) < 0.5 * np.minimum(apart, 1e6)
        )
        now = np.where(sure[:, None], found.centroid_px, now)
    return now, found
