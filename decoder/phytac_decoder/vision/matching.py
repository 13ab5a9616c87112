"""Assignment of blobs to markers by k-medoids from the rest frame."""

from dataclasses import dataclass

import numpy as np

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


def nearest_same_colour_px(rest_px: FloatArray, colour: IntArray) -> FloatArray:
    """Distance (n,) of each marker to the nearest other marker of its own colour, px."""
    distance = np.linalg.norm(rest_px[:, None] - rest_px[None], axis=2)
    distance[colour[:, None] != colour[None]] = np.inf
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance.min(axis=1))


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
) -> Matched:
    """Assign every blob to the medoid (expected position) nearest to it, of its own colour.

    As in the paper the number of clusters is known: one per marker, with the rest coordinates as
    first medoids. A marker that its own tip splits into several blobs gets the weighted
    mean of all of them. After each pass the medoids move with the median motion of the marker and
    its neighbours, so that a pressed marker near another one's rest position keeps its identity.

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
    """
    ids = np.flatnonzero(np.isfinite(rest_px).all(axis=1))
    position, merged = np.full_like(rest_px, np.nan), np.zeros(len(rest_px), dtype=np.bool_)
    if len(ids):
        # One more entry, for the neighbour -1.
        number = np.full(len(rest_px) + 1, -1, dtype=np.int64)
        number[ids] = np.arange(len(ids))
        near = number[neighbours[ids]]
        position[ids], merged[ids] = _match_shown(blobs, rest_px[ids], colour[ids], near)
    return Matched(position_px=position, found=np.isfinite(position[:, 0]), merged=merged)


def _match_shown(
    blobs: Blobs, rest_px: FloatArray, colour: IntArray, neighbours: IntArray
) -> tuple[FloatArray, BoolArray]:
    """Positions (n, 2) of markers that are all shown, NaN where not found, and merged ones."""
    gate = 0.6 * np.minimum(nearest_same_colour_px(rest_px, colour), 200.0)
    medoid = rest_px.copy()
    position, owner = np.full_like(rest_px, np.nan), np.full(len(blobs.colour), -1)
    with_own = np.column_stack([np.arange(len(rest_px)), neighbours])
    for _ in range(3):
        owner = _owners(blobs, medoid, colour, gate)
        position = _centroids(blobs, owner, len(rest_px))
        motion = position - rest_px
        shift = np.nan_to_num(neighbour_median(motion, with_own))
        own = np.isfinite(motion[:, 0])
        shift[own] = (shift[own] + motion[own]) / 2.0
        medoid = rest_px + shift
    return position, _merged(blobs, owner, medoid, colour, np.isfinite(position[:, 0]))


def _owners(blobs: Blobs, medoid: FloatArray, colour: IntArray, gate: FloatArray) -> IntArray:
    """Marker (m,) whose medoid is nearest to each blob of its colour, -1 for none."""
    owner = np.full(len(blobs.colour), -1, dtype=np.int64)
    for paint in np.unique(colour):
        ids = np.flatnonzero(colour == paint)
        pick = np.flatnonzero(blobs.colour == paint)
        if len(pick) == 0:
            continue
        distance = np.linalg.norm(blobs.centroid_px[pick, None] - medoid[ids][None], axis=2)
        nearest = np.argmin(distance, axis=1)
        near = distance[np.arange(len(pick)), nearest] <= gate[ids[nearest]]
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
