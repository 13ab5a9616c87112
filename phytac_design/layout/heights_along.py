"""Distances along the sensor, by which accuracies are grouped."""

import numpy as np

from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

MIDDLE = (0.125, 0.792)
"""Middle of the sensor as fractions of its length: heights 15 to 95 mm of 120 (paper)."""


def along_mm(surface: Surface, uv: FloatArray) -> FloatArray:
    """Return the distance of chart positions from the near rim along the unwrapped surface, mm."""
    low = surface.domain[0, 0]
    flat = surface.unwrap(uv)[:, 1]
    start = np.column_stack([np.full(len(uv), low), uv[:, 1]])
    return np.asarray(flat - surface.unwrap(start)[:, 1])


def length_mm(surface: Surface) -> float:
    """Return the length of the sensor from rim to rim, along v0, mm."""
    (_, u1), (v0, _) = surface.domain
    return float(along_mm(surface, np.array([[u1, v0]]))[0])


def middle_mm(surface: Surface) -> tuple[float, float]:
    """Return the bounds of the middle of this sensor, mm."""
    length = length_mm(surface)
    return MIDDLE[0] * length, MIDDLE[1] * length
