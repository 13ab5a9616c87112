"""Interactions of simultaneous contacts: marker shifts beyond the sum of single contacts.

Koiter's second-order term of several forces contains f²·S₂ of each and a mixed term of each two, ::

    d ⊃ f₁·f₂·M(place₁, place₂)

since the stress and rotation of one contact stiffen or soften the wall for the other. Strong
contacts bring a curved wall nearer to buckling together than each does alone. With the share a of
the stiffness that a newton takes away at each place (:attr:`ResponseTable.softening`), the contacts
leave at place i ::

    1 - λᵢ    λᵢ = Σₖ ρᵢₖ·aₖ·fₖ

of it, where ρᵢₖ says how far M of two places is that of two contacts on one place: 1 there, less
further away, and negative where they stiffen the wall for each other. What a contact does beyond
linear shifts is as 1 / (1 - λᵢ) in place of 1 / (1 - aᵢ·fᵢ), and an interaction as that of the mean
of both λ (derived here: exact where all contacts are on one place). Checked by solutions with large
displacements on ``cylinder60``: two to five discs of 3 to 25 N, 4 to 31 mm apart.

Most of M, over all places, lies in a space of some hundred dimensions: tabulated are the axes of
that space, and the coordinates of M over pairs of places.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray

SHARE_MAX = 0.3
"""Largest interaction of second order over the shifts of each contact alone, before it grows: the
tables do not hold for contacts that nearly coincide."""
STIFFNESS_MIN = 0.2
"""Share of the stiffness that contacts leave, at least, in how nonlinear shifts grow."""


@dataclass(frozen=True, kw_only=True)
class InteractionTable:
    """Interactions over each two of p places.

    Attributes
    ----------
    grid : ResponseTable
        The places; their rows (p, p, r) are coordinates of M.
    axes_px : (r, 2n) float32
        Images of the coordinates, px/N².
    """

    grid: ResponseTable
    axes_px: NDArray[np.float32]

    def scaled(self, stiffness: float) -> "InteractionTable":
        """Return the table of a sensor stiffer by a factor."""
        return replace(self, axes_px=self.axes_px / np.float32(stiffness**2))

    def between(self, points_mm: FloatArray) -> NDArray[np.float32]:
        """Return M (k, 2n) px/N² of each two of points (c, 3), in the order of ``tril_indices``."""
        return np.asarray(self.coordinates(points_mm) @ self.axes_px)

    def coordinates(self, points_mm: FloatArray) -> NDArray[np.float32]:
        """Return the coordinates (k, r) of :meth:`between`."""
        places, counts = self.grid.shares(points_mm)
        own, weight = places.tolist(), counts.astype(np.float32)
        rows = [
            weight[k] @ (weight[i] @ self._block(own[i], own[k])).reshape(weight.shape[1], -1)
            for i, k in _each_two(len(points_mm))
        ]
        return np.stack(rows)

    def _block(self, one: int, other: int) -> NDArray[np.float32]:
        """Return coordinates (q, q·r) of M over the places around two places."""
        block = self._blocks.get((one, other))
        if block is None:
            # 128 blocks, of 200 kB each for cylinder60.
            if len(self._blocks) >= 128:
                del self._blocks[next(iter(self._blocks))]
            near, _ = self.grid.fits
            block = self.grid.shift_px[near[one][:, None], near[other]]
            block = self._blocks[one, other] = block.reshape(near.shape[1], -1)
        return block

    @cached_property
    def _blocks(self) -> dict[tuple[int, int], NDArray[np.float32]]:
        """Blocks of recent pairs of places: contacts stay for many iterations and frames."""
        return {}


@dataclass(kw_only=True)
class InteractionCache:
    """Interactions during one fit, computed again where contacts have moved.

    Attributes
    ----------
    pairs : InteractionTable
        The table.
    """

    pairs: InteractionTable
    _points_mm: FloatArray | None = None
    _images: NDArray[np.float32] | None = None

    def between(self, points_mm: FloatArray) -> NDArray[np.float32]:
        """Return M of points (c, 3), or of earlier points less than 0.05 mm away.

        M changes over millimetres, and is a few percent of the response.
        """
        last = self._points_mm
        if self._images is None or last is None or np.abs(points_mm - last).max() > 0.05:
            self._images, self._points_mm = self.pairs.between(points_mm), points_mm
        return self._images


def interaction_likeness(
    images: NDArray[np.float32] | FloatArray, square_px: NDArray[np.float32] | FloatArray
) -> FloatArray:
    """Return ρ (c, c) of each two contacts; 1 of each with itself, and -1 at least.

    Parameters
    ----------
    images : (k, 2n) float
        M px/N² of each two, by the tables.
    square_px : (c, 2n) float
        S₂ at the place of each contact, px/N²: half of M of two contacts there.
    """
    out = np.eye(len(square_px))
    i, k = np.array(_each_two(len(square_px))).T
    # Single precision has no 1e-300: there it is 0.
    square_px = np.asarray(square_px, dtype=np.float64)
    size = np.sqrt(np.einsum("cn,cn->c", square_px, square_px))
    mean = square_px[i] + square_px[k]
    length = np.sqrt(np.einsum("kn,kn->k", mean, mean))
    along = np.einsum("kn,kn->k", images, mean) / np.maximum(length, 1e-300)
    own_px = 2.0 * np.sqrt(size[i] * size[k])
    alike = np.clip(along / np.maximum(own_px, 1e-300), -1.0, 1.0)
    # A place whose shifts are linear has nothing to compare.
    out[i, k] = out[k, i] = np.where(own_px > 0.0, alike, 0.0)
    return out


@dataclass(frozen=True, kw_only=True)
class InteractionGrowth:
    """Growth of nonlinear shifts by the stiffness that c contacts take away together.

    Attributes
    ----------
    own, by_own : (c,), (c, c) float
        Factors on the nonlinear shifts of each contact, and their derivatives by the share of the
        stiffness that each takes away.
    pair, by_pair : (k,), (k, c) float
        The same of each two.
    """

    own: FloatArray
    by_own: FloatArray
    pair: FloatArray
    by_pair: FloatArray

    @classmethod
    def of(cls, likeness: FloatArray, lost: FloatArray) -> "InteractionGrowth":
        """Growth by :func:`interaction_likeness` and the shares (c,) that each takes away."""
        i, k = np.array(_each_two(len(lost))).T
        left, alone = 1.0 - likeness @ lost, np.maximum(1.0 - lost, STIFFNESS_MIN)
        both, slope = 0.5 * (left[i] + left[k]), 0.5 * (likeness[i] + likeness[k])
        own = alone / np.maximum(left, STIFFNESS_MIN)
        by_own = (np.where(left > STIFFNESS_MIN, own**2 / alone, 0.0))[:, None] * likeness
        by_own -= np.diag(np.where(alone > STIFFNESS_MIN, own / alone, 0.0))
        pair = 1.0 / np.maximum(both, STIFFNESS_MIN)
        by_pair = np.where(both > STIFFNESS_MIN, pair**2, 0.0)[:, None] * slope
        return cls(own=own, by_own=by_own, pair=pair, by_pair=by_pair)


def add_interactions(
    images: NDArray[np.float32] | FloatArray,
    likeness: FloatArray,
    force_N: FloatArray,
    softening: FloatArray,
    parts: Sequence[tuple[FloatArray, FloatArray]],
    linear_px: Sequence[FloatArray],
    *,
    size_px: FloatArray | None = None,
) -> list[tuple[FloatArray, FloatArray]]:
    """Return shifts and slopes of c contacts with their interactions.

    Parameters
    ----------
    images : (k, 2n) float
        M px/N² of each two, see :meth:`InteractionTable.between`.
    likeness : (c, c) float
        See :func:`interaction_likeness`.
    force_N, softening : (c,) float
        Forces of the contacts, and the share of the stiffness that a newton of each takes away.
    parts : sequence of ((2n,), (u, 2n)) float
        Shifts of each, and their slopes by its unknowns, of which the first is the force; the
        slopes are changed. They leave out the small change of M with the places, and of what grows.
    linear_px : sequence of (2n,) float
        Linear shifts of each by a newton.
    size_px : (k,) float, optional
        Size of M by the tables, which :data:`SHARE_MAX` is about; that of the images by default.
    """
    count = len(parts)
    size = np.array([np.linalg.norm(total) for total, _ in parts])
    # Strictly below the diagonal, row by row, as the images.
    i, k = np.array(_each_two(count)).T
    pair, own = np.arange(len(images)), np.arange(count)
    both = force_N[i] * force_N[k]
    much = both * (np.linalg.norm(images, axis=1) if size_px is None else size_px)
    share = np.minimum(1.0, SHARE_MAX * np.minimum(size[i], size[k]) / np.maximum(much, 1e-300))
    grows = InteractionGrowth.of(likeness, softening * force_N)
    rows = [total - f * row for (total, _), f, row in zip(parts, force_N, linear_px, strict=True)]
    rows += [slope[0] - row for (_, slope), row in zip(parts, linear_px, strict=True)]
    of = np.zeros((2, count, 2 * count + len(images)))
    of[0, own, own] = of[1, own, count + own] = grows.own - 1.0
    of[1, :, :count] = (grows.by_own * softening).T
    at = of[:, :, 2 * count :]
    at[0, i, pair] = at[0, k, pair] = 0.5 * both * share * grows.pair
    at[1] = ((both * share)[:, None] * grows.by_pair * softening).T
    at[1, i, pair] += force_N[k] * share * grows.pair
    at[1, k, pair] += force_N[i] * share * grows.pair
    stack = np.concatenate([np.array(rows, dtype=images.dtype), images])
    more = of.reshape(2 * count, -1).astype(images.dtype) @ stack
    out = []
    for (total, slope), add, steeper in zip(parts, *more.reshape(2, count, -1), strict=True):
        slope[0] += steeper
        out.append((total + add, slope))
    return out


def _each_two(count: int) -> list[tuple[int, int]]:
    return [(i, k) for i in range(count) for k in range(i)]
