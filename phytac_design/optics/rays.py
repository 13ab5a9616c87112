"""The direction of every pixel of a lens, once per lens.

Most lenses have no closed inverse. It is computed exactly on a coarse grid of pixels and
interpolated between (Lagrange, six nodes each way). A cell whose error at its middle exceeds
``RAY_ERROR``, or with a node beyond the field, is split into four; pixels of the remaining cells
are computed exactly.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from phytac_decoder.camera.lens import Lens
from phytac_design.core.kernels import in_bands, kernel
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

STEPS = (32, 16, 8, 4)
"""Sides of the cells, coarse to fine, px."""
RAY_ERROR = 1e-8
"""Largest error of an interpolated unit direction: 1e-5 px at a focal length of 1000 px."""
TAPS = 6
BEFORE = 2
"""Nodes of a cell each way, and how many of them lie before its first corner."""
ELSEWHERE, SMOOTH, EXACT = 0, 1, 2
"""What to do in a cell: nothing (another level does it, or nothing is seen), interpolate, take
pixels exactly."""


@dataclass(frozen=True, kw_only=True)
class Level:
    """Cells of one size: ``nodes`` (rows + 5, columns + 5, 3), ``state`` (rows, columns)."""

    step: int
    nodes: FloatArray
    state: NDArray[np.uint8]


class RayGrid:
    """Exact directions on grids of pixels around the image, and what each cell of them needs."""

    def __init__(self, lens: Lens) -> None:
        # Cells are at least this much smaller than the field, so that none spans it.
        field_cells = 16.0
        self.lens = lens
        self.levels: list[Level] = []
        finest = STEPS[-1]
        most = max(finest, float(lens.focal_px.min()) * min(lens.field_rad, 1.0) / field_cells)
        steps = [step for step in STEPS if step <= most]
        first = steps[0]
        rows, columns = -(-lens.height_px // first), -(-lens.width_px // first)
        wanted = np.ones((rows, columns), dtype=np.bool_)
        for step in steps:
            level = _level(lens, step, wanted)
            self.levels.append(level)
            wanted = level.state == EXACT
            if not wanted.any():
                break
            if step > finest:
                level.state[wanted] = ELSEWHERE
                wanted = np.repeat(np.repeat(wanted, 2, axis=0), 2, axis=1)

    def rows(self, first: int, last: int, offset: FloatArray) -> FloatArray:
        """Directions (last - first, width, 3) of the pixels of some rows, moved by ``offset``.

        ``offset`` (2,) px is at most half a pixel each way.
        """
        out = np.empty((last - first, self.lens.width_px, 3))
        self.fill_rows(first, last, offset, out)
        return out

    def fill_rows(self, first: int, last: int, offset: FloatArray, out: FloatArray) -> None:
        """Write what :meth:`rows` returns into ``out``."""
        if any((level.state == ELSEWHERE).any() for level in self.levels):
            out[:] = np.nan
        for level in self.levels:
            shares = (np.arange(level.step)[:, None] + offset) / level.step
            across, down = _weights(shares[:, 0]), _weights(shares[:, 1])
            _interpolate(level.nodes, level.state, first, across, down, out)
        finest = self.levels[-1]
        exact = np.repeat(finest.state == EXACT, finest.step, axis=1)[:, : out.shape[1]]
        if exact.any():
            y, x = np.nonzero(exact[np.arange(first, last) // finest.step])
            out[y, x] = self.lens.unproject(np.column_stack([x, y + first]) + offset)

    def at(self, pixels: IntArray) -> FloatArray:
        """Directions (n, 3) of some pixels (n, 2), which may lie beyond the image."""
        out = np.empty((len(pixels), 3))
        missing = np.ones(len(pixels), dtype=np.bool_)
        for level in self.levels:
            weights = _weights(np.arange(level.step) / level.step)

            def some(first: int, last: int, level: Level = level, w: FloatArray = weights) -> None:
                rows = slice(first, last)
                _pick(level.nodes, level.state, w, pixels[rows], out[rows], missing[rows])

            in_bands(some, len(pixels))
        out[missing] = self.lens.unproject(pixels[missing].astype(np.float64))
        return out


def _level(lens: Lens, step: int, wanted: BoolArray) -> Level:
    """Nodes of the wanted cells (rows, columns), and what each of those needs."""
    rows, columns = wanted.shape
    needed = np.zeros((rows + TAPS - 1, columns + TAPS - 1), dtype=np.bool_)
    for m in range(TAPS):
        for n in range(TAPS):
            needed[m : m + rows, n : n + columns] |= wanted
    nodes = np.full((*needed.shape, 3), np.nan)
    y, x = np.nonzero(needed)
    nodes[y, x] = lens.unproject(
        np.column_stack([x - BEFORE, y - BEFORE]).astype(np.float64) * step
    )
    seen = sliding_window_view(np.isfinite(nodes[..., 2]), (TAPS, TAPS))
    near = seen[:, :, 1:-1, 1:-1].any(axis=(2, 3))
    state = np.where(wanted & near, EXACT, ELSEWHERE).astype(np.uint8)
    y, x = np.nonzero(wanted & seen.all(axis=(2, 3)))
    weights = _weights(np.array([0.5]))[0]
    around = sliding_window_view(nodes, (TAPS, TAPS), axis=(0, 1))[y, x]
    middle = np.einsum("kcmn,m,n->kc", around, weights, weights)
    exact = lens.unproject(np.column_stack([x + 0.5, y + 0.5]) * float(step))
    good = np.abs(middle - exact).max(axis=1) <= RAY_ERROR
    state[y[good], x[good]] = SMOOTH
    return Level(step=step, nodes=nodes, state=state)


def _weights(share: FloatArray) -> FloatArray:
    """Lagrange weights (m, TAPS) of a cell's nodes at shares (m,) of its side."""
    place = np.arange(TAPS) - float(BEFORE)
    weights = np.ones((len(share), TAPS))
    for i in range(TAPS):
        for j in range(TAPS):
            if i != j:
                weights[:, i] *= (share - place[j]) / (place[i] - place[j])
    return weights


@kernel
def _interpolate(
    nodes: FloatArray,
    state: NDArray[np.uint8],
    first: int,
    across: FloatArray,
    down: FloatArray,
    out: FloatArray,
) -> None:
    """Directions in all smooth cells of whole rows from row ``first`` on.

    ``across`` and ``down`` (step, TAPS) weigh the nodes for each column and row of a cell.
    """
    step, width = len(across), out.shape[1]
    line = np.empty((nodes.shape[1], 3))
    for row in range(out.shape[0]):
        k = (first + row) // step
        if not (state[k] == SMOOTH).any():
            continue
        w = down[(first + row) % step]
        for j in range(nodes.shape[1]):
            for axis in range(3):
                line[j, axis] = (
                    w[0] * nodes[k, j, axis]
                    + w[1] * nodes[k + 1, j, axis]
                    + w[2] * nodes[k + 2, j, axis]
                    + w[3] * nodes[k + 3, j, axis]
                    + w[4] * nodes[k + 4, j, axis]
                    + w[5] * nodes[k + 5, j, axis]
                )
        for j in range(state.shape[1]):
            if state[k, j] != SMOOTH:
                continue
            left = j * step
            for axis in range(3):
                a, b, c = line[j, axis], line[j + 1, axis], line[j + 2, axis]
                d, e, f = line[j + 3, axis], line[j + 4, axis], line[j + 5, axis]
                for i in range(min(step, width - left)):
                    out[row, left + i, axis] = (
                        across[i, 0] * a
                        + across[i, 1] * b
                        + across[i, 2] * c
                        + across[i, 3] * d
                        + across[i, 4] * e
                        + across[i, 5] * f
                    )


@kernel
def _pick(
    nodes: FloatArray,
    state: NDArray[np.uint8],
    weights: FloatArray,
    pixels: IntArray,
    out: FloatArray,
    missing: BoolArray,
) -> None:
    """Directions of those ``pixels`` (n, 2) that lie in smooth cells; they are not ``missing``."""
    step = len(weights)
    for i in range(len(pixels)):
        x, y = pixels[i]
        j, k = x // step, y // step
        if min(x, y) < 0 or j >= state.shape[1] or k >= state.shape[0] or state[k, j] != SMOOTH:
            continue
        missing[i] = False
        across, down = weights[x - j * step], weights[y - k * step]
        for axis in range(3):
            total = 0.0
            for m in range(TAPS):
                line = 0.0
                for n in range(TAPS):
                    line += across[n] * nodes[k + m, j + n, axis]
                total += down[m] * line
            out[i, axis] = total


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
        grid.fill_rows(first, last, np.zeros(2), out[first:last])

    in_bands(band, lens.height_px)
    return out
