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
from functools import cached_property
from typing import ClassVar

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.plane_curves import Line, Path
from phytac_shapes.revolved import PathRevolved
from phytac_shapes.variables import check_variables, variable


@dataclass(frozen=True, kw_only=True)
class Cylinder(PathRevolved):
    """Circular cylinder; chart u = z (mm), v = angle (rad)."""

    diameter_outer_mm: float = variable(
        "Diameter of the outer face, what the hand touches.", minimum=1.0, maximum=2000.0
    )
    length_mm: float = variable(
        "Length of the sensing surface between the two rims.", minimum=1.0, maximum=5000.0
    )
    name: ClassVar[str] = "cylinder"

    def __post_init__(self) -> None:
        check_variables(self)

    @property
    def radius_mm(self) -> float:
        """Radius of the outer face."""
        return self.diameter_outer_mm / 2.0

    @cached_property
    def profile(self) -> Path:
        """Straight generator, parallel to the axis."""
        return Path(
            parts=(Line(start=(self.radius_mm, 0.0), end=(self.radius_mm, self.length_mm)),)
        )

    def unwrap(self, uv: FloatArray) -> FloatArray:
        """(R·angle, z) in mm, (n, 2)."""
        uv = np.asarray(uv, dtype=np.float64)
        return np.column_stack([self.radius_mm * uv[:, 1], uv[:, 0]])

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
