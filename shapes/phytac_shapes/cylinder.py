r"""A circular cylinder around the optical axis: the published PhyTac.

::

        camera ◁   |<------ length ------>|
                   +----------------------+  outer face (offset 0), radius R
         axis  - - | - - - - - - - - - - -| - - ▷ z = u
                   +----------------------+
                 z = 0                 z = L        v: angle from +x about +z, radians
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError
from phytac_shapes.surface import Surface
from phytac_shapes.variables import variable


@dataclass(frozen=True, kw_only=True)
class Cylinder(Surface):
    """Circular cylinder; chart u = z (mm), v = angle (rad)."""

    diameter_outer_mm: float = variable(
        "Diameter of the outer face, what the hand touches.", minimum=1.0, maximum=2000.0
    )
    length_mm: float = variable(
        "Length of the sensing surface between the two rims.", minimum=1.0, maximum=5000.0
    )
    name: ClassVar[str] = "cylinder"

    def __post_init__(self) -> None:
        for label, value in (
            ("diameter_outer_mm", self.diameter_outer_mm),
            ("length_mm", self.length_mm),
        ):
            if not (np.isfinite(value) and value > 0.0):
                raise DesignError(
                    f"cylinder: {label} must be a positive length (got {value!r}); give it in mm"
                )

    @property
    def radius_mm(self) -> float:
        """Radius of the outer face."""
        return self.diameter_outer_mm / 2.0

    @property
    def domain(self) -> FloatArray:
        """Chart limits: z in [0, L], angle in [0, 2π)."""
        return np.array([[0.0, self.length_mm], [0.0, 2.0 * np.pi]])

    @property
    def periodic(self) -> tuple[bool, bool]:
        """Closed around, open along."""
        return (False, True)

    def normal(self, uv: FloatArray) -> FloatArray:
        """Radial unit vectors, (n, 3)."""
        angle = np.asarray(uv, dtype=np.float64)[:, 1]
        return np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])

    def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
        """Points at radius R + offset, (n, 3) mm."""
        uv = np.asarray(uv, dtype=np.float64)
        radius = np.broadcast_to(self.radius_mm + np.asarray(offset_mm), uv.shape[:1])
        points: FloatArray = self.normal(uv) * radius[:, None]
        points[:, 2] = uv[:, 0]
        return points

    def tangents(self, uv: FloatArray) -> FloatArray:
        """d/dz and d/dangle of the outer face, (n, 2, 3)."""
        uv = np.asarray(uv, dtype=np.float64)
        out = np.zeros((len(uv), 2, 3))
        out[:, 0, 2] = 1.0
        out[:, 1, 0] = -self.radius_mm * np.sin(uv[:, 1])
        out[:, 1, 1] = self.radius_mm * np.cos(uv[:, 1])
        return out

    def chart(self, points_mm: FloatArray) -> FloatArray:
        """(z, angle in [0, 2π)) of each point, (n, 2)."""
        points = np.asarray(points_mm, dtype=np.float64)
        angle = np.mod(np.arctan2(points[:, 1], points[:, 0]), 2.0 * np.pi)
        return np.column_stack([points[:, 2], angle])

    def intersect(
        self, origins_mm: FloatArray, directions: FloatArray, offset_mm: float = 0.0
    ) -> FloatArray:
        """First hit of each ray with the face at R + offset and 0 <= z <= L; inf if none."""
        o = np.asarray(origins_mm, dtype=np.float64)
        d = np.asarray(directions, dtype=np.float64)
        radius = self.radius_mm + offset_mm
        a = np.sum(d[:, :2] ** 2, axis=1)
        b = np.sum(o[:, :2] * d[:, :2], axis=1)
        c = np.sum(o[:, :2] ** 2, axis=1) - radius**2
        disc = b * b - a * c
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(disc)
            roots = np.stack([(-b - root) / a, (-b + root) / a])
            z = o[:, 2] + roots * d[:, 2]
            valid = (roots >= 0.0) & (z >= 0.0) & (z <= self.length_mm)
        return np.asarray(np.where(valid, roots, np.inf).min(axis=0))

    def unwrap(self, uv: FloatArray) -> FloatArray:
        """(R·angle, z) in mm, (n, 2)."""
        uv = np.asarray(uv, dtype=np.float64)
        return np.column_stack([self.radius_mm * uv[:, 1], uv[:, 0]])

    def area_mm2(self, offset_mm: float = 0.0) -> float:
        """2π(R + offset)·L."""
        return float(2.0 * np.pi * (self.radius_mm + offset_mm) * self.length_mm)

    def inner_reach_mm(self) -> float:
        """All normals meet on the axis."""
        return self.radius_mm

    def facts(self) -> Mapping[str, float]:
        """Outer area and the lengths that define it."""
        return {
            "area_outer_mm2": self.area_mm2(),
            "circumference_outer_mm": 2.0 * np.pi * self.radius_mm,
            "length_mm": self.length_mm,
        }
