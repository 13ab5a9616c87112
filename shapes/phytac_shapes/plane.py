r"""A flat pad in front of the camera, square to the optical axis or tilted about x.

::

                    hand
             .---------------. outer face, centre at the origin; u runs along y, v along x
      camera ◁ - - - - | - - - - ▷ z      tilt: far side (u1) away from the camera
             `---------------´
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.surface import Surface
from phytac_shapes.variables import check_variables, variable


@dataclass(frozen=True, kw_only=True)
class Plane(Surface):
    """Flat rectangle; chart u, v = distances from its centre (mm)."""

    width_mm: float = variable("Size along x (v).", minimum=1.0, maximum=5000.0)
    height_mm: float = variable("Size along the pad's other side (u).", minimum=1.0, maximum=5000.0)
    tilt_deg: float = variable(
        "Tilt about x: how far the pad leans away from the camera at its far side.",
        minimum=-80.0,
        maximum=80.0,
        default=0.0,
    )
    name: ClassVar[str] = "plane"

    def __post_init__(self) -> None:
        check_variables(self)

    @property
    def _axes(self) -> FloatArray:
        """Rows: unit vectors of u, v and the outward normal."""
        c, s = np.cos(np.radians(self.tilt_deg)), np.sin(np.radians(self.tilt_deg))
        return np.array([[0.0, c, s], [1.0, 0.0, 0.0], [0.0, -s, c]])

    @property
    def domain(self) -> FloatArray:
        """Chart limits, centred."""
        half = np.array([[self.height_mm / 2.0], [self.width_mm / 2.0]])
        return np.asarray(half * np.array([[-1.0, 1.0]]))

    @property
    def periodic(self) -> tuple[bool, bool]:
        """Open both ways."""
        return (False, False)

    def normal(self, uv: FloatArray) -> FloatArray:
        """The same everywhere, (n, 3)."""
        return np.tile(self._axes[2], (len(uv), 1))

    def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
        """Points of the offset face, (n, 3) mm."""
        uv = np.asarray(uv, dtype=np.float64)
        offset = np.broadcast_to(np.asarray(offset_mm, dtype=np.float64), uv.shape[:1])
        return np.asarray(np.column_stack([uv, offset]) @ self._axes)

    def tangents(self, uv: FloatArray) -> FloatArray:
        """Unit vectors, (n, 2, 3)."""
        return np.tile(self._axes[:2], (len(uv), 1, 1))

    def chart(self, points_mm: FloatArray) -> FloatArray:
        """(u, v) of the foot of each point, (n, 2); beyond the pad too."""
        return np.asarray(np.asarray(points_mm, dtype=np.float64) @ self._axes[:2].T)

    def unwrap(self, uv: FloatArray) -> FloatArray:
        """(v, u) in mm, (n, 2)."""
        uv = np.asarray(uv, dtype=np.float64)
        return uv[:, ::-1].copy()

    def area_mm2(self, offset_mm: float = 0.0) -> float:
        """Width times height, at any offset."""
        del offset_mm
        return self.width_mm * self.height_mm

    def inner_reach_mm(self) -> float:
        """Parallel normals never meet."""
        return float("inf")

    def facts(self) -> Mapping[str, float]:
        """Area."""
        return {"area_outer_mm2": self.area_mm2()}
