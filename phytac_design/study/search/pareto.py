"""Pareto fronts."""

import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


def front(values: FloatArray) -> BoolArray:
    """Non-dominated rows (n,) of (n, k) values to minimise; equal rows all count."""
    out = np.ones(len(values), dtype=np.bool_)
    for number, own in enumerate(values):
        if out[number]:
            out &= ~(np.all(values >= own, axis=1) & np.any(values > own, axis=1))
    return out


def ranks(values: FloatArray) -> IntArray:
    """Number of the front (n,) that each of (n, k) values is on, once earlier ones are removed."""
    out = np.full(len(values), -1, dtype=np.int64)
    remaining, number = np.arange(len(values)), 0
    while len(remaining):
        best = front(values[remaining])
        out[remaining[best]] = number
        remaining, number = remaining[~best], number + 1
    return out
