"""How contacts on one flat wall stiffen it for each other.

A flat wall that is pressed in stretches, and its tension stiffens it. That tension is nearly one
number for the whole wall, and grows with the squares of what contacts do (Berger 1955, the energy
of a plate without the second invariant of its strains; contacts are taken to stretch alike by the
square of their forces, wherever they are). So each contact presses a wall that is as stiff as if
the root of the sum of all squares pressed alone. Curved walls bend more than they stretch, here
more and there less: of those :mod:`pairs` tells.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from decoder.places import Places
from shapes.arrays import FloatArray

if TYPE_CHECKING:
    from decoder.contact_fit import State

ALIKE = 1e-4
"""One less the cosine of normals that are those of one wall: 0.8°."""
LEVEL = 0.02
"""Height of one place over the other's wall that it may have, over their distance."""


def shared_N(places: Places, states: Sequence["State"]) -> FloatArray:
    """Force (c,) of a contact that alone would stretch each one's wall as all together do."""
    force = np.array([state.x[0] for state in states])
    if len(states) < 2 or not places.flat.any():
        return force
    own = np.array([state.place for state in states])
    normal = np.cross(places.along[own], places.around[own])
    arm = places.point_mm[own][:, None] - places.point_mm[own][None]
    over = np.abs(np.einsum("ijk,jk->ij", arm, normal))
    one = places.flat[own][:, None] & places.flat[own][None]
    one &= normal @ normal.T > 1.0 - ALIKE
    one &= over <= LEVEL * np.linalg.norm(arm, axis=2)
    one |= np.eye(len(states), dtype=np.bool_)
    return np.asarray(np.sqrt(one @ force**2))
