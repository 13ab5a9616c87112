"""Curvatures of a surface along its chart's lines."""

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.surface import Surface


def curvatures(surface: Surface, uv: FloatArray) -> FloatArray:
    """Curvatures (n, 2) along the chart's lines, 1/mm, positive where the outer face is convex."""
    out = []
    for axis, (low, high) in enumerate(surface.domain):
        step = np.zeros(2)
        step[axis] = 1e-4 * (high - low)
        inner = np.clip(uv, surface.domain[:, 0] + step, surface.domain[:, 1] - step)
        tangent = surface.tangents(inner)[:, axis]
        turn = (surface.normal(inner + step) - surface.normal(inner - step)) / (2.0 * step[axis])
        size = np.maximum(np.sum(tangent**2, axis=1), 1e-12)
        out.append(np.sum(turn * tangent, axis=1) / size)
    return np.stack(out, axis=1)
