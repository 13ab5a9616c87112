r"""Finite rotations as unit quaternions, vectorised; exact to relative precision when tiny.

A quaternion (w, v) turns x by R x = x + 2w v×x + 2 v×(v×x). Nothing here forms R − 1 by
subtraction, so that rotations of 1e-12 rad keep their digits. Sources: Felippa and Haugen (2005),
*A unified formulation of small-strain corotational finite elements*, appendix; Shuster (1993).
"""

import numpy as np

from phytac_shapes.arrays import FloatArray

SMALL = 0.1
"""Angle (rad) below which the series is used instead of a closed form that cancels."""


def spin(v: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) with spin(v) x = v × x, of vectors (..., 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product over the last axis; several times faster than ``numpy.cross``."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def identity(count: int) -> FloatArray:
    """Quaternions (count, 4) of no rotation."""
    out = np.zeros((count, 4))
    out[:, 0] = 1.0
    return out


def exponential(theta: FloatArray) -> FloatArray:
    """Quaternion (..., 4) of the rotation vector ``theta`` (..., 3), rad."""
    half = 0.5 * np.linalg.norm(theta, axis=-1)
    # np.sinc(x) = sin(πx)/(πx)
    return np.concatenate(
        [np.cos(half)[..., None], 0.5 * np.sinc(half / np.pi)[..., None] * theta], axis=-1
    )


def logarithm(q: FloatArray) -> FloatArray:
    """Rotation vector (..., 3), rad, of length <= π, of quaternions (..., 4)."""
    q = np.where(q[..., :1] < 0.0, -q, q)
    w, v = q[..., 0], q[..., 1:]
    length = np.linalg.norm(v, axis=-1)
    ratio = np.where(
        length > 0.0, 2.0 * np.arctan2(length, w) / np.where(length > 0.0, length, 1.0), 2.0
    )
    return np.asarray(ratio[..., None] * v)


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Quaternion (..., 4) of b followed by a: R(product) = R(a) R(b); normalised."""
    wa, va, wb, vb = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    w = wa * wb - np.sum(va * vb, axis=-1, keepdims=True)
    out = np.concatenate([w, wa * vb + wb * va + cross(va, vb)], axis=-1)
    return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))


def inverse(q: FloatArray) -> FloatArray:
    """Quaternion of the opposite rotation."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def deviation(q: FloatArray) -> FloatArray:
    """R − 1, (..., 3, 3), without cancellation."""
    w, V = q[..., 0, None, None], spin(q[..., 1:])
    return np.asarray(2.0 * (w * V + V @ V))


def matrix(q: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3)."""
    return deviation(q) + np.eye(3)


def spin_to_vector(theta: FloatArray) -> FloatArray:
    """H (..., 3, 3): change of the rotation vector per spin ω, where δR = spin(ω) R.

    H = 1 − θ̂/2 + η θ̂², η = (1 − (θ/2) cot(θ/2)) / θ².
    """
    T = spin(theta)
    return np.asarray(np.eye(3) - 0.5 * T + _eta(theta)[0][..., None, None] * (T @ T))


def moment_change(theta: FloatArray, moment: FloatArray) -> FloatArray:
    """∂(H(θ)ᵀ m)/∂θ, (..., 3, 3), at constant m: Felippa and Haugen (2005), eq. 101.

    H(θ)ᵀ m = m + θ×m/2 + η θ×(θ×m).
    """
    eta, mu = (c[..., None, None] for c in _eta(theta))
    along = np.sum(theta * moment, axis=-1)[..., None, None]
    column, row = theta[..., :, None], theta[..., None, :]
    twice = cross(theta, cross(theta, moment))[..., :, None]
    m_column, m_row = moment[..., :, None], moment[..., None, :]
    inner = along * np.eye(3) + column * m_row - 2.0 * m_column * row
    return np.asarray(-0.5 * spin(moment) + eta * inner + mu * twice * row)


def _eta(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """η(θ) of ``spin_to_vector`` and μ = η'(θ)/θ."""
    square = np.sum(theta * theta, axis=-1)
    angle = np.sqrt(square)
    safe = np.where(angle < SMALL, 1.0, angle)
    half = 0.5 * safe
    sine = np.sin(half)
    eta = (1.0 - half * np.cos(half) / sine) / safe**2
    mu = (safe * (safe + np.sin(safe)) - 8.0 * sine**2) / (4.0 * safe**4 * sine**2)
    eta_series = 1.0 / 12.0 + square / 720.0 + square**2 / 30240.0
    mu_series = 1.0 / 360.0 + square / 7560.0 + square**2 / 201600.0
    small = angle < SMALL
    return np.where(small, eta_series, eta), np.where(small, mu_series, mu)
