"""The one interface through which every stage sees a sensor's surface."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray


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
        u, v = tangents[:, 0].T, tangents[:, 1].T
        # Faster than einsum by far, which adds up three numbers at a time.
        e, f, g = (a[0] * b[0] + a[1] * b[1] + a[2] * b[2] for a, b in ((u, u), (u, v), (v, v)))
        return np.stack([e, f, f, g], axis=1).reshape(-1, 2, 2)

    def bounds_mm(self) -> FloatArray:
        """Corners [[x0, y0, z0], [x1, y1, z1]] of a box around the outer face (sampled), mm."""
        (u0, u1), (v0, v1) = self.domain
        u, v = np.meshgrid(np.linspace(u0, u1, 65), np.linspace(v0, v1, 129), indexing="ij")
        points = self.point(np.column_stack([u.ravel(), v.ravel()]))
        return np.stack([points.min(axis=0), points.max(axis=0)])
