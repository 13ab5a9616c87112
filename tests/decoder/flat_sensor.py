"""A flat sensor in closed form: what a load of any second moments does to its markers' images.

A load with covariance M about its centre dents the face by a Gaussian of covariance s²·1 + M: the
load itself, taken as a Gaussian, smeared by the sheet's own. Images move with the dent's depth and
slope, and by a share of the force more: a sheet that softens.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from phytac_decoder.estimation.contact_fit import ContactPrior, MarkerNoise, ShiftNoise
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray, IntArray

SIDE_MM = 60.0
PITCH_MM = 6.0
SMEAR_MM = 7.0
RADIUS_MM = 5.0
SOFTENING = 0.01
DISC = np.array([RADIUS_MM**2 / 4.0, 0.0, RADIUS_MM**2 / 4.0])


def grid(step_mm: float, margin_mm: float = 0.0) -> FloatArray:
    """Points (m, 3) of a square grid."""
    count = round((SIDE_MM - 2.0 * margin_mm) / step_mm) + 1
    line = np.linspace(margin_mm, SIDE_MM - margin_mm, count)
    x, y = np.meshgrid(line, line, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


MARKERS = grid(PITCH_MM, 3.0)


def neighbours() -> IntArray:
    """The eight nearest in the grid, -1 beyond its edges."""
    side = round(len(MARKERS) ** 0.5)
    out = np.full((len(MARKERS), 8), -1)
    steps = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
    for i in range(side):
        for j in range(side):
            for k, (a, b) in enumerate(steps):
                if 0 <= i + a < side and 0 <= j + b < side:
                    out[i * side + j, k] = (i + a) * side + j + b
    return out


def per_newton(point_mm: FloatArray, moments: FloatArray = DISC) -> FloatArray:
    """Shifts (2n,) px by a small load at a point (3,) with second moments xx, xy, yy."""
    spread = SMEAR_MM**2 * np.eye(2) + np.array([moments[[0, 1]], moments[[1, 2]]])
    inverse = np.linalg.inv(spread)
    arm = MARKERS[:, :2] - point_mm[:2]
    depth = SMEAR_MM**2 / np.sqrt(np.linalg.det(spread))
    depth = depth * np.exp(-0.5 * np.einsum("ni,ij,nj->n", arm, inverse, arm))
    slope = -depth[:, None] * (arm @ inverse)
    return np.asarray((np.array([0.4, 0.3]) * depth[:, None] + 5.0 * slope).ravel())


def shifts(
    point_mm: FloatArray, force_N: float, moments: FloatArray = DISC, *, soft: float = SOFTENING
) -> FloatArray:
    """Shifts (2n,) px of one load."""
    return per_newton(point_mm, moments) * force_N * (1.0 + soft * force_N)


def together(points_mm: Sequence[FloatArray], forces_N: Sequence[float]) -> FloatArray:
    """Shifts (2n,) px of loads at once."""
    return np.sum([shifts(at, f) for at, f in zip(points_mm, forces_N, strict=True)], axis=0)


def flat_places(step_mm: float = 2.5) -> ResponseTable:
    """Tables of the sensor."""
    points = grid(step_mm)
    first = np.stack([per_newton(point) for point in points])
    both = np.stack([first, SOFTENING * first], axis=1)
    ones = np.ones(len(points))
    return ResponseTable(
        point_mm=points,
        along=np.outer(ones, [1.0, 0.0, 0.0]),
        around=np.outer(ones, [0.0, 1.0, 0.0]),
        shift_px=both.astype(np.float32),
        radius_mm=RADIUS_MM,
    )


def flat_locator(*, place_mm: float = 1.5, noise_px: float = 0.02) -> ContactLocator:
    """The estimator ``auto`` of the sensor."""
    return ContactLocator(
        places=flat_places(),
        position_mm=MARKERS,
        neighbours=neighbours(),
        footprint_mm=2.3,
        threshold_N=np.full(len(MARKERS), 0.5),
        prior=ContactPrior(place_mm=place_mm),
        noise=ShiftNoise(centroid_px=noise_px, share=0.005, switched_px=0.0),
    )


def with_fitted_noise(locator: ContactLocator) -> ContactLocator:
    """The same, its noise fitted to each marker's own data: all have the usual one."""
    still = np.full(2 * len(MARKERS), locator.noise.centroid_px)
    noise = MarkerNoise(still_px=still, moved_px=np.zeros_like(still))
    return replace(locator, noise=replace(locator.noise, markers=noise, fitted=True))


def nearest(point_mm: FloatArray) -> int:
    """Marker nearest to a point."""
    return int(np.argmin(np.linalg.norm(MARKERS - point_mm, axis=1)))
