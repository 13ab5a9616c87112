"""Rules on sizes against each other and against the printer: no geometry but the sensor's size."""

import numpy as np

from phytac_design.design.safe_rounding import at_least, at_most
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.rules.refusal import SLACK_mm, refuse
from phytac_shapes import Surface


def check_count(design: Design) -> None:
    """Check that there are no more markers than any camera resolves."""
    markers_max = 50_000  # far more than any camera resolves
    count = design.layout.wanted
    if count > markers_max:
        refuse(
            "too-many-markers",
            f"{design.layout.rows} rows x {design.layout.columns} columns are {count} markers, "
            f"more than {markers_max}; lower layout.rows or layout.columns",
        )


def check_wall_size(design: Design) -> None:
    """Check that the wall can be printed."""
    thickness, least = design.wall.thickness_mm, design.print_rules.wall_min_mm
    if thickness < least - SLACK_mm:
        refuse(
            "wall-too-thin",
            f"the wall is too thin to print ({thickness:g} mm < {least:g} mm); raise "
            f"wall.thickness_mm to {at_least(least)}",
        )


def check_receptor_sizes(design: Design) -> None:
    """Check that tubes or posts can be printed, and that the switch's tip passes the hole."""
    receptor, rules = design.receptor, design.print_rules
    outer, hole, tip = (
        receptor.diameter_outer_mm,
        receptor.diameter_hole_mm,
        design.switch.tip_diameter_mm,
    )
    if not design.has_switches:
        if outer < rules.wall_min_mm - SLACK_mm:
            refuse(
                "tube-wall-too-thin",
                f"the receptors' posts are too thin to print ({outer:g} mm < "
                f"{rules.wall_min_mm:g} mm); raise receptor.diameter_outer_mm to "
                f"{at_least(rules.wall_min_mm)}",
            )
        return
    if hole < rules.hole_min_mm - SLACK_mm:
        refuse(
            "hole-too-small",
            f"the receptors' holes would close in printing ({hole:g} mm < "
            f"{rules.hole_min_mm:g} mm); raise receptor.diameter_hole_mm to "
            f"{at_least(rules.hole_min_mm)}",
        )
    if hole >= outer:
        refuse(
            "hole-exceeds-tube",
            f"the receptors' hole is not smaller than the tube (hole {hole:g} mm ≥ outer "
            f"{outer:g} mm); lower receptor.diameter_hole_mm or raise receptor.diameter_outer_mm",
        )
    side = (outer - hole) / 2.0
    if side < rules.wall_min_mm - SLACK_mm:
        what = "inserts' walls" if receptor.has_inserts else "receptors' tube walls"
        refuse(
            "tube-wall-too-thin",
            f"the {what} are too thin to print ({side:.2f} mm < "
            f"{rules.wall_min_mm:g} mm); raise receptor.diameter_outer_mm to "
            f"{at_least(hole + 2.0 * rules.wall_min_mm)} or lower receptor.diameter_hole_mm",
        )
    if hole - tip < rules.gap_min_mm - SLACK_mm:
        refuse(
            "tip-clearance-too-small",
            f"the switch's tip does not pass the receptor's hole (tip {tip:g} mm in a hole of "
            f"{hole:g} mm leaves {hole - tip:.2f} mm < {rules.gap_min_mm:g} mm); lower "
            f"switch.tip_diameter_mm to {at_most(hole - rules.gap_min_mm)} or raise "
            "receptor.diameter_hole_mm",
        )


def check_switch_sizes(design: Design) -> None:
    """Check that a switch turns on and off, and covers its hole."""
    if not design.has_switches:
        return
    switch, hole = design.switch, design.receptor.diameter_hole_mm
    if switch.release_N >= switch.threshold_N:
        refuse(
            "release-above-threshold",
            f"a switch must release below its threshold (release {switch.release_N:g} N ≥ "
            f"threshold {switch.threshold_N:g} N); lower switch.release_N",
        )
    if switch.stroke_mm <= switch.tip_recess_mm:
        refuse(
            "stroke-below-recess",
            f"the red tip never comes out (stroke {switch.stroke_mm:g} mm ≤ recess "
            f"{switch.tip_recess_mm:g} mm); raise switch.stroke_mm above "
            f"{at_least(switch.tip_recess_mm)}",
        )
    if switch.footprint_diameter_mm <= hole:
        refuse(
            "footprint-below-hole",
            f"the switch's bowl does not cover the hole (footprint "
            f"{switch.footprint_diameter_mm:g} mm ≤ hole {hole:g} mm); raise "
            f"switch.footprint_diameter_mm above {at_least(hole)}",
        )


def check_training(sensor: Sensor) -> None:
    """Check that contacts fit and can trip switches at all: else there is nothing to learn."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    training, switch = design.training, design.switch
    size = min(float(surface.reach_mm(markers.uv).max()), _half_size_mm(surface))
    if training.patch_radius_max_mm > size + SLACK_mm:
        refuse(
            "patch-exceeds-sensor",
            f"contact patches are larger than the sensor (radius {training.patch_radius_max_mm:g} "
            f"mm > {size:g} mm); lower training.patch_radius_max_mm to {at_most(size)}",
        )
    share = min(1.0, switch.footprint_diameter_mm / (2.0 * training.patch_radius_min_mm)) ** 2
    most = share * training.force_max_N
    threshold = float(thresholds_N(design, markers).min())
    if most <= threshold:
        refuse(
            "threshold-unreachable",
            f"no contact can trip a switch: the strongest one ({training.force_max_N:g} N) puts "
            f"{most:.3g} N on a switch's footprint, its threshold is {threshold:g} N; "
            f"lower switch.threshold_N below {at_most(most, 3)} or raise training.force_max_N",
        )


def _half_size_mm(surface: Surface) -> float:
    """Half of the smaller side of a sheet; inf for shapes that close around."""
    if surface.periodic[1]:
        return float("inf")
    (u0, u1), (v0, v1) = surface.domain
    middle_u, middle_v = (u0 + u1) / 2.0, (v0 + v1) / 2.0
    ends = np.array([[u0, middle_v], [u1, middle_v], [middle_u, v0], [middle_u, v1]])
    flat = surface.unwrap(ends)
    along, around = flat[1, 1] - flat[0, 1], flat[3, 0] - flat[2, 0]
    return float(min(abs(along), abs(around)) / 2.0)
