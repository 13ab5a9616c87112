r"""A cone around the optical axis: a frustum, or closed by a round cap.

::

    camera ◁   +-.                      +-.
               |   `-.                  |   `-.
               |      `+  open          |      `-.
      axis - - | - - - | - - ▷ z        | - - - - ) pole    cap: part of a sphere,
               |      .+                |      .-´          tangent to the cone
               |   .-´                  |   .-´
               +-´                      +-´
             z = 0    z = length
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal

import numpy as np

from phytac_shapes.plane_curves import Arc, Line, Path
from phytac_shapes.revolved import PathRevolved
from phytac_shapes.variables import check_variables, choice, variable


@dataclass(frozen=True, kw_only=True)
class Cone(PathRevolved):
    """Cone; chart u = length along the generator from the near rim (mm), v = angle (rad)."""

    diameter_near_mm: float = variable(
        "Outer diameter at the near rim.", minimum=1.0, maximum=2000.0
    )
    diameter_far_mm: float = variable(
        "Outer diameter at the far end of the straight part.", minimum=0.1, maximum=2000.0
    )
    length_mm: float = variable(
        "Length of the straight part along the axis.", minimum=0.1, maximum=5000.0
    )
    end: Literal["open", "cap"] = choice(
        "Far end: `open` with a rim, or closed by a round `cap`.", default="open"
    )
    name: ClassVar[str] = "cone"

    def __post_init__(self) -> None:
        check_variables(self)

    @property
    def half_angle_rad(self) -> float:
        """Angle between generator and axis; positive where the cone narrows from the near rim."""
        return float(
            np.arctan2((self.diameter_near_mm - self.diameter_far_mm) / 2.0, self.length_mm)
        )

    @property
    def cap_radius_mm(self) -> float:
        """Radius of the sphere that is tangent to the cone at its far end."""
        return float(self.diameter_far_mm / 2.0 / np.cos(self.half_angle_rad))

    @cached_property
    def profile(self) -> Path:
        """Generator, and the cap's meridian."""
        far = (self.diameter_far_mm / 2.0, self.length_mm)
        line = Line(start=(self.diameter_near_mm / 2.0, 0.0), end=far)
        if self.end == "open":
            return Path(parts=(line,))
        lean, radius = self.half_angle_rad, self.cap_radius_mm
        centre = (0.0, self.length_mm - radius * float(np.sin(lean)))
        return Path(
            parts=(line, Arc(centre=centre, radius=radius, first=lean, last=float(np.pi / 2.0)))
        )

    @property
    def poles(self) -> tuple[bool, bool]:
        """The cap's top is a pole."""
        return (False, self.end == "cap")

    def facts(self) -> Mapping[str, float]:
        """Outer area, slant length and half-angle."""
        return {
            "area_outer_mm2": self.area_mm2(),
            "slant_length_mm": self.profile.parts[0].length,
            "half_angle_deg": float(np.degrees(self.half_angle_rad)),
        } | ({"cap_radius_mm": self.cap_radius_mm} if self.end == "cap" else {})
