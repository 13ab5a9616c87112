"""Compiled z-buffer: triangles into windows of pixels, for straight and for bent images.

A pinhole keeps lines straight: each triangle is filled row by row between its exact edge
crossings, and inverse depth is the plane through the triangle evaluated at the pixel, linear on
the image. Any other lens bends lines: there a row's span is only a bound, wider than the triangle
by the bulge of its edges, and each pixel centre in it is tested with its own ray d: inside if
``d·(a×b)``, ``d·(b×c)``, ``d·(c×a)`` have the sign of ``a·(b×c)``; their sum over that determinant
is the inverse distance. That holds in all directions, also behind the image plane. Float64
throughout, no fixed point, no back-face culling.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phytac_design.optics.kernels import kernel
from shapes.arrays import FloatArray

EDGE_PX = 1e-9
"""Pixels this close outside an edge belong to the triangle: shared edges leave no holes."""
AREA_PX2 = 1e-15
"""Twice the image area below which a pinhole sees a triangle edge-on; it is skipped."""


class View(NamedTuple):
    """A scene ready to fill, in pieces: triangles cut at the near plane, or split by their bulge.

    ``camera`` (V, 3) mm, camera frame; ``triangles`` (P, 3), the corners in ``camera`` whose plane
    and edges count; ``image`` (P, 3, 2) px, the corners of the piece; ``bulge`` (P,) px, by which
    the piece may reach beyond them; ``source`` (P,), index of the scene's triangle; ``lens`` =
    (fx, fy, cx, cy) px; ``rays`` (rows, columns, 3), unit directions of the pixels from
    ``origin`` (column, row) on, NaN where the lens sees nothing; no rows for a pinhole.
    """

    camera: FloatArray
    triangles: NDArray[np.int32]
    image: FloatArray
    bulge: FloatArray
    source: NDArray[np.int32]
    lens: FloatArray
    rays: FloatArray
    origin: NDArray[np.int64]


Grid = tuple[int, int, int, float, float]
"""First column and row of a window, step between its pixels, and offset (x, y) px of all."""


@kernel
def fill(
    view: View,
    chosen: NDArray[np.int32],
    grid: Grid,
    owner: NDArray[np.int32],
    inverse: FloatArray,
) -> None:
    """Fill the ``chosen`` pieces into a window of pixels.

    ``owner`` gets ``source`` of the nearest triangle; ``inverse`` its 1/z for a pinhole, 1 over
    the distance along the ray for other lenses (0 = nothing yet).
    """
    if view.rays.shape[0] == 0:
        _fill_straight(view, chosen, grid, owner, inverse)
    else:
        _fill_bent(view, chosen, grid, owner, inverse)


Edge = tuple[float, float, float, float, float]
"""Start (x, y), extent (dx, dy) and dx / dy of an edge."""


@kernel
def _edge(start: FloatArray, end: FloatArray) -> Edge:
    """Edge between two corners of an image triangle."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    return start[0], start[1], dx, dy, dx / dy


@kernel
def _crossing(edge: Edge, y: float, span: tuple[float, float]) -> tuple[float, float]:
    """Narrow a row's span (first, last) to the inner side of one edge."""
    first, last = span
    x, start, dx, dy, slope = edge
    if dy > 0.0:
        last = min(last, x + slope * (y - start) + EDGE_PX)
    elif dy < 0.0:
        first = max(first, x + slope * (y - start) - EDGE_PX)
    elif dx * (y - start) < -EDGE_PX * abs(dx):
        last = first - 1.0
    return first, last


@kernel
def _plane(p: FloatArray, q: FloatArray, r: FloatArray) -> tuple[float, float, float, float]:
    """Normal of the triangle (p, q, r), not normalised, and its product with p."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return nx, ny, nz, nx * p[0] + ny * p[1] + nz * p[2]


@kernel
def _fill_straight(
    view: View,
    chosen: NDArray[np.int32],
    grid: Grid,
    owner: NDArray[np.int32],
    inverse: FloatArray,
) -> None:
    """Triangles of a pinhole's image."""
    rows, columns = owner.shape
    x0, y0, step = grid[0] + grid[3], grid[1] + grid[4], grid[2]
    fx, fy, cx, cy = view.lens
    per_step = 1.0 / step
    for piece in chosen:
        a, b, c = view.image[piece, 0], view.image[piece, 1], view.image[piece, 2]
        low, high = min(a[1], b[1], c[1]) - EDGE_PX, max(a[1], b[1], c[1]) + EDGE_PX
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        if not (high >= y0 and low <= y0 + step * (rows - 1)) or not (
            right >= x0 - 1.0 and left <= x0 + step * columns
        ):
            continue
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < AREA_PX2:
            continue
        ia, ib, ic = view.triangles[piece]
        if area < 0.0:  # Turn it, so that the inside of every edge has the same sign.
            ib, ic, b, c = ic, ib, c, b
        p, q, r = view.camera[ia], view.camera[ib], view.camera[ic]
        nx, ny, nz, plane = _plane(p, q, r)
        if plane == 0.0:
            continue
        near, far = 1.0 / min(p[2], q[2], r[2]), 1.0 / max(p[2], q[2], r[2])
        nx, ny, nz = nx / (fx * plane), ny / (fy * plane), nz / plane
        edges = (_edge(a, b), _edge(b, c), _edge(c, a))
        first_row = max(0, int(np.ceil((low - y0) / step - EDGE_PX)))
        for row in range(first_row, min(rows - 1, int((high - y0) / step + EDGE_PX)) + 1):
            y = y0 + step * row
            span = (x0, x0 + step * (columns - 1.0))
            for edge in edges:
                span = _crossing(edge, y, span)
            first = int(np.ceil((span[0] - x0) * per_step - EDGE_PX))
            base = nz + ny * (y - cy) - nx * cx
            for column in range(first, int((span[1] - x0) * per_step + EDGE_PX) + 1):
                z = min(max(base + nx * (x0 + step * column), far), near)
                if z > inverse[row, column]:
                    inverse[row, column] = z
                    owner[row, column] = view.source[piece]


@kernel
def _wide_crossing(
    edge: Edge, y: float, margin: float, span: tuple[float, float]
) -> tuple[float, float]:
    """Narrow a row's span to what is on the inner side of an edge, or ``margin`` px beyond."""
    first, last = span
    x, start, dx, dy, slope = edge
    if dy == 0.0:
        return first, (first - 1.0 if dx * (y - start) < -margin * abs(dx) else last)
    wide = margin * np.sqrt(1.0 + slope * slope)
    if dy > 0.0:
        last = min(last, x + slope * (y - start) + wide)
    else:
        first = max(first, x + slope * (y - start) - wide)
    return first, last


@kernel
def _edge_normal(p: FloatArray, q: FloatArray, sign: float) -> tuple[float, float, float]:
    """Cross product of two corners: exactly opposite for the neighbour across the edge."""
    return (
        sign * (p[1] * q[2] - p[2] * q[1]),
        sign * (p[2] * q[0] - p[0] * q[2]),
        sign * (p[0] * q[1] - p[1] * q[0]),
    )


@kernel
def _fill_bent(
    view: View,
    chosen: NDArray[np.int32],
    grid: Grid,
    owner: NDArray[np.int32],
    inverse: FloatArray,
) -> None:
    """Pieces of a bent image."""
    rows, columns = owner.shape
    left, top, step, dx, dy = grid
    x0, y0 = left + dx, top + dy
    ray_left, ray_top = left - view.origin[0], top - view.origin[1]
    per_step = 1.0 / step
    for piece in chosen:
        margin = view.bulge[piece]
        a, b, c = view.image[piece, 0], view.image[piece, 1], view.image[piece, 2]
        low, high = min(a[1], b[1], c[1]) - margin, max(a[1], b[1], c[1]) + margin
        if not (high >= y0 and low <= y0 + step * (rows - 1)):
            continue
        near = max(x0, min(a[0], b[0], c[0]) - margin)
        wide = min(x0 + step * (columns - 1.0), max(a[0], b[0], c[0]) + margin)
        ia, ib, ic = view.triangles[piece]
        p, q, r = view.camera[ia], view.camera[ib], view.camera[ic]
        n = _edge_normal(q, r, 1.0)
        volume = p[0] * n[0] + p[1] * n[1] + p[2] * n[2]
        if wide < near or not abs(volume) > 0.0:
            continue
        sign = 1.0 if volume > 0.0 else -1.0
        na, nb, nc = _edge_normal(p, q, sign), _edge_normal(q, r, sign), _edge_normal(r, p, sign)
        scale = 1.0 / abs(volume)
        if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0.0:
            b, c = c, b
        edges = (_edge(a, b), _edge(b, c), _edge(c, a))
        first_row = max(0, int(np.ceil((low - y0) / step - EDGE_PX)))
        for row in range(first_row, min(rows - 1, int((high - y0) / step + EDGE_PX)) + 1):
            y = y0 + step * row
            span = (near, wide)
            for edge in edges:
                span = _wide_crossing(edge, y, margin, span)
            first = int(np.ceil((span[0] - x0) * per_step - EDGE_PX))
            rays = view.rays[ray_top + step * row]
            for column in range(first, int((span[1] - x0) * per_step + EDGE_PX) + 1):
                d = rays[ray_left + step * column]
                e = d[0] * na[0] + d[1] * na[1] + d[2] * na[2]
                f = d[0] * nb[0] + d[1] * nb[1] + d[2] * nb[2]
                g = d[0] * nc[0] + d[1] * nc[1] + d[2] * nc[2]
                value = (e + f + g) * scale
                if min(e, f, g) >= 0.0 and value > inverse[row, column]:
                    inverse[row, column] = value
                    owner[row, column] = view.source[piece]
