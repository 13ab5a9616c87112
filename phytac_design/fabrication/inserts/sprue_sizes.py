"""Sizes of the sprues that inserts are printed on, from the printer's rules."""

from dataclasses import dataclass

from phytac_design.design.layout_table import ReceptorSection
from phytac_design.design.print_rules_table import PrintSection

NECK_LENGTH_mm = 1.0
"""Between a bar and the heads of its inserts: room for the blades of a flush cutter."""

LABEL_mm = 2.9
"""Least width of a bar: its label's letters are up to 2.3 mm tall, with strokes of 0.4 mm."""


def neck_mm(rules: PrintSection) -> float:
    """Diameter of the necks that hold an insert on its bar."""
    return max(rules.post_diameter_mm(NECK_LENGTH_mm), rules.wall_free_min_mm)


def ring_mm(receptor: ReceptorSection) -> float:
    """Width of an insert's head that a neck can stand on: beside the hole, or all of it."""
    if receptor.diameter_hole_mm > 0.0:
        return (receptor.diameter_head_mm - receptor.diameter_hole_mm) / 2.0
    return receptor.diameter_head_mm


@dataclass(frozen=True, kw_only=True)
class SprueSizes:
    """Sizes of a sprue, mm.

    Attributes
    ----------
    neck : float
        Diameter of the necks.
    arm : float
        From an insert's axis to its necks, one on each side of the bar's middle; 0 for one neck.
    thickness, width : float
        Of the bar's section.
    letter : float
        Length of the tab before the first insert, for each letter of its label.
    gap : float
        Free space between sprues on the bed.
    """

    neck: float
    arm: float
    thickness: float
    width: float
    letter: float
    gap: float

    @property
    def middle(self) -> float:
        """Height of the middle of the bar over the outer face."""
        return NECK_LENGTH_mm + self.thickness / 2.0


def sprue_sizes(receptor: ReceptorSection, rules: PrintSection) -> SprueSizes:
    """Sizes for a receptor and a printer."""
    neck, hole = neck_mm(rules), receptor.diameter_hole_mm
    arm = (receptor.diameter_head_mm + hole) / 4.0 if hole > 0.0 else 0.0
    return SprueSizes(
        neck=neck,
        arm=arm,
        thickness=max(rules.wall_free_min_mm, rules.wall_min_mm),
        width=max(2.0 * arm + neck, LABEL_mm),
        letter=2.0,
        gap=max(1.0, rules.gap_min_mm),
    )
