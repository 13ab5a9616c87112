"""Plane curves of straight lines and circular arcs: profiles and cross-sections, exactly.

A path runs at unit speed (its parameter s is arc length, mm) through points (a, b) of a plane.
Its outward side is on the right of its heading: normal = (b', -a').
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Line:
    """Straight from ``start`` to ``end``, (2,) mm each."""

    start: tuple[float, float]
    end: tuple[float, float]

    @cached_property
    def length(self) -> float:
        """Length, mm."""
        return float(np.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1]))

    @cached_property
    def _start(self) -> FloatArray:
        return np.array(self.start)

    @cached_property
    def _heading(self) -> FloatArray:
        return np.asarray(np.subtract(self.end, self.start) / self.length)

    @property
    def curvature(self) -> float:
        """Zero, 1/mm."""
        return 0.0

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and headings (n, 2) at distances s (n,) from the start."""
        heading = np.empty((len(s), 2))
        heading[:] = self._heading
        return self._start + s[:, None] * self._heading, heading

    def foot(self, points: FloatArray) -> FloatArray:
        """Distance from the start (n,) of the foot of each point (n, 2); not clamped."""
        return np.asarray((points - self._start) @ self._heading)


@dataclass(frozen=True, kw_only=True)
class Arc:
    """Circular arc: ``centre + radius (cos a, sin a)`` from angle ``first`` to ``last``, rad.

    Anticlockwise (``last > first``) it is convex towards its outward side.
    """

    centre: tuple[float, float]
    radius: float
    first: float
    last: float

    @property
    def length(self) -> float:
        """Length, mm."""
        return self.radius * abs(self.last - self.first)

    @property
    def curvature(self) -> float:
        """1/mm, positive where convex outward."""
        return float(np.sign(self.last - self.first)) / self.radius

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and headings (n, 2) at distances s (n,) from the start."""
        sign = np.sign(self.last - self.first)
        angle = self.first + sign * s / self.radius
        out = np.column_stack([np.cos(angle), np.sin(angle)])
        heading = sign * np.column_stack([-out[:, 1], out[:, 0]])
        return np.array(self.centre) + self.radius * out, heading

    def foot(self, points: FloatArray) -> FloatArray:
        """Distance from the start (n,) of the foot of each point (n, 2); beyond the ends too."""
        arm = points - np.array(self.centre)
        middle = (self.first + self.last) / 2.0
        turned = np.arctan2(arm[:, 1], arm[:, 0]) - middle
        turned -= 2.0 * np.pi * np.rint(turned / (2.0 * np.pi))
        sign = np.sign(self.last - self.first)
        return np.asarray(self.radius * (sign * turned + abs(self.last - self.first) / 2.0))


@dataclass(frozen=True, kw_only=True)
class Path:
    """Lines and arcs end to end; ``closed`` if the last meets the first."""

    parts: tuple[Line | Arc, ...]
    closed: bool = False

    @cached_property
    def marks(self) -> FloatArray:
        """Arc length at which each part begins, and the total length, (parts + 1,) mm."""
        return np.concatenate([[0.0], np.cumsum([part.length for part in self.parts])])

    @property
    def length(self) -> float:
        """Length, mm."""
        return float(self.marks[-1])

    def _part(self, s: FloatArray) -> IntArray:
        last = len(self.parts) - 1
        return np.clip(np.searchsorted(self.marks, s, side="right") - 1, 0, last)

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points and unit headings (n, 2) at arc lengths s (n,)."""
        s = np.asarray(s, dtype=np.float64)
        if self.closed:
            s = np.mod(s, self.length)
        if len(self.parts) == 1:
            return self.parts[0].at(s)
        point, heading = np.zeros((len(s), 2)), np.zeros((len(s), 2))
        which = self._part(s)
        for k, part in enumerate(self.parts):
            own = which == k
            point[own], heading[own] = part.at(s[own] - self.marks[k])
        return point, heading

    def curvature(self, s: FloatArray) -> FloatArray:
        """Curvature (n,), 1/mm, positive where convex outward."""
        if len(self.parts) == 1:
            return np.full(len(s), self.parts[0].curvature)
        s = np.mod(s, self.length) if self.closed else np.asarray(s)
        return np.array([part.curvature for part in self.parts])[self._part(s)]

    def foot(self, points: FloatArray) -> FloatArray:
        """Arc length (n,) of the nearest point of the path to each point (n, 2).

        An open path is extended beyond its ends (lines as lines, arcs as arcs).
        """
        points = np.asarray(points, dtype=np.float64)
        best, least = np.zeros(len(points)), np.full(len(points), np.inf)
        for k, part in enumerate(self.parts):
            low = -np.inf if k == 0 and not self.closed else 0.0
            high = np.inf if k == len(self.parts) - 1 and not self.closed else part.length
            s = np.clip(part.foot(points), low, high)
            gap = np.linalg.norm(part.at(s)[0] - points, axis=1)
            nearer: BoolArray = gap < least
            best, least = np.where(nearer, self.marks[k] + s, best), np.where(nearer, gap, least)
        return best
