"""Which blob is which marker: the assignment whose shifts are the smoothest over the lattice.

A shell bends smoothly: neighbouring markers shift alike. Each marker chooses one of the blobs of
its colour nearby, or none, so that the shifts of neighbours differ as little as possible over
their distance. The choice is that of min-sum belief propagation on the graph of neighbours
(Pearl 1988; truncated costs as in Felzenszwalb and Huttenlocher 2006). Unlike the nearest blob it
is right for motions larger than the distance between markers, as long as neighbours stay together.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class LatticeSettings:
    """Costs of an assignment; a strain is a difference of shifts over the distance at rest.

    Attributes
    ----------
    candidates : int
        Blobs that each marker may choose from, nearest first.
    strain_max : float
        Larger strains cost no more: paint of another marker, or a marker that is not where its
        neighbours are. Another marker of the same colour is at a strain of about 1 or more.
    unseen_strain : float
        A marker without a blob costs as much as this strain to each neighbour. Loads strain the
        picture by less than 0.2.
    prior : float
        Square of a shift of one marker distance against the expected position counts this much:
        it decides only where the lattice does not.
    iterations_max, settled : int, float
        Of belief propagation, each over one more ring of neighbours; it ends when no cost changes
        by more than this.
    """

    candidates: int = 5
    strain_max: float = 1.0
    unseen_strain: float = 0.4
    prior: float = 0.02
    iterations_max: int = 15
    settled: float = 0.01


SETTINGS = LatticeSettings()
_COMPLEX = np.array([1.0, 1.0j])


def smoothest_shifts(
    blob_px: FloatArray,
    blob_colour: IntArray,
    *,
    rest_px: FloatArray,
    expected_px: FloatArray,
    colour: IntArray,
    neighbours: IntArray,
    spacing_px: FloatArray,
) -> FloatArray:
    """Shifts (n, 2) px of n markers to the blobs that they choose; NaN for those that choose none.

    Parameters
    ----------
    blob_px : (m, 2) float
        Centroids of blobs.
    blob_colour, colour : (m,), (n,) int
        Colours of blobs and markers.
    rest_px, expected_px : (n, 2) float
        Positions at rest, and where markers are looked for.
    neighbours : (n, 8) int
        Neighbours of each marker; -1 or n for none.
    spacing_px : (n,) float
        Distance at rest to the nearest other marker of the same colour.
    """
    # Points as complex numbers: one array, and ``abs`` is the distance.
    blob, rest, expected = (points @ _COMPLEX for points in (blob_px, rest_px, expected_px))
    none = SETTINGS.candidates
    shift = np.full((none + 1, len(rest)), complex(np.nan, np.nan))
    number = np.full(shift.shape, -1)
    for paint in np.unique(colour):
        ids, blobs = np.flatnonzero(colour == paint), np.flatnonzero(blob_colour == paint)
        near = blobs[_nearest_columns(blob[blobs] - expected[ids, None], none).T]
        number[: len(near), ids], shift[: len(near), ids] = near, blob[near] - rest[ids]
    own_cost = SETTINGS.prior * np.abs((shift - (expected - rest)) / spacing_px) ** 2
    own_cost = np.where(np.isfinite(own_cost), own_cost, 1e3).astype(np.float32)
    own_cost[none] = SETTINGS.prior  # a marker without neighbours takes a blob within its spacing
    to, of, back = directed_edges(neighbours)
    # Costs (k, k, e) of the choices of the marker that an edge is of, and of the one it is to.
    seen = np.nan_to_num(shift).astype(np.complex64)
    strain = np.abs(seen.take(of, axis=1)[:, None] - seen.take(to, axis=1))
    strain /= np.abs(rest[to] - rest[of]).astype(np.float32)
    strain = np.minimum(strain, np.float32(SETTINGS.strain_max))
    strain[none] = strain[:, none] = SETTINGS.unseen_strain
    cost = _propagated(own_cost, strain * strain, to, of, back)
    chosen, each = np.argmin(cost, axis=0), np.arange(len(rest))
    # A blob that several markers chose, as hidden ones may, is the one's with the least cost.
    cheapest = np.argsort(cost[chosen, each], kind="stable")
    first = cheapest[np.unique(number[chosen, each][cheapest], return_index=True)[1]]
    chosen[np.setdiff1d(each, first)] = none
    out = shift[chosen, each]
    # The entry for "none" is NaN.
    return np.column_stack([out.real, out.imag])


def _nearest_columns(gap: NDArray[np.complex128], count: int) -> IntArray:
    """Columns (n, k) of the ``count`` smallest gaps (n, m) in each row, smallest first."""
    square = gap.real**2 + gap.imag**2
    if square.shape[1] <= count:
        return np.argsort(square, axis=1)
    few = np.argpartition(square, count, axis=1)[:, :count]
    order = np.argsort(np.take_along_axis(square, few, axis=1), axis=1)
    return np.asarray(np.take_along_axis(few, order, axis=1))


def directed_edges(neighbours: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Edges to and of markers, both (e,) and ordered by ``to``, and each one's reverse (e,)."""
    count = len(neighbours)
    to, of = np.repeat(np.arange(count), neighbours.shape[1]), neighbours.ravel()
    known = (of >= 0) & (of < count)
    to, of = to[known], of[known]
    key = np.unique(np.concatenate([to * count + of, of * count + to]))
    to, of = np.divmod(key, count)
    return to, of, np.searchsorted(key, of * count + to)


def _propagated(
    own_cost: NDArray[np.float32],
    strain_cost: NDArray[np.float32],
    to: IntArray,
    of: IntArray,
    back: IntArray,
) -> NDArray[np.float32]:
    """Costs (k, n) of all choices with those of the neighbours, from (k, n) and (k, k, e)."""
    reached, first = np.unique(to, return_index=True)
    message, cost = np.zeros((len(own_cost), len(to)), dtype=np.float32), own_cost
    for _ in range(SETTINGS.iterations_max if len(to) else 0):
        others = cost.take(of, axis=1) - message.take(back, axis=1)
        message = (strain_cost + others[:, None]).min(axis=0)
        message -= message.min(axis=0)
        before, cost = cost, own_cost.copy()
        cost[:, reached] += np.add.reduceat(message, first, axis=1)
        if np.abs(cost - before).max() < SETTINGS.settled:
            break
    return cost
