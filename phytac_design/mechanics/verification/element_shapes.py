"""Single elements of every awkward shape, for trials of their rigid motions."""

import numpy as np

from phytac_shapes.arrays import FloatArray

SHAPES: dict[str, tuple[tuple[float, float, float], ...]] = {
    "square": ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)),
    "skewed": ((0, 0, 0), (1, 0, 0), (1.8, 0.6, 0), (0.8, 0.6, 0)),
    "tapered": ((0, 0, 0), (1, 0, 0), (0.6, 1, 0), (0.4, 1, 0)),
    "warped": ((0, 0, 0), (1.3, 0.1, 0.2), (1.1, 1.2, -0.3), (-0.1, 0.9, 0.4)),
    "twisted by 90°": ((0, -0.5, 0), (1, -0.5, 0), (1, 0, 0.5), (0, 0.5, 0)),
    "aspect 100": ((0, 0, 0), (100, 0, 0), (100, 1, 0), (0, 1, 0)),
    "nearly a triangle": ((0, 0, 0), (1, 0, 0), (0.505, 0.5, 0), (0, 1, 0)),
}
"""Corners of one element each."""


def element_shape(name: str) -> tuple[FloatArray, FloatArray]:
    """Nodes (4, 3) and unit directors (4, 3), the normals of the bilinear face at its corners."""
    nodes = np.array(SHAPES[name], dtype=np.float64)
    after = np.roll(nodes, -1, axis=0) - nodes
    normals = np.cross(after, -np.roll(after, 1, axis=0))
    return nodes, normals / np.linalg.norm(normals, axis=1)[:, None]
