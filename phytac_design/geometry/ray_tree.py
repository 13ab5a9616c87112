"""Rays against a triangle mesh, in double precision: a tree of boxes, compiled.

Intersection of ray and triangle after Möller and Trumbore (*Fast, minimum storage ray/triangle
intersection*, 1997); edges count as hit, so that no ray slips between two triangles.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from phytac_design.core.kernels import in_bands, kernel
from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import FloatArray, IntArray

START_mm = 1e-4
"""How far from its face a ray starts, so that it does not meet that face."""


@dataclass(frozen=True, kw_only=True)
class Hits:
    """First hits of rays (n,): distance in mm (inf: no hit) and triangle (-1: no hit)."""

    distance_mm: FloatArray
    triangle: IntArray


class RayTree:
    """Bounding-volume hierarchy of a mesh, for ray queries.

    Parameters
    ----------
    mesh : TriangleMesh
        Any triangles; closed for questions of inside and outside.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.triangles = mesh.triangles
        self.corners = np.ascontiguousarray(mesh.corners_mm)
        a, b, c = np.moveaxis(self.corners, 1, 0)
        cross = np.cross(b - a, c - a)
        length = np.linalg.norm(cross, axis=1)
        self.area_mm2 = length / 2.0
        self.normal = cross / np.maximum(length, 1e-300)[:, None]
        low, high = self.corners.min(axis=1), self.corners.max(axis=1)
        self._tree = _build(low, high)
        # Only corners that are extreme somewhere can be lowest.
        points = mesh.vertices_mm
        self._hull = points[ConvexHull(points).vertices] if len(points) > 3 else points

    def lowest_mm(self, up: FloatArray) -> float:
        """Height of the lowest corner along a direction."""
        return float((self._hull @ up).min())

    def cast(
        self, start_mm: FloatArray, direction: FloatArray, limit_mm: float | FloatArray = 1e6
    ) -> Hits:
        """First hits of rays from points (n, 3) along unit vectors (n, 3), within a limit (n,)."""
        start = np.ascontiguousarray(start_mm, dtype=np.float64)
        way = np.ascontiguousarray(direction, dtype=np.float64)
        limit = np.ascontiguousarray(np.broadcast_to(limit_mm, len(start)), dtype=np.float64)
        distance = np.full(len(start), np.inf)
        triangle = np.full(len(start), -1, dtype=np.int64)
        order, boxes, nodes = self._tree

        def band(first: int, last: int) -> None:
            rows = slice(first, last)
            _cast(
                self.corners, order, boxes, nodes, start[rows], way[rows], limit[rows],
                distance[rows], triangle[rows],
            )  # fmt: skip

        if len(start):
            in_bands(band, len(start))
        return Hits(distance_mm=distance, triangle=triangle)


@kernel
def _build(low: FloatArray, high: FloatArray) -> tuple[IntArray, FloatArray, IntArray]:
    """Boxes halved at the median of centres: order (n,), boxes (m, 6), nodes (m, 3).

    A node is (left child or -1, first, last): children are neighbours in the list.
    """
    leaf = 6  # most triangles of a box that is not halved again
    count = len(low)
    order = np.arange(count)
    middle = (low + high) / 2.0
    most = max(4, 4 * count)
    boxes = np.empty((most, 6))
    nodes = np.empty((most, 3), dtype=np.int64)
    nodes[0, 0], nodes[0, 1], nodes[0, 2] = -1, 0, count
    used, k = 1, 0
    while k < used:
        first, last = nodes[k, 1], nodes[k, 2]
        widest, widest_mm = 0, -np.inf
        for axis in range(3):
            near, far, start, stop = np.inf, -np.inf, np.inf, -np.inf
            for i in range(first, last):
                t = order[i]
                near, far = min(near, low[t, axis]), max(far, high[t, axis])
                start, stop = min(start, middle[t, axis]), max(stop, middle[t, axis])
            boxes[k, axis], boxes[k, 3 + axis] = near, far
            if stop - start > widest_mm:
                widest, widest_mm = axis, stop - start
        if last - first > leaf:
            half = (first + last) // 2
            _halve(order, middle, widest, first, half, last - 1)
            nodes[k, 0] = used
            for child in range(2):
                nodes[used + child, 0] = -1
                nodes[used + child, 1] = first if child == 0 else half
                nodes[used + child, 2] = half if child == 0 else last
            used += 2
        k += 1
    return order, boxes[:used].copy(), nodes[:used].copy()


@kernel
def _halve(
    order: IntArray, middle: FloatArray, axis: int, first: int, half: int, last: int
) -> None:
    """Order from ``first`` to ``last`` so that no key before ``half`` is above one after it.

    Hoare's quickselect. ``np.argsort`` in its place takes seven seconds to compile.
    """
    while first < last:
        pivot = middle[order[(first + last) // 2], axis]
        i, j = first, last
        while i <= j:
            while middle[order[i], axis] < pivot:
                i += 1
            while middle[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
        if half <= j:
            last = j
        elif half >= i:
            first = i
        else:
            return


@kernel
def _meets_box(box: FloatArray, start: FloatArray, way: FloatArray, limit: float) -> bool:
    near, far = 0.0, limit
    for axis in range(3):
        o, d = start[axis], way[axis]
        if d == 0.0:
            if o < box[axis] or o > box[3 + axis]:
                return False
            continue
        one, two = (box[axis] - o) / d, (box[3 + axis] - o) / d
        near, far = max(near, min(one, two)), min(far, max(one, two))
    # Boxes without depth are met at one point: rounding must not lose it.
    return near <= far + 1e-9


@kernel
def _way_to_triangle(corners: FloatArray, start: FloatArray, way: FloatArray) -> float:
    """Way to a triangle (3, 3) along a ray; inf where it is not met."""
    a0, a1, a2 = corners[0, 0], corners[0, 1], corners[0, 2]
    e0, e1, e2 = corners[1, 0] - a0, corners[1, 1] - a1, corners[1, 2] - a2
    f0, f1, f2 = corners[2, 0] - a0, corners[2, 1] - a1, corners[2, 2] - a2
    d0, d1, d2 = way[0], way[1], way[2]
    p0, p1, p2 = d1 * f2 - d2 * f1, d2 * f0 - d0 * f2, d0 * f1 - d1 * f0
    det = e0 * p0 + e1 * p1 + e2 * p2
    if abs(det) < 1e-14:
        return np.inf
    s0, s1, s2 = start[0] - a0, start[1] - a1, start[2] - a2
    u = (s0 * p0 + s1 * p1 + s2 * p2) / det
    q0, q1, q2 = s1 * e2 - s2 * e1, s2 * e0 - s0 * e2, s0 * e1 - s1 * e0
    v = (d0 * q0 + d1 * q1 + d2 * q2) / det
    if u < -1e-9 or v < -1e-9 or u + v > 1.0 + 1e-9:
        return np.inf
    ahead = (f0 * q0 + f1 * q1 + f2 * q2) / det
    return ahead if ahead > 0.0 else np.inf


@kernel
def _cast(
    corners: FloatArray,
    order: IntArray,
    boxes: FloatArray,
    nodes: IntArray,
    start: FloatArray,
    way: FloatArray,
    limit: FloatArray,
    distance: FloatArray,
    triangle: IntArray,
) -> None:
    stack = np.empty(128, dtype=np.int64)
    for r in range(len(start)):
        best, found = limit[r], -1
        top = 1
        stack[0] = 0
        while top > 0:
            top -= 1
            k = stack[top]
            if not _meets_box(boxes[k], start[r], way[r], best):
                continue
            if nodes[k, 0] >= 0:
                stack[top], stack[top + 1] = nodes[k, 0], nodes[k, 0] + 1
                top += 2
                continue
            for i in range(nodes[k, 1], nodes[k, 2]):
                ahead = _way_to_triangle(corners[order[i]], start[r], way[r])
                if ahead < best:
                    best, found = ahead, order[i]
        if found >= 0:
            distance[r], triangle[r] = best, found
