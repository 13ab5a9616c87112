"""Anderson's acceleration of x ← x + K₀⁻¹ r(x), in the norm of K₀."""

import numpy as np

from phytac_shapes.arrays import FloatArray

MEMORY = 12
"""Differences that are remembered."""
RCOND = 1e-12
"""Share of the largest singular value below which a direction of the memory is dropped."""
TINY = 1e-300


class AndersonAcceleration:
    """Differences of the last steps, and the next step from them (Walker and Ni 2011)."""

    def __init__(self) -> None:
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None
        self._steps: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        self._table = np.zeros((0, 0))

    def next(
        self, x: FloatArray, g: FloatArray, residual: FloatArray, damping: float
    ) -> FloatArray:
        """Return the next motion.

        Parameters
        ----------
        x, g, residual : (n,) float
            The motion, K₀⁻¹r and the residual r there.
        damping : float
            Share of the remaining g that is added.
        """
        if self._last is not None:
            before, g_before, residual_before = self._last
            self._steps.append((x - before, g - g_before, residual - residual_before))
            line = np.array([change @ self._steps[-1][2] for _, change, _ in self._steps])
            count = len(line)
            table = np.empty((count, count))
            table[:-1, :-1] = self._table
            table[-1], table[:, -1] = line, line
            self._steps, self._table = self._steps[-MEMORY:], table[-MEMORY:, -MEMORY:]
        self._last = x, g, residual
        out = x + damping * g
        if self._steps:
            scale = 1.0 / np.sqrt(np.maximum(np.diag(self._table), TINY))
            right = scale * np.array([change @ residual for _, change, _ in self._steps])
            scaled = scale[:, None] * self._table * scale
            share = scale * np.linalg.lstsq(scaled, right, rcond=RCOND)[0]
            for part, (step, change, _) in zip(share, self._steps, strict=True):
                out -= part * (step + damping * change)
        return out
