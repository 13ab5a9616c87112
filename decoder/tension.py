"""How contacts on one flat wall stiffen it for each other.

A flat wall that is pressed in stretches, and its tension stiffens it. That tension is nearly one
number for the whole wall: it grows with the wall's stretching, the integral of its squared slope
(Berger 1955, the energy of a plate without the second invariant of its strains). Of contacts j
and k with forces f that is f_j f_k c_jk summed over all pairs, with c_jk the integral of the
product of what a newton of each does to the slope; the markers' images move with the slope where
they stand, so that products of table rows stand for it. Each contact then presses a wall that is
as stiff as if a force

    T_i² = Σ_jk f_j f_k c_jk / c_ii

pressed in its place alone. Curved walls bend more than they stretch, here more and there less: of
those :mod:`pairs` tells.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from decoder.places import Places
from shapes.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from decoder.contact_fit import State

ALIKE = 1e-4
"""One less the cosine of normals that are those of one wall: 0.8°."""
LEVEL = 0.02
"""Height of one place over the other's wall that it may have, over their distance."""
FAINT = 0.01
"""Least c_ii over the largest: beside a clamped edge a newton hardly stretches the wall."""
SLACK = 0.25
"""Least T² over the squared force: contacts hardly undo each other's stretching."""
SURE = 1.1
"""How far powers of the force hold beyond the largest that tables were made with."""
NEAR_TOP = 2.0 / 3.0
"""Share of that force from which to it the response tells how it goes on; at the very end the
slope of a fitted power is anything."""
STEEPEST = 1.0
"""Largest exponent of the response per newton there, either way; a membrane's is -2/3."""


def one_wall(places: Places, states: Sequence["State"]) -> BoolArray:
    """Whether two contacts (c, c) press one flat wall; each is with itself."""
    own = np.array([state.place for state in states])
    normal = np.cross(places.along[own], places.around[own])
    arm = places.point_mm[own][:, None] - places.point_mm[own][None]
    over = np.abs(np.einsum("ijk,jk->ij", arm, normal))
    one = places.flat[own][:, None] & places.flat[own][None]
    one &= normal @ normal.T > 1.0 - ALIKE
    one &= over <= LEVEL * np.linalg.norm(arm, axis=2)
    return np.asarray(one | np.eye(len(states), dtype=np.bool_))


def shared_N(places: Places, states: Sequence["State"]) -> tuple[FloatArray, FloatArray]:
    """Force (c,) T that alone would stretch each contact's wall as all together do.

    Returns
    -------
    stretch_N, grows : (c,) float
        T, and how it grows with the contact's own force: f/T · dT/df.
    """
    force = np.array([state.x[0] for state in states])
    if len(states) < 2 or not places.flat.any():
        return force, np.ones(len(force))
    one = one_wall(places, states)
    usual = np.minimum(np.sqrt(one @ force**2), SURE * places.top_N)
    rows = places.shift_px[[state.place for state in states]]
    each = np.einsum("ck,ckn->cn", usual[:, None] ** np.arange(places.orders), rows)
    product = np.where(one, each @ each.T, 0.0)
    own = np.diagonal(product)
    own = np.maximum(own, FAINT * own.max() + 1e-300)
    mine = np.where(one, force, 0.0)
    square = np.maximum(np.sum((mine @ product) * mine, axis=1) / own, SLACK * force**2)
    # Of the sum, what goes with this contact's force, twice over.
    part = force * (product @ force) / own
    return np.sqrt(square), np.clip(part / square, 0.0, 1.0)


def powers_of(
    rows: NDArray[np.float32], stretch_N: float, top_N: float
) -> tuple[FloatArray, FloatArray]:
    """What orders (k,) of the response per newton count for at a stretch, and how that grows.

    Far beyond the force that tables were made with powers run away: there the response goes on as
    it does up to that force, by a power of the stretch.

    Parameters
    ----------
    rows : (k, 2n) float32
        Orders of the response.
    stretch_N, top_N : float
        Where, and how far the tables go.

    Returns
    -------
    powers, grows : (k,) float
        Factors, and the logarithmic derivative of each by the stretch.
    """
    order = np.arange(len(rows))
    within = min(stretch_N, SURE * top_N)
    powers = within ** order.astype(np.float64)
    if within == stretch_N:
        return powers, order.astype(np.float64)
    ends = top_N * np.array([[NEAR_TOP], [1.0]])
    before, there = np.linalg.norm((ends**order).astype(np.float32) @ rows, axis=1) + 1e-30
    exponent = float(np.clip(np.log(there / before) / -np.log(NEAR_TOP), -STEEPEST, STEEPEST))
    scale = (stretch_N / within) ** exponent
    return scale * powers, np.full(len(rows), exponent)
