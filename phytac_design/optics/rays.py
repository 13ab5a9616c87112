"""The direction of every pixel of a lens, once per lens.

Most lenses have no closed inverse. It is taken exactly on a coarse grid of pixels and interpolated
between (bicubic Lagrange). Each cell is checked in its middle; where it is off by more than
``RAY_ERROR``, or a node lies beyond the field, the cell's pixels are taken exactly.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from decoder.lens import Lens
from phytac_design.optics.kernels import in_bands, kernel
from shapes.arrays import FloatArray

STEPS = (16, 8, 4, 2)
RAY_ERROR = 1e-8
"""Largest error of an interpolated unit direction: 1e-5 px at a focal length of 1000 px."""
REFINE = 8.0
"""The next finer grid costs this / step² pixels of the image; it must save as many exact ones."""
SMOOTH, EXACT, BLIND = 0, 1, 2
"""What to do in a cell: interpolate, take pixels exactly, nothing to see."""


class RayGrid:
    """Exact directions on a grid of pixels around the image, and what each cell of it needs."""

    def __init__(self, lens: Lens) -> None:
        self.lens = lens
        for step in STEPS:
            self.step, self.nodes = step, _nodes(lens, step)
            self.state = _states(lens, self.nodes, step)
            if (self.state == EXACT).mean() <= REFINE / step**2:
                break

    def rows(self, first: int, last: int, offset: FloatArray) -> FloatArray:
        """Directions (last - first, width, 3) of the pixels of some rows, moved by ``offset``."""
        out = np.empty((last - first, self.lens.width_px, 3))
        missing = np.zeros(out.shape[:2], dtype=np.bool_)
        _interpolate(
            self.nodes,
            self.state,
            self.step,
            (first, float(offset[0]), float(offset[1])),
            out,
            missing,
        )
        y, x = np.nonzero(missing)
        if len(x):
            pixels = np.column_stack([x, y + first]) + offset
            out[y, x] = self.lens.unproject(pixels)
        return out


def _nodes(lens: Lens, step: int) -> FloatArray:
    """Directions at every ``step``-th pixel, from one node before the image to two after it."""
    x = step * np.arange(-1, lens.width_px // step + 3, dtype=np.float64)
    y = step * np.arange(-1, lens.height_px // step + 3, dtype=np.float64)
    xx, yy = np.meshgrid(x, y)
    return lens.unproject(np.column_stack([xx.ravel(), yy.ravel()])).reshape(len(y), len(x), 3)


def _states(lens: Lens, nodes: FloatArray, step: int) -> NDArray[np.uint8]:
    """What each cell (rows - 3, columns - 3) needs; its corners are nodes 1 and 2 of four."""
    rows, columns = nodes.shape[0] - 3, nodes.shape[1] - 3
    seen = np.isfinite(nodes[..., 2])
    count = np.zeros((rows, columns), dtype=np.int64)
    middle = np.zeros((rows, columns, 3))
    weights = (-0.0625, 0.5625, 0.5625, -0.0625)  # of the four nodes around a cell's middle
    for m in range(4):
        for n in range(4):
            part = (slice(m, m + rows), slice(n, n + columns))
            count += seen[part]
            middle += weights[m] * weights[n] * nodes[part]
    y, x = np.nonzero(count == 16)
    exact = lens.unproject(np.column_stack([x + 0.5, y + 0.5]) * step)
    wrong = ~(np.abs(middle[y, x] - exact).max(axis=1) <= RAY_ERROR)
    state = np.where(count == 0, BLIND, EXACT).astype(np.uint8)
    state[y, x] = np.where(wrong, EXACT, SMOOTH)
    return state


@kernel
def _weights(t: float) -> tuple[float, float, float, float]:
    """Cubic Lagrange weights of nodes -1, 0, 1, 2 at ``t`` between 0 and 1."""
    return (
        -t * (t - 1.0) * (t - 2.0) / 6.0,
        (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
        -(t + 1.0) * t * (t - 2.0) / 2.0,
        (t + 1.0) * t * (t - 1.0) / 6.0,
    )


@kernel
def _interpolate(
    nodes: FloatArray,
    state: NDArray[np.uint8],
    step: int,
    start: tuple[int, float, float],
    out: FloatArray,
    missing: NDArray[np.bool_],
) -> None:
    """Directions of whole rows from row ``start[0]`` on, moved by ``start[1:]``."""
    first, dx, dy = start
    line = np.empty((nodes.shape[1], 3))
    for row in range(out.shape[0]):
        v = (first + row + dy) / step
        k = min(max(int(np.floor(v)), 0), state.shape[0] - 1)
        wy = _weights(v - k)
        for j in range(nodes.shape[1]):
            for axis in range(3):
                line[j, axis] = (
                    wy[0] * nodes[k, j, axis]
                    + wy[1] * nodes[k + 1, j, axis]
                    + wy[2] * nodes[k + 2, j, axis]
                    + wy[3] * nodes[k + 3, j, axis]
                )
        for column in range(out.shape[1]):
            u = (column + dx) / step
            j = min(max(int(np.floor(u)), 0), state.shape[1] - 1)
            missing[row, column] = state[k, j] == EXACT
            if state[k, j] != SMOOTH:
                out[row, column] = np.nan
                continue
            wx = _weights(u - j)
            for axis in range(3):
                out[row, column, axis] = (
                    wx[0] * line[j, axis]
                    + wx[1] * line[j + 1, axis]
                    + wx[2] * line[j + 2, axis]
                    + wx[3] * line[j + 3, axis]
                )


@lru_cache(maxsize=4)
def ray_grid(lens: Lens) -> RayGrid:
    """The grid of a lens, kept for the last few lenses."""
    return RayGrid(lens)


@lru_cache(maxsize=2)
def pixel_rays(lens: Lens) -> FloatArray:
    """Unit directions (h, w, 3) of all pixel centres, camera frame; kept for the last two lenses.

    24 bytes a pixel; do not write to it.
    """
    grid = ray_grid(lens)
    out = np.empty((lens.height_px, lens.width_px, 3))

    def band(first: int, last: int) -> None:
        out[first:last] = grid.rows(first, last, np.zeros(2))

    in_bands(band, lens.height_px)
    return out
