"""The direction of every pixel of a lens, once per lens.

Most lenses have no closed inverse. It is computed exactly on a coarse grid of pixels and
interpolated between (Lagrange, six nodes each way). Pixels of cells whose error at the middle is
too large, or with a node beyond the field, are computed exactly.
"""

from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from phytac_decoder.camera.lens import Lens
from phytac_design.core.kernels import in_bands, kernel
from phytac_shapes.arrays import BoolArray, FloatArray

TAPS, BEFORE = 6, 2
"""Nodes of a cell each way, and how many of them lie before its first corner."""


class RayGrid:
    """Exact directions on a grid of pixels around the image, interpolated between.

    Parameters
    ----------
    lens : Lens
        The lens.
    step : int
        Side of the cells, px. Eight cost little to set up, and leave few pixels at the border of a
        field to be computed one by one.
    error : float
        Largest error of an interpolated unit direction; 1e-8 is 1e-5 px at a focal length of
        1000 px.
    """

    def __init__(self, lens: Lens, *, step: int = 8, error: float = 1e-8) -> None:
        self.lens, self.step = lens, step
        rows, columns = -(-lens.height_px // step), -(-lens.width_px // step)
        y, x = np.indices((rows + TAPS - 1, columns + TAPS - 1)).reshape(2, -1) - BEFORE
        nodes = lens.unproject(step * np.column_stack([x, y]).astype(np.float64))
        nodes = nodes.reshape(rows + TAPS - 1, columns + TAPS - 1, 3)
        windows = sliding_window_view(np.isfinite(nodes[..., 2]), (TAPS, TAPS))
        self.smooth: BoolArray = np.asarray(windows.all(axis=(2, 3)))
        self.nodes = np.nan_to_num(nodes)
        y, x = np.nonzero(self.smooth)
        middle = _weights(np.array([0.5]))[0]
        around = sliding_window_view(self.nodes, (TAPS, TAPS), axis=(0, 1))[y, x]
        found = np.einsum("kcmn,m,n->kc", around, middle, middle)
        exact = lens.unproject(np.column_stack([x + 0.5, y + 0.5]) * float(step))
        self.smooth[y, x] = np.abs(found - exact).max(axis=1) <= error

    def rows(self, first: int, last: int, offset: FloatArray) -> FloatArray:
        """Directions (last - first, width, 3) of the pixels of some rows, moved by ``offset``.

        ``offset`` (2,) px is at most half a pixel each way.
        """
        out = np.empty((last - first, self.lens.width_px, 3))
        self.fill_rows(first, last, offset, out)
        return out

    def fill_rows(self, first: int, last: int, offset: FloatArray, out: FloatArray) -> None:
        """Write what :meth:`rows` returns into ``out``."""
        shares = (np.arange(self.step)[:, None] + offset) / self.step
        across, down = _weights(shares[:, 0]), _weights(shares[:, 1])
        _interpolate(self.nodes, self.smooth, first, across, down, out)
        cells = self.smooth[np.arange(first, last) // self.step]
        y, x = np.nonzero(~np.repeat(cells, self.step, axis=1)[:, : out.shape[1]])
        out[y, x] = self.lens.unproject(np.column_stack([x, y + first]) + offset)


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
    smooth: BoolArray,
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
        line[:] = 0.0
        for m in range(TAPS):
            line += down[(first + row) % step, m] * nodes[k + m]
        for j in range(smooth.shape[1]):
            if not smooth[k, j]:
                continue
            for i in range(min(step, width - j * step)):
                for axis in range(3):
                    total = 0.0
                    for n in range(TAPS):
                        total += across[i, n] * line[j + n, axis]
                    out[row, j * step + i, axis] = total


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
