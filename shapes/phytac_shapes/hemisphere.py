r"""A dome to the pole, on a straight skirt if wanted: a fingertip.

::

    camera ◁   +--------.
               | skirt   `-.
               |            \
      axis - - | - - - - - - | pole - - ▷ z
               |            /
               |         .-´
               +--------´
             z = 0   z = skirt
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from phytac_shapes.plane_curves import Arc, Line, Path
from phytac_shapes.revolved import PathRevolved
from phytac_shapes.variables import check_variables, variable


@dataclass(frozen=True, kw_only=True)
class Hemisphere(PathRevolved):
    """Hemisphere; chart u = length along the meridian from the rim (mm), v = angle (rad)."""

    diameter_outer_mm: float = variable("Outer diameter of the dome.", minimum=1.0, maximum=2000.0)
    skirt_mm: float = variable(
        "Length of the straight part between the rim and the dome.",
        minimum=0.0,
        maximum=5000.0,
        default=0.0,
    )
    name: ClassVar[str] = "hemisphere"

    def __post_init__(self) -> None:
        check_variables(self)

    @cached_property
    def profile(self) -> Path:
        """Skirt and a quarter of a circle."""
        radius = self.diameter_outer_mm / 2.0
        dome = Arc(centre=(0.0, self.skirt_mm), radius=radius, first=0.0, last=float(np.pi / 2.0))
        if self.skirt_mm == 0.0:
            return Path(parts=(dome,))
        return Path(parts=(Line(start=(radius, 0.0), end=(radius, self.skirt_mm)), dome))

    @property
    def poles(self) -> tuple[bool, bool]:
        """The top is a pole."""
        return (False, True)

    def facts(self) -> Mapping[str, float]:
        """Outer area and radius."""
        return {
            "area_outer_mm2": self.area_mm2(),
            "radius_outer_mm": self.diameter_outer_mm / 2.0,
            "meridian_mm": self.profile.length,
        }
