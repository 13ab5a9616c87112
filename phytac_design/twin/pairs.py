r"""Koiter's mixed term of two discs, as a fit that does not know it takes it for force.

With x the linear motion of a newton on a disc and Π the shell's energy, the mixed term of discs i
and k solves ``K·x_ik = -Π‴(x_i, x_k)``. What it moves of the image, along a row g, is one number::

    g·x_ik = -Π‴(x_i, x_k, z)      K·z = gᵀ of the image's rows on the wall

(derived here: the third derivative of an energy is symmetric), linear in x_k: a place costs one
solve and one difference of internal forces for each of its rows, and pairs only products.
"""

import numpy as np

from decoder.contact_fit import Prior, start
from decoder.contact_shifts import explain
from decoder.pairs import ROWS, Pairs
from decoder.places import Places
from phytac_design.mechanics.large.resting import Resting
from phytac_design.mechanics.pressure import tangent_frame
from phytac_design.twin.pressed import Pressed, Seen
from shapes.arrays import FloatArray, IntArray

SHARE = 1.5
"""Distance of places over the disc's radius."""
MOST = 1000
"""Places at most: tables grow by their square."""
BATCH = 32
"""Loads solved together."""
FAINT = 1e-9
"""Least square of the shifts of a place over the most: on a clamped rim nothing moves."""
BENT_RAD, STEP_RAD = 1e-3, 1e-6
"""Turn of the wall at which its stiffness is taken, and that of the differences for it."""


def pair_spacing_mm(area_mm2: float, radius_mm: float) -> float:
    """Distance of the places of a table over so much surface."""
    return max(SHARE * radius_mm, float(np.sqrt(area_mm2 / MOST)))


def make_pairs(
    shell: Pressed,
    see: Seen,
    places: Places,
    *,
    uv: FloatArray,
    turned: IntArray,
) -> Pairs:
    """Tables of pairs of places on a shell.

    Parameters
    ----------
    shell, see : Pressed, Seen
        The sensor's shell, and what its cameras see.
    places : Places
        Its tables of single discs.
    uv : (p, 2) float
        Places of the pairs.
    turned : (p, p) int
        Row i turns the sensor such that place i comes from place ``turned[i, i]``: that and all
        the others, before it was turned. ``turned[i, k] = k`` without turning.
    """
    resting = Resting(shell.model)
    linear = Places(
        point_mm=places.point_mm,
        along=places.along,
        around=places.around,
        shift_px=np.ascontiguousarray(places.shift_px[:, :1]),
        radius_mm=places.radius_mm,
    )
    solved = np.unique(np.diagonal(turned))
    points = shell.surface.point(uv)
    along, around = tangent_frame(shell.surface, uv)
    pulls = np.empty((3 * len(solved), resting.held.size), dtype=np.float32)
    square = np.empty(len(solved))
    for first in range(0, len(solved), BATCH):
        batch = solved[first : first + BATCH]
        motion = shell.linear(uv[batch], places.radius_mm)[1]
        for row, k in enumerate(batch.tolist()):
            rows = _rows(linear, points[k], along[k], around[k])
            at = 3 * (first + row)
            square[first + row] = rows[0] @ rows[0]
            pulls[at : at + 3] = _pulls(resting, shell, see, motion[:, row], rows)
    seen = np.empty((3 * len(solved), len(uv)), dtype=np.float32)
    for first in range(0, len(uv), BATCH):
        part = slice(first, first + BATCH)
        motion = shell.linear(uv[part], places.radius_mm)[1]
        seen[:, part] = pulls @ motion.astype(np.float32)
    square = np.maximum(square, FAINT * square.max())
    of_solved = seen.reshape(len(solved), 3, len(uv)) / square[:, None, None]
    table = np.empty((len(uv), ROWS, len(uv)), dtype=np.float32)
    for i in range(len(uv)):
        own = int(np.searchsorted(solved, turned[i, i]))
        force, down, aside = of_solved[own][:, turned[i]]
        table[i, 0] = force
        table[i, 1:] = along[i][:, None] * down + around[i][:, None] * aside
    return Pairs(
        grid=Places(
            point_mm=points,
            along=along,
            around=around,
            shift_px=table,
            radius_mm=places.radius_mm,
        )
    )


def _rows(
    linear: Places, point_mm: FloatArray, along: FloatArray, around: FloatArray
) -> FloatArray:
    """Shifts (3, 2n) px by a newton at a point, and their slopes along and around, px/mm."""
    state = start(linear, Prior(place_mm=1.0), point_mm, 1.0)
    rows = explain(state, 1)[1][:3]
    frame = np.stack([linear.along[state.place], linear.around[state.place]])
    rows[1:] = np.stack([along, around]) @ frame.T @ rows[1:]
    return rows


def _pulls(
    resting: Resting, shell: Pressed, see: Seen, motion: FloatArray, rows: FloatArray
) -> FloatArray:
    """What the mixed term of a disc's motion (6N,) with another's makes of rows (3, 2n), (3, 6N).

    Its product with the other's motion is told, per newton of each.
    """
    push = np.stack([shell.feet.matrix.T @ see.pull(row).ravel() for row in rows], axis=1)
    push[resting.held] = 0.0
    stirred = resting.solved(push.copy())
    bend = BENT_RAD / resting.reach(motion)
    bent = resting.internal(bend * motion)
    out = np.empty((len(rows), len(motion)))
    for k, z in enumerate(stirred.T):
        step = STEP_RAD / resting.reach(z)
        tangent = (resting.internal(bend * motion + step * z) - bent) / step
        out[k] = np.where(resting.held, 0.0, -(tangent - push[:, k]) / bend)
    return out
