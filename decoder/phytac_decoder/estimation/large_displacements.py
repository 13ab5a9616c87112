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
    InteractionTable,
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
    _pairs: dict[tuple[int, int], tuple[FloatArray, float, float]] = field(
        default_factory=dict, init=False, repr=False
    )

    @property
    def largest_N(self) -> float:
        """Largest force of the tables; 0 where that is not known."""
        return self.places.top_N / self.softness if np.isfinite(self.places.top_N) else 0.0

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
        pairs = self.places.pairs
        if pairs is not None and len(receptors) > 1:
            images, coupling, size_px = self._interactions(pairs, receptors)
            softening = self.places.softening[self._nearest[receptors]]
            parts = add_interactions(images, coupling, force, softening, parts, size_px=size_px)
        linear = np.stack([own[0] for own in rows])
        total = np.sum([shift for shift, _ in parts], axis=0) - force @ linear
        slope = np.concatenate([slope for _, slope in parts]) - linear
        return total, self.softness * slope

    def interactions(self, pair: IntArray, force_N: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return inputs (s, k) N² under forces (s, n), and shifts (k, 2n) px/N², of pairs (2, k).

        An interaction is the product of both.
        """
        one, other = pair
        images_px = np.zeros((len(one), self.places.shift_px.shape[2]))
        coupling = np.zeros(len(one))
        if self.places.pairs is not None:
            for k, both in enumerate(pair.T.tolist()):
                images_px[k], coupling[k], _ = self._interaction(self.places.pairs, *both)
        lost = self.softness * force_N * self.places.softening[self._nearest]
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
            change, force = np.abs(new - force).max(), force + step
            if change <= TOLERANCE * max(float(force.max()), 1.0):
                break
        return force

    @cached_property
    def _nearest(self) -> IntArray:
        """Place (n,) nearest to each receptor."""
        return self.places.nearest(self.position_mm)

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

    def _interactions(
        self, pairs: InteractionTable, receptors: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return images (k, 2n), coupling (k,) and size (k,) as :func:`add_interactions`."""
        ids = receptors.tolist()
        two = [(one, other) for i, one in enumerate(ids) for other in ids[:i]]
        found = [self._interaction(pairs, one, other) for one, other in two]
        rows, coupling, size_px = zip(*found, strict=True)
        return np.stack(rows), np.array(coupling), np.array(size_px)

    def _interaction(
        self, pairs: InteractionTable, one: int, other: int
    ) -> tuple[FloatArray, float, float]:
        """Return image (2n,), coupling, and size of the image by the tables, of two receptors."""
        known = self._pairs.get((one, other))
        if known is None:
            both = [one, other]
            (row,) = pairs.between(self.position_mm[both])
            own_px = self.places.own_interaction_px[self._nearest[both]]
            (coupling,) = interaction_coupling(row[None], own_px)
            size_px, row = float(np.linalg.norm(row)), row.astype(np.float64)
            if self.measured:
                more = self.measured.pairs.get((max(both), min(both)), 0.0)
                row += more / self.softness**2
            if len(self._pairs) >= PAIRS_KEPT:
                self._pairs.pop(next(iter(self._pairs)), None)
            known = self._pairs[one, other] = row, float(coupling), size_px
        return known
