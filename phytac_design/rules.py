"""Whether a design can be built at all: cheap checks made before any solid, mesh or picture.

Every check is a function that returns nothing or raises one :class:`DesignError` which says what
fails, by how much, and what mends it. Rows and columns are counted from 0, row 0 nearest the
camera. Cameras are checked in ``phytac_design.optics``.
"""

from typing import NoReturn

import numpy as np

from phytac_design.fabrication.receptors import root_depth_mm
from phytac_design.fabrication.spacing import (
    nearest_pair,
    segment_distance_mm,
    smallest_receptor_gap_mm,
)
from phytac_design.layout import Markers, make_markers
from phytac_design.spec import Design
from shapes import Surface
from shapes.arrays import FloatArray
from shapes.errors import DesignError

MARKERS_MAX = 50_000
"""Most markers that a design may ask for; far beyond what any camera tells apart."""
SLACK_mm = 1e-9
"""Lengths that meet a rule exactly pass in spite of rounding."""


def check_design(design: Design) -> tuple[Surface, Markers]:
    """Check everything that needs no camera; return the surface and the markers.

    Raises
    ------
    DesignError
        At the first rule that the design breaks.
    """
    check_sizes(design)
    surface = design.surface()
    check_wall(design, surface)
    markers = make_markers(design, surface)
    check_heights(design, surface, markers)
    check_reach(design, surface, markers)
    check_ends(design, surface, markers)
    check_receptor_gaps(design, surface, markers)
    check_footprints(design, surface, markers)
    root_depth_mm(design, surface, markers)
    check_training(design, surface)
    return surface, markers


def _refuse(text: str) -> NoReturn:
    raise DesignError(text)


def check_sizes(design: Design) -> None:
    """Check sizes against each other and against the print rules: needs no geometry."""
    receptor, switch, rules = design.receptor, design.switch, design.print_rules
    count = design.layout.rows * design.layout.columns
    if count > MARKERS_MAX:
        _refuse(
            f"{design.layout.rows} rows x {design.layout.columns} columns are {count} markers, "
            f"more than {MARKERS_MAX}; lower layout.rows or layout.columns"
        )
    outer, hole, tip = (
        receptor.diameter_outer_mm,
        receptor.diameter_hole_mm,
        switch.tip_diameter_mm,
    )
    if design.wall.thickness_mm < rules.wall_min_mm - SLACK_mm:
        _refuse(
            f"the wall is too thin to print ({design.wall.thickness_mm:g} mm < "
            f"{rules.wall_min_mm:g} mm); raise wall.thickness_mm to {rules.wall_min_mm:g}"
        )
    if hole < rules.hole_min_mm - SLACK_mm:
        _refuse(
            f"the receptors' holes would close in printing ({hole:g} mm < "
            f"{rules.hole_min_mm:g} mm); raise receptor.diameter_hole_mm to {rules.hole_min_mm:g}"
        )
    if hole >= outer:
        _refuse(
            f"the receptors' hole is not smaller than the tube (hole {hole:g} mm ≥ outer "
            f"{outer:g} mm); lower receptor.diameter_hole_mm or raise receptor.diameter_outer_mm"
        )
    side = (outer - hole) / 2.0
    if side < rules.wall_min_mm - SLACK_mm:
        _refuse(
            f"the receptors' tube walls are too thin to print ({side:.2f} mm < "
            f"{rules.wall_min_mm:g} mm); raise receptor.diameter_outer_mm to "
            f"{hole + 2.0 * rules.wall_min_mm:g} or lower receptor.diameter_hole_mm"
        )
    if hole - tip < rules.gap_min_mm - SLACK_mm:
        _refuse(
            f"the switch's tip does not pass the receptor's hole (tip {tip:g} mm in a hole of "
            f"{hole:g} mm leaves {hole - tip:.2f} mm < {rules.gap_min_mm:g} mm); lower "
            f"switch.tip_diameter_mm to {hole - rules.gap_min_mm:g} or raise "
            "receptor.diameter_hole_mm"
        )
    _check_switch(design)


def _check_switch(design: Design) -> None:
    switch, hole = design.switch, design.receptor.diameter_hole_mm
    if switch.release_N >= switch.threshold_N:
        _refuse(
            f"a switch must release below its threshold (release {switch.release_N:g} N ≥ "
            f"threshold {switch.threshold_N:g} N); lower switch.release_N"
        )
    if switch.stroke_mm <= switch.tip_recess_mm:
        _refuse(
            f"the red tip never comes out (stroke {switch.stroke_mm:g} mm ≤ recess "
            f"{switch.tip_recess_mm:g} mm); raise switch.stroke_mm above "
            f"{switch.tip_recess_mm:g}"
        )
    if switch.footprint_diameter_mm <= hole:
        _refuse(
            f"the switch's bowl does not cover the hole (footprint "
            f"{switch.footprint_diameter_mm:g} mm ≤ hole {hole:g} mm); raise "
            f"switch.footprint_diameter_mm above {hole:g}"
        )


def check_training(design: Design, surface: Surface) -> None:
    """Check that contacts can trip switches at all: else there is nothing to learn from."""
    training, switch = design.training, design.switch
    reach = surface.inner_reach_mm()
    if training.patch_radius_max_mm > reach:
        _refuse(
            f"contact patches are larger than the sensor (radius {training.patch_radius_max_mm:g} "
            f"mm > {reach:g} mm); lower training.patch_radius_max_mm"
        )
    share = min(1.0, switch.footprint_diameter_mm / (2.0 * training.patch_radius_min_mm)) ** 2
    most = share * training.force_max_N
    if most <= switch.threshold_N:
        _refuse(
            f"no contact can trip a switch: the strongest one ({training.force_max_N:g} N) puts "
            f"{most:.3g} N on a switch's footprint, its threshold is {switch.threshold_N:g} N; "
            f"lower switch.threshold_N below {most:.3g} or raise training.force_max_N"
        )


def check_wall(design: Design, surface: Surface) -> None:
    """Check that the wall leaves a hollow."""
    thickness, reach = design.wall.thickness_mm, surface.inner_reach_mm()
    if thickness >= reach:
        _refuse(
            f"the wall is thicker than the {surface.name} allows (thickness {thickness:g} mm ≥ "
            f"radius {reach:g} mm); lower wall.thickness_mm below {reach:g}"
        )


def _lower_heights(design: Design, surface: Surface) -> str:
    """Fix for receptors that are too tall, with the greatest height (0.1 mm steps) that fits.

    Empty if no height fits: then the height is not what is wrong.
    """
    layout = design.layout
    fields = {"height_near_mm": layout.height_near_mm}
    if layout.rows > 1:
        fields["height_far_mm"] = layout.height_far_mm
    fitting, failing = 0, int(np.ceil(max(fields.values()) * 10.0))
    while failing - fitting > 1:
        middle = (fitting + failing) // 2
        heights = {field: min(value, middle / 10.0) for field, value in fields.items()}
        trial = design.model_copy(update={"layout": layout.model_copy(update=heights)})
        if _room_mm(trial, surface) > 0.0:
            fitting = middle
        else:
            failing = middle
    if fitting == 0:
        return ""
    lower = [f"layout.{name}" for name, value in fields.items() if value > fitting / 10.0]
    return f"lower {' and '.join(lower)} to {fitting / 10.0:g}"


def _room_mm(design: Design, surface: Surface) -> float:
    """Least clearance of the receptors beyond what the rules ask: axis, light bar, each other."""
    markers = make_markers(design, surface)
    room = surface.inner_reach_mm() - design.wall.thickness_mm - markers.height_mm.max()
    gap, _ = smallest_receptor_gap_mm(design, markers)
    reach = [(free - least).min() for _, free, least in _bar_clearances(design, markers)]
    return float(min(room, gap - design.print_rules.gap_min_mm + SLACK_mm, *reach))


def check_heights(design: Design, surface: Surface, markers: Markers) -> None:
    """Check that no receptor is longer than the way to where the normals meet."""
    tallest = int(np.argmax(markers.height_mm))
    row, height = markers.row[tallest], markers.height_mm[tallest]
    room = surface.inner_reach_mm() - design.wall.thickness_mm
    if height >= room:
        mend = _lower_heights(design, surface) or "lower the receptors' heights"
        _refuse(
            f"receptor tips of row {row} collide at the axis (height {height:.1f} mm ≥ inner "
            f"radius {room:.1f} mm); {mend}"
        )


def check_reach(design: Design, surface: Surface, markers: Markers) -> None:
    """Check that tubes and pushed-out red tips stay clear of the light bar on the axis."""
    bar = design.light.bar_radius_mm
    for what, free, least in _bar_clearances(design, markers):
        worst = int(np.argmin(free))
        if free[worst] < least - SLACK_mm:
            mend = _lower_heights(design, surface)
            _refuse(
                f"{what} tips of row {markers.row[worst]} reach the light bar (they end "
                f"{free[worst]:.1f} mm from the axis, height {markers.height_mm[worst]:.1f} mm; "
                f"the bar of radius {bar:g} mm needs {least:.1f} mm); "
                f"{mend or 'lower the heights'}, or lower light.bar_radius_mm"
            )


def _bar_clearances(design: Design, markers: Markers) -> list[tuple[str, FloatArray, float]]:
    """What comes near the bar, how near its axis (n,) it comes, and how near it may; mm."""
    bar, switch = design.light.bar_radius_mm, design.switch
    if bar == 0.0:
        return []
    pushed = markers.tip_mm - (switch.stroke_mm - switch.tip_recess_mm) * markers.normal
    return [
        (
            what,
            _axis_distance_mm(design, markers, end) - radius * np.abs(markers.normal[:, 2]),
            least,
        )
        for what, end, radius, least in (
            (
                "receptor",
                markers.tip_mm,
                design.receptor.diameter_outer_mm / 2.0,
                bar + design.print_rules.gap_min_mm,
            ),
            ("pushed-out red", pushed, switch.tip_diameter_mm / 2.0, bar),
        )
    ]


def _axis_distance_mm(design: Design, markers: Markers, end_mm: FloatArray) -> FloatArray:
    """Distance of each segment foot-end from the light bar's axis, (n,); the bar ends far."""
    far = np.maximum(markers.foot_mm, end_mm)[:, 2].max() + design.wall.rim_length_mm
    start = np.tile([0.0, 0.0, design.light.bar_start_mm], (markers.count, 1))
    stop = np.tile([0.0, 0.0, max(far, design.light.bar_start_mm)], (markers.count, 1))
    return segment_distance_mm(markers.foot_mm, end_mm, start, stop)


def check_ends(design: Design, surface: Surface, markers: Markers) -> None:
    """Check that tubes and switch footprints stay within the open ends of the surface."""
    flat = surface.unwrap(markers.uv)
    rim_stands_out = design.wall.rim_length_mm > 0.0 and design.wall.rim_flange_mm > 0.0
    for axis, around_or_along in ((0, 1), (1, 0)):
        if surface.periodic[axis]:
            continue
        for end in surface.domain[axis]:
            edge = markers.uv.copy()
            edge[:, axis] = end
            distance = np.abs(surface.unwrap(edge) - flat)[:, around_or_along]
            worst = int(np.argmin(distance))
            place = (
                f"receptor (row {markers.row[worst]}, column {markers.column[worst]}) lies "
                f"{distance[worst]:.2f} mm from the end of the surface"
            )
            count = "rows" if axis == 0 else "columns"
            for what, field, radius in (
                ("tube", "receptor.diameter_outer_mm", design.receptor.diameter_outer_mm / 2.0),
                (
                    "switch footprint",
                    "switch.footprint_diameter_mm",
                    design.switch.footprint_diameter_mm / 2.0,
                ),
            ):
                matters = what == "tube" or (rim_stands_out and axis == 0)
                if matters and distance[worst] < radius - SLACK_mm:
                    _refuse(
                        f"{place}, less than the radius of its {what} ({radius:.2f} mm): it cuts "
                        f"the rim; lower layout.{count} or {field}"
                    )


def _name(markers: Markers, marker: int) -> str:
    return f"(row {markers.row[marker]}, column {markers.column[marker]})"


def check_receptor_gaps(design: Design, surface: Surface, markers: Markers) -> None:
    """Check that tubes keep the printer's gap between each other.

    The gap is the distance between the axes' segments less one diameter: exact for sides that
    meet, up to a few hundredths of a millimetre too small where flat ends are nearest.
    """
    gap, pair = smallest_receptor_gap_mm(design, markers)
    least = design.print_rules.gap_min_mm
    if pair is None or gap >= least - SLACK_mm:
        return
    first, second = _name(markers, pair[0]), _name(markers, pair[1])
    state = f"overlap by {-gap:.2f} mm" if gap < 0.0 else f"are {gap:.2f} mm apart"
    spacing = "columns" if markers.row[pair[0]] == markers.row[pair[1]] else "rows or columns"
    mend = _lower_heights(design, surface)
    _refuse(
        f"receptors {first} and {second} meet: they {state} (the printer needs a gap of "
        f"{least:g} mm); {mend + ', or ' if mend else ''}lower layout.{spacing} or "
        "receptor.diameter_outer_mm"
    )


def check_footprints(design: Design, surface: Surface, markers: Markers) -> None:
    """Check that the bowls of neighbouring switches do not overlap on the outer face."""
    if markers.count < 2:
        return
    outer = surface.point(markers.uv)
    apart, (low, high) = nearest_pair(outer)
    size = design.switch.footprint_diameter_mm
    if apart < size - SLACK_mm:
        _refuse(
            f"switches {_name(markers, low)} and {_name(markers, high)} overlap on the outer "
            f"face (footprint {size:g} mm, centres {apart:.2f} mm apart); lower "
            f"switch.footprint_diameter_mm to {np.floor(apart * 10.0) / 10.0:g}, or layout.rows "
            "or layout.columns"
        )
