r"""A contoured grip: a smooth profile through given diameters, revolved about the optical axis.

::

    camera ◁   d0   d1    d2    d3   d4       diameters at equal steps from the near rim to
               +-.           _..--.           the far one; a natural cubic spline joins them
               |  `-.____.--´     `+
      axis - - | - - - - - - - - - | - - ▷ z
               |   .-----.__       |
               +-´          `--..--+
             z = 0                z = length
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError
from phytac_shapes.revolved import SEGMENTS, Revolved
from phytac_shapes.spline import Spline
from phytac_shapes.variables import check_variables, variable


@dataclass(frozen=True, kw_only=True)
class Grip(Revolved):
    """Spline profile; chart u = z (mm), v = angle (rad)."""

    diameters_mm: tuple[float, ...] = variable(
        "Outer diameters at equal steps along the axis, near rim first; at least two.",
        minimum=1.0,
        maximum=2000.0,
    )
    length_mm: float = variable(
        "Length along the axis between the two rims.", minimum=1.0, maximum=5000.0
    )
    name: ClassVar[str] = "grip"

    def __post_init__(self) -> None:
        check_variables(self)
        if not 2 <= len(self.diameters_mm) <= 64:
            raise DesignError(
                "grip-diameter-count",
                f"grip: diameters_mm must have 2 to 64 numbers (got {len(self.diameters_mm)})",
            )
        stations = np.linspace(0.0, self.length_mm, 1025)
        least = float(self.curve(stations)[0][:, 0].min())
        if least <= 0.0:
            raise DesignError(
                "grip-profile-meets-axis",
                f"grip: the profile meets the axis (radius {least:.2f} mm at its thinnest); give "
                "diameters_mm that change less from one to the next, or more of them",
            )

    @cached_property
    def _spline(self) -> Spline:
        return Spline(values=np.array(self.diameters_mm) / 2.0)

    @property
    def _step(self) -> float:
        return self.length_mm / (len(self.diameters_mm) - 1)

    @property
    def _segments(self) -> int:
        """As many to each piece of the spline."""
        pieces = len(self.diameters_mm) - 1
        return pieces * -(-SEGMENTS // pieces)

    def span(self) -> tuple[float, float]:
        """0 to the length."""
        return (0.0, self.length_mm)

    def curve(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(r, z), derivative by z, curvature."""
        u = np.asarray(u, dtype=np.float64)
        r, first, second = self._spline.at(u / self._step)
        first, second = first / self._step, second / self._step**2
        slope = np.column_stack([first, np.ones_like(u)])
        return np.column_stack([r, u]), slope, -second / (1.0 + first**2) ** 1.5

    def foot(self, rz: FloatArray) -> FloatArray:
        """Nearest z by Newton's method from the nearest of 128 stations."""
        rz = np.asarray(rz, dtype=np.float64)
        chunk = 20_000  # bounds the memory
        parts = [self._foot(rz[k : k + chunk]) for k in range(0, len(rz), chunk)]
        return np.concatenate([np.zeros(0), *parts])

    def _foot(self, rz: FloatArray) -> FloatArray:
        samples = 128  # stations among which the start of Newton's method is chosen
        stations = np.linspace(0.0, self.length_mm, samples)
        known = self.curve(stations)[0]
        gap = (rz[:, :1] - known[:, 0]) ** 2 + (rz[:, 1:] - known[:, 1]) ** 2
        u = stations[np.argmin(gap, axis=1)]
        # The profile is straight beyond its ends, so an end is a good start.
        reach = stations[1]
        for _ in range(30):
            r, first, second = self._spline.at(u / self._step)
            first, second = first / self._step, second / self._step**2
            miss = (rz[:, 0] - r) * first + rz[:, 1] - u
            slope = 1.0 + first**2 - (rz[:, 0] - r) * second
            step = miss / np.where(slope > 0.1, slope, 0.1)
            out = (u + step < 0.0) | (u + step > self.length_mm)
            u = u + np.where(out, step, np.clip(step, -reach, reach))
            if float(np.abs(step).max(initial=0.0)) < 1e-13 * self.length_mm:
                break
        return np.asarray(u)

    def facts(self) -> Mapping[str, float]:
        """Outer area and extreme diameters."""
        r = self.radius(np.linspace(0.0, self.length_mm, 4097))
        return {
            "area_outer_mm2": self.area_mm2(),
            "diameter_least_mm": 2.0 * float(r.min()),
            "diameter_greatest_mm": 2.0 * float(r.max()),
        }
