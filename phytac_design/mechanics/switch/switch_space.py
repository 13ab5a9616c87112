"""What a switch must fit: the receptor's space, the mold's rules, what the camera must see."""

from dataclasses import dataclass

import numpy as np

from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class SwitchSpace:
    """Room and rules of one switch.

    Attributes
    ----------
    footprint_diameter_mm : float
        Widest bowl on the shell's outer face.
    hole_diameter_mm : float
        Hole of the receptor.
    stem_diameter_mm : float
        Stem and red tip; it must pass the hole.
    pitch_mm : float
        Least distance to a neighbour's axis on the outer face.
    gap_mm : float
        Least gap between two bowls.
    recess_mm : float
        How far the resting tip stays behind the end face.
    visible_mm : float
        Least length of red tip that must come out.
    wall_min_mm : float
        Thinnest wall that the mold casts.
    core_min_mm : float
        Thinnest free wall of the mold's core: the least gap between a plunger's stop and side wall.
    draft_deg : float
        Least slope of the bowl's wall against the mold's pull.
    release_margin : float
        Least valley force, as a share of the threshold: below it the switch might not return.
    snap_min : float
        Least fall from threshold to valley, as a share of the threshold: below it there is no
        clear on and off.
    """

    footprint_diameter_mm: float = 4.6
    hole_diameter_mm: float = 1.6
    stem_diameter_mm: float = 1.2
    pitch_mm: float = 1e9
    gap_mm: float = 0.3
    recess_mm: float = 0.3
    visible_mm: float = 1.2
    wall_min_mm: float = 0.2
    core_min_mm: float = 0.4
    draft_deg: float = 1.0
    release_margin: float = 0.1
    snap_min: float = 0.05

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise DesignError(
                    "switch-size-invalid",
                    f"the switch's {name} must be a number of at least 0 (got {value:g})",
                )
        if self.stem_diameter_mm >= self.hole_diameter_mm:
            raise DesignError(
                "stem-wider-than-hole",
                f"the stem does not pass the hole (stem {self.stem_diameter_mm:g} mm ≥ hole "
                f"{self.hole_diameter_mm:g} mm); lower switch.tip_diameter_mm",
            )
        minimum = self.hole_diameter_mm + 4.0 * self.wall_min_mm
        if self.diameter_mm < minimum:
            raise DesignError(
                "bowl-no-room",
                f"no bowl stands around the hole: {self.diameter_mm:.3g} mm are free (footprint "
                f"{self.footprint_diameter_mm:g}, pitch {self.pitch_mm:g} less gap "
                f"{self.gap_mm:g}), a {self.hole_diameter_mm:g} mm hole and two walls need "
                f"{minimum:.3g}; raise switch.footprint_diameter_mm or the pitch",
            )
        if self.depth_max_mm - self.wall_min_mm <= self.stroke_mm:
            raise DesignError(
                "bowl-too-shallow",
                f"a bowl {self.diameter_mm:.3g} mm wide is at most "
                f"{self.depth_max_mm - self.wall_min_mm:.3g} mm deep with {self.draft_deg:g} "
                f"degrees of draft, too little for a stroke of {self.stroke_mm:g} mm; raise the "
                "footprint or the pitch, or ask for less red",
            )

    @property
    def diameter_mm(self) -> float:
        """Widest bowl that fits."""
        return min(self.footprint_diameter_mm, self.pitch_mm - self.gap_mm)

    @property
    def stroke_mm(self) -> float:
        """Way that the tip must make."""
        return self.recess_mm + self.visible_mm

    @property
    def depth_max_mm(self) -> float:
        """Tallest bowl, wall included, that still has its draft at the rim."""
        return 0.5 * self.diameter_mm * float(np.tan(np.radians(45.0 - 0.5 * self.draft_deg)))


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """How well walls and rubbers repeat, each ± at two standard deviations.

    Attributes
    ----------
    thickness_mm : float
        Of the wall.
    modulus : float
        Of the modulus, relative.
    """

    thickness_mm: float = 0.05
    modulus: float = 0.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and 0.0 <= value <= 0.5):
                raise DesignError(
                    "switch-tolerance-invalid",
                    f"the tolerance of {name} must lie within 0 and 0.5 (got {value:g})",
                )
