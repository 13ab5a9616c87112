r"""Third derivatives of the elements' energies at rest.

Forces of elements that share no node, under motions of two of their DOFs, give them by second
differences, for all elements at once. Forces work on spins, so that these are not symmetric; along
rotation vectors v the energy's second derivative is ``m - v × m / 2`` to second order, what is to
be added to the third is ``-(v_a × K_b + v_b × K_a)·v_c / 2``, and its mean over the three indices
is none (derived here). So the symmetric part is the third derivative along rotation vectors.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.large.corotational import Configuration, Corotational
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray

DOFS = 24


def cubic_stiffness(
    model: ShellModel, *, at_once: int = 512
) -> Iterator[tuple[slice, NDArray[np.float32]]]:
    """Elements, ``at_once`` to bound the memory, and Π‴ (e, 24, 24, 24) of each, in N, mm and rad.

    DOFs of an element are motion (mm) and rotation vector (rad) of its corners in turn, along
    global axes.
    """
    for first in range(0, len(model.quads), at_once):
        some = slice(first, min(first + at_once, len(model.quads)))
        yield some, _of(Corotational(model, apart=some))


def _of(elastic: Corotational) -> NDArray[np.float32]:
    count = elastic.size // DOFS
    # Of motion, then of rotation, of each corner.
    each = np.stack([elastic.extent_mm, np.ones(count)], axis=1)
    # Turns of 1e-3 rad, and motion of that times the element's size.
    step = 1e-3 * np.tile(np.repeat(each, 3, axis=1), 4)

    def even(*dofs: int) -> FloatArray:
        """Half of what forces (e, 24) have in common under steps of DOFs and back."""
        motion = np.zeros((count, DOFS))
        for dof in dofs:
            motion[:, dof] += step[:, dof]
        return 0.5 * (_forces(elastic, motion) + _forces(elastic, -motion))

    raw = np.empty((count, DOFS, DOFS, DOFS), dtype=np.float32)
    alone = [even(a) for a in range(DOFS)]
    for a in range(DOFS):
        for b in range(a + 1):
            both = even(a, b) - alone[a] - alone[b] if a != b else 2.0 * alone[a]
            raw[:, a, b] = raw[:, b, a] = both / (step[:, a] * step[:, b])[:, None]
    turned: Any = raw.transpose(0, 2, 3, 1) + raw.transpose(0, 3, 1, 2)
    return np.ascontiguousarray((raw + turned) / np.float32(3.0))


def _forces(elastic: Corotational, motion: FloatArray) -> FloatArray:
    parts = motion.reshape(-1, 6)
    state = Configuration(
        displacement_mm=parts[:, :3].copy(), quaternion=rot.exponential(parts[:, 3:])
    )
    return elastic.internal(state).reshape(motion.shape)
