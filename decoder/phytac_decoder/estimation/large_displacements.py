"""Large displacements of forces on receptors: marker shifts beyond those that are linear in them.

The estimators that invert the compliance know one column of shifts per newton for each receptor. A
thin wall softens or stiffens as it is pressed in, and forces on it soften or stiffen it for each
other: at 25 N on ``cylinder60``, by a tenth. The tables of ``auto`` hold both.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from phytac_decoder.estimation.measured_columns import MeasuredColumns
from phytac_decoder.mechanics.interaction_table import (
    add_interactions,
    interaction_coupling,
    interaction_growth,
)
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
PAIRS_KEPT = 2000
"""Latest interactions that are kept: 12 MB for ``cylinder60``."""


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
    measured : MeasuredColumns, optional
        Of a print; its columns are not used here, as they are linear in the forces.
    """

    places: ResponseTable
    position_mm: FloatArray
    softness: float = 1.0
    measured: MeasuredColumns | None = None
    _own: dict[int, FloatArray] = field(default_factory=dict, init=False, repr=False)
    _pairs: dict[tuple[int, int], FloatArray] = field(default_factory=dict, init=False, repr=False)

    def shifts(self, receptors: IntArray, force_N: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return shifts (2n,) px of forces (m,) on receptors, and their slopes (m, 2n) by forces.

        Both without what is linear in the forces.
        """
        if not len(receptors):
            return np.zeros(self.places.shift_px.shape[2]), np.zeros((0, 0))
        force = self.softness * force_N
        rows = [self._rows(receptor) for receptor in receptors.tolist()]
        parts = []
        for own, f in zip(rows, force.tolist(), strict=True):
            powers, grows = order_factors(own, f, self.places.top_N)
            parts.append((f * powers @ own, ((1.0 + grows) * powers @ own)[None]))
        images_px = self._interactions(receptors)
        if len(images_px):
            softening, own_px = self._softening[:, receptors]
            parts = add_interactions(images_px, force, softening, own_px, parts)
        linear = np.stack([own[0] for own in rows])
        total = np.sum([shift for shift, _ in parts], axis=0) - force @ linear
        slope = np.concatenate([slope for _, slope in parts]) - linear
        return total, self.softness * slope

    def interactions(self, pair: IntArray, force_N: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return inputs (s, k) N² under forces (s, n), and shifts (k, 2n) px/N², of pairs (2, k).

        An interaction is the product of both.
        """
        one, other = pair
        softening, own_px = self._softening
        images_px = np.zeros((len(one), self.places.shift_px.shape[2]))
        for row, both in zip(images_px, pair.T, strict=True):
            row[:] = self._interactions(both)[0]
        size = np.linalg.norm(images_px, axis=1)
        lost = self.softness * force_N * softening
        coupling = interaction_coupling(size, own_px[one], own_px[other])
        growth, _ = interaction_growth(coupling * (lost[:, one] + lost[:, other]))
        return force_N[:, one] * force_N[:, other] * growth, self.softness**2 * images_px

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

    @cached_property
    def _softening(self) -> FloatArray:
        """``softening`` and ``own_interaction_px`` of the tables at receptors, (2, n)."""
        nearest = self.places.nearest(self.position_mm)
        return np.stack([self.places.softening, self.places.own_interaction_px])[:, nearest]

    def _rows(self, receptor: int) -> FloatArray:
        """Return the orders (k, 2n) of the response per newton on a receptor."""
        rows = self._own.get(receptor)
        if rows is None:
            place, weights = self.places.shares(self.position_mm[receptor][None])
            near = self.places.fits[0][place[0]]
            table = self.places.shift_px[near][:, : self.places.orders]
            rows = np.tensordot(weights[0], table, axes=1)
            if self.measured:
                rows[1] += self.measured.squares.get(receptor, 0.0) / self.softness**2
            self._own[receptor] = rows
        return rows

    def _interactions(self, receptors: IntArray) -> FloatArray:
        """Return the interactions (k, 2n) of each two receptors, as :func:`add_interactions`."""
        ids, pairs = receptors.tolist(), self.places.pairs
        out: list[FloatArray] = []
        if pairs is None or len(ids) < 2:
            return np.zeros((0, 0))
        for i, one in enumerate(ids):
            for other in ids[:i]:
                row = self._pairs.get((one, other))
                if row is None:
                    row = pairs.between(self.position_mm[[one, other]])[0].astype(np.float64)
                    if self.measured:
                        both = max(one, other), min(one, other)
                        row += self.measured.pairs.get(both, 0.0) / self.softness**2
                    if len(self._pairs) >= PAIRS_KEPT:
                        del self._pairs[next(iter(self._pairs))]
                    self._pairs[one, other] = row
                out.append(row)
        return np.stack(out)
