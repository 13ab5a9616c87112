"""Brown-Conrady distortion of a plane, its derivative, and its inverse.

Coefficients are (8,) in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6, with
``x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2 x²)``
and y' alike (OpenCV, calib3d).
"""

import numpy as np

from phytac_shapes.arrays import FloatArray


def _radial(r2: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radial factor and its derivative by r²; NaN where the denominator is not positive."""
    top = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    top_slope = k[0] + r2 * (2.0 * k[1] + r2 * 3.0 * k[4])
    bottom = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    bottom = np.where(bottom > 0.0, bottom, np.nan)
    bottom_slope = k[5] + r2 * (2.0 * k[6] + r2 * 3.0 * k[7])
    factor = top / bottom
    return factor, (top_slope - factor * bottom_slope) / bottom


def distort(plane: FloatArray, k: FloatArray) -> FloatArray:
    """Distorted points (n, 2) of points (n, 2) on the undistorted plane."""
    x, y = plane[:, 0], plane[:, 1]
    r2 = x * x + y * y
    factor = _radial(r2, k)[0]
    p1, p2 = k[2], k[3]
    return np.column_stack(
        [
            x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    )


def distort_jacobian(plane: FloatArray, k: FloatArray) -> FloatArray:
    """Derivative of :func:`distort`, (n, 2, 2)."""
    x, y = plane[:, 0], plane[:, 1]
    factor, slope = _radial(x * x + y * y, k)
    p1, p2 = k[2], k[3]
    out = np.empty((len(plane), 2, 2))
    out[:, 0, 0] = factor + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    out[:, 0, 1] = out[:, 1, 0] = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    out[:, 1, 1] = factor + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return out


def undistort(
    bent: FloatArray, k: FloatArray, radius: FloatArray, distorted: FloatArray
) -> FloatArray:
    """Inverse of :func:`distort` by Newton's method from the radial table; NaN if not converged.

    Parameters
    ----------
    bent : (n, 2) float
        Distorted points.
    radius, distorted : (m,) float
        Radii of the field and their radial distortion, both rising.
    """
    size = np.hypot(bent[:, 0], bent[:, 1])
    # A little beyond the field, for tangential distortion; the caller cuts at the field itself.
    far = 1.05 * radius[-1]
    reach = distorted[-1] + 4.0 * far**2 * (abs(k[2]) + abs(k[3]))
    shrink = np.interp(size, distorted, radius) / np.where(size > 0.0, size, 1.0)
    plane = bent * np.where(size > 0.0, shrink, 1.0)[:, None]
    plane[~(size <= reach)] = np.nan
    left = np.flatnonzero(size <= reach)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for _ in range(12):
            here, wanted = plane[left], bent[left]
            error = distort(here, k) - wanted
            open_ = ~(np.abs(error).max(axis=1) <= 1e-14 * np.maximum(1.0, size[left]))
            left, here, error = left[open_], here[open_], error[open_]
            if not len(left):
                break
            slope = distort_jacobian(here, k)
            a, b, c, d = slope[:, 0, 0], slope[:, 0, 1], slope[:, 1, 0], slope[:, 1, 1]
            step = np.column_stack(
                [d * error[:, 0] - b * error[:, 1], a * error[:, 1] - c * error[:, 0]]
            )
            here = here - step / (a * d - b * c)[:, None]
            off = np.hypot(here[:, 0], here[:, 1])
            plane[left] = here * np.where(off > far, far / off, 1.0)[:, None]
    plane[left] = np.nan
    return plane
