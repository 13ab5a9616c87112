"""How contacts on one flat wall stiffen it for each other.

A flat wall that is pressed in stretches, and its tension stiffens it. To good accuracy that is one
number for the whole wall (Berger 1955, the energy of a plate without the second invariant of its
strains), under which the wall is linear. It goes with the integral of the wall's squared slope: of
contacts j and k with forces f that is f_j f_k s_j·s_k summed over all pairs, s being what a newton
of each does to the slopes, in as many numbers as tell their products. A wall of one mode of
deflection loses the share v of its softness, ::

    v / (1 - v) = |Σ_j f_j s_j(v)|²

and all of its places answer by powers of v, as s itself does, since what is stiffer slopes less.
Beside a contact tension is more than elsewhere, so that what it does alone goes by powers of its
force, as large displacements have it; only what others take from its response besides goes by v,
from that under it alone to that under all. Curved walls bend more than they stretch, here more
and there less: of those :mod:`pairs` tells.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from phytac_shapes.arrays import FloatArray, IntArray

SURE = 1.1
"""How far powers of the force hold beyond the largest that tables were made with."""
NEAR_TOP = 2.0 / 3.0
"""Share of that force from which to it the response tells how it goes on; at the very end the
slope of a fitted power is anything."""
STEEPEST = 1.0
"""Largest exponent of the response per newton there, either way; a membrane's is -2/3."""

STEPS, STILL = 40, 1e-12
"""Looks for v, and the last change of it."""


@dataclass(frozen=True, kw_only=True)
class BergerWall:
    """Flat walls of a sensor whose tables hold p places.

    Attributes
    ----------
    wall : (p,) int
        Number of each place's wall; -1 where there is none.
    slopes : (p, k, r) float32
        What a newton on each place does to its wall's slopes, by powers of v from 0.
    most : float
        Largest v that the tables hold for.
    """

    wall: IntArray
    slopes: NDArray[np.float32]
    most: float

    @property
    def orders(self) -> int:
        """Powers of v, from the first."""
        return int(self.slopes.shape[1]) - 1

    def scaled(self, stiffness: float) -> "BergerWall":
        """Those of a sensor that is stiffer by a factor."""
        return replace(self, slopes=self.slopes / np.float32(stiffness))

    def cubic(self, near: IntArray, weights: NDArray[np.float32], place: int) -> FloatArray:
        """Derivatives (10, k, r) of the slopes at a place, by the places (q,) of its cubic."""
        mine = self.wall[near] == self.wall[place]
        return np.asarray(np.tensordot(weights * mine, self.slopes[near], axes=1))


def lost_softness(slopes: FloatArray, most: float) -> tuple[float, float]:
    """Share v of its softness that a wall loses under slopes (k, r), and dv/d|slopes|².

    v is at most ``most``; there it no longer grows.
    """
    gram = slopes @ slopes.T
    square = np.zeros(2 * len(gram) - 1)
    for k, row in enumerate(gram):
        square[k : k + len(row)] += row
    change = polynomial.polyder(square)

    def over(v: float) -> tuple[float, float]:
        """What is asked for less what is lost, and its slope."""
        size = float(polynomial.polyval(v, square))
        slope = float(polynomial.polyval(v, change))
        return (1.0 - v) * size - v, (1.0 - v) * slope - size - 1.0

    if over(most)[0] >= 0.0:
        return most, 0.0
    low, high = 0.0, most
    v = min(float(square[0]), 0.5) * most
    for _ in range(STEPS):
        left, slope = over(v)
        low, high = (v, high) if left > 0.0 else (low, v)
        step = v - left / slope if slope < 0.0 else low - 1.0
        new = step if low < step < high else (low + high) / 2.0
        if abs(new - v) <= STILL:
            break
        v = new
    return v, (1.0 - v) / -min(over(v)[1], -1e-9)


def order_factors(
    rows: NDArray[np.float32], force_N: float, top_N: float
) -> tuple[FloatArray, FloatArray]:
    """What orders (k,) of the response per newton count for under a force, and how that grows.

    Far beyond the force that tables were made with powers run away: there the response goes on as
    it does up to that one, by a power of the force.

    Parameters
    ----------
    rows : (k, 2n) float32
        Orders of the response.
    force_N, top_N : float
        Where, and how far the tables go.

    Returns
    -------
    powers, grows : (k,) float
        Factors, and the logarithmic derivative of each by the force.
    """
    order = np.arange(len(rows))
    within = min(force_N, SURE * top_N)
    powers = within ** order.astype(np.float64)
    if within == force_N:
        return powers, order.astype(np.float64)
    ends = top_N * np.array([[NEAR_TOP], [1.0]])
    before, there = np.linalg.norm((ends**order).astype(np.float32) @ rows, axis=1) + 1e-30
    exponent = float(np.clip(np.log(there / before) / -np.log(NEAR_TOP), -STEEPEST, STEEPEST))
    scale = (force_N / within) ** exponent
    return scale * powers, np.full(len(rows), exponent)
