"""Assignment of blobs to markers by k-medoids."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.vision.lattice_matching import smoothest_shifts
from phytac_decoder.vision.segmentation import Blobs
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Matched:
    """Marker positions found in one image.

    Attributes
    ----------
    position_px : (n, 2) float
        Chroma-weighted centroid of each marker's blobs; NaN where none was found.
    found : (n,) bool
        Whether the marker was seen.
    merged : (n,) bool
        Markers whose paint is one blob with another's: its centroid is that of neither.
    """

    position_px: FloatArray
    found: BoolArray
    merged: BoolArray


def areas_px(matched: Matched, blobs: Blobs, colour: IntArray) -> FloatArray:
    """Area (n,) px of the paint of each marker that is one with no other's; NaN of others.

    ``colour`` (n,) are the markers' paints. Of several blobs of a marker the nearest one counts.
    """
    square = squared_distances(matched.position_px, blobs.centroid_px)
    square[colour[:, None] != blobs.colour] = np.inf
    nearest = np.argmin(np.nan_to_num(square, nan=np.inf), axis=1)
    return np.where(matched.found & ~matched.merged, blobs.weight[nearest], np.nan)


def nearest_same_colour_px(rest_px: FloatArray, colour: IntArray) -> FloatArray:
    """Distance (n,) of each marker to the nearest other marker of its own colour, px."""
    out = np.full(len(rest_px), np.inf)
    for paint in np.unique(colour):
        ids = np.flatnonzero(colour == paint)
        square = squared_distances(rest_px[ids], rest_px[ids])
        np.fill_diagonal(square, np.inf)
        out[ids] = np.sqrt(square.min(axis=1))
    return out


def squared_distances(a_px: FloatArray, b_px: FloatArray) -> FloatArray:
    """Squares (m, n) of the distances of points (m, 2) from points (n, 2)."""
    out = np.subtract.outer(a_px[:, 0], b_px[:, 0])
    out *= out
    down = np.subtract.outer(a_px[:, 1], b_px[:, 1])
    down *= down
    out += down
    return np.asarray(out)


def neighbour_median(values: FloatArray, neighbours: IntArray) -> FloatArray:
    """Median (n, k) of the values (n, k) of each marker's neighbours (n, 8) that are not NaN.

    NaN where none is known. Neighbours are -1 or n beyond a rim.
    """
    around = np.append(values, np.full((1, values.shape[1]), np.nan), axis=0)[neighbours]
    out = np.full_like(values, np.nan)
    some = np.isfinite(around[:, :, 0]).any(axis=1)
    out[some] = np.nanmedian(around[some], axis=1)
    return out


def fill_from_neighbours(motion: FloatArray, neighbours: IntArray) -> FloatArray:
    """Motion (n, 2) with that of unknown markers (NaN) replaced by their neighbours' median.

    0 where none of the neighbours is known.
    """
    lost = ~np.isfinite(motion[:, :1])
    return np.where(lost, np.nan_to_num(neighbour_median(motion, neighbours)), motion)


def match_markers(
    blobs: Blobs,
    *,
    rest_px: FloatArray,
    colour: IntArray,
    neighbours: IntArray,
    expected_px: FloatArray | None = None,
) -> Matched:
    """Assign every blob to the nearest medoid (expected position) of its own colour.

    As in the paper the number of clusters is known: one per marker. The medoids are the rest
    positions, shifted as smoothly over neighbours as the blobs allow
    (:func:`phytac_decoder.vision.lattice_matching.smoothest_shifts`), so that a marker near
    another one's rest position keeps its identity. A marker that its own tip splits into several
    blobs gets the weighted mean of all of them.

    Parameters
    ----------
    blobs : Blobs
        Of the image; colours outside ``colour`` (the red tips) are left alone.
    rest_px : (n, 2) float
        Rest positions; NaN for a marker that the image does not show, which is not looked for.
    colour : (n,) int
        Colour of each marker, as in ``blobs.colour``.
    neighbours : (n, 8) int
        Neighbour ids, -1 beyond a rim.
    expected_px : (n, 2) float, optional
        Where markers are looked for: finite where ``rest_px`` is, which it is if not given.
    """
    ids = np.flatnonzero(np.isfinite(rest_px).all(axis=1))
    position, merged = np.full_like(rest_px, np.nan), np.zeros(len(rest_px), dtype=np.bool_)
    if len(ids):
        # One more entry, for the neighbour -1.
        number = np.full(len(rest_px) + 1, -1, dtype=np.int64)
        number[ids] = np.arange(len(ids))
        near = number[neighbours[ids]]
        expected = rest_px if expected_px is None else expected_px
        position[ids], merged[ids] = _match_shown(
            blobs, rest_px[ids], colour[ids], near, expected[ids]
        )
    return Matched(position_px=position, found=np.isfinite(position[:, 0]), merged=merged)


def _match_shown(
    blobs: Blobs,
    rest_px: FloatArray,
    colour: IntArray,
    neighbours: IntArray,
    expected_px: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """Positions (n, 2) of markers that are all shown, NaN where not found, and merged ones."""
    spacing = np.minimum(nearest_same_colour_px(rest_px, colour), 200.0)
    shift = smoothest_shifts(
        blobs.centroid_px,
        blobs.colour,
        rest_px=rest_px,
        expected_px=expected_px,
        colour=colour,
        neighbours=neighbours,
        spacing_px=spacing,
    )
    medoid = rest_px + fill_from_neighbours(shift, neighbours)
    owner = _owners(blobs, medoid, colour, 0.6 * spacing)
    position = _centroids(blobs, owner, len(rest_px))
    return position, _merged(blobs, owner, medoid, colour, np.isfinite(position[:, 0]))


def _owners(blobs: Blobs, medoid: FloatArray, colour: IntArray, gate: FloatArray) -> IntArray:
    """Marker (m,) whose medoid is nearest to each blob of its colour, -1 for none."""
    owner = np.full(len(blobs.colour), -1, dtype=np.int64)
    for paint in np.unique(colour):
        ids = np.flatnonzero(colour == paint)
        pick = np.flatnonzero(blobs.colour == paint)
        if len(pick) == 0:
            continue
        square = squared_distances(blobs.centroid_px[pick], medoid[ids])
        nearest = np.argmin(square, axis=1)
        near = square[np.arange(len(pick)), nearest] <= gate[ids[nearest]] ** 2
        owner[pick[near]] = ids[nearest[near]]
    return owner


def _centroids(blobs: Blobs, owner: IntArray, count: int) -> FloatArray:
    """Weighted mean (n, 2) of the blobs of each marker, NaN where there is none."""
    own = owner >= 0
    target, weight = owner[own], blobs.weight[own]
    total = np.bincount(target, weights=weight, minlength=count)
    summed = np.column_stack(
        [
            np.bincount(target, weights=weight * blobs.centroid_px[own, k], minlength=count)
            for k in range(2)
        ]
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(summed / np.where(total > 0.0, total, np.nan)[:, None])


def _merged(
    blobs: Blobs, owner: IntArray, medoid: FloatArray, colour: IntArray, found: BoolArray
) -> BoolArray:
    """Markers (n,) that were not found and lie in the paint of another one, and that one."""
    margin_px = 1.5
    out = np.zeros(len(found), dtype=np.bool_)
    named = np.flatnonzero(owner >= 0)
    for lost in np.flatnonzero(~found):
        box = blobs.box_px[named]
        inside = np.all(
            (medoid[lost] >= box[:, :2] - margin_px) & (medoid[lost] <= box[:, 2:] + margin_px),
            axis=1,
        )
        whose = owner[named[inside & (blobs.colour[named] == colour[lost])]]
        out[whose] = True
        out[lost] = len(whose) > 0
    return out
