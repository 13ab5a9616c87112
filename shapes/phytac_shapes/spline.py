"""Natural cubic splines through equally spaced knots, on numpy alone."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Spline:
    """Curve through ``values`` (k, …) at parameters 0, 1, …, k - 1; straight beyond its ends."""

    values: FloatArray

    @cached_property
    def _second(self) -> FloatArray:
        """Second derivatives at the knots, zero at both ends."""
        y = np.asarray(self.values, dtype=np.float64)
        count = len(y)
        second = np.zeros_like(y)
        if count > 2:
            inner = count - 2
            matrix = (
                4.0 * np.eye(inner)
                + np.diag(np.ones(inner - 1), 1)
                + np.diag(np.ones(inner - 1), -1)
            )
            right = 6.0 * (y[2:] - 2.0 * y[1:-1] + y[:-2])
            second[1:-1] = np.linalg.solve(matrix, right.reshape(inner, -1)).reshape(right.shape)
        return second

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Value, first and second derivative by t, each (n, …), at parameters t (n,)."""
        t = np.asarray(t, dtype=np.float64)
        y, m = np.asarray(self.values, dtype=np.float64), self._second
        k = np.clip(np.floor(t).astype(np.int64), 0, len(y) - 2)
        shape = (-1,) + (1,) * (y.ndim - 1)
        b = np.clip(t - k, 0.0, 1.0).reshape(shape)
        beyond = (t - k).reshape(shape) - b
        a = 1.0 - b
        value = a * y[k] + b * y[k + 1] + ((a**3 - a) * m[k] + (b**3 - b) * m[k + 1]) / 6.0
        slope = y[k + 1] - y[k] + ((1.0 - 3.0 * a**2) * m[k] + (3.0 * b**2 - 1.0) * m[k + 1]) / 6.0
        return value + beyond * slope, slope, a * m[k] + b * m[k + 1]
