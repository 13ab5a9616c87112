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

from phytac_design.core.kernels import kernel
from phytac_shapes.arrays import FloatArray

EDGE_PX = 1e-9
"""Pixels this close outside an edge belong to the triangle: shared edges leave no holes."""


class View(NamedTuple):
    """A scene ready to fill, in pieces: triangles cut at the near plane, or split by their bulge.

    ``camera`` (V, 3) mm, camera frame; ``triangles`` (P, 3), the corners in ``camera`` whose plane
    and edges count; ``image`` (P, 3, 2) px, the corners of the piece; ``bulge`` (P,) px, by which
    the piece may reach beyond them; ``source`` (P,), index of the scene's triangle; ``lens`` =
    (fx, fy, cx, cy) px; ``rays`` (rows, columns, 3), unit directions of every ``spacing``-th pixel
    from ``origin`` (column, row) on, NaN where the lens sees nothing; no rows for a pinhole.
    """

    camera: FloatArray
    triangles: NDArray[np.int32]
    image: FloatArray
    bulge: FloatArray
    source: NDArray[np.int32]
    lens: FloatArray
    rays: FloatArray
    origin: NDArray[np.int64]
    spacing: int = 1


Grid = tuple[int, int, int, float, float]
"""First column and row of a window, step between its pixels, and offset (x, y) px of all."""


Pixel = tuple[float, float]
Point = tuple[float, float, float]
# Kernels pass numbers, not slices: counting the references of slices costs as much as the work.


@kernel
def outline(view: View, piece: int) -> tuple[Pixel, Pixel, Pixel]:
    """Corners of a piece on the image."""
    image = view.image
    return (
        (image[piece, 0, 0], image[piece, 0, 1]),
        (image[piece, 1, 0], image[piece, 1, 1]),
        (image[piece, 2, 0], image[piece, 2, 1]),
    )


@kernel
def corner(view: View, piece: int, number: int) -> Point:
    """Corner of the triangle that a piece is of, mm."""
    vertex, camera = view.triangles[piece, number], view.camera
    return camera[vertex, 0], camera[vertex, 1], camera[vertex, 2]


@kernel
def reach(view: View, piece: int) -> tuple[float, float, float, float]:
    """Box (x0, y0, x1, y1) px that holds all pixels of a piece."""
    a, b, c = outline(view, piece)
    margin = view.bulge[piece] + EDGE_PX
    return (
        min(a[0], b[0], c[0]) - margin,
        min(a[1], b[1], c[1]) - margin,
        max(a[0], b[0], c[0]) + margin,
        max(a[1], b[1], c[1]) + margin,
    )


@kernel
def meets(low: float, high: float, start: float, step: int, count: int) -> bool:
    """Whether one of a grid's ``count`` lines lies between ``low`` and ``high``."""
    first = max(0.0, np.ceil((low - start) / step))
    return bool(first <= min(count - 1.0, np.floor((high - start) / step)))


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
        _fill_distorted(view, chosen, grid, owner, inverse)


Line = tuple[float, float, float]
"""Start (x, y) and dx / dy of an edge: at y it lies at x + slope (y - start)."""
Sides = tuple[Line, Line, Line, Line]
"""Two lines on the left and two on the right of a triangle; those it lacks are infinitely far."""


@kernel
def sides(a: Pixel, b: Pixel, c: Pixel, margin: float) -> Sides:
    """Edges of a triangle, moved out by ``margin`` px or a little more.

    Horizontal edges are skipped: they bound the rows, not the columns within one.
    """
    if (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) < 0.0:
        b, c = c, b
    left, left_2 = (-np.inf, 0.0, 0.0), (-np.inf, 0.0, 0.0)
    right, right_2 = (np.inf, 0.0, 0.0), (np.inf, 0.0, 0.0)
    for start, end in ((a, b), (b, c), (c, a)):
        dx, dy = end[0] - start[0], end[1] - start[1]
        slope = dx / dy
        out = margin * (1.0 + abs(slope))  # along x; margin √(1 + slope²), from above
        if dy > 0.0:
            right_2, right = right, (start[0] + out, start[1], slope)
        elif dy < 0.0:
            left_2, left = left, (start[0] - out, start[1], slope)
    return left, left_2, right, right_2


@kernel
def span(edges: Sides, y: float, first: float, last: float) -> tuple[float, float]:
    """Part of a row between ``first`` and ``last`` that lies between all sides."""
    a, b, c, d = edges
    first = max(first, a[0] + a[2] * (y - a[1]), b[0] + b[2] * (y - b[1]))
    return first, min(last, c[0] + c[2] * (y - c[1]), d[0] + d[2] * (y - d[1]))


@kernel
def _plane(p: Point, q: Point, r: Point) -> tuple[float, float, float, float]:
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
    # Twice the image area below which a pinhole sees a triangle edge-on; it is skipped.
    area_px2 = 1e-15
    rows, columns = owner.shape
    x0, y0, step = grid[0] + grid[3], grid[1] + grid[4], grid[2]
    fx, fy, cx, cy = view.lens
    per_step = 1.0 / step
    for piece in chosen:
        a, b, c = outline(view, piece)
        low, high = min(a[1], b[1], c[1]) - EDGE_PX, max(a[1], b[1], c[1]) + EDGE_PX
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        if not (high >= y0 and low <= y0 + step * (rows - 1)) or not (
            right >= x0 - 1.0 and left <= x0 + step * columns
        ):
            continue
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if abs(area) < area_px2:
            continue
        p, q, r = corner(view, piece, 0), corner(view, piece, 1), corner(view, piece, 2)
        if area < 0.0:  # Turn it, so that the inside of every edge has the same sign.
            q, r = r, q
        nx, ny, nz, plane = _plane(p, q, r)
        if plane == 0.0:
            continue
        near, far = 1.0 / min(p[2], q[2], r[2]), 1.0 / max(p[2], q[2], r[2])
        nx, ny, nz = nx / (fx * plane), ny / (fy * plane), nz / plane
        edges = sides(a, b, c, EDGE_PX)
        first_row = max(0, int(np.ceil((low - y0) / step - EDGE_PX)))
        for row in range(first_row, min(rows - 1, int(np.floor((high - y0) / step + EDGE_PX))) + 1):
            y = y0 + step * row
            ends = span(edges, y, x0, x0 + step * (columns - 1.0))
            first = int(np.ceil((ends[0] - x0) * per_step - EDGE_PX))
            base = nz + ny * (y - cy) - nx * cx
            for column in range(first, int(np.floor((ends[1] - x0) * per_step + EDGE_PX)) + 1):
                z = min(max(base + nx * (x0 + step * column), far), near)
                if z > inverse[row, column]:
                    inverse[row, column] = z
                    owner[row, column] = view.source[piece]


@kernel
def edge_normal(p: Point, q: Point, sign: float) -> Point:
    """Cross product of two corners: exactly opposite for the neighbour across the edge."""
    return (
        sign * (p[1] * q[2] - p[2] * q[1]),
        sign * (p[2] * q[0] - p[0] * q[2]),
        sign * (p[0] * q[1] - p[1] * q[0]),
    )


@kernel
def _fill_distorted(
    view: View,
    chosen: NDArray[np.int32],
    grid: Grid,
    owner: NDArray[np.int32],
    inverse: FloatArray,
) -> None:
    """Pieces of a bent image."""
    rows, columns = owner.shape
    left, top, step, right, down = grid
    x0, y0, rays = left + right, top + down, view.rays
    ray_left = (left - view.origin[0]) // view.spacing
    ray_top, ray_step = (top - view.origin[1]) // view.spacing, step // view.spacing
    per_step = 1.0 / step
    for piece in chosen:
        margin = view.bulge[piece]
        a, b, c = outline(view, piece)
        low, high = min(a[1], b[1], c[1]) - margin, max(a[1], b[1], c[1]) + margin
        if not (high >= y0 and low <= y0 + step * (rows - 1)):
            continue
        near = max(x0, min(a[0], b[0], c[0]) - margin)
        wide = min(x0 + step * (columns - 1.0), max(a[0], b[0], c[0]) + margin)
        p, q, r = corner(view, piece, 0), corner(view, piece, 1), corner(view, piece, 2)
        n = edge_normal(q, r, 1.0)
        volume = p[0] * n[0] + p[1] * n[1] + p[2] * n[2]
        if wide < near or not abs(volume) > 0.0:
            continue
        sign = 1.0 if volume > 0.0 else -1.0
        na, nb, nc = edge_normal(p, q, sign), edge_normal(q, r, sign), edge_normal(r, p, sign)
        scale = 1.0 / abs(volume)
        edges = sides(a, b, c, margin)
        first_row = max(0, int(np.ceil((low - y0) / step - EDGE_PX)))
        for row in range(first_row, min(rows - 1, int(np.floor((high - y0) / step + EDGE_PX))) + 1):
            y = y0 + step * row
            ends = span(edges, y, near, wide)
            first = int(np.ceil((ends[0] - x0) * per_step - EDGE_PX))
            line = ray_top + ray_step * row
            for column in range(first, int(np.floor((ends[1] - x0) * per_step + EDGE_PX)) + 1):
                ray = ray_left + ray_step * column
                dx, dy, dz = rays[line, ray, 0], rays[line, ray, 1], rays[line, ray, 2]
                e = dx * na[0] + dy * na[1] + dz * na[2]
                f = dx * nb[0] + dy * nb[1] + dz * nb[2]
                g = dx * nc[0] + dy * nc[1] + dz * nc[2]
                value = (e + f + g) * scale
                if min(e, f, g) >= 0.0 and value > inverse[row, column]:
                    inverse[row, column] = value
                    owner[row, column] = view.source[piece]
