r"""Noise of force-displacement data, estimated from the residuals.

Row i of press p, with y the displacement that the model expects::

    measured_i = y_i·(1 + a·ε_i + τ·η_p) + f·ε'_i        ε, ε', η standard normal

``a`` is the relative noise of a row, ``f`` the floor of the displacement reading, and ``τ`` the
relative error of the force reading, *common to all rows of one press*: without it a thousand
markers seen under one press would look like a thousand measurements of the modulus.
"""

from dataclasses import dataclass

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class MeasurementNoise:
    """Standard deviations.

    Attributes
    ----------
    relative : float
        Of each row, as a fraction of its displacement.
    floor_mm : float
        Of each row, absolute.
    force_relative : float
        Of each press, as a fraction of its force; 0 where every press has one row.
    """

    relative: float
    floor_mm: float
    force_relative: float


def whiten(
    noise: MeasurementNoise, expected: FloatArray, press: IntArray, columns: FloatArray
) -> FloatArray:
    """V^(-1/2)·columns (n, k) for the covariance V of the noise; rows ``expected`` mm (n,)."""
    sigma = np.hypot(noise.relative * expected, noise.floor_mm)
    scaled, g = columns / sigma[:, None], expected / sigma
    if noise.force_relative == 0.0:
        return np.asarray(scaled)
    energy = np.bincount(press, g * g)
    gain = -np.expm1(-0.5 * np.log1p(noise.force_relative**2 * energy))
    gain = gain / np.maximum(energy, 1e-300)
    dots = np.stack([np.bincount(press, g * column) for column in scaled.T], axis=1)
    return np.asarray(scaled - (gain[:, None] * dots)[press] * g[:, None])


def estimate_noise(
    expected: FloatArray,
    residual: FloatArray,
    press: IntArray,
    *,
    fitted: int,
    start: MeasurementNoise | None = None,
) -> MeasurementNoise:
    """Most likely noise for the residuals (n,) mm of a model with ``fitted`` parameters.

    The search begins at ``start``, an estimate for nearly the same residuals, where there is one.

    The likelihood counts the residuals as n/(n - fitted) larger, and the force error as
    P/(P - 1), for what the fit has taken out of n rows and P presses.
    """
    from scipy.optimize import minimize

    size = float(np.sqrt(np.mean(expected**2)))
    grouped = press.max() + 1 < len(press)
    residual = residual * np.sqrt(len(residual) / max(1, len(residual) - fitted))
    # Relative noise, floor and force error: data without noise must not divide by zero.
    scale = np.array([1.0, size, 1.0])
    low = np.log(np.array([1e-5, 1e-6, 1e-5]) * scale)
    count = 3 if grouped else 2

    def unpack(log: FloatArray) -> tuple[float, float, float]:
        values = np.exp(np.maximum(log, low[:count]))
        return float(values[0]), float(values[1]), float(values[2]) if grouped else 0.0

    def cost(log: FloatArray) -> float:
        a, f, tau = unpack(log)
        variance = (a * expected) ** 2 + f * f
        total = np.sum(np.log(variance) + residual**2 / variance)
        if grouped:
            s = np.bincount(press, expected**2 / variance)
            q = np.bincount(press, expected * residual / variance)
            total += np.sum(np.log1p(tau**2 * s) - tau**2 * q * q / (1.0 + tau**2 * s))
        return float(total)

    begin = np.array([0.05, 1e-2, 0.01]) * scale
    if start is not None:
        begin = np.array([start.relative, start.floor_mm, start.force_relative])
    first = np.maximum(np.log(np.maximum(begin, 1e-300)), low)[:count]
    # Half a percent of a noise level, a thousandth in the log-likelihood.
    options = {"xatol": 5e-3, "fatol": 1e-3, "initial_simplex": _simplex(first)}
    best = minimize(cost, first, method="Nelder-Mead", options=options)
    a, f, tau = unpack(best.x)
    presses = int(press.max()) + 1
    return MeasurementNoise(
        relative=a, floor_mm=f, force_relative=tau * np.sqrt(presses / max(1, presses - 1))
    )


def _simplex(first: FloatArray) -> FloatArray:
    """A search simplex of half an e-fold in every direction, toward the inside."""
    return np.asarray(np.vstack([first, first + 0.5 * np.eye(len(first))]))
