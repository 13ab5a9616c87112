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
from phytac_shapes.arrays import FloatArray, IntArray

DOFS = 24


def cubic_stiffness(
    model: ShellModel, *, at_once: int = 512
) -> Iterator[tuple[slice, NDArray[np.float32]]]:
    """Elements, ``at_once`` to bound the memory, and Π‴ (e, 24, 24, 24) of each, in N, mm and rad.

    DOFs of an element are motion (mm) and rotation vector (rad) of its corners in turn, along
    global axes.
    """
    alone, like, turn = _copies(model)
    few = _of(Corotational(model, apart=alone)) if len(alone) <= at_once else None
    for first in range(0, len(model.quads), at_once):
        some = slice(first, min(first + at_once, len(model.quads)))
        if few is None:
            yield some, _of(Corotational(model, apart=np.arange(some.start, some.stop)))
        else:
            yield some, _turned(few, like[some], turn[some])


def _copies(model: ShellModel) -> tuple[IntArray, IntArray, FloatArray]:
    """Elements that others are copies of, turned around the sensor's axis.

    Returns
    -------
    alone : (g,) int
        One element of each kind.
    like : (E,) int
        Which of these each element is a copy of.
    turn : (E, 3, 3) float
        Rotation from that one to the element.
    """
    digits = 9  # of lengths and stiffnesses over an element's own: copies differ by rounding
    elastic = Corotational(model)
    middle = model.nodes_mm[model.quads].mean(axis=1)
    angle = np.arctan2(middle[:, 1], middle[:, 0])
    own = _around_axis(-angle)
    arms = (elastic.arms @ own.transpose(0, 2, 1)) / elastic.extent_mm[:, None, None]
    blocks = elastic.stiffness.reshape(-1, 8, 3, 8, 3).transpose(0, 1, 3, 2, 4)
    seen = own[:, None, None] @ blocks @ own.transpose(0, 2, 1)[:, None, None]
    size = np.abs(seen).max(axis=(1, 2, 3, 4), keepdims=True)
    kinds: dict[bytes, int] = {}
    parts = [elastic.extent_mm[:, None], arms, seen / size, size]
    looks = np.concatenate([part.reshape(len(angle), -1) for part in parts], axis=1)
    looks[:, [0, -1]] = np.log(looks[:, [0, -1]])
    rounded = np.round(looks, digits) + 0.0  # no negative zeros
    like = np.array([kinds.setdefault(row.tobytes(), len(kinds)) for row in rounded])
    alone = np.unique(like, return_index=True)[1]
    return alone, like, _around_axis(angle - angle[alone][like])


def _around_axis(angle: FloatArray) -> FloatArray:
    """Rotations (e, 3, 3) about z."""
    turn = np.zeros((len(angle), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 1, 0] = np.sin(angle)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = 1.0
    return turn


def _turned(third: NDArray[np.float32], like: IntArray, turn: FloatArray) -> NDArray[np.float32]:
    """Third derivatives (e, 24, 24, 24) of turned copies."""
    blocks = np.zeros((len(like), 8, 3, 8, 3), dtype=np.float32)
    blocks[:, range(8), :, range(8)] = turn
    by = blocks.reshape(-1, DOFS, DOFS)
    out = third[like]
    for _ in range(3):  # each index comes first once
        out = (by @ out.reshape(-1, DOFS, DOFS * DOFS)).reshape(out.shape)
        out = out.transpose(0, 2, 3, 1)
    return np.ascontiguousarray(out)


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
