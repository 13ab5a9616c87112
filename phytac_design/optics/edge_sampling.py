"""Light on the pixels where it changes: many samples there, for straight and for bent images.

Pixels inside one evenly lit surface need few samples; those on edges decide where a centroid lies.
A few samples of every pixel find the edges, then only pixels on them and beside them are sampled
finely. A triangle's inside test ``d·(a×b) ≥ 0``, … and inverse depth are linear in the ray d (see
:mod:`phytac_design.optics.zbuffer`), and d is linear across a pixel, exactly for a pinhole: each
costs two gradients a pixel and triangle, and triangles that miss a pixel are left out at once.

Each sample may look through a point o of the aperture of its own. The ray from o to a corner a
meets the surface of sharp focus where the camera's centre sees ``a + o s_a``,
``s_a = |a| / focus - 1`` (a's depth in place of its distance for lenses that image planes sharply).
So an inside test becomes ``d·(a×b) + o·((s_a b - s_b a)×d)``, linear in o, since o×o is 0. Planes
stay planes and depths stay depths, so that each sample sees what hides what from its point.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phytac_design.core.kernels import kernel
from phytac_design.optics.zbuffer import (
    EDGE_PX,
    Point,
    View,
    corner,
    edge_normal,
    outline,
    sides,
    span,
)
from phytac_shapes.arrays import BoolArray, FloatArray

HALF_PX = 0.51
"""A pixel's samples lie this close to its centre, along each axis."""


class Aperture(NamedTuple):
    """``per_focus``, 1 over the distance of sharp focus, 1/mm; ``radius_mm`` holds all points.

    ``flat`` where that distance is along the axis, and not from the centre.
    """

    per_focus: float
    radius_mm: float
    flat: bool


@kernel
def mark_edges(
    owner: NDArray[np.int32],
    shade: NDArray[np.float32],
    side: int,
    step: float,
    edge: BoolArray,
) -> None:
    """Mark pixels whose samples, or whose neighbours' samples, differ in shade.

    Parameters
    ----------
    owner : (side * h, side * w) int32
        Triangle of each of ``side`` by ``side`` samples a pixel.
    shade : (T + 1, 3) float32
        Shade of each triangle and, last, of the background.
    step : float
        Difference from which on shades differ.
    edge : (h, w) bool
        Written.
    """
    rows, columns = owner.shape
    edge[:] = False
    for row in range(rows):
        for column in range(columns):
            t = owner[row, column]
            for way in range(2):
                down, right = row + way, column + 1 - way
                if down >= rows or right >= columns:
                    continue
                u = owner[down, right]
                if u == t or (
                    abs(shade[u, 0] - shade[t, 0]) <= step
                    and abs(shade[u, 1] - shade[t, 1]) <= step
                    and abs(shade[u, 2] - shade[t, 2]) <= step
                ):
                    continue
                # Both sides: the edge may pass on either side of a sample.
                edge[row // side, column // side] = True
                edge[down // side, right // side] = True


@kernel
def mark_blurred(
    edge: BoolArray,
    inverse: FloatArray,
    aperture: Aperture,
    px_per_radian: float,
    near: BoolArray,
) -> None:
    """Mark pixels that a marked edge reaches when it is blurred by a lens.

    Parameters
    ----------
    edge : (h, w) bool
        See :func:`mark_edges`.
    inverse : (side * h, side * w) float
        Inverse depths of the samples, as in :func:`phytac_design.optics.zbuffer.fill`.
    px_per_radian : float
        Largest on the image.
    near : (h, w) bool
        Written.
    """
    rows, columns = edge.shape
    side = inverse.shape[0] // rows
    near[:] = edge
    for row in range(rows):
        for column in range(columns):
            if not edge[row, column]:
                continue
            away = 0.0
            for sample in range(side * side):
                value = inverse[side * row + sample // side, side * column + sample % side]
                if value > 0.0:  # not the background
                    away = max(away, abs(value - aperture.per_focus))
            blur = aperture.radius_mm * px_per_radian * away
            # From any place in this pixel to any place in that one.
            most = int(np.ceil(blur))
            for down in range(max(row - most, 0), min(row + most, rows - 1) + 1):
                half = int(np.sqrt((blur + 1.0) ** 2 - (max(abs(down - row) - 1, 0)) ** 2))
                for right in range(max(column - half, 0), min(column + half, columns - 1) + 1):
                    near[down, right] = True


@kernel
def _bent_rays(
    view: View, first: int, slot: NDArray[np.int32], here: FloatArray, change: FloatArray
) -> None:
    """Write directions at pixels' centres (m, 3), and their changes by a pixel (m, 2, 3).

    The changes are to the right and down.
    """
    rays = view.rays
    rows, columns = rays.shape[:2]
    above = first - view.origin[1]
    for row in range(above, above + slot.shape[0]):
        for column in range(columns):
            k = slot[row - above, column]
            if k < 0:
                continue
            for i in range(3):
                here[k, i] = rays[row, column, i]
            for axis in range(2):
                low_row, low_column = max(row - axis, 0), max(column - 1 + axis, 0)
                high_row, high_column = min(row + axis, rows - 1), column + 1 - axis
                high_column = min(high_column, columns - 1)
                # The lens sees nothing beyond the edge of its field.
                if np.isnan(rays[low_row, low_column, 0]):
                    low_row, low_column = row, column
                if np.isnan(rays[high_row, high_column, 0]):
                    high_row, high_column = row, column
                apart = max(high_row - low_row + high_column - low_column, 1)
                for i in range(3):
                    step = rays[high_row, high_column, i] - rays[low_row, low_column, i]
                    change[k, axis, i] = step / apart


Linear = tuple[np.float32, np.float32, np.float32, np.float32, np.float32]
"""Value at a pixel's centre for the centre of the lens, and its changes.

By a pixel to the right and down, and by a millimetre of the aperture along x and y.
"""


@kernel
def _straight_ray(lens: FloatArray, column: int, row: int) -> tuple[Point, Point, Point]:
    """Direction at the centre of a pixel of a pinhole, and its change to the right and down."""
    fx, fy, cx, cy = lens
    return ((column - cx) / fx, (row - cy) / fy, 1.0), (1.0 / fx, 0.0, 0.0), (0.0, 1.0 / fy, 0.0)


@kernel
def _bent_ray(d: FloatArray, c: FloatArray, k: int) -> tuple[Point, Point, Point]:
    """Return the same of pixel number k, from :func:`_bent_rays`."""
    return (
        (d[k, 0], d[k, 1], d[k, 2]),
        (c[k, 0, 0], c[k, 0, 1], c[k, 0, 2]),
        (c[k, 1, 0], c[k, 1, 1], c[k, 1, 2]),
    )


@kernel
def _stretch(p: Point, aperture: Aperture) -> float:
    """By how much a corner appears moved, over the point of the aperture that is looked through."""
    if aperture.radius_mm == 0.0:
        return 0.0
    away = p[2] if aperture.flat else np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
    return away * aperture.per_focus - 1.0


@kernel
def _between(p: Point, q: Point, s_p: float, s_q: float, scale: float) -> Point:
    """Of an edge from p to q, stretched: what moves its inside test."""
    return (
        scale * (s_p * q[0] - s_q * p[0]),
        scale * (s_p * q[1] - s_q * p[1]),
        scale * (s_p * q[2] - s_q * p[2]),
    )


@kernel
def _side(n: Point, w: Point, ray: tuple[Point, Point, Point]) -> Linear:
    """Inside test of an edge, by its normal and by :func:`_between`."""
    d, x, y = ray
    return (
        np.float32(n[0] * d[0] + n[1] * d[1] + n[2] * d[2]),
        np.float32(n[0] * x[0] + n[1] * x[1] + n[2] * x[2]),
        np.float32(n[0] * y[0] + n[1] * y[1] + n[2] * y[2]),
        np.float32(w[1] * d[2] - w[2] * d[1]),
        np.float32(w[2] * d[0] - w[0] * d[2]),
    )


@kernel
def _misses(side: Linear, radius_mm: float) -> bool:
    """Whether all of a pixel lies outside an edge, through every point of the lens."""
    over_pixel = HALF_PX * (abs(side[1]) + abs(side[2]))
    over_lens = radius_mm * np.sqrt(side[3] ** 2 + side[4] ** 2)
    return bool(side[0] + over_pixel + over_lens < 0.0)


@kernel
def fill_edges(
    view: View,
    chosen: NDArray[np.int32],
    first: int,
    slot: NDArray[np.int32],
    offsets: NDArray[np.float32],
    aperture: Aperture,
    owner: NDArray[np.int32],
    inverse: NDArray[np.float32],
) -> None:
    """Fill the ``chosen`` pieces into the samples of some pixels.

    Parameters
    ----------
    view : View
        Pieces with a ``bulge`` that holds their blur, too.
    first : int
        Row of the image that ``slot`` begins with; a bent view has rays of the rows around it, too.
    slot : (r, w) int32
        Index of each pixel's samples; -1 where it has none.
    offsets : (4, s) float32
        Samples in a pixel, px from its centre to the right and down, and the points of the aperture
        that they look through, mm.
    owner, inverse : (m, s)
        As in :func:`phytac_design.optics.zbuffer.fill`, of each pixel's samples.
    """
    rows, columns = slot.shape
    straight, lens, radius = view.rays.shape[0] == 0, view.lens, aperture.radius_mm
    count = 0 if straight else owner.shape[0]
    here, change = np.empty((count, 3)), np.empty((count, 2, 3))
    if not straight:
        _bent_rays(view, first, slot, here, change)
    one = np.float32(1.0)
    for piece in chosen:
        margin = view.bulge[piece] + HALF_PX
        a, b, c = outline(view, piece)
        low, high = min(a[1], b[1], c[1]) - margin, max(a[1], b[1], c[1]) + margin
        near = max(0.0, min(a[0], b[0], c[0]) - margin)
        wide = min(columns - 1.0, max(a[0], b[0], c[0]) + margin)
        p, q, r = corner(view, piece, 0), corner(view, piece, 1), corner(view, piece, 2)
        n = edge_normal(q, r, 1.0)
        volume = p[0] * n[0] + p[1] * n[1] + p[2] * n[2]
        if wide < near or not abs(volume) > 0.0:
            continue
        # Over the volume: their sum is the inverse depth, over the change of the volume.
        scale = 1.0 / volume
        na, nb, nc = edge_normal(p, q, scale), edge_normal(q, r, scale), edge_normal(r, p, scale)
        s_p, s_q, s_r = _stretch(p, aperture), _stretch(q, aperture), _stretch(r, aperture)
        wa, wb = _between(p, q, s_p, s_q, scale), _between(q, r, s_q, s_r, scale)
        wc = _between(r, p, s_r, s_p, scale)
        v_x = np.float32(s_p * nb[0] + s_q * nc[0] + s_r * na[0])
        v_y = np.float32(s_p * nb[1] + s_q * nc[1] + s_r * na[1])
        lines, source = sides(a, b, c, margin), view.source[piece]
        top = max(0, int(np.ceil(low - first - EDGE_PX)))
        for row in range(top, min(rows - 1, int(np.floor(high - first + EDGE_PX))) + 1):
            ends = span(lines, float(first + row), near, wide)
            left = int(np.ceil(ends[0] - EDGE_PX))
            for column in range(left, int(np.floor(ends[1] + EDGE_PX)) + 1):
                k = slot[row, column]
                if k >= 0:  # The loop over samples is inlined: that is four times as fast.
                    if straight:
                        ray = _straight_ray(lens, column, first + row)
                    else:
                        ray = _bent_ray(here, change, k)
                    tests = _side(na, wa, ray), _side(nb, wb, ray), _side(nc, wc, ray)
                    if (
                        _misses(tests[0], radius)
                        or _misses(tests[1], radius)
                        or _misses(tests[2], radius)
                    ):
                        continue
                    (e_0, e_x, e_y, e_u, e_v), (f_0, f_x, f_y, f_u, f_v) = tests[0], tests[1]
                    g_0, g_x, g_y, g_u, g_v = tests[2]
                    for s in range(offsets.shape[1]):
                        right, down, u, v = (
                            offsets[0, s],
                            offsets[1, s],
                            offsets[2, s],
                            offsets[3, s],
                        )
                        e_s = e_0 + e_x * right + e_y * down + e_u * u + e_v * v
                        f_s = f_0 + f_x * right + f_y * down + f_u * u + f_v * v
                        g_s = g_0 + g_x * right + g_y * down + g_u * u + g_v * v
                        value = (e_s + f_s + g_s) / (one + v_x * u + v_y * v)
                        old, was = inverse[k, s], owner[k, s]
                        better = (e_s >= 0) & (f_s >= 0) & (g_s >= 0) & (value > old)
                        inverse[k, s] = value if better else old
                        owner[k, s] = source if better else was


@kernel
def number_edges(edge: BoolArray, slot: NDArray[np.int32]) -> int:
    """Number the marked pixels (h, w) in ``slot``, -1 elsewhere; return how many there are."""
    count = 0
    for row in range(edge.shape[0]):
        for column in range(edge.shape[1]):
            slot[row, column] = -1
            if edge[row, column]:
                slot[row, column] = count
                count += 1
    return count


@kernel
def write_edges(
    owner: NDArray[np.int32],
    light: NDArray[np.float32],
    slot: NDArray[np.int32],
    total: NDArray[np.float32],
) -> None:
    """Write the mean light of each numbered pixel's samples; ``light[-1]`` is the background's."""
    samples = owner.shape[1]
    share = np.float32(1.0 / samples)
    for row in range(slot.shape[0]):
        for column in range(slot.shape[1]):
            k = slot[row, column]
            if k < 0:
                continue
            for channel in range(3):
                total[row, column, channel] = 0.0
            last, times = owner[k, 0], 0
            for s in range(samples):
                if owner[k, s] != last:
                    for channel in range(3):
                        total[row, column, channel] += times * share * light[last, channel]
                    last, times = owner[k, s], 0
                times += 1
            for channel in range(3):
                total[row, column, channel] += times * share * light[last, channel]
