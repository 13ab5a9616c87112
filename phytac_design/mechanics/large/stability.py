"""Stability of an equilibrium from the factor of its tangent, and whether a path can be trusted.

With pivots on the diagonal, P K Pᵀ = L U with a unit L, and for a symmetric K Sylvester's law makes
the negative entries of diag(U) as many as its negative eigenvalues. The tangents here are symmetric
at equilibrium under dead forces; with moments of fixed axes, follower pressure or a small residual
they are not quite. The *parity* of the count is then still exact (it is the sign of det K), the
count itself as long as no pivot is small against the unsymmetric part; oscillating instability
(flutter) under follower loads is not seen.
"""

from typing import Any

import numpy as np

from phytac_design.mechanics.shell.solve import SUPERLU
from phytac_shapes.arrays import FloatArray

STRAY = 0.5
"""Largest departure of an increment's motion from the tangents at its ends, over the motion, that
still counts as one smooth path; the trapezoidal rule is far better on the smooth paths tried."""
SOUND = 1e-6
"""Largest residual of a solve with unpivoted factors that are still trusted for their signs."""


def negative_pivots(factor: Any, matrix: Any) -> int | None:
    """Negative eigenvalues of a (nearly) symmetric matrix, from the signs of its pivots.

    Where partial pivoting left the diagonal, the symmetric part is factored again without it, and
    believed only if that factor solves a system to ``SOUND``.

    Parameters
    ----------
    factor : scipy.sparse.linalg.SuperLU
        Factor of ``matrix``.
    matrix : (n, n) scipy.sparse.csc_matrix
        The matrix, scaled by congruence or not.

    Returns
    -------
    int or None
        The number; None if it cannot be told.
    """
    from scipy.sparse.linalg import splu

    if not np.array_equal(factor.perm_r, factor.perm_c):
        symmetric = (0.5 * (matrix + matrix.T)).tocsc()
        try:
            factor = splu(symmetric, **(SUPERLU | {"diag_pivot_thresh": 0.0}))
        except RuntimeError:
            return None
        right = symmetric @ np.ones(symmetric.shape[0])
        gap = symmetric @ factor.solve(right) - right
        diagonal = np.array_equal(factor.perm_r, factor.perm_c)
        if not (diagonal and np.linalg.norm(gap) <= SOUND * np.linalg.norm(right)):
            return None
    return int(np.sum(factor.U.diagonal() < 0.0))


def stray(moved: FloatArray, before: FloatArray, after: FloatArray) -> float:
    """Departure of an increment from the trapezoidal rule on the tangents at its ends.

    Parameters
    ----------
    moved : (N, 3) float
        Translations in the increment, mm.
    before, after : (N, 3) float
        What the tangents at its start and at its end give for the whole increment, mm.

    Returns
    -------
    float
        ‖moved − ½(before + after)‖ over the larger of ‖moved‖ and a tenth of ‖½(before + after)‖.
    """
    rule = 0.5 * (before + after)
    scale = max(float(np.linalg.norm(moved)), 0.1 * float(np.linalg.norm(rule)), 1e-300)
    return float(np.linalg.norm(moved - rule)) / scale
