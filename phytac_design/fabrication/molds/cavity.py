"""Sizes of a mold and the outlines of its cavities, shrinkages taken out."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.design.switch_table import MoldSection
from phytac_design.fabrication.molds.plate_grid import SwitchKind
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.fabrication.switch_strips import StripSet
from phytac_design.geometry.triangles import sides_for, widening
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

FLANK_deg = 15.0
"""Slope of keys and of the pinching rings: they must find each other and come apart by hand."""
TROUGH_deg = 1.0
"""Least slope of the troughs behind the stems and of the cap's bosses in them."""
KEY_SIDES = 32
EDGE_mm = 0.3
"""Least wall around a key's socket and between troughs, whatever the printer's rules."""


@dataclass(frozen=True, kw_only=True)
class Cavity:
    """Section of the rubber of one kind of switch, as the closed mold holds it.

    Attributes
    ----------
    over : (k, 2) float
        (r, z) from the rim up the dome to the pad's edge.
    under : (m, 2) float
        From the rim's inner edge up the core, over its ridge, and down the stem to the tip.
    """

    over: FloatArray
    under: FloatArray

    @property
    def reach_mm(self) -> float:
        """Depth of the tip below the parting plane."""
        return float(-self.under[-1, 1])


@dataclass(frozen=True, kw_only=True)
class MoldSizes:
    """Dimensions common to the plates of one mold; mm, before the print's shrinkage.

    Attributes
    ----------
    section : MoldSection
        The design's settings.
    rules : PrintSection
        The printer.
    cavities : mapping of kind to Cavity
        Outlines, the rubber's shrinkage taken out.
    labels : mapping of kind to str
        What is embossed beside each run of a kind.
    sides : int
        Corners of a cavity's rings.
    strips : StripSet, optional
        The strips, where switches are cast on some.
    spacing_mm : float, optional
        Least distance of two cavities, where they do not stand in a grid.
    """

    section: MoldSection
    rules: PrintSection
    cavities: Mapping[SwitchKind, Cavity]
    labels: Mapping[SwitchKind, str]
    sides: int
    strips: StripSet | None = None
    spacing_mm: float | None = None

    @property
    def rubber_scale(self) -> float:
        """Scale factor of cavities and of their places."""
        return 1.0 / (1.0 - self.section.shrink_rubber)

    @property
    def print_scale(self) -> float:
        """Scale factor of the printed parts."""
        scale = 1.0 / (1.0 - self.section.shrink_print)
        if self.section.way == "silicone-master":
            scale /= 1.0 - self.section.shrink_silicone
        return scale

    @property
    def rim_mm(self) -> float:
        """Radius of the widest bowl."""
        return max(float(cavity.over[0, 0]) for cavity in self.cavities.values())

    @property
    def pad_mm(self) -> float:
        """Radius of the rings that pinch the rubber off, and of the pads that carry keys."""
        return self.rim_mm + self.section.land_mm

    @property
    def pitch_mm(self) -> float:
        """Side of a cell."""
        wide = self.section.overflow_mm * float(np.tan(np.radians(self.flank_deg)))
        return 2.0 * (self.pad_mm + wide) + self.section.channel_mm

    @property
    def flank_deg(self) -> float:
        """Slope of keys, pinching rings and fences."""
        return max(self.section.draft_deg, FLANK_deg)

    @property
    def trough_deg(self) -> float:
        """Slope of troughs and bosses."""
        return max(self.section.draft_deg, TROUGH_deg)

    @property
    def dome_mm(self) -> float:
        """Height of the tallest dome above the parting plane."""
        return max(float(cavity.over[-1, 1]) for cavity in self.cavities.values())

    @property
    def core_mm(self) -> float:
        """Height of the tallest core above the parting plane."""
        return max(float(cavity.under[:, 1].max()) for cavity in self.cavities.values())

    @property
    def reach_mm(self) -> float:
        """Longest stem below the parting plane."""
        return max(cavity.reach_mm for cavity in self.cavities.values())

    @property
    def key_height_mm(self) -> float:
        """Height of a key."""
        return 0.6 * self.section.key_mm

    @property
    def depth_mm(self) -> float:
        """Thickness of the core plate, or of its silicone, below the parting plane."""
        least = self.key_height_mm + self.section.key_clearance_mm + self.section.backing_mm
        return max(self.reach_mm + self.section.backing_mm, 2.0 * least)

    @property
    def top_mm(self) -> float:
        """Thickness of the dome plate, or of its silicone, above the parting plane."""
        highest = max(self.dome_mm, self.key_height_mm + self.section.key_clearance_mm)
        return highest + self.section.backing_mm

    @property
    def key_wall_mm(self) -> float:
        """Wall around a key's socket."""
        return self.pad_mm - float(self.key(socket=True)[0, 0])

    def trough_mm(self, cavity: Cavity, z_mm: float) -> float:
        """Half the width of the trough behind a kind of stems, at a height."""
        shoulder_mm = 1.0  # face around each stem's end, for the blade that trims it
        slope = float(np.tan(np.radians(self.trough_deg)))
        tip = float(cavity.under[-1, 0])
        return tip + shoulder_mm - slope * (z_mm + cavity.reach_mm)

    @property
    def trough_wall_mm(self) -> float:
        """Least wall between two troughs, at their mouths."""
        wide = max(self.trough_mm(cavity, -self.depth_mm) for cavity in self.cavities.values())
        return (self.spacing_mm or self.pitch_mm) - 2.0 * wide

    @property
    def web_mm(self) -> tuple[float, float]:
        """Thickness of the webs, and half their width at the foot; 0 without strips.

        Their sides lean by ``flank_deg``.
        """
        if self.strips is None:
            return 0.0, 0.0
        section, scale = self.strips.section, self.rubber_scale
        return scale * section.web_mm, 0.5 * scale * section.web_width_mm

    def key(self, *, socket: bool) -> FloatArray:
        """Section (2, 2) of a key that rises from z = 0, or of its socket."""
        slope = np.radians(self.flank_deg)
        gap = self.section.key_clearance_mm if socket else 0.0
        # Square to the flats of the key's polygon.
        flat = widening(KEY_SIDES) * np.cos(np.pi / KEY_SIDES)
        base = 0.5 * self.section.key_mm + gap / np.cos(np.arctan(np.tan(slope) * flat)) / flat
        height = self.key_height_mm + gap
        return np.array([[base, 0.0], [base - height * np.tan(slope), height]])

    def vent(self, cavity: Cavity, level_mm: float) -> FloatArray:
        """Section (2, 2) of the vent from a stem's end down to the silicone's back.

        Raises
        ------
        DesignError
            If its draft leaves nothing of it.
        """
        vent_min_mm = 0.2  # least diameter of a vent
        start = float(cavity.under[-1, 0]) - self.section.vent_step_mm
        # The flats of a ring's polygon are closer to the axis than its circle.
        flat = widening(self.sides) * np.cos(np.pi / self.sides)
        fall = np.tan(np.radians(self.section.draft_deg)) * (level_mm - cavity.reach_mm) / flat
        end = float(start - fall)
        if 2.0 * end < vent_min_mm:
            raise DesignError(
                "mold-vent-too-thin",
                f"the vent of a stem of {cavity.reach_mm:.3g} mm would end {2.0 * end:.2g} mm "
                f"wide, too thin for air to leave ({vent_min_mm:g} mm); lower [mold] draft_deg or "
                'vent_step_mm, raise [switch] tip_diameter_mm, or take way = "rigid"',
            )
        return np.array([[start, -cavity.reach_mm], [end, -level_mm]])


def make_sizes(
    section: MoldSection, rules: PrintSection, switches: SwitchSet, tolerance_mm: float
) -> MoldSizes:
    """Sizes of the mold of a set of switches.

    Raises
    ------
    DesignError
        If the keys do not fit their pads.
    """
    # Cavities keep this tolerance along their section, however coarse their rings are.
    profile_mm = 0.01
    scale = 1.0 / (1.0 - section.shrink_rubber)
    cavities = {
        kind: _cavity(scale * switches.profile(kind, min(tolerance_mm, profile_mm)))
        for kind in switches.kinds
    }
    widest = max(float(cavity.over[0, 0]) for cavity in cavities.values())
    sizes = MoldSizes(
        section=section,
        rules=rules,
        cavities=cavities,
        labels={kind: switches.label(kind) for kind in switches.kinds},
        sides=sides_for(widest, tolerance_mm),
    )
    over = sizes.key_wall_mm - EDGE_mm
    if over < 0.0:
        raise DesignError(
            "mold-keys-too-wide",
            f"keys of {section.key_mm:g} mm do not fit their pads of {2.0 * sizes.pad_mm:.3g} mm; "
            f"set [mold] key_mm to at most {section.key_mm + 2.0 * over:.2g} or raise land_mm",
        )
    return sizes


def _cavity(profile: FloatArray) -> Cavity:
    """Split a switch's section at its rim."""
    rim = int(profile[:, 0].argmax())
    return Cavity(over=profile[rim:0:-1], under=profile[rim + 1 : -1])
