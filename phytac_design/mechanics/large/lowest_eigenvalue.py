"""How soft a loaded shell has become against itself at rest: Ritz values of K₀⁻¹ K_t.

A basis Q, orthonormal in K₀, and the products K_t Q give the Ritz values of QᵀK_tQ. The least one
lies above the least eigenvalue; the basis grows by K₀⁻¹ times the residual of the least pair, which
closes in on that eigenvalue (Davidson's method with K₀, factored already; from a single vector it
spans what Lanczos' does). The start must be random: from the motion itself the least value settles
on the softest mode of the load's own symmetry, and modes of other symmetry would buckle unseen.

The residual's length is a distance from the least Ritz value to *an* eigenvalue. From a random
start, and after a few steps, the difference of both has been a lower bound of the least one or
within a few hundredths of it.
"""

from collections.abc import Callable

import numpy as np

from phytac_shapes.arrays import FloatArray

NEW = 1e-8
"""Share of a vector that must be left when the basis is taken out of it."""
ROOM = 8
"""Vectors that room is made for at a time."""


class Softest:
    """Rayleigh and Ritz's procedure on the tangent, in the norm of the stiffness at rest.

    Parameters
    ----------
    vector, image : (n,) float
        First vector of the basis, and K₀ times it.

    Attributes
    ----------
    gap : float
        ‖K₀⁻¹K_t v − θ v‖ of the least pair (θ, v) when it was last closed in on: there is an
        eigenvalue within it of θ, in most cases the least.
    """

    def __init__(self, vector: FloatArray, image: FloatArray) -> None:
        # Vectors q, images K₀ q, products K_t q, one per row.
        self._rows = np.empty((3, 0, len(vector)))
        self._count = self._known = 0
        self._table = np.zeros((0, 0))
        self.gap = np.inf
        self.add(vector, image)

    def add(self, vector: FloatArray, image: FloatArray) -> None:
        """Take a vector and its image into the basis, unless it holds them already."""
        before = float(vector @ image)
        vectors, images = self._rows[0, : self._count], self._rows[1, : self._count]
        for _ in range(2):
            share = images @ vector
            vector, image = vector - share @ vectors, image - share @ images
        left = float(vector @ image)
        if not left > NEW * NEW * before:
            return
        if self._count == self._rows.shape[1]:
            grown = np.empty((3, self._count + ROOM, len(vector)))
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
    def least(self) -> float:
        """Least Ritz value."""
        return float(np.linalg.eigvalsh(self._table)[0])

    @property
    def largest(self) -> float:
        """Largest Ritz value."""
        return float(np.linalg.eigvalsh(self._table)[-1])

    @property
    def sure(self) -> float:
        """Least Ritz value less the residual's length."""
        return self.least - self.gap

    @property
    def steps(self) -> int:
        """Products formed."""
        return self._known

    def afresh(self) -> "Softest":
        """The same basis without its products, for another tangent."""
        out = Softest(self._rows[0, 0], self._rows[1, 0])
        for vector, image in zip(*self._rows[:2, 1 : self._count], strict=True):
            out.add(vector, image)
        return out

    def residual(self) -> FloatArray:
        """K_t v − θ K₀ v of the least pair."""
        image, product = self._share() @ self._rows[1:, : self._known]
        return np.asarray(product - self.least * image)

    def close_in(self, vector: FloatArray, image: FloatArray) -> None:
        """Take K₀⁻¹ of the residual in, and note how long it is."""
        self.gap = float(np.sqrt(max(float(vector @ image), 0.0)))
        self.add(vector, image)

    def rate(self, force: FloatArray) -> FloatArray:
        """Motion per unit of load, K_t⁻¹ force, as far as the basis holds it."""
        known = self._rows[0, : self._known]
        return np.asarray(np.linalg.solve(self._table, known @ force) @ known)

    def _share(self) -> FloatArray:
        return np.asarray(np.linalg.eigh(self._table)[1][:, 0])
