"""Which blob is which marker: k-medoids-based coordinate matching to the rest frame."""

from dataclasses import dataclass

import numpy as np

from decoder.segmentation import Blobs
from shapes.arrays import BoolArray, FloatArray, IntArray

ROUNDS = 3
"""Passes of assignment; each moves the medoids with their neighbourhood's motion."""


@dataclass(frozen=True, kw_only=True)
class Matched:
    """Marker positions found in one image.

    Attributes
    ----------
    position_px : (n, 2) float
        Chroma-weighted centroid of each marker's blobs; NaN where none was found.
    found : (n,) bool
        Whether the marker was seen.
    """

    position_px: FloatArray
    found: BoolArray


def nearest_same_colour_px(rest_px: FloatArray, colour: IntArray) -> FloatArray:
    """Distance (n,) of each marker to the nearest other marker of its own colour, px."""
    distance = np.linalg.norm(rest_px[:, None] - rest_px[None], axis=2)
    distance[colour[:, None] != colour[None]] = np.inf
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance.min(axis=1))


def match_markers(
    blobs: Blobs,
    *,
    rest_px: FloatArray,
    colour: IntArray,
    neighbours: IntArray,
) -> Matched:
    """Assign every blob to the medoid (expected position) nearest to it, of its own colour.

    As in the paper the number of clusters is known: one per marker, with the rest coordinates as
    first medoids. A marker that paint or its own tip splits into several blobs gets the weighted
    mean of all of them. After each pass the medoids move with the median motion of the marker and
    its neighbours, so that a pressed marker that comes near another one's rest place is still
    called by its own name.

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
    shown = np.isfinite(rest_px).all(axis=1)
    if not shown.all():
        return _match_some(blobs, np.flatnonzero(shown), rest_px, colour, neighbours)
    gate = 0.6 * np.minimum(nearest_same_colour_px(rest_px, colour), 200.0)
    medoid = rest_px.copy()
    position = np.full_like(rest_px, np.nan)
    for _ in range(ROUNDS):
        position = _assign(blobs, medoid, colour, gate)
        motion = position - rest_px
        around = np.concatenate([motion, np.full((1, 2), np.nan)])[neighbours]
        both = np.concatenate([motion[:, None], around], axis=1)
        seen = np.isfinite(both[:, :, 0]).any(axis=1)
        shift = np.zeros_like(rest_px)
        shift[seen] = np.nanmedian(both[seen], axis=1)
        own = np.isfinite(motion[:, 0])
        shift[own] = (shift[own] + motion[own]) / 2.0
        medoid = rest_px + shift
    return Matched(position_px=position, found=np.isfinite(position[:, 0]))


def _match_some(
    blobs: Blobs, ids: IntArray, rest_px: FloatArray, colour: IntArray, neighbours: IntArray
) -> Matched:
    """Match markers ``ids`` (m,) alone; all others are not found."""
    position = np.full_like(rest_px, np.nan)
    if len(ids):
        # One more entry, for the neighbour -1.
        number = np.full(len(rest_px) + 1, -1, dtype=np.int64)
        number[ids] = np.arange(len(ids))
        position[ids] = match_markers(
            blobs,
            rest_px=rest_px[ids],
            colour=colour[ids],
            neighbours=number[neighbours[ids]],
        ).position_px
    return Matched(position_px=position, found=np.isfinite(position[:, 0]))


def _assign(blobs: Blobs, medoid: FloatArray, colour: IntArray, gate: FloatArray) -> FloatArray:
    """Weighted mean (n, 2) of the blobs nearest to each medoid, NaN where there is none."""
    count = len(medoid)
    total = np.zeros(count)
    summed = np.zeros((count, 2))
    for paint in np.unique(colour):
        ids = np.flatnonzero(colour == paint)
        pick = np.flatnonzero(blobs.colour == paint)
        if len(pick) == 0:
            continue
        distance = np.linalg.norm(blobs.centroid_px[pick, None] - medoid[ids][None], axis=2)
        nearest = np.argmin(distance, axis=1)
        near = distance[np.arange(len(pick)), nearest] <= gate[ids[nearest]]
        target, weight = ids[nearest[near]], blobs.weight[pick[near]]
        np.add.at(total, target, weight)
        np.add.at(summed, target, weight[:, None] * blobs.centroid_px[pick[near]])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(summed / np.where(total > 0.0, total, np.nan)[:, None])
