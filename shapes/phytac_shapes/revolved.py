"""Surfaces of revolution about the sensor axis, from a profile in the (r, z) half-plane."""

from abc import abstractmethod

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.plane_curves import Arc, Line, Path
from phytac_shapes.surface import Surface

SEGMENTS = 64
"""Segments of a profile without closed form, for its arc length and area."""


class Revolved(Surface):
    """Chart u along the profile, v the angle from +x about +z (rad); outward is away from the axis.

    A family gives its profile through :meth:`curve` and :meth:`foot`; u need not be a length.
    """

    @abstractmethod
    def span(self) -> tuple[float, float]:
        """Limits of u."""

    @abstractmethod
    def curve(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(r, z) in mm (n, 2), its derivative by u (n, 2), and its curvature (n,) in 1/mm.

        The curvature is positive where the profile is convex outward.
        """

    @abstractmethod
    def foot(self, rz: FloatArray) -> FloatArray:
        """Return u (n,) of the profile point nearest to each (r, z) (n, 2)."""

    @property
    def domain(self) -> FloatArray:
        """Chart limits: the profile's, and [0, 2π)."""
        return np.array([self.span(), (0.0, 2.0 * np.pi)])

    @property
    def periodic(self) -> tuple[bool, bool]:
        """Closed around, open along."""
        return (False, True)

    @property
    def _segments(self) -> int:
        """Segments of quadratures along the profile; it must be smooth within each."""
        return SEGMENTS

    def radius(self, u: FloatArray) -> FloatArray:
        """Distance of the outer face from the axis, (n,) mm; exactly 0 at a pole."""
        return self._radius(self.curve(np.asarray(u, dtype=np.float64))[0])

    def _radius(self, rz: FloatArray) -> FloatArray:
        """R (n,) of points (r, z) of the profile (n, 2), exactly 0 at a pole."""
        pole_tol = 1e-12  # radius, as a fraction of the sensor's length, that counts as the axis
        low, high = self.span()
        radius = rz[:, 0]
        return np.where(np.abs(radius) <= pole_tol * (high - low), 0.0, radius)

    def _profile_and_normal(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(r, z), with r exactly 0 at a pole, and the outward normal in that plane, (n, 2) each."""
        rz, slope, _ = self.curve(u)
        across, along = slope[:, 1], -slope[:, 0]
        size = np.sqrt(across * across + along * along)
        out = np.stack([across / size, along / size], axis=1)
        return np.stack([self._radius(rz), rz[:, 1]], axis=1), out

    def normal(self, uv: FloatArray) -> FloatArray:
        """Outward unit normals, (n, 3)."""
        uv = np.asarray(uv, dtype=np.float64)
        return _turned(self._profile_and_normal(uv[:, 0])[1], uv[:, 1])

    def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
        """Points of the offset face, (n, 3) mm."""
        uv = np.asarray(uv, dtype=np.float64)
        if np.ndim(offset_mm) == 0 and offset_mm == 0.0:
            rz = self.curve(uv[:, 0])[0]
            return _turned(np.stack([self._radius(rz), rz[:, 1]], axis=1), uv[:, 1])
        offset = np.broadcast_to(np.asarray(offset_mm, dtype=np.float64), uv.shape[:1])
        rz, out = self._profile_and_normal(uv[:, 0])
        return _turned(rz + offset[:, None] * out, uv[:, 1])

    def tangents(self, uv: FloatArray) -> FloatArray:
        """d/du and d/dv of the outer face, (n, 2, 3); d/dv is zero at a pole."""
        uv = np.asarray(uv, dtype=np.float64)
        rz, slope, _ = self.curve(uv[:, 0])
        c, s, radius = np.cos(uv[:, 1]), np.sin(uv[:, 1]), self._radius(rz)
        along = [slope[:, 0] * c, slope[:, 0] * s, slope[:, 1]]
        flat = np.stack([*along, radius * -s, radius * c, np.zeros(len(uv))], axis=1)
        return flat.reshape(-1, 2, 3)

    def chart(self, points_mm: FloatArray) -> FloatArray:
        """(u, angle in [0, 2π)) of each point, (n, 2)."""
        p = np.asarray(points_mm, dtype=np.float64)
        angle = np.mod(np.arctan2(p[:, 1], p[:, 0]), 2.0 * np.pi)
        return np.column_stack(
            [self.foot(np.column_stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]])), angle]
        )

    def unwrap(self, uv: FloatArray) -> FloatArray:
        """Sinusoidal map (equal area), (n, 2) mm: along = arc length, around = r·(v - π) + π·r_max.

        On a cylinder this is (R·angle, z).
        """
        uv = np.asarray(uv, dtype=np.float64)
        low, high = self.span()
        widest = float(self.radius(np.linspace(low, high, 257)).max())
        around = self.radius(uv[:, 0]) * (uv[:, 1] - np.pi) + np.pi * widest
        return np.column_stack([around, self.arc_length_mm(uv[:, 0])])

    def arc_length_mm(self, u: FloatArray) -> FloatArray:
        """Length of the profile from its near end to u, (n,) mm."""
        low, high = self.span()
        edges = np.linspace(low, high, self._segments + 1)
        whole = np.concatenate([[0.0], np.cumsum(self._lengths(edges[:-1], edges[1:]))])
        u = np.asarray(u, dtype=np.float64)
        k = np.clip(np.searchsorted(edges, u, side="right") - 1, 0, self._segments - 1)
        return np.asarray(whole[k] + self._lengths(edges[k], u))

    def _lengths(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Profile length between parameters, (n,), by Gauss quadrature of eight points."""
        x, w = np.polynomial.legendre.leggauss(8)
        middle, half = (start + end) / 2.0, (end - start) / 2.0
        u = middle[:, None] + half[:, None] * x
        speed = np.linalg.norm(self.curve(u.ravel())[1], axis=1).reshape(u.shape)
        return np.asarray(half * (speed @ w))

    def area_mm2(self, offset_mm: float = 0.0) -> float:
        """Pappus' theorem by Gauss quadrature: 2π ∫ (r + o·n_r)(1 + o·κ) ds."""
        low, high = self.span()
        x, w = np.polynomial.legendre.leggauss(8)
        edges = np.linspace(low, high, self._segments + 1)
        half = (high - low) / self._segments / 2.0
        u = ((edges[:-1] + edges[1:]) / 2.0)[:, None] + half * x
        flat = u.ravel()
        rz, slope, curvature = self.curve(flat)
        radius = rz[:, 0] + offset_mm * self._profile_and_normal(flat)[1][:, 0]
        ring = radius * (1.0 + offset_mm * curvature) * np.linalg.norm(slope, axis=1)
        return float(2.0 * np.pi * half * np.sum(ring.reshape(u.shape) @ w))

    def reach_mm(self, uv: FloatArray) -> FloatArray:
        """Depth to the nearer centre of principal curvature, (n,) mm: axis or profile's centre."""
        u = np.asarray(uv, dtype=np.float64)[:, 0]
        rz, normal = self._profile_and_normal(u)
        curvature, out, radius = self.curve(u)[2], normal[:, 0], rz[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            axis = np.where((out > 0.0) & (radius > 0.0), radius / out, np.inf)
            own = np.where(curvature > 0.0, 1.0 / curvature, np.inf)
        return np.asarray(np.minimum(axis, own))

    def inner_reach_mm(self) -> float:
        """Least depth along the profile (sampled at 1025 stations, ends included)."""
        low, high = self.span()
        u = np.linspace(low, high, 1025)
        return float(self.reach_mm(np.column_stack([u, np.zeros_like(u)])).min())


class PathRevolved(Revolved):
    """A profile of straight lines and arcs; u is its arc length in mm."""

    @property
    @abstractmethod
    def profile(self) -> Path:
        """Path in the (r, z) half-plane, from the near rim on."""

    def span(self) -> tuple[float, float]:
        """0 to the profile's length."""
        return (0.0, self.profile.length)

    def curve(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Points, headings and curvature of the profile."""
        path = self.profile
        return *path.at(u), path.curvature(u)

    def foot(self, rz: FloatArray) -> FloatArray:
        """Nearest arc length; at most the pole where there is one."""
        s = self.profile.foot(rz)
        return np.minimum(s, self.span()[1]) if self.poles[1] else s

    def arc_length_mm(self, u: FloatArray) -> FloatArray:
        """U itself."""
        return np.asarray(u, dtype=np.float64)

    def area_mm2(self, offset_mm: float = 0.0) -> float:
        """Closed form, part by part (Pappus)."""
        return float(sum(_swept(part, offset_mm) for part in self.profile.parts))


def _swept(part: Line | Arc, offset: float) -> float:
    """Area swept by a part of a profile moved outward, mm²."""
    if isinstance(part, Line):
        out = (part.end[1] - part.start[1]) / part.length
        return 2.0 * np.pi * ((part.start[0] + part.end[0]) / 2.0 + offset * out) * part.length
    sign = float(np.sign(part.last - part.first))
    radius = part.radius + sign * offset
    turn = part.centre[0] * (part.last - part.first)
    turn += radius * (np.sin(part.last) - np.sin(part.first))
    return float(2.0 * np.pi * radius * sign * turn)


def _turned(rz: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors (n, 3) of (r, z) components (n, 2) at angles (n,)."""
    return np.stack([rz[:, 0] * np.cos(angle), rz[:, 0] * np.sin(angle), rz[:, 1]], axis=1)
