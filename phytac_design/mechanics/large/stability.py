"""Stability of an equilibrium, and whether an increment stayed on its path.

Two measures of stability (:meth:`.ReferenceShell.is_firmer` uses the first to bound the second):

- *negative pivots* of a factored tangent. With pivots on the diagonal, P K Pᵀ = L U with a unit L,
  and for a symmetric K Sylvester's law makes the negative entries of diag(U) as many as its
  negative eigenvalues. The tangents here are symmetric at equilibrium under dead forces; with
  moments of fixed axes or a small residual they are not quite. The *parity* of the count is then
  still exact (it is the sign of det K), the count itself as long as no pivot is small against the
  unsymmetric part.
- the *lowest Ritz value* of K₀⁻¹ K_t, without a factor of the tangent K_t. A basis Q, orthonormal
  in K₀, and the products K_t Q give the Ritz values of QᵀK_tQ. The lowest one lies above the lowest
  eigenvalue; the basis grows by K₀⁻¹ times the residual of the lowest pair, which converges to that
  eigenvalue (Davidson's method with K₀, factored already; from a single vector it spans what
  Lanczos' does). The start must be random: from the motion itself the lowest value converges to the
  softest mode of the load's own symmetry, and modes of other symmetry would be missed. The
  residual's length is a distance from the lowest Ritz value to *an* eigenvalue. From a random
  start, and after a few steps, the difference of both has been a lower bound of the lowest
  eigenvalue or within a few hundredths of it.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from phytac_design.mechanics.shell.solve import SUPERLU
from phytac_shapes.arrays import FloatArray

PATH_DEVIATION_MAX = 0.5
"""Largest deviation of an increment from the tangents at its ends, over its motion, on one smooth
path; the trapezoidal rule is far better on the smooth paths tried."""


def negative_pivots(factor: Any, matrix: Any) -> int | None:
    """Negative eigenvalues of a (nearly) symmetric matrix, from the signs of its pivots.

    Where partial pivoting left the diagonal, the symmetric part is factored again without it; that
    factor is used only if it solves a system to 1e-6.

    Parameters
    ----------
    factor : scipy.sparse.linalg.SuperLU
        Factor of ``matrix``.
    matrix : (n, n) scipy.sparse.csc_matrix
        The matrix, scaled by congruence or not.

    Returns
    -------
    int or None
        The number; None if it is unknown.
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
        if not (diagonal and np.linalg.norm(gap) <= 1e-6 * np.linalg.norm(right)):
            return None
    return int(np.sum(factor.U.diagonal() < 0.0))


def path_deviation(moved: FloatArray, before: FloatArray, after: FloatArray) -> float:
    """Deviation of an increment from the trapezoidal rule on the tangents at its ends.

    Parameters
    ----------
    moved : (N, 3) float
        Translations in the increment, mm.
    before, after : (N, 3) float
        Motion over the whole increment by the tangent at its start, and at its end, mm.

    Returns
    -------
    float
        ‖moved − ½(before + after)‖ over the larger of ‖moved‖ and a tenth of ‖½(before + after)‖.
    """
    rule = 0.5 * (before + after)
    scale = max(float(np.linalg.norm(moved)), 0.1 * float(np.linalg.norm(rule)), 1e-300)
    return float(np.linalg.norm(moved - rule)) / scale


def ritz_values(
    product: Callable[[FloatArray], FloatArray],
    solve: Callable[[FloatArray], FloatArray],
    force: FloatArray,
) -> Iterator[tuple[float, float]]:
    """Lowest Ritz value of K₀⁻¹K_t, after each product, and its distance from an eigenvalue.

    Parameters
    ----------
    product : callable
        K_t times a vector (n,).
    solve : callable
        K₀⁻¹ times a vector (n,).
    force : (n,) float
        Random forces: K₀⁻¹ of them is the first vector.
    """
    vectors = images = products = np.empty((0, len(force)))
    vector, image = solve(force), force
    while True:
        for _ in range(2):
            share = images @ vector
            vector, image = vector - share @ vectors, image - share @ images
        size = float(np.sqrt(max(float(vector @ image), 0.0)))
        if not size > 0.0:
            return
        vector, image = vector / size, image / size
        vectors, images = np.vstack([vectors, vector]), np.vstack([images, image])
        products = np.vstack([products, product(vector)])
        # The tangent is symmetric but for rounding and moments of fixed axes.
        table = vectors @ products.T
        values, shares = np.linalg.eigh(0.5 * (table + table.T))
        image = shares[:, 0] @ (products - values[0] * images)
        vector = solve(image)
        yield float(values[0]), float(np.sqrt(max(float(vector @ image), 0.0)))
