"""What contacts at once do to each other's forces, beyond the sum of what each does alone.

Koiter's second term of several forces holds, besides each one's own f²·S₂, a mixed term for each
two of them, ::

    d ⊃ f₁·f₂·M(place₁, place₂)

since one contact's stress and bend stiffen or soften the wall for the other. A fit that knows no
such term takes M's part along S₁ of both contacts, and along S₁'s slopes, for force and place.
That part alone is tabulated, not M: four numbers for each two places, of which the first is
S₁·M / S₁·S₁, the change of a force by a newton on the other contact, over itself; the others are
the same with the components along x, y and z of S₁'s slope in place of the first S₁. The normal
equations of the two, in force and centre, tell from them by how much both forces are off
(derived here).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decoder.contact_fit import point_of
from decoder.contact_shifts import State
from decoder.places import Places
from shapes.arrays import FloatArray

ROWS = 4
"""Of a pair's table: with S₁, and with its slope along x, y and z."""
MOST = 0.3
"""Largest change of a force, over it: contacts that all but cover each other are no pair."""
ROUNDS = 3
"""It is the true forces that soften, not those found: their product is looked at so often."""
FORCE_WEIGHT = 1e-6
"""Of a force, about which nothing is known beforehand, N⁻²."""


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Mixed terms over each two of p places, as a fit of the first of them sees them.

    Attributes
    ----------
    grid : Places
        The places; their rows (p, 4, p), 1/N and 1/(N mm), run over the second's place.
    """

    grid: Places

    def scaled(self, stiffness: float) -> "Pairs":
        """Those of a sensor that is stiffer by a factor."""
        rows = self.grid.shift_px / np.float32(stiffness)
        return Pairs(grid=replace(self.grid, shift_px=rows))

    def between(self, points_mm: FloatArray) -> FloatArray:
        """Rows (c, c, 4) of each two of points (c, 3): the first index's with the second's M."""
        near, share = zip(*(self.grid.shares(point) for point in points_mm), strict=True)
        one = np.stack(
            [
                np.tensordot(weight, self.grid.shift_px[own], axes=1)
                for own, weight in zip(near, share, strict=True)
            ]
        )
        return np.asarray(np.einsum("iakq,kq->ika", one[:, :, np.stack(near)], np.stack(share)))


def mixed_off_N(
    pairs: Pairs, places: Places, states: Sequence[State], noise_px: float
) -> FloatArray:
    """Force (c,) N by which each of c contacts is found too large, for what the others do to it.

    Parameters
    ----------
    pairs : Pairs
        Of the same sensor as ``places``.
    places : Places
        The tables that the contacts were fitted with.
    states : list of State
        The contacts.
    noise_px : float
        Of each shift: what is known of the centres beforehand weighs against it.
    """
    count = len(states)
    if count < 2:
        return np.zeros(count)
    force = np.array([state.x[0] for state in states])
    slopes = np.concatenate([_slopes(state) for state in states])
    gram = (slopes @ slopes.T).astype(np.float64)
    square = np.diagonal(gram)[::3].copy()
    known = np.concatenate([[FORCE_WEIGHT, *[s.place_sd_mm**-2.0] * 2] for s in states])
    gram[np.diag_indices(len(gram))] += noise_px**2 * known
    points = np.stack([point_of(places, state) for state in states])
    rows = pairs.between(points)
    unit = np.zeros((count, count))
    for i in range(count):
        for k in range(i):
            seen = [
                square[i] * _laid(places, states[i], rows[i, k]),
                square[k] * _laid(places, states[k], rows[k, i]),
            ]
            own = np.array([3 * i, 3 * i + 1, 3 * i + 2, 3 * k, 3 * k + 1, 3 * k + 2])
            off = np.linalg.solve(gram[np.ix_(own, own)], np.concatenate(seen))
            unit[i, k], unit[k, i] = off[0], off[3]
    out = np.zeros(count)
    for _ in range(ROUNDS):
        true = force - out
        out = np.clip(true * (unit @ true), -MOST * force, MOST * force)
    return out


def _slopes(state: State) -> NDArray[np.float32]:
    """Linear shifts (3, 2n) by the force, and by the centre along and around."""
    f, x, y = state.x[:3]
    xx, xy, yy = x * x / 2.0, x * y, y * y / 2.0
    t = np.zeros((3, 10), dtype=np.float32)
    t[0, :6] = (1.0, x, y, xx, xy, yy)
    t[1, [1, 3, 4]] = t[2, [2, 4, 5]] = (f, f * x, f * y)
    return np.asarray(t @ state.tables[:, 0])


def _laid(places: Places, state: State, row: FloatArray) -> FloatArray:
    """The same (3,) of force and centre, by a table's row (4,)."""
    f = float(state.x[0])
    along, around = places.along[state.place], places.around[state.place]
    return np.array([row[0], f * float(along @ row[1:]), f * float(around @ row[1:])])
