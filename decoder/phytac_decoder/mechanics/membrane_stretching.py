"""Membrane stretching: how contacts on one flat wall stiffen it for each other.

A flat wall that is pressed in stretches, and its tension stiffens it. To good accuracy the tension
is one number for the whole wall (Berger 1955, the energy of a plate without the second invariant
of its strains), at which the wall is linear. It is proportional to the integral of the wall's
squared slope: for contacts j and k with forces f the sum of f_j f_k s_j·s_k over all pairs, where
s is the slope by a newton in coordinates that keep the products. A wall of one mode of deflection
loses the share v of its softness, ::

    v / (1 - v) = |Σ_j f_j s_j(v)|²

and the responses of all places are powers of v, as is s itself, since a stiffer wall slopes less.
Near a contact the tension is larger than elsewhere, so that its own response is tabulated by powers
of its force, from large displacements. Only the reduction by other contacts is a function of v,
between its value under the contact alone and under all. Curved walls bend more than they stretch,
differently from place to place: see :mod:`phytac_decoder.mechanics.interaction_table`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class BergerWall:
    """Flat walls of a sensor whose tables hold p places.

    Attributes
    ----------
    wall : (p,) int
        Wall of each place; -1 where there is none.
    slopes : (p, k, r) float32
        Slopes of the wall by a newton on each place, by powers of v from 0.
    most : float
        Largest v that the tables are valid for.
    """

    wall: IntArray
    slopes: NDArray[np.float32]
    most: float

    @property
    def orders(self) -> int:
        """Powers of v, from the first."""
        return int(self.slopes.shape[1]) - 1

    def scaled(self, stiffness: float) -> "BergerWall":
        """Return the walls of a sensor stiffer by a factor."""
        return replace(self, slopes=self.slopes / np.float32(stiffness))

    def cubic(self, near: IntArray, weights: NDArray[np.float32], place: int) -> FloatArray:
        """Derivatives (10, k, r) of the slopes at a place, by the places (q,) of its cubic."""
        mine = self.wall[near] == self.wall[place]
        return np.asarray(np.tensordot(weights * mine, self.slopes[near], axes=1))


def lost_softness(slopes: FloatArray, most: float) -> tuple[float, float]:
    """Return the share v of softness that a wall loses under slopes (k, r), and dv/d|slopes|².

    v is at most ``most``; there its derivative is 0. Newton's method with bisection.
    """
    gram = slopes @ slopes.T
    square = np.zeros(2 * len(gram) - 1)
    for k, row in enumerate(gram):
        square[k : k + len(row)] += row
    change = polynomial.polyder(square)

    def over(v: float) -> tuple[float, float]:
        """Return the residual of the equation of v, and its derivative."""
        size = float(polynomial.polyval(v, square))
        slope = float(polynomial.polyval(v, change))
        return (1.0 - v) * size - v, (1.0 - v) * slope - size - 1.0

    if over(most)[0] >= 0.0:
        return most, 0.0
    low, high = 0.0, most
    v = min(float(square[0]), 0.5) * most
    for _ in range(40):
        residual, slope = over(v)
        low, high = (v, high) if residual > 0.0 else (low, v)
        step = v - residual / slope if slope < 0.0 else low - 1.0
        new = step if low < step < high else (low + high) / 2.0
        if abs(new - v) <= 1e-12:
            break
        v = new
    return v, (1.0 - v) / -min(over(v)[1], -1e-9)


def order_factors(
    rows: NDArray[np.float32] | FloatArray, force_N: float, top_N: float
) -> tuple[FloatArray, FloatArray]:
    """Return factors (k,) of the orders of the response per newton at a force, and their growth.

    Above 1.1 times the largest tabulated force the response is extrapolated by a power law with
    the exponent of the last third of the table, limited to ±1; a membrane's is -2/3.

    Parameters
    ----------
    rows : (k, 2n) float
        Orders of the response.
    force_N, top_N : float
        The force, and the largest tabulated force.

    Returns
    -------
    powers, grows : (k,) float
        Factors, and the logarithmic derivative of each by the force.
    """
    order = np.arange(len(rows))
    within = min(force_N, 1.1 * top_N)
    powers = within ** order.astype(np.float64)
    if within == force_N:
        return powers, order.astype(np.float64)
    ends = top_N * np.array([[2.0 / 3.0], [1.0]])
    before, there = np.linalg.norm((ends**order).astype(np.float32) @ rows, axis=1) + 1e-30
    exponent = float(np.clip(np.log(there / before) / np.log(1.5), -1.0, 1.0))
    scale = (force_N / within) ** exponent
    return scale * powers, np.full(len(rows), exponent)
