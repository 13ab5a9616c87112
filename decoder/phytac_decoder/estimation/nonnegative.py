"""Non-negative least squares."""

import numpy as np

from phytac_shapes.arrays import FloatArray


def nonnegative_least_squares(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Minimise ½ fᵀ G f − rᵀ f over f >= 0.

    Block principal pivoting (Júdice and Pires 1994) exchanges whole sets, and single variables
    where that cycles. It needs a few solves; active-set methods need one per unknown.

    Parameters
    ----------
    gram : (m, m) float
        AᵀA, positive definite on every subset.
    right : (m,) float
        Aᵀb.
    """
    size = len(right)
    tolerance = 1e-12 * max(float(np.abs(right).max(initial=0.0)), 1e-300)
    passive = np.ones(size, dtype=np.bool_)
    fewest, patience = size + 1, 3
    f = np.zeros(size)
    for _ in range(10 * size + 10):
        index = np.flatnonzero(passive)
        f = np.zeros(size)
        f[index] = _solved(gram[index[:, None], index], right[index])
        wrong = np.where(passive, f < 0.0, right - gram @ f > tolerance)
        count = int(wrong.sum())
        if count == 0:
            break
        if count < fewest:
            fewest, patience = count, 3
        elif patience > 0:
            patience -= 1
        else:
            # Murty's rule: the last one alone, which cannot cycle.
            wrong[: np.flatnonzero(wrong)[-1]] = False
        passive ^= wrong
    return np.maximum(f, 0.0)


def _solved(gram: FloatArray, right: FloatArray) -> FloatArray:
    try:
        return np.asarray(np.linalg.solve(gram, right))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(gram, right, rcond=None)[0])
