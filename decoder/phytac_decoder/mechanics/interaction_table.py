"""Interactions of simultaneous contacts: marker shifts beyond the sum of single contacts.

Koiter's second-order term of several forces contains f²·S₂ of each and a mixed term of each two, ::

    d ⊃ f₁·f₂·M(place₁, place₂)

since the stress and rotation of one contact stiffen or soften the wall for the other. Two strong
contacts close to each other bring a curved wall nearer to buckling than either alone, and the
interaction is larger than the second-order term by ::

    1 / (1 - (0.4 + 0.9·ρ)·(a₁·f₁ + a₂·f₂))

with the shares a of the stiffness that a newton takes away at each place
(:attr:`ResponseTable.softening`), and ρ the size of M over the geometric mean of those at each
place. The two numbers are chosen by solutions with large displacements on ``cylinder60``: 25 N on
each of two discs, 8 to 45 mm apart, interact 1.4 to 4.3 times as much as by the second-order term.
Most of M, over all places, lies in a space of some dozen dimensions: tabulated are the axes of that
space, and the coordinates of M over pairs of places.
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
COUPLING = (0.4, 0.9)
"""Weight of softening in an interaction: where two contacts hardly interact, and what is added
times ρ."""
STIFFNESS_MIN = 0.2
"""Share of the stiffness that two contacts leave, at least, in the growth of their interaction."""


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
            # 128 blocks, of 100 kB each for cylinder60.
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


def interaction_coupling(
    images: NDArray[np.float32] | FloatArray, own_px: FloatArray
) -> FloatArray:
    """Return the weight (k,) of softening in the interaction of each two contacts.

    Parameters
    ----------
    images : (k, 2n) float
        M px/N² of each two, by the tables.
    own_px : (c,) float
        Size of the interaction of two contacts on the place of each, px/N².
    """
    i, k = np.array(_each_two(len(own_px))).T
    size = np.linalg.norm(images, axis=1)
    alike = size / np.maximum(np.sqrt(own_px[i] * own_px[k]), 1e-300)
    return np.asarray(COUPLING[0] + COUPLING[1] * np.minimum(alike, 1.0))


def interaction_growth(lost: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return factors on interactions of second order, and the derivatives of their logarithms.

    By the shares of the stiffness that each two contacts take away together.
    """
    growth = 1.0 / np.maximum(1.0 - lost, STIFFNESS_MIN)
    return growth, np.where(1.0 - lost > STIFFNESS_MIN, growth, 0.0)


def add_interactions(
    images: NDArray[np.float32] | FloatArray,
    coupling: FloatArray,
    force_N: FloatArray,
    softening: FloatArray,
    parts: Sequence[tuple[FloatArray, FloatArray]],
    *,
    size_px: FloatArray | None = None,
) -> list[tuple[FloatArray, FloatArray]]:
    """Return shifts and slopes of c contacts with their interactions.

    Parameters
    ----------
    images : (k, 2n) float
        M px/N² of each two, see :meth:`InteractionTable.between`.
    coupling : (k,) float
        See :func:`interaction_coupling`.
    force_N, softening : (c,) float
        Forces of the contacts, and the share of the stiffness that a newton of each takes away.
    parts : sequence of ((2n,), (u, 2n)) float
        Shifts of each, and their slopes by its unknowns, of which the first is the force; the
        slopes are changed. They leave out the small change of M with the places.
    size_px : (k,) float, optional
        Size of M by the tables, which :data:`SHARE_MAX` is about; that of the images by default.
    """
    size = np.array([np.linalg.norm(total) for total, _ in parts])
    # Strictly below the diagonal, row by row, as the images.
    i, k = np.array(_each_two(len(parts))).T
    both = force_N[i] * force_N[k]
    much = both * (np.linalg.norm(images, axis=1) if size_px is None else size_px)
    share = np.minimum(1.0, SHARE_MAX * np.minimum(size[i], size[k]) / np.maximum(much, 1e-300))
    lost = softening * force_N
    growth, steepness = interaction_growth(coupling * (lost[i] + lost[k]))
    steepness = coupling * steepness
    share *= growth
    of, pair = np.zeros((2, len(parts), len(images))), np.arange(len(images))
    of[0, i, pair] = of[0, k, pair] = 0.5 * both * share
    of[1, i, pair] = force_N[k] * share * (1.0 + lost[i] * steepness)
    of[1, k, pair] = force_N[i] * share * (1.0 + lost[k] * steepness)
    more = (of.astype(np.float32).reshape(-1, len(images)) @ images).reshape(2, len(parts), -1)
    out = []
    for (total, slope), add, grows in zip(parts, *more, strict=True):
        slope[0] += grows
        out.append((total + add, slope))
    return out


def _each_two(count: int) -> list[tuple[int, int]]:
    return [(i, k) for i in range(count) for k in range(i)]
