"""Rules on the clearance inside: wall, receptor heights, light bar."""

import numpy as np

from phytac_design.design.safe_rounding import at_most
from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import bar_span_mm
from phytac_design.layout import make_markers, profile_heights_mm, with_heights
from phytac_design.layout.receptor_distances import segment_distance_mm, smallest_receptor_gap_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.refusal import SLACK_mm, refuse
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


def check_wall(design: Design, surface: Surface) -> None:
    """Check that the wall leaves a hollow."""
    thickness, reach = design.wall.thickness_mm, surface.inner_reach_mm()
    if thickness >= reach:
        # What limits the wall of a shape, in its own words.
        limits = {"cylinder": "radius", "cuboid": "edge_radius_mm"}
        limit = limits.get(surface.name, "smallest radius of curvature")
        more = " or raise shape.edge_radius_mm" if surface.name == "cuboid" else ""
        refuse(
            "wall-too-thick",
            f"the wall is thicker than the {surface.name} allows (thickness {thickness:g} mm ≥ "
            f"{limit} {reach:g} mm); lower wall.thickness_mm below {at_most(reach)}{more}",
        )


def check_heights(sensor: Sensor) -> None:
    """Check that no receptor is longer than the way to where the normals meet below it."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    clearance = surface.reach_mm(markers.uv) - design.wall.thickness_mm
    worst = int(np.argmax(markers.height_mm - np.minimum(clearance, 1e9)))
    height, free = markers.height_mm[worst], clearance[worst]
    if height >= free:
        fix = lower_heights(sensor) or (
            "no height fits there: lower wall.thickness_mm, receptor.diameter_outer_mm or the "
            "number of markers, or keep them off such tightly curved places"
        )
        round_about = surface.name == "cylinder"
        where = "at the axis" if round_about else "where the wall's normals meet"
        limit = "inner radius" if round_about else "depth there"
        refuse(
            "tips-collide",
            f"receptor tips of {markers.place(worst)} collide {where} (height {height:.1f} mm ≥ "
            f"{limit} {free:.1f} mm); {fix}",
        )


def check_reach(sensor: Sensor) -> None:
    """Check that tubes and pushed-out red tips stay clear of the light bar on the axis."""
    design, markers = sensor.design, sensor.markers
    bar = design.light.bar_radius_mm
    for what, free, least in _bar_clearances(sensor):
        worst = int(np.argmin(free))
        if free[worst] < least - SLACK_mm:
            fix = lower_heights(sensor)
            refuse(
                "light-bar-hits-tips",
                f"{what} tips of {markers.place(worst)} reach the light bar (they end "
                f"{free[worst]:.1f} mm from the axis, height {markers.height_mm[worst]:.1f} mm; "
                f"the bar of radius {bar:g} mm needs {least:.1f} mm); "
                f"{fix or 'lower the heights'}, or lower light.bar_radius_mm",
            )


def lower_heights(sensor: Sensor) -> str:
    """Fix for receptors that are too tall, with the greatest height (0.1 mm steps) that fits.

    Empty if no height fits: then the height is not what is wrong.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    layout = design.layout
    if layout.position_heights_mm:
        return "lower layout.position_heights_mm"
    fields = {"height_near_mm": layout.height_near_mm}
    if layout.heights != "constant" and len(np.unique(markers.row)) > 1:
        fields["height_far_mm"] = layout.height_far_mm
    fitting, failing = 0, int(np.ceil(max(fields.values()) * 10.0))
    while failing - fitting > 1:
        middle = (fitting + failing) // 2
        heights = {field: min(value, middle / 10.0) for field, value in fields.items()}
        trial = design.model_copy(update={"layout": layout.model_copy(update=heights)})
        if _clearance_mm(Sensor.of(trial, surface, markers)) > 0.0:
            fitting = middle
        else:
            failing = middle
    if fitting == 0:
        return ""
    lower = [f"layout.{name}" for name, value in fields.items() if value > fitting / 10.0]
    return f"lower {' and '.join(lower)} to {fitting / 10.0:g}"


def _clearance_mm(sensor: Sensor) -> float:
    """Least clearance of the receptors beyond what the rules ask: axis, light bar, each other."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    if design.layout.heights == "line-of-sight":
        try:
            lowered = make_markers(design, surface)
        except DesignError:
            return -1.0
    else:
        heights = profile_heights_mm(design, surface, markers.uv, in_rows=markers.in_rows)
        lowered = with_heights(design, surface, markers, heights)
    reach = surface.reach_mm(lowered.uv) - design.wall.thickness_mm
    clearance = float((reach - lowered.height_mm).min())
    gap, _ = smallest_receptor_gap_mm(design, lowered)
    free = [
        (free - least).min()
        for _, free, least in _bar_clearances(Sensor.of(design, surface, lowered))
    ]
    return float(min(clearance, gap - design.print_rules.gap_min_mm + SLACK_mm, *free))


def _bar_clearances(sensor: Sensor) -> list[tuple[str, FloatArray, float]]:
    """What comes near the bar, how near its axis (n,) it comes, and how near it may; mm."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    bar, switch = design.light.bar_radius_mm, design.switch
    near, far = bar_span_mm(design, surface) if bar > 0.0 else (0.0, 0.0)
    if near >= far:
        return []
    pushed = markers.tip_mm + design.tip_travel_mm * markers.direction
    ends = (
        (
            "receptor",
            markers.tip_mm,
            design.receptor.diameter_tube_mm / 2.0,
            bar + design.print_rules.gap_min_mm,
        ),
        ("pushed-out red", pushed, switch.tip_diameter_mm / 2.0, bar),
    )
    start = np.tile([0.0, 0.0, near], (markers.count, 1))
    stop = np.tile([0.0, 0.0, far], (markers.count, 1))
    lean = np.abs(markers.direction[:, 2])
    return [
        (what, segment_distance_mm(markers.base_mm, end, start, stop) - radius * lean, least)
        for what, end, radius, least in ends
    ]
