"""The tables ``[switch]``, ``[mold]`` and ``[strip]`` of a design file."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from phytac_design.design.base_table import Section, assumed

Id = Annotated[int, Field(ge=0)]
BEST = "best"
"""Family or rubber that is left to the choice of the smallest spread."""


class SwitchRegion(Section):
    """Receptors whose switches have a threshold of their own."""

    threshold_N: float = Field(gt=0.0, le=1000.0)
    """Their switches turn on when the force on the bowl's footprint exceeds this."""
    rows: tuple[Id, ...] = Field((), max_length=2)
    """First and last row of the region, for layouts with rows."""
    markers: tuple[Id, ...] = Field((), max_length=50000)
    """Ids of the region's markers."""

    @model_validator(mode="after")
    def _some_markers(self) -> Self:
        if bool(self.rows) == bool(self.markers):
            raise ValueError("a region needs either rows = [first, last] or markers = [ids]")
        if self.rows and (len(self.rows) < 2 or self.rows[0] > self.rows[1]):
            raise ValueError(f"rows must be [first, last] (got {list(self.rows)})")
        return self


class SwitchSection(Section):
    """The threshold switch: a soft body on the outer face, its stem, its red tip."""

    family: Literal["bowl", "membrane", "plunger", "best"] = "bowl"
    """`bowl` snaps; `membrane` and `plunger` do not: their tips come out as the force grows;
    `best`: whichever has the smallest spread of its threshold."""
    threshold_N: float = Field(0.5, gt=0.0, le=1000.0)
    """The switch turns on when the force on its footprint exceeds this."""
    release_N: float = assumed(0.4, ge=0.0, le=1000.0)
    """A bowl turns off again below this force; lower than the threshold. In regions it
    is in proportion to theirs. The other families turn off at the threshold."""
    footprint_diameter_mm: float = assumed(4.6, gt=0.0, le=500.0)
    """Diameter of bowl, membrane or plunger: contact pressure is summed over this disc."""
    tip_diameter_mm: float = assumed(1.2, gt=0.0, le=200.0)
    """Diameter of the red tip; it must pass the hole."""
    tip_recess_mm: float = assumed(0.3, ge=0.0, le=100.0)
    """How far the resting tip stays behind the end face."""
    stroke_mm: float = assumed(1.5, gt=0.0, le=100.0)
    """How far a switch that is on pushes its tip."""
    material: str = Field("tpu-8400n", max_length=64)
    """Rubber of the switch and its stem; `best`: whichever known one has the smallest spread."""
    modulus_MPa: float = assumed(0.0, ge=0.0, le=1000.0)
    """Young's modulus of that rubber as you mix it; 0 for the one assumed with its name."""
    wall_min_mm: float = assumed(0.2, gt=0.0, le=100.0)
    """Thinnest wall that the mold casts."""
    wall_tolerance_mm: float = assumed(0.05, ge=0.0, le=0.5)
    """± of a switch's walls, at two standard deviations."""
    modulus_tolerance: float = assumed(0.1, ge=0.0, le=0.5)
    """± of the modulus, relative, at two standard deviations."""
    regions: tuple[SwitchRegion, ...] = Field((), max_length=20)
    """Receptors with other thresholds; where regions overlap, the last one counts."""

    @model_validator(mode="after")
    def _bowls_of_one_rubber(self) -> Self:
        if self.family == "bowl" and self.material == BEST:
            raise ValueError(
                'material = "best" compares rubbers by their spread, and a bowl is designed for '
                'one; set family = "best" (or plunger, membrane), or name the rubber'
            )
        return self


class MoldSection(Section):
    """How the switches are cast."""

    way: Literal["silicone-master", "rigid"] = "silicone-master"
    """`silicone-master`: printed positives, a silicone mold off them, rubber (the paper's way);
    `rigid`: rubber cast in printed plates."""
    draft_deg: float = assumed(0.5, ge=0.0, le=10.0)
    """Least slope of walls against the pull; stems taper by it or more towards their tip."""
    shrink_rubber: float = assumed(0.005, ge=0.0, le=0.2)
    """Linear shrinkage of the switch's rubber while it cures, relative."""
    shrink_silicone: float = assumed(0.002, ge=0.0, le=0.2)
    """Linear shrinkage of the silicone of the mold."""
    shrink_print: float = assumed(0.0, ge=-0.1, le=0.2)
    """Linear shrinkage of the printed plates or masters that the slicer does not take out."""
    land_mm: float = assumed(0.6, gt=0.0, le=20.0)
    """Width of the flat ring around each bowl on which the plates meet: it pinches the rubber."""
    channel_mm: float = assumed(1.0, gt=0.0, le=50.0)
    """Least width of the channels between these rings, for the rubber that runs over."""
    overflow_mm: float = assumed(1.0, gt=0.0, le=20.0)
    """Depth of these channels; also the gap into which a blade goes to part the plates."""
    backing_mm: float = assumed(3.0, gt=0.0, le=50.0)
    """Least material behind cavities, keys and stems: plate, tray or silicone."""
    wall_mm: float = assumed(3.0, gt=0.0, le=50.0)
    """Thickness of frames and fences."""
    moat_mm: float = assumed(3.0, gt=0.0, le=50.0)
    """Width of the moat around the core plate, where the rubber rises that runs over."""
    fence_mm: float = assumed(2.0, gt=0.0, le=50.0)
    """Height of the moat's fence over the parting plane."""
    key_mm: float = assumed(3.5, gt=0.0, le=50.0)
    """Diameter of the registration keys at their foot."""
    key_clearance_mm: float = assumed(0.15, ge=0.0, le=5.0)
    """Gap between a key and its socket, square to the flank, and of the cap in its troughs."""
    vent_step_mm: float = assumed(0.1, gt=0.0, le=5.0)
    """Silicone mold: how much smaller a vent's radius is than the tip that it starts from; the
    step shows where to cut."""
    vent_gap_mm: float = assumed(0.15, gt=0.0, le=5.0)
    """Rigid mold: gap between the stems' ends and the cap, through which air leaves."""


class StripSection(Section):
    """Whether switches are cast one by one, or on strips: bowls on one flat web of rubber."""

    form: Literal["single", "strip"] = "single"
    """`single`: each switch is cast, placed and glued alone; `strip`: bowls that lie side by side
    are joined by a web, cast flat, and wrapped around the shell. Bowls that fit no strip stay
    single."""
    rows: int = Field(2, ge=1, le=100)
    """Rows of markers on a strip; 1: all its stems have one length."""
    columns: int = Field(0, ge=0, le=1000)
    """Most markers of a row on a strip; 0 for as many as the mold has room for."""
    web_mm: float = assumed(0.4, gt=0.0, le=5.0)
    """Thickness of the web, over the shell's outer face."""
    web_width_mm: float = assumed(1.5, gt=0.0, le=50.0)
    """Width of the web between two bowls, at its foot."""
    strain_max: float = assumed(0.03, gt=0.0, le=1.0)
    """Most strain of the web on the shell: from bending and from stretch."""
    pitch_error_mm: float = assumed(0.05, ge=0.0, le=5.0)
    """± of the distance of two neighbouring stems: print, mold, shrinkage of the rubber."""

    @model_validator(mode="after")
    def _web_lies_flat(self) -> Self:
        if self.web_width_mm < self.web_mm:
            raise ValueError(
                f"web_width_mm must be at least web_mm (got {self.web_width_mm:g} and "
                f"{self.web_mm:g})"
            )
        return self
