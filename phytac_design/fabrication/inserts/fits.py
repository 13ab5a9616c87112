"""Whether inserts go in and stay in, nominally and with sizes off by the printer's accuracy."""

from dataclasses import asdict, dataclass

import numpy as np

from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.switch.switch_inputs import space_of
from phytac_design.solids.receptor_tubes import rim_sag_mm


@dataclass(frozen=True, kw_only=True)
class Fits:
    """Fits of a design's inserts, mm; positive is good but for ``proud``.

    Attributes
    ----------
    push_in, push_in_worst : float
        Gap on each side between insert and bore, nominal and least.
    hold_in, hold_in_worst : float
        How far the head is wider than the bore, on each side: it cannot be pushed through.
    cover : float or None
        How far a switch's bowl reaches over the seat, on each side: the insert cannot be pulled
        out once the switch is glued on. None without switches: glue alone holds it.
    stem, stem_worst : float or None
        Gap on each side between the switch's stem, where it is widest, and the insert's hole.
    proud_worst : float
        How far a head may stand out of the outer face: the printer's error, and the head's flat
        top on a curved face.
    marker_off_worst : float
        How far the marker may stand beside its receptor's axis.
    """

    push_in: float
    push_in_worst: float
    hold_in: float
    hold_in_worst: float
    cover: float | None
    stem: float | None
    stem_worst: float | None
    proud_worst: float
    marker_off_worst: float

    def as_dict(self) -> dict[str, float | None]:
        """Plain values."""
        return asdict(self)


def fits_of(sensor: Sensor) -> Fits:
    """Fits of the inserts of a design, whose diameters are each off by ``accuracy_mm`` at worst.

    Two diameters that are off in opposite ways change a gap on one side by the accuracy itself.
    """
    design, receptor = sensor.design, sensor.design.receptor
    accuracy = design.print_rules.accuracy_mm
    sag, _ = rim_sag_mm(
        sensor.surface,
        sensor.markers,
        sensor.surface.point(sensor.markers.uv),
        receptor.diameter_head_mm / 2.0,
    )
    cover = stem = None
    if design.has_switches:
        cover = (design.switch.footprint_diameter_mm - receptor.diameter_seat_mm) / 2.0
        # The mold's own shrinkage is taken out; the stem counts as exact.
        stem = (receptor.diameter_hole_mm - space_of(design).stem_diameter_mm) / 2.0
    return Fits(
        push_in=receptor.gap_insert_mm,
        push_in_worst=receptor.gap_insert_mm - accuracy,
        hold_in=receptor.ledge_insert_mm,
        hold_in_worst=receptor.ledge_insert_mm - accuracy,
        cover=cover,
        stem=stem,
        stem_worst=None if stem is None else stem - accuracy / 2.0,
        proud_worst=accuracy + float(np.maximum(sag, 0.0).max()),
        marker_off_worst=receptor.gap_insert_mm + accuracy,
    )
