"""What contacts at once do to the markers' images, beyond the sum of what each does alone.

Koiter's second term of several forces holds, besides each one's own f²·S₂, a mixed term for each
two of them, ::

    d ⊃ f₁·f₂·M(place₁, place₂)

since one contact's stress and turn stiffen or soften the wall for the other. Images M of all places
lie, but for a few hundredths, in a space of some dozen dimensions: tabulated are that space's
axes, and M's coordinates over pairs of places.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray

INTERACTION_SHARE_MAX = 0.3
"""Largest mixed term over what each of the two does alone: contacts that all but cover each other
are no pair."""

NEAR_MM = 0.05
"""M changes over a patch, of some millimetres, and is a few hundredths of the response."""
KEPT = 128
"""Pairs of places whose blocks are kept; one of cylinder60 holds 100 kB."""


@dataclass(frozen=True, kw_only=True)
class InteractionTable:
    """Mixed terms over each two of p places.

    Attributes
    ----------
    grid : Places
        The places; their rows (p, p, r) are coordinates of M.
    axes_px : (r, 2n) float32
        Images, px/N², that these count.
    """

    grid: ResponseTable
    axes_px: NDArray[np.float32]

    def scaled(self, stiffness: float) -> "InteractionTable":
        """Those of a sensor that is stiffer by a factor."""
        return replace(self, axes_px=self.axes_px / np.float32(stiffness**2))

    def between(self, points_mm: FloatArray) -> NDArray[np.float32]:
        """M (k, 2n) px/N² of each two of points (c, 3), in the order of ``numpy.tril_indices``."""
        places, counts = self.grid.shares(points_mm)
        own, weight = places.tolist(), counts.astype(np.float32)
        rows = [
            weight[k] @ (weight[i] @ self._block(own[i], own[k])).reshape(weight.shape[1], -1)
            for i, k in _each_two(len(points_mm))
        ]
        return np.asarray(np.stack(rows) @ self.axes_px)

    def _block(self, one: int, other: int) -> NDArray[np.float32]:
        """Coordinates (q, q·r) of M over the places around two places."""
        block = self._blocks.get((one, other))
        if block is None:
            if len(self._blocks) >= KEPT:
                # The oldest.
                del self._blocks[next(iter(self._blocks))]
            near, _ = self.grid.fits
            block = self.grid.shift_px[near[one][:, None], near[other]]
            block = self._blocks[one, other] = block.reshape(near.shape[1], -1)
        return block

    @cached_property
    def _blocks(self) -> dict[tuple[int, int], NDArray[np.float32]]:
        """Contacts stay where they are for many rounds, and frames."""
        return {}


@dataclass(kw_only=True)
class InteractionCache:
    """Mixed terms while one fit moves its contacts: made anew where they have moved.

    Attributes
    ----------
    pairs : Pairs
        Tables.
    """

    pairs: InteractionTable
    _points_mm: FloatArray | None = None
    _images: NDArray[np.float32] | None = None

    def between(self, points_mm: FloatArray) -> NDArray[np.float32]:
        """Those of points (c, 3), or of others less than :data:`NEAR_MM` away; as of the pairs."""
        last = self._points_mm
        if self._images is None or last is None or np.abs(points_mm - last).max() > NEAR_MM:
            self._images, self._points_mm = self.pairs.between(points_mm), points_mm
        return self._images


def add_interactions(
    images: NDArray[np.float32],
    force_N: FloatArray,
    parts: Sequence[tuple[FloatArray, FloatArray]],
) -> list[tuple[FloatArray, FloatArray]]:
    """Add mixed terms of c contacts to what each does alone.

    Parameters
    ----------
    images : (k, 2n) float32
        M px/N² of each two, see :meth:`InteractionTable.between`.
    force_N : (c,) float
        Of the contacts.
    parts : sequence of ((2n,), (u, 2n)) float
        Shifts of each, and their slopes by its unknowns, of which the first is the force: these
        are changed. How M goes with the places is left out of them: it goes little.
    """
    size = np.array([np.linalg.norm(total) for total, _ in parts])
    # Strictly below the diagonal, row by row, as those are.
    i, k = np.array(_each_two(len(parts))).T
    both = force_N[i] * force_N[k]
    much = both * np.linalg.norm(images, axis=1)
    share = np.minimum(
        1.0, INTERACTION_SHARE_MAX * np.minimum(size[i], size[k]) / np.maximum(much, 1e-300)
    )
    of, pair = np.zeros((2, len(parts), len(images))), np.arange(len(images))
    of[0, i, pair] = of[0, k, pair] = 0.5 * both * share
    of[1, i, pair], of[1, k, pair] = force_N[k] * share, force_N[i] * share
    more = (of.astype(np.float32).reshape(-1, len(images)) @ images).reshape(2, len(parts), -1)
    out = []
    for (total, slope), add, grows in zip(parts, *more, strict=True):
        slope[0] += grows
        out.append((total + add, slope))
    return out


def _each_two(count: int) -> list[tuple[int, int]]:
    return [(i, k) for i in range(count) for k in range(i)]
