"""Structured meshes of solids of revolution: blocks of nine-node quadrilaterals, joined."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray

SAME = 1e-7
"""Nodes closer than this share of the body's size are one."""


@dataclass(frozen=True, kw_only=True)
class AxiMesh:
    """Half section of a solid of revolution about r = 0.

    Attributes
    ----------
    nodes_mm : (N, 2) float
        r and z.
    quads : (E, 9) int
        Local node 3 i + j is the i-th along ξ (outward) and the j-th along η (upward).
    """

    nodes_mm: FloatArray
    quads: IntArray

    def at(self, r_mm: float, z_mm: float) -> int:
        """Node nearest to a place."""
        return int(np.argmin(np.hypot(*(self.nodes_mm - [r_mm, z_mm]).T)))

    def where(self, condition: FloatArray) -> IntArray:
        """Nodes whose entry of ``condition`` (N,) vanishes to within ``SAME``."""
        size = float(np.ptp(self.nodes_mm, axis=0).max())
        return np.flatnonzero(np.abs(condition) <= SAME * size)


def block(low: FloatArray, high: FloatArray, layers: int) -> FloatArray:
    """Nodes (2m + 1, 2·layers + 1, 2) between two lines of nodes (2m + 1, 2)."""
    share = np.linspace(0.0, 1.0, 2 * layers + 1)[None, :, None]
    return (1.0 - share) * low[:, None] + share * high[:, None]


def join(blocks: Sequence[FloatArray]) -> AxiMesh:
    """Mesh of blocks (2m + 1, 2k + 1, 2) whose common edges have the same nodes."""
    points, quads, start = [], [], 0
    for grid in blocks:
        along, across, _ = grid.shape
        number = start + np.arange(along * across).reshape(along, across)
        window = np.lib.stride_tricks.sliding_window_view(number, (3, 3))[::2, ::2]
        quads.append(window.reshape(-1, 9))
        points.append(grid.reshape(-1, 2))
        start += along * across
    nodes = np.concatenate(points)
    size = float(np.ptp(nodes, axis=0).max())
    key = np.round(nodes / (SAME * size)).astype(np.int64)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return AxiMesh(nodes_mm=nodes[first], quads=inverse.ravel()[np.concatenate(quads)])
