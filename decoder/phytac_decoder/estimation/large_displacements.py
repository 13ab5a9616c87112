"""Large displacements of forces on receptors: marker shifts beyond those that are linear in them.

The estimators that invert the compliance know one column of shifts per newton for each receptor. A
thin wall softens or stiffens as it is pressed in, and forces on it soften or stiffen it for each
other: at 25 N on ``cylinder60``, by a tenth. The tables of ``auto`` hold both.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.mechanics.interaction_table import SHARE_MAX, InteractionTable
from phytac_decoder.mechanics.membrane_stretching import order_factors
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray, IntArray

ITERATIONS_MAX = 12
FULL_STEPS = 4
"""Iterations after which steps are halved: where the interaction of two forces has its limit, a
weak force may alternate between two values."""
TOLERANCE = 5e-3
"""Change of the forces, over the largest, at which the iteration ends."""
TABLES_FACTOR = 2.0
"""Forces above this many times the largest tabulated one have the slope that is there."""


@dataclass(frozen=True, kw_only=True)
class LargeDisplacements:
    """Shifts beyond linear ones, of forces on n receptors.

    How forces on one flat wall stiffen it for each other is left out.

    Attributes
    ----------
    places : ResponseTable
        Tables of more than one order.
    position_mm : (n, 3) float
        Receptors on the outer face.
    softness : float
        Softness of the wall over that of the tables.
    """

    places: ResponseTable
    position_mm: FloatArray
    softness: float = 1.0
    _own: dict[int, NDArray[np.float32]] = field(default_factory=dict, init=False, repr=False)
    _pairs: dict[tuple[int, int], NDArray[np.float32]] = field(
        default_factory=dict, init=False, repr=False
    )

    def shifts(self, receptors: IntArray, force_N: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return shifts (2n,) px of forces (m,) on receptors, and their slopes (m, 2n) by forces.

        Both without what is linear in the forces.
        """
        force = self.softness * force_N
        rows = [self._rows(receptor) for receptor in receptors.tolist()]
        factors = [
            order_factors(own, f, self.places.top_N)
            for own, f in zip(rows, force.tolist(), strict=True)
        ]
        orders, coordinates = self.places.orders, self.places.shift_px.shape[2]
        tables = np.array(rows).reshape(len(force), orders, coordinates)
        powers, grows = np.array(factors).reshape(len(force), 2, orders).transpose(1, 0, 2)
        first = np.eye(orders)[0]
        more = force[:, None] * np.einsum("mk,mkn->mn", powers - first, tables)
        slope = np.einsum("mk,mkn->mn", (1.0 + grows) * powers - first, tables)
        total = more.sum(axis=0)
        pairs = self.places.pairs
        if pairs is not None and len(force) > 1:
            size = force * np.linalg.norm(tables[:, 0], axis=1)
            weights = self._interactions(pairs, receptors, force, size)
            each = np.tensordot(force, weights, axes=1) @ pairs.axes_px
            total += 0.5 * force @ each
            slope += each
        return total, self.softness * slope

    def solve(
        self,
        least_squares: Callable[[FloatArray, FloatArray], FloatArray],
        linear_px: FloatArray,
        shift_px: FloatArray,
        receptors: IntArray,
    ) -> FloatArray:
        """Return the forces (m,) N on receptors behind shifts (2n,) px, by the Gauss-Newton method.

        Parameters
        ----------
        least_squares : callable
            Forces (m,) by shifts (m, 2n) per newton, and shifts (2n,).
        linear_px : (m, 2n) float
            Shifts per newton that are linear in the forces.
        """
        force = least_squares(linear_px, shift_px)
        most_N = TABLES_FACTOR * self.places.top_N / self.softness
        for number in range(ITERATIONS_MAX):
            at = np.minimum(force, most_N)
            more, slope = self.shifts(receptors, at)
            new = least_squares(linear_px + slope, shift_px - more + at @ slope)
            step = new - force if number < FULL_STEPS else 0.5 * (new - force)
            change, force = np.abs(step).max(), force + step
            if change <= TOLERANCE * max(float(force.max()), 1.0):
                break
        return force

    def _rows(self, receptor: int) -> NDArray[np.float32]:
        """Return the orders (k, 2n) of the response per newton on a receptor."""
        rows = self._own.get(receptor)
        if rows is None:
            place, weights = self.places.shares(self.position_mm[receptor][None])
            near = self.places.fits[0][place[0]]
            table = self.places.shift_px[near][:, : self.places.orders]
            rows = np.tensordot(weights[0].astype(np.float32), table, axes=1)
            self._own[receptor] = rows
        return rows

    def _interactions(
        self, pairs: InteractionTable, receptors: IntArray, force: FloatArray, size: FloatArray
    ) -> FloatArray:
        """Return coordinates (m, m, r) of the interaction of each two receptors, 0 of itself."""
        out = np.zeros((len(force), len(force), len(pairs.axes_px) + 1))
        ids = receptors.tolist()
        for i, one in enumerate(ids):
            for k, other in enumerate(ids[:i]):
                row = self._pairs.get((one, other))
                if row is None:
                    row = pairs.coordinates(self.position_mm[[one, other]])[0]
                    norm = np.linalg.norm(row @ pairs.axes_px)
                    row = self._pairs[one, other] = np.append(row, norm)
                out[i, k] = out[k, i] = row
        much = np.outer(force, force) * out[:, :, -1]
        least = SHARE_MAX * np.minimum.outer(size, size)
        share = np.minimum(1.0, least / np.maximum(much, 1e-30))
        return np.asarray(out[:, :, :-1] * share[:, :, None])
