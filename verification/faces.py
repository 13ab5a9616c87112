"""The surface families once more, from text-book formulae alone: what the project's are held to.

Nothing here uses :mod:`shapes`; splines are SciPy's.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_shapes.arrays import FloatArray

Gap = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, kw_only=True)
class Face:
    """One outer face.

    Attributes
    ----------
    gap : callable or None
        (m,) of points (m, 3): 0 on the face, positive outside; None where there is no formula.
    area_mm2 : float
        Of the face itself.
    span_mm : (2,) float
        Least and greatest z of the face.
    convex : bool
        Whether a straight line meets it twice at most, and from outside first where it enters.
    """

    gap: Gap | None
    area_mm2: float
    span_mm: tuple[float, float]
    convex: bool


def face_of(kind: str, table: Mapping[str, Any]) -> Face:
    """Face of a ``[shape]`` table whose fields are all given."""
    return FACES[kind](table)


def _cylinder(t: Mapping[str, Any]) -> Face:
    R, L = t["diameter_outer_mm"] / 2.0, t["length_mm"]
    return Face(
        gap=lambda p: np.hypot(p[:, 0], p[:, 1]) - R,
        area_mm2=2.0 * np.pi * R * L,
        span_mm=(0.0, L),
        convex=True,
    )


def _cone(t: Mapping[str, Any]) -> Face:
    a, b, L = t["diameter_near_mm"] / 2.0, t["diameter_far_mm"] / 2.0, t["length_mm"]
    slant = float(np.hypot(L, a - b))
    cosine, sine = L / slant, (a - b) / slant
    area = np.pi * (a + b) * slant
    cap = t.get("end", "open") == "cap"
    radius = b / cosine
    centre = L - radius * sine
    if cap:
        area += 2.0 * np.pi * radius * (centre + radius - L)

    def gap(p: FloatArray) -> FloatArray:
        off = np.hypot(p[:, 0], p[:, 1])
        side = (off - a) * cosine + p[:, 2] * sine
        if not cap:
            return np.asarray(side, dtype=np.float64)
        ball = np.hypot(off, p[:, 2] - centre) - radius
        # The normal through the far end of the straight part divides the two.
        beyond = (p[:, 2] - centre) * cosine > off * sine
        return np.asarray(np.where(beyond, ball, side))

    top = centre + radius if cap else L
    return Face(gap=gap, area_mm2=area, span_mm=(0.0, top), convex=True)


def _plane(t: Mapping[str, Any]) -> Face:
    lean = np.radians(t.get("tilt_deg", 0.0))
    normal = np.array([0.0, -np.sin(lean), np.cos(lean)])
    high = t["height_mm"] / 2.0 * abs(np.sin(lean))
    return Face(
        gap=lambda p: p @ normal,
        area_mm2=t["width_mm"] * t["height_mm"],
        span_mm=(-high, high),
        convex=True,
    )


def _cuboid(t: Mapping[str, Any]) -> Face:
    r, L = t["edge_radius_mm"], t["length_mm"]
    half = np.array([t["width_mm"], t["depth_mm"]]) / 2.0 - r

    def gap(p: FloatArray) -> FloatArray:
        q = np.abs(p[:, :2]) - half
        outside = np.hypot(*np.maximum(q, 0.0).T)
        return np.asarray(outside + np.minimum(q.max(axis=1), 0.0) - r)

    around = 4.0 * float(half.sum()) + 2.0 * np.pi * r
    return Face(gap=gap, area_mm2=around * L, span_mm=(0.0, L), convex=True)


def _hemisphere(t: Mapping[str, Any]) -> Face:
    R, s = t["diameter_outer_mm"] / 2.0, t.get("skirt_mm", 0.0)

    def gap(p: FloatArray) -> FloatArray:
        off = np.hypot(p[:, 0], p[:, 1])
        return np.asarray(np.hypot(off, np.maximum(p[:, 2] - s, 0.0)) - R)

    area = 2.0 * np.pi * R * (s + R)
    return Face(gap=gap, area_mm2=area, span_mm=(0.0, s + R), convex=True)


def _grip(t: Mapping[str, Any]) -> Face:
    from scipy.interpolate import CubicSpline

    radii, L = np.array(t["diameters_mm"], dtype=np.float64) / 2.0, t["length_mm"]
    knots = np.linspace(0.0, L, len(radii))
    curve = CubicSpline(knots, radii, bc_type="natural")
    x, w = np.polynomial.legendre.leggauss(64)
    half = np.diff(knots) / 2.0
    z = (knots[:-1] + half)[:, None] + half[:, None] * x
    ring = 2.0 * np.pi * curve(z) * np.sqrt(1.0 + curve(z, 1) ** 2)
    return Face(
        gap=lambda p: (
            (np.hypot(p[:, 0], p[:, 1]) - curve(p[:, 2])) / np.sqrt(1.0 + curve(p[:, 2], 1) ** 2)
        ),
        area_mm2=float(np.sum(half[:, None] * ring * w)),
        span_mm=(0.0, L),
        convex=False,
    )


def patch_point(points: Any, uv: FloatArray, du: int = 0, dv: int = 0) -> FloatArray:
    """Point, or derivative, (m, 3) of the natural bicubic spline through a grid of points."""
    grid = np.array(points, dtype=np.float64)
    rows, columns = grid.shape[:2]
    across, along = _weights(rows, uv[:, 0], du), _weights(columns, uv[:, 1], dv)
    return np.asarray(np.einsum("mr,mc,rck->mk", across, along, grid, optimize=True))


def _weights(count: int, t: FloatArray, order: int) -> FloatArray:
    """Share (m, count) of each knot in a natural cubic spline at t (m,), or in its derivative."""
    from scipy.interpolate import CubicSpline

    if count == 2:
        return np.column_stack([1.0 - t, t]) if order == 0 else np.tile([-1.0, 1.0], (len(t), 1))
    return np.asarray(CubicSpline(np.arange(count), np.eye(count), bc_type="natural")(t, order))


def _patch(t: Mapping[str, Any]) -> Face:
    grid = np.array(t["points_mm"], dtype=np.float64)
    x, w = np.polynomial.legendre.leggauss(12)
    area = 0.0
    for i in range(grid.shape[0] - 1):
        for j in range(grid.shape[1] - 1):
            u, v = np.meshgrid(i + (x + 1.0) / 2.0, j + (x + 1.0) / 2.0, indexing="ij")
            uv = np.column_stack([u.ravel(), v.ravel()])
            cross = np.cross(patch_point(grid, uv, 1, 0), patch_point(grid, uv, 0, 1))
            size = np.linalg.norm(cross, axis=1)
            area += float(np.outer(w, w).ravel() @ size) / 4.0
    low, high = grid[..., 2].min(), grid[..., 2].max()
    return Face(gap=None, area_mm2=area, span_mm=(float(low), float(high)), convex=False)


FACES: dict[str, Callable[[Mapping[str, Any]], Face]] = {
    "cylinder": _cylinder,
    "cone": _cone,
    "plane": _plane,
    "cuboid": _cuboid,
    "hemisphere": _hemisphere,
    "grip": _grip,
    "patch": _patch,
}
