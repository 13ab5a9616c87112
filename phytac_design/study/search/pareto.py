"""Fronts of what cannot be better in everything, and how much they cover."""

import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


def front(values: FloatArray) -> BoolArray:
    """Which of (n, k) values, less is better, no other one is at least as good as in everything.

    Of equals all count. Values are taken from the best sum on, so that few comparisons are left.
    """
    n = len(values)
    out = np.zeros(n, dtype=np.bool_)
    spread = np.maximum(np.ptp(values, axis=0), 1e-300) if n else np.ones(values.shape[1])
    order = np.argsort((values / spread).sum(axis=1), kind="stable")
    kept = np.empty((0, values.shape[1]))
    for number in order:
        own = values[number]
        if not np.any(np.all(kept <= own, axis=1) & np.any(kept < own, axis=1)):
            out[number] = True
            kept = np.concatenate([kept, own[None]])
    return out


def ranks(values: FloatArray) -> IntArray:
    """Number of the front (n,) that each of (n, k) values is on, once earlier ones are gone."""
    out = np.full(len(values), -1, dtype=np.int64)
    left, number = np.arange(len(values)), 0
    while len(left):
        here = front(values[left])
        out[left[here]] = number
        left, number = left[~here], number + 1
    return out


def hypervolume(values: FloatArray, reference: FloatArray) -> float:
    """Part of the space below a reference point (k,) that (n, k) values dominate, less is better.

    By slices along the last objective; for the few objectives and points of a front.
    """
    inside = values[np.all(values < reference, axis=1)]
    if len(inside) == 0:
        return 0.0
    if values.shape[1] == 1:
        return float(reference[0] - inside.min())
    order = np.argsort(inside[:, -1], kind="stable")
    inside = inside[order]
    ends = np.append(inside[1:, -1], reference[-1])
    total = 0.0
    for number, (low, high) in enumerate(zip(inside[:, -1], ends, strict=True)):
        if high > low:
            part = inside[: number + 1, :-1]
            total += (high - low) * hypervolume(part[front(part)], reference[:-1])
    return float(total)
