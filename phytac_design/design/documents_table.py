"""The tables ``[bench]`` and ``[kit]`` of a design file."""

from typing import Literal, Self

from pydantic import model_validator

from phytac_design.design.base_table import Section, assumed
from phytac_design.design.safe_rounding import at_least


class BenchSection(Section):
    """Papers for the bench: how they are printed, how much is wasted."""

    sheet: Literal["A4", "letter"] = "A4"
    """Paper of the paint map."""
    waste_rubber: float = assumed(0.5, ge=0.0, le=100.0)
    """Rubber left in cups, sprues and flash, as a share of what the switches hold."""
    waste_silicone: float = assumed(0.15, ge=0.0, le=100.0)
    """Silicone left in cups, as a share of what the molds hold."""


class KitSection(Section):
    """The calibration kit: load cell, rig, and the steps of the motion program."""

    cell_bolts: int = assumed(3, ge=1, le=24)
    """Screws that hold the load cell to a seat: 3 or 4 for buttons, 1 for the stud of an S-beam."""
    cell_bolt_circle_mm: float = assumed(15.0, ge=0.0, le=500.0)
    """Diameter of the circle they stand on; 0 for one in the middle."""
    cell_bolt_hole_mm: float = assumed(3.2, gt=0.0, le=50.0)
    """Through-holes of these screws."""
    cell_diameter_mm: float = assumed(20.0, gt=0.0, le=500.0)
    """Diameter of the load cell's body, or the diagonal of an S-beam's end."""
    cell_height_mm: float = assumed(10.0, gt=0.0, le=500.0)
    """Height of the load cell between its two seats."""
    seat_mm: float = assumed(4.0, gt=0.0, le=100.0)
    """Thickness of seats and flanges."""
    shaft_mm: float = assumed(12.0, gt=0.0, le=500.0)
    """Length of an indenter between its flange and its face."""
    rig_bolt_square_mm: float = assumed(20.0, gt=0.0, le=500.0)
    """Side of the square of four screws on the rig's carriage."""
    rig_bolt_hole_mm: float = assumed(3.2, gt=0.0, le=50.0)
    """Through-holes of these screws."""
    clearance_mm: float = assumed(0.3, ge=0.0, le=10.0)
    """Gap between the jig and the sensor, and between indenters and the rims."""
    force_steps: int = assumed(8, ge=1, le=1000)
    """Force steps at each region, from training.force_min_N to training.force_max_N."""
    shell_steps: int = assumed(4, ge=1, le=1000)
    """Small displacements at each region that calibrate the bare wall (linear range)."""
    hover_mm: float = assumed(8.0, gt=0.5, le=1000.0)
    """Distance from the sensor between regions."""
    feed_mm_min: float = assumed(60.0, gt=0.0, le=1e5)
    """Speed of the approach."""

    @model_validator(mode="after")
    def _bolts_fit(self) -> Self:
        ring = 0.5 * self.cell_bolt_circle_mm
        if self.cell_bolts > 1:
            apart = 2.0 * ring * _sine(self.cell_bolts)
            if apart <= self.cell_bolt_hole_mm:
                raise ValueError(
                    f"{self.cell_bolts} holes of {self.cell_bolt_hole_mm:g} mm do not fit on a "
                    f"circle of {self.cell_bolt_circle_mm:g} mm; raise cell_bolt_circle_mm"
                )
        if 2.0 * ring + self.cell_bolt_hole_mm >= self.cell_diameter_mm:
            raise ValueError(
                f"screws on a circle of {self.cell_bolt_circle_mm:g} mm lie outside a load cell "
                f"of {self.cell_diameter_mm:g} mm; lower cell_bolt_circle_mm"
            )
        corner = self.rig_bolt_square_mm * 0.5**0.5
        reach = 0.5 * self.cell_diameter_mm + self.clearance_mm + 1.2 + self.rig_bolt_hole_mm / 2.0
        if corner <= reach:
            raise ValueError(
                f"the rig's screws lie under the load cell ({corner:.1f} mm from its axis, need "
                f"more than {at_least(reach)}); raise rig_bolt_square_mm above "
                f"{at_least(reach * 2.0**0.5)}"
            )
        return self


def _sine(count: int) -> float:
    from math import pi, sin

    return sin(pi / count)
