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
    InteractionGrowth,
    InteractionTable,
    add_interactions,
    interaction_likeness,
)
from phytac_decoder.mechanics.membrane_stretching import order_factors
from phytac_decoder.mechanics.receptor_table import ReceptorTable
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
    receptors : ReceptorTable, optional
        In place of the tables where receptors are in it.
    measured : MeasuredColumns, optional
        Of a print; its columns are not used here, as they are linear in the forces.
    """

    places: ResponseTable
    position_mm: FloatArray
    softness: float = 1.0
    receptors: ReceptorTable | None = None
    measured: MeasuredColumns | None = None
    _own: dict[int, FloatArray] = field(default_factory=dict, init=False, repr=False)
    _pairs: dict[tuple[int, int], tuple[FloatArray, float, float]] = field(
        default_factory=dict, init=False, repr=False
    )

    _sets: dict[tuple[int, ...], tuple[FloatArray, FloatArray, FloatArray]] = field(
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
            images, likeness, size_px = self._interactions(pairs, receptors)
            softening = self._softening[receptors]
            parts = add_interactions(
                images,
                likeness,
                force,
                softening,
                parts,
                [own[0] for own in rows],
                size_px=size_px,
            )
        linear = np.stack([own[0] for own in rows])
        total = np.sum([shift for shift, _ in parts], axis=0) - force @ linear
        slope = np.concatenate([slope for _, slope in parts]) - linear
        return total, self.softness * slope

    def second_order(self, pair: IntArray, force_N: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return squares (s, n) of forces (s, n), and products (s, k) of pairs (2, k), N².

        Grown as the wall softens: shifts of second order are in proportion to them. Each pair has
        the larger number first.
        """
        squares, products = force_N**2, np.zeros((len(force_N), pair.shape[1]))
        if self.places.pairs is None:
            return squares, products
        column = {(one, other): k for k, (one, other) in enumerate(pair.T.tolist())}
        softening = self.softness * self._softening
        for sample, force in enumerate(force_N):
            own = np.flatnonzero(force)
            if len(own) < 2:
                continue
            _, likeness, _ = self._interactions(self.places.pairs, own)
            grows = InteractionGrowth.of(likeness, softening[own] * force[own])
            squares[sample, own] *= grows.own
            two = [(one, other) for i, one in enumerate(own.tolist()) for other in own[:i].tolist()]
            for both, growth in zip(two, grows.pair.tolist(), strict=True):
                if both in column:
                    products[sample, column[both]] = growth * np.prod(force[list(both)])
        return squares, products

    def interaction_px(self, pair: IntArray) -> FloatArray:
        """Return shifts (k, 2n) px/N² by interactions of pairs (2, k)."""
        out = np.zeros((pair.shape[1], self.places.shift_px.shape[2]))
        if self.places.pairs is not None:
            for row, (one, other) in zip(out, pair.T.tolist(), strict=True):
                row[:], _, _ = self._interaction(self.places.pairs, one, other)
        return self.softness**2 * out

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

    @cached_property
    def _softening(self) -> FloatArray:
        """Share (n,) of the stiffness that a newton of the tables takes away on each receptor."""
        out = self.places.softening[self._nearest]
        if self.receptors:
            out[self.receptors.marker] = self.receptors.softening
        return out

    def _rows(self, receptor: int) -> FloatArray:
        """Return the orders (k, 2n) of the response per newton on a receptor."""
        rows = self._own.get(receptor)
        if rows is None:
            place, weights = self.places.shares(self.position_mm[receptor][None])
            near = self.places.fits[0][place[0]]
            table = self.places.shift_px[near][:, : self.places.orders]
            rows = np.tensordot(weights[0], table, axes=1)
            if self.receptors and receptor in self.receptors.rows:
                rows[1:] = self.receptors.rows[receptor]
            if self.measured:
                rows[1] += self.measured.squares.get(receptor, 0.0) / self.softness**2
            self._own[receptor] = rows
        return rows

    def _interactions(
        self, pairs: InteractionTable, receptors: IntArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return images (k, 2n), likeness (c, c) and size (k,) as :func:`add_interactions`."""
        ids = tuple(receptors.tolist())
        known = self._sets.get(ids)
        if known is None:
            two = [(one, other) for i, one in enumerate(ids) for other in ids[:i]]
            found = [self._interaction(pairs, one, other) for one, other in two]
            rows, alike, size_px = zip(*found, strict=True)
            likeness = np.eye(len(ids))
            i, k = np.tril_indices(len(ids), -1)
            likeness[i, k] = likeness[k, i] = alike
            # Those of the last frame: they are the same in each iteration, and mostly in the next.
            self._sets.clear()
            known = self._sets[ids] = np.stack(rows), likeness, np.array(size_px)
        return known

    def _interaction(
        self, pairs: InteractionTable, one: int, other: int
    ) -> tuple[FloatArray, float, float]:
        """Return image (2n,), likeness, and size of the image by the tables, of two receptors."""
        known = self._pairs.get((one, other))
        if known is None:
            both = [one, other]
            numbers = max(both), min(both)
            if self.receptors and numbers in self.receptors.pairs:
                image = self.receptors.pairs[numbers]
                square_px = np.stack([self.receptors.rows[each][0] for each in both])
            else:
                (image,) = pairs.between(self.position_mm[both])
                square_px = self.places.shift_px[self._nearest[both], 1]
            likeness = float(interaction_likeness(image[None], square_px)[1, 0])
            size_px, row = float(np.linalg.norm(image)), image.astype(np.float64)
            if self.measured:
                more = self.measured.pairs.get(numbers, 0.0)
                row += more / self.softness**2
            if len(self._pairs) >= PAIRS_KEPT:
                self._pairs.pop(next(iter(self._pairs)), None)
            known = self._pairs[one, other] = row, likeness, size_px
        return known
