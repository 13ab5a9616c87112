"""Rules on markers that are inserts: they must go in, stay in, and be printable."""

import numpy as np

from phytac_design.design.safe_rounding import at_least
from phytac_design.design.spec import Design
from phytac_design.fabrication.inserts.sprue_sizes import neck_mm, ring_mm
from phytac_design.fabrication.inserts.sprues import insert_lengths_mm, sprue_room_mm
from phytac_design.layout.receptor_distances import nearest_pair
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.refusal import SLACK_mm, fewer, refuse

LEAN_MAX_deg = 1.0
"""Between an insert and the wall's normal: its head then stands out by 0.03 mm on one side."""


def check_inserts(sensor: Sensor) -> None:
    """Check that inserts can be printed, pushed in and not through, and are covered by switches.

    Fits are those of the least favourable print: every diameter off by the printer's accuracy.
    """
    design = sensor.design
    if not design.receptor.has_inserts:
        return
    _check_fits(design)
    _check_seats(sensor)
    _check_slenderness(sensor)
    sprue_room_mm(design)
    neck, ring = neck_mm(design.print_rules), ring_mm(design.receptor)
    if neck > ring + SLACK_mm:
        refuse(
            "insert-neck-too-thick",
            f"the sprues of the inserts cannot be printed: their necks are {neck:g} mm thick, the "
            f"inserts' heads {ring:.2f} mm around the hole; raise receptor.diameter_outer_mm to "
            f"{at_least(design.receptor.diameter_outer_mm + 2.0 * (neck - ring))}, or set "
            'receptor.colouring = "paint"',
        )


def _check_slenderness(sensor: Sensor) -> None:
    """Check that the longest insert can be printed upright."""
    design, rules = sensor.design, sensor.design.print_rules
    longest = float(insert_lengths_mm(design, sensor.markers).max(initial=0.0))
    outer, least = design.receptor.diameter_outer_mm, rules.post_diameter_mm(longest)
    if outer < least - SLACK_mm:
        refuse(
            "insert-too-slender",
            f"an insert {longest:.1f} mm long is too slender to print ({outer:g} mm < {least:.2f} "
            f"mm); raise receptor.diameter_outer_mm to {at_least(least)} or lower "
            "layout.height_far_mm",
        )


def _check_fits(design: Design) -> None:
    receptor, rules = design.receptor, design.print_rules
    accuracy = rules.accuracy_mm
    if receptor.gap_insert_mm < accuracy - SLACK_mm:
        refuse(
            "insert-gap-too-small",
            f"inserts may not go into their tubes: with both off by ±{accuracy:g} mm the gap of "
            f"{receptor.gap_insert_mm:g} mm on each side closes; raise receptor.gap_insert_mm to "
            f"{at_least(accuracy)}",
        )
    if receptor.ledge_insert_mm <= accuracy + SLACK_mm:
        refuse(
            "insert-ledge-too-small",
            f"inserts may fall through: with both off by ±{accuracy:g} mm a head that is "
            f"{receptor.ledge_insert_mm:g} mm wider than the bore on each side is no wider; raise "
            f"receptor.ledge_insert_mm above {at_least(accuracy)}",
        )
    if receptor.thickness_tube_mm < rules.wall_min_mm - SLACK_mm:
        refuse(
            "insert-tube-too-thin",
            f"the tubes around the inserts are too thin to print ({receptor.thickness_tube_mm:g} "
            f"mm < {rules.wall_min_mm:g} mm); raise receptor.thickness_tube_mm to "
            f"{at_least(rules.wall_min_mm)}",
        )
    left = design.wall.thickness_mm - receptor.depth_seat_mm
    if left < rules.wall_min_mm - SLACK_mm:
        refuse(
            "insert-seat-too-deep",
            f"the seats of the inserts leave {left:.2f} mm of the wall "
            f"(< {rules.wall_min_mm:g} mm); raise wall.thickness_mm to "
            f"{at_least(receptor.depth_seat_mm + rules.wall_min_mm)}",
        )


def _check_seats(sensor: Sensor) -> None:
    design, markers, surface = sensor.design, sensor.markers, sensor.surface
    seat = design.receptor.diameter_seat_mm
    cosine = -np.sum(markers.direction * markers.normal, axis=1)
    lean = float(np.degrees(np.arccos(np.clip(cosine.min(), -1.0, 1.0))))
    if lean > LEAN_MAX_deg:
        refuse(
            "insert-leans",
            f"inserts go in square to the wall (receptor.direction leans them by {lean:.1f}°): set "
            'receptor.direction = "normal", or receptor.colouring = "paint"',
        )
    if design.has_switches and design.switch.footprint_diameter_mm < seat - SLACK_mm:
        refuse(
            "footprint-below-seat",
            f"the switch's bowl does not cover the seat of its insert (footprint "
            f"{design.switch.footprint_diameter_mm:g} mm < seat {seat:.2f} mm); raise "
            f"switch.footprint_diameter_mm to {at_least(seat)}, or lower "
            "receptor.diameter_outer_mm and receptor.diameter_hole_mm",
        )
    if design.has_switches or markers.count < 2:
        return  # bowls are wider and keep apart
    apart, (low, high) = nearest_pair(surface.point(markers.uv))
    least = seat + design.print_rules.wall_min_mm
    if apart < least - SLACK_mm:
        refuse(
            "insert-seats-meet",
            f"the seats of inserts {markers.name(low)} and {markers.name(high)} leave too thin a "
            f"wall between them (centres {apart:.2f} mm apart, seats {seat:.2f} mm wide); "
            f"{fewer(design)} receptor.diameter_outer_mm",
        )
