"""Exact overlaps of tubes, points and triangles; arrays run over things first."""

import numpy as np

from phytac_design.geometry.triangles import TriangleMesh, distinct_points
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

PAIRS_MAX = 2_000_000
"""Pairs that are worked on at once."""


def box_pairs(low: FloatArray, high: FloatArray, first: FloatArray, last: FloatArray) -> IntArray:
    """Pairs (k, 2) of boxes (n, 3) and boxes (m, 3) that overlap or touch."""
    some = np.flatnonzero(((low <= last.max(axis=0)) & (high >= first.min(axis=0))).all(axis=1))
    if not len(some):
        return np.zeros((0, 2), dtype=np.int64)
    step = max(PAIRS_MAX // len(first), 1)
    found = []
    for k in range(0, len(some), step):
        part = some[k : k + step]
        near = np.ones((len(part), len(first)), dtype=np.bool_)
        for axis in range(3):
            near &= low[part, axis, None] <= last[None, :, axis]
            near &= high[part, axis, None] >= first[None, :, axis]
        one, other = np.nonzero(near)
        found.append(np.column_stack([part[one], other]))
    return np.concatenate(found)


def tube_overlaps_mm(
    start_mm: FloatArray, end_mm: FloatArray, radius_mm: float, mesh: TriangleMesh
) -> FloatArray:
    """How far a surface of triangles reaches into solid tubes with flat ends, (n,) mm.

    Parameters
    ----------
    start_mm, end_mm : (n, 3) float
        Ends of the tubes' axes.
    radius_mm : float
        Of all tubes.
    mesh : TriangleMesh
        The triangles; only their surface counts.

    Returns
    -------
    (n,) float
        0 where they do not meet. Where they do, the lesser of the ways out of the tube's side and
        out of its end: from the surface's point nearest to the axis, and the one farthest in.
    """
    out = np.zeros(len(start_mm))
    corners = mesh.vertices_mm[mesh.triangles]
    low, high = np.minimum(start_mm, end_mm) - radius_mm, np.maximum(start_mm, end_mm) + radius_mm
    pairs = box_pairs(low, high, corners.min(axis=1), corners.max(axis=1))
    length = np.linalg.norm(end_mm - start_mm, axis=1)
    axis = (end_mm - start_mm) / length[:, None]
    side, end = np.full(len(out), np.inf), np.full(len(out), np.inf)
    for k in range(0, len(pairs), PAIRS_MAX // 16):
        tube, triangle = pairs[k : k + PAIRS_MAX // 16].T
        flat, along = _in_tube_frame(corners[triangle] - start_mm[tube, None], axis[tube])
        away, at = _reach(flat, along, length[tube], radius_mm)
        np.minimum.at(side, tube, away)
        np.minimum.at(end, tube, at)
    met = side < radius_mm
    out[met] = np.minimum(radius_mm - side[met], length[met] - end[met])
    return out


def _in_tube_frame(arm: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners (k, 3, 3) across tubes' axes, (k, 3, 2), and along them, (k, 3)."""
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frame = np.stack([first, np.cross(axis, first)], axis=1)
    return np.einsum("kij,kcj->kic", arm, frame), np.einsum("kij,kj->ki", arm, axis)


def _reach(
    flat: FloatArray, along: FloatArray, length: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray]:
    """How near triangles come to the axis between two planes (k,), and how far in, along (k,).

    The part of a triangle in a tube is convex: its extremes lie on the triangle's edges, on its
    sections with the planes, where the axis crosses it, or where its plane's ellipse is lowest.
    """
    pairs_of_edges = ((0, 1), (1, 2), (2, 0))
    near, low = np.full(len(length), np.inf), np.full(len(length), np.inf)
    crossings: list[list[tuple[FloatArray, BoolArray]]] = [[], []]
    for i, j in pairs_of_edges:
        rise = along[:, j] - along[:, i]
        level = rise == 0.0
        safe = np.where(level, 1.0, rise)
        cuts = [(plane - along[:, i]) / safe for plane in (0.0, length)]
        for kept, cut in zip(crossings, cuts, strict=True):
            point = flat[:, i] + cut[:, None] * (flat[:, j] - flat[:, i])
            kept.append((point, ~level & (cut >= 0.0) & (cut <= 1.0)))
        s0, s1 = np.minimum(*cuts), np.maximum(*cuts)
        between = (along[:, i] >= 0.0) & (along[:, i] <= length)
        s0 = np.where(level, np.where(between, 0.0, 2.0), np.clip(s0, 0.0, None))
        s1 = np.where(level, 1.0, np.clip(s1, None, 1.0))
        away, enter, leave = _to_origin(flat[:, i], flat[:, j], s0, s1, radius)
        hit = (s0 <= s1) & (away <= radius)
        near = np.where(hit, np.minimum(near, away), near)
        for end in (np.maximum(enter, s0), np.minimum(leave, s1)):
            low = np.where(hit, np.minimum(low, along[:, i] + end * rise), low)
    zero = 0.0 * length
    for kept, plane in zip(crossings, (zero, length), strict=True):
        for i, j in pairs_of_edges:
            (p, there), (q, too) = kept[i], kept[j]
            away, _, _ = _to_origin(p, q, zero, zero + 1.0, radius)
            hit = there & too & (away <= radius)
            near = np.where(hit, np.minimum(near, away), near)
            low = np.where(hit, np.minimum(low, plane), low)
    hit, _ = _over(flat, along, length, np.zeros((len(length), 2)))
    near = np.where(hit, 0.0, near)
    hit, at = _over(flat, along, length, radius * _downhill(flat, along))
    return near, np.where(hit, np.minimum(low, at), low)


def _to_origin(
    p: FloatArray, q: FloatArray, s0: FloatArray, s1: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How near 0 the way from p to q (k, 2) comes, (k,), between its shares s0 and s1 (k,).

    Then the shares at which its line enters and leaves the circle, if it meets it.
    """
    d = q - p
    square = np.maximum(np.sum(d * d, axis=1), np.finfo(np.float64).tiny)
    foot = -np.sum(p * d, axis=1) / square
    share = np.minimum(np.maximum(foot, s0), s1)
    off = np.sum((p + foot[:, None] * d) ** 2, axis=1)
    half = np.sqrt(np.maximum(radius**2 - off, 0.0) / square)
    return np.linalg.norm(p + share[:, None] * d, axis=1), foot - half, foot + half


def _downhill(flat: FloatArray, along: FloatArray) -> FloatArray:
    """Direction across the axis (k, 2) in which triangles fall; 0 where they do not lean."""
    d, e = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    rise, other = along[:, 1] - along[:, 0], along[:, 2] - along[:, 0]
    twice = d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0]
    slope = np.column_stack([rise * e[:, 1] - other * d[:, 1], other * d[:, 0] - rise * e[:, 0]])
    slope *= np.sign(twice)[:, None]
    size = np.linalg.norm(slope, axis=1, keepdims=True)
    return np.asarray(-slope / np.where(size > 0.0, size, 1.0))


def _over(
    flat: FloatArray, along: FloatArray, length: FloatArray, place: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Whether a line along the axis at ``place`` (k, 2) crosses between the planes, and where."""
    x, y = np.moveaxis(flat - place[:, None], 2, 0)
    areas = np.stack(
        [x[:, i] * y[:, j] - x[:, j] * y[:, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1
    )
    whole = areas.sum(axis=1)
    share = areas / np.where(whole == 0.0, 1.0, whole)[:, None]
    at = np.sum(share * along, axis=1)
    return (whole != 0.0) & (share >= 0.0).all(axis=1) & (at >= 0.0) & (at <= length), at


def within(points_mm: FloatArray, mesh: TriangleMesh) -> BoolArray:
    """Whether points (n, 3) lie inside a closed surface, (n,); never inside an open one.

    Counts crossings of a ray, so that triangles may turn either way.
    """
    # Direction of the rays that count crossings: along no edge of anything drawn by hand.
    ray = np.array([0.541, 0.283, 0.792])
    inside = np.zeros(len(points_mm), dtype=np.bool_)
    corners = mesh.vertices_mm[mesh.triangles]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    some = np.flatnonzero(((points_mm >= low) & (points_mm <= high)).all(axis=1))
    if not len(some) or not _closed(mesh):
        return inside
    a = corners[:, 0]
    first, second = corners[:, 1] - a, corners[:, 2] - a
    p = np.cross(ray, second)
    twice = np.sum(first * p, axis=1)
    real = twice != 0.0
    a, first, second, p, twice = a[real], first[real], second[real], p[real], twice[real]
    step = max(PAIRS_MAX // max(len(a), 1), 1)
    for k in range(0, len(some), step):
        part = some[k : k + step]
        arm = points_mm[part, None] - a
        s = np.sum(arm * p, axis=-1) / twice
        q = np.cross(arm, first)
        t = q @ ray / twice
        away = np.sum(q * second, axis=-1) / twice
        hits = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0) & (away > 0.0)
        inside[part] = hits.sum(axis=1) % 2 == 1
    return inside


def _closed(mesh: TriangleMesh) -> bool:
    """Whether every edge, between places and not corners' numbers, has an even number of sides."""
    # Adding 0 makes -0 the same place as 0.
    _, same = distinct_points(mesh.vertices_mm + 0.0)
    corners = same[mesh.triangles]
    edges = np.sort(corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, number = np.unique(edges[edges[:, 0] < edges[:, 1]], axis=0, return_counts=True)
    return bool((number % 2 == 0).all())


def distance_mm(point_mm: FloatArray, mesh: TriangleMesh) -> float:
    """Distance of a point (3,) from the nearest triangle, mm."""
    a, b, c = np.moveaxis(mesh.vertices_mm[mesh.triangles] - point_mm, 1, 0)
    best = np.inf
    for p, q in ((a, b), (b, c), (c, a)):
        d = q - p
        square = np.maximum(np.sum(d * d, axis=1), np.finfo(np.float64).tiny)
        share = np.clip(-np.sum(p * d, axis=1) / square, 0.0, 1.0)
        best = min(best, float(np.linalg.norm(p + share[:, None] * d, axis=1).min()))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    a, b, c, normal = a[size > 0.0], b[size > 0.0], c[size > 0.0], normal[size > 0.0]
    sides = [np.sum(np.cross(p, q) * normal, axis=1) for p, q in ((a, b), (b, c), (c, a))]
    above = np.all([side >= 0.0 for side in sides], axis=0)
    height = np.abs(np.sum(a * normal, axis=1)) / size[size > 0.0]
    return float(min(best, height[above].min(initial=np.inf)))
