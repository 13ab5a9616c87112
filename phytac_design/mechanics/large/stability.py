"""Stability of an equilibrium, and whether an increment stayed on its path.

Two measures of stability:

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

from collections.abc import Callable
from typing import Any

import numpy as np

from phytac_design.mechanics.shell.solve import SUPERLU
from phytac_shapes.arrays import FloatArray

PATH_DEVIATION_MAX = 0.5
"""Largest deviation of an increment from the tangents at its ends, over its motion, on one smooth
path; the trapezoidal rule is far better on the smooth paths tried."""
FACTOR_RESIDUAL_MAX = 1e-6
"""Largest residual of a solve with unpivoted factors whose pivot signs are used."""
INDEPENDENT_SHARE = 1e-8
"""Share of a vector that must remain when its part in the basis is subtracted."""
ROWS_ADDED = 8
"""Vectors by which the storage grows at a time."""


def negative_pivots(factor: Any, matrix: Any) -> int | None:
    """Negative eigenvalues of a (nearly) symmetric matrix, from the signs of its pivots.

    Where partial pivoting left the diagonal, the symmetric part is factored again without it; that
    factor is used only if it solves a system to ``FACTOR_RESIDUAL_MAX``.

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
        if not (diagonal and np.linalg.norm(gap) <= FACTOR_RESIDUAL_MAX * np.linalg.norm(right)):
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


class LowestEigenvalue:
    """Rayleigh and Ritz's procedure on the tangent, in the norm of the stiffness at rest.

    Parameters
    ----------
    vector, image : (n,) float
        First vector of the basis, and K₀ times it.

    Attributes
    ----------
    gap : float
        ‖K₀⁻¹K_t v − θ v‖ of the lowest pair (θ, v) at its last refinement: there is an
        eigenvalue within it of θ, in most cases the lowest.
    """

    def __init__(self, vector: FloatArray, image: FloatArray) -> None:
        # Vectors q, images K₀ q, products K_t q, one per row.
        self._rows = np.empty((3, 0, len(vector)))
        self._count = self._known = 0
        self._table = np.zeros((0, 0))
        self.gap = np.inf
        self.extend(vector, image)

    def extend(self, vector: FloatArray, image: FloatArray) -> None:
        """Add a vector and its image to the basis, unless it contains them already."""
        before = float(vector @ image)
        vectors, images = self._rows[0, : self._count], self._rows[1, : self._count]
        for _ in range(2):
            share = images @ vector
            vector, image = vector - share @ vectors, image - share @ images
        left = float(vector @ image)
        if not left > INDEPENDENT_SHARE * INDEPENDENT_SHARE * before:
            return
        if self._count == self._rows.shape[1]:
            grown = np.empty((3, self._count + ROWS_ADDED, len(vector)))
            grown[:, : self._count] = self._rows
            self._rows = grown
        self._rows[0, self._count] = vector / np.sqrt(left)
        self._rows[1, self._count] = image / np.sqrt(left)
        self._count += 1

    def measure(self, product: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
        """Form the products still missing: ``product(q, K₀ q)`` gives K_t q."""
        for k in range(self._known, self._count):
            vector, image, out = self._rows[:, k]
            out[:] = product(vector, image)
            known = self._rows[:, : k + 1]
            # The tangent is symmetric but for rounding and moments of fixed axes.
            line = 0.5 * (known[0] @ out + known[2] @ vector)
            table = np.empty((k + 1, k + 1))
            table[:k, :k] = self._table
            table[k], table[:, k] = line, line
            self._table, self._known = table, k + 1

    @property
    def lowest(self) -> float:
        """Lowest Ritz value."""
        return float(np.linalg.eigvalsh(self._table)[0])

    @property
    def highest(self) -> float:
        """Largest Ritz value."""
        return float(np.linalg.eigvalsh(self._table)[-1])

    @property
    def lower_bound(self) -> float:
        """Lowest Ritz value less the residual's length."""
        return self.lowest - self.gap

    @property
    def products(self) -> int:
        """Products formed."""
        return self._known

    def restarted(self) -> "LowestEigenvalue":
        """The same basis without its products, for another tangent."""
        out = LowestEigenvalue(self._rows[0, 0], self._rows[1, 0])
        for vector, image in zip(*self._rows[:2, 1 : self._count], strict=True):
            out.extend(vector, image)
        return out

    def residual(self) -> FloatArray:
        """K_t v − θ K₀ v of the lowest pair."""
        image, product = self._share() @ self._rows[1:, : self._known]
        return np.asarray(product - self.lowest * image)

    def refine(self, vector: FloatArray, image: FloatArray) -> None:
        """Add K₀⁻¹ of the residual, and keep its length."""
        self.gap = float(np.sqrt(max(float(vector @ image), 0.0)))
        self.extend(vector, image)

    def rate(self, force: FloatArray) -> FloatArray:
        """Motion per unit of load, K_t⁻¹ force, within the basis."""
        known = self._rows[0, : self._known]
        return np.asarray(np.linalg.solve(self._table, known @ force) @ known)

    def _share(self) -> FloatArray:
        return np.asarray(np.linalg.eigh(self._table)[1][:, 0])
