"""Offset surface, from which the jigs that lie over a sensor are made."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray


@dataclass(frozen=True, kw_only=True)
class OffsetSurface(Surface):
    """The parallel surface ``lift_mm`` outside ``base``, on the same chart."""

    base: Surface
    lift_mm: float
    name = "lifted"

    @property
    def domain(self) -> FloatArray:
        """That of the base."""
        return self.base.domain

    @property
    def periodic(self) -> tuple[bool, bool]:
        """As the base."""
        return self.base.periodic

    @property
    def poles(self) -> tuple[bool, bool]:
        """As the base."""
        return self.base.poles

    def sensing(self, uv: FloatArray) -> BoolArray:
        """As the base."""
        return self.base.sensing(uv)

    def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
        """Points of the base, farther out."""
        return self.base.point(uv, np.asarray(offset_mm) + self.lift_mm)

    def normal(self, uv: FloatArray) -> FloatArray:
        """Those of the base."""
        return self.base.normal(uv)

    def tangents(self, uv: FloatArray) -> FloatArray:
        """Those of the base and the turn of its normal, by central differences."""
        uv = np.asarray(uv, dtype=np.float64)
        share = 1e-6  # step of the differences, relative to the chart
        span = self.domain[:, 1] - self.domain[:, 0]
        out = self.base.tangents(uv).copy()
        for axis in (0, 1):
            step = np.zeros(2)
            step[axis] = share * span[axis]
            turn = self.base.normal(uv + step) - self.base.normal(uv - step)
            out[:, axis] += self.lift_mm * turn / (2.0 * share * span[axis])
        return out

    def chart(self, points_mm: FloatArray) -> FloatArray:
        """Chart positions of the base: normals are shared."""
        return self.base.chart(points_mm)

    def unwrap(self, uv: FloatArray) -> FloatArray:
        """Flat map of the base."""
        return self.base.unwrap(uv)

    def area_mm2(self, offset_mm: float = 0.0) -> float:
        """Area of the base's offset face."""
        return self.base.area_mm2(offset_mm + self.lift_mm)

    def inner_reach_mm(self) -> float:
        """That of the base, and the lift."""
        return self.base.inner_reach_mm() + self.lift_mm

    def facts(self) -> Mapping[str, float]:
        """Area."""
        return {"area_outer_mm2": self.area_mm2()}
