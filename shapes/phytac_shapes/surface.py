"""The one interface through which every stage sees a sensor's surface."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

MARCH_STEPS = 256
"""Steps of a ray through the box around a surface, before bisection."""
BISECTIONS = 48


class Surface(ABC):
    """A smooth sensing surface with a chart (u, v) and an outward normal.

    The surface itself (offset 0) is the *outer* face, the one that the hand touches. Positive
    offsets lie outside, negative ones inside: the middle of a wall of thickness t is at offset
    -t/2, its inner face at -t.

    The chart runs *along* the sensor with ``u`` (away from the camera) and *around* it with
    ``v``. Chart coordinates need not be lengths; :meth:`metric` turns them into millimetres.
    Frame: origin in the middle of the rim nearest the camera, +z away from the camera,
    right-handed, millimetres.
    """

    name: ClassVar[str]
    """Registry name, the ``kind`` of a design file."""

    @property
    @abstractmethod
    def domain(self) -> FloatArray:
        """Chart limits ``[[u0, u1], [v0, v1]]``, (2, 2)."""

    @property
    @abstractmethod
    def periodic(self) -> tuple[bool, bool]:
        """Whether u and v close on themselves."""

    @property
    def poles(self) -> tuple[bool, bool]:
        """Whether the edge at u0, and at u1, is a single point, where all v meet."""
        return (False, False)

    def edges(self) -> tuple[tuple[int, int], ...]:
        """Open edges of the chart, where rims sit: (axis, end), axis 0 = u, end 0 = low.

        In order: near (0, 0), far (0, 1), then the sides (1, 0), (1, 1).
        """
        found = [(0, end) for end in (0, 1) if not self.periodic[0] and not self.poles[end]]
        found += [(1, end) for end in (0, 1) if not self.periodic[1]]
        return tuple(found)

    def sensing(self, uv: FloatArray) -> BoolArray:
        """Whether markers may sit at ``uv`` (n, 2), (n,); everywhere by default."""
        return np.ones(len(uv), dtype=np.bool_)

    @abstractmethod
    def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
        """Points of the chart, (n, 3) mm, for ``uv`` (n, 2), moved by ``offset_mm`` outward."""

    @abstractmethod
    def normal(self, uv: FloatArray) -> FloatArray:
        """Outward unit normals, (n, 3)."""

    @abstractmethod
    def tangents(self, uv: FloatArray) -> FloatArray:
        """Partial derivatives of :meth:`point` at offset 0, (n, 2, 3): d/du and d/dv."""

    @abstractmethod
    def chart(self, points_mm: FloatArray) -> FloatArray:
        """Chart coordinates (n, 2) of the foot of the normal through each point (n, 3)."""

    def intersect(
        self, origins_mm: FloatArray, directions: FloatArray, offset_mm: float = 0.0
    ) -> FloatArray:
        """Ray parameter t >= 0 of the first hit of each ray with the offset face; inf if none.

        ``origins_mm`` and ``directions`` are (n, 3); the hit is ``origin + t * direction``. Found
        by marching and bisection on the height above the face, so that a ray which only grazes
        it by less than a hundredth of the sensor may pass; shapes with a closed form override it.
        """
        return march(self, origins_mm, directions, offset_mm)

    @abstractmethod
    def unwrap(self, uv: FloatArray) -> FloatArray:
        """Flat map of the chart in mm, (n, 2): (around, along), for drawings and distances."""

    @abstractmethod
    def area_mm2(self, offset_mm: float = 0.0) -> float:
        """Area of the offset face, closed form where there is one."""

    @abstractmethod
    def inner_reach_mm(self) -> float:
        """Largest depth below the outer face before normals meet, anywhere on the surface."""

    def reach_mm(self, uv: FloatArray) -> FloatArray:
        """Return that depth at ``uv`` (n, 2) itself, (n,): how tall a receptor may be there."""
        return np.full(len(uv), self.inner_reach_mm())

    @abstractmethod
    def facts(self) -> Mapping[str, float]:
        """Closed-form facts (areas, lengths) used by reports and tests, units in the names."""

    def metric(self, uv: FloatArray) -> FloatArray:
        """First fundamental form, (n, 2, 2), mm² per squared chart unit."""
        tangents = self.tangents(uv)
        return np.asarray(np.einsum("nai,nbi->nab", tangents, tangents))

    def bounds_mm(self) -> FloatArray:
        """Corners [[x0, y0, z0], [x1, y1, z1]] of a box around the outer face (sampled), mm."""
        (u0, u1), (v0, v1) = self.domain
        u, v = np.meshgrid(np.linspace(u0, u1, 65), np.linspace(v0, v1, 129), indexing="ij")
        points = self.point(np.column_stack([u.ravel(), v.ravel()]))
        return np.stack([points.min(axis=0), points.max(axis=0)])


def march(
    surface: Surface, origins_mm: FloatArray, directions: FloatArray, offset_mm: float
) -> FloatArray:
    """First hits of rays (n, 3) with an offset face, as :meth:`Surface.intersect`."""
    o = np.asarray(origins_mm, dtype=np.float64)
    d = np.asarray(directions, dtype=np.float64)
    low, high = surface.bounds_mm()
    # Along each axis by its own extent: through a long thin sensor the steps stay short.
    margin = abs(offset_mm) + 0.05 * (high - low) + 1e-6 * float(np.linalg.norm(high - low))
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = (low - margin - o) / d, (high + margin - o) / d
    enter = np.nanmax(np.where(d != 0.0, np.minimum(near, far), -np.inf), axis=1)
    leave = np.nanmin(np.where(d != 0.0, np.maximum(near, far), np.inf), axis=1)
    enter = np.maximum(enter, 0.0)
    hit = np.full(len(o), np.inf)
    rays = np.flatnonzero(enter < leave)

    def height(ray: IntArray, t: FloatArray) -> tuple[FloatArray, BoolArray]:
        point = o[ray] + t[:, None] * d[ray]
        foot = surface.chart(point)
        (u0, u1), (v0, v1) = surface.domain
        tol_u, tol_v = 1e-9 * (u1 - u0), 1e-9 * (v1 - v0)
        inside = (foot[:, 0] >= u0 - tol_u) & (foot[:, 0] <= u1 + tol_u)
        inside &= (foot[:, 1] >= v0 - tol_v) & (foot[:, 1] <= v1 + tol_v)
        gap = np.sum((point - surface.point(foot)) * surface.normal(foot), axis=1)
        return gap - offset_mm, inside

    if len(rays) == 0:
        return hit
    step = (leave[rays] - enter[rays]) / MARCH_STEPS
    before, _ = height(rays, enter[rays])
    for k in range(1, MARCH_STEPS + 1):
        t = enter[rays] + k * step
        after, _ = height(rays, t)
        crossed = np.flatnonzero((np.sign(before) != np.sign(after)) & np.isinf(hit[rays]))
        if len(crossed):
            a, b = t[crossed] - step[crossed], t[crossed].copy()
            start = np.sign(before[crossed])
            for _ in range(BISECTIONS):
                middle = (a + b) / 2.0
                same = np.sign(height(rays[crossed], middle)[0]) == start
                a, b = np.where(same, middle, a), np.where(same, b, middle)
            left, inside = height(rays[crossed], (a + b) / 2.0)
            real = inside & (np.abs(left) < 1e-6 * (1.0 + float(margin.max())))
            hit[rays[crossed[real]]] = ((a + b) / 2.0)[real]
        before = after
    return hit
