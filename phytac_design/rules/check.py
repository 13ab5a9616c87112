"""All rules of a design in one place, checked before anything is computed or written."""

from collections.abc import Callable, Mapping

from phytac_design.design.design_file import with_unit_hints
from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.hardware_assembly import check_hardware
from phytac_design.layout.mark_placement import place_reference_marks
from phytac_design.layout.region_chart import design_regions
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.switch.switch_inputs import rubbers_of
from phytac_design.optics.separability import check_paints
from phytac_design.optics.sharpness import sharpness
from phytac_design.rules.body_rules import check_cameras, check_fixtures
from phytac_design.rules.clearance import check_heights, check_reach, check_wall
from phytac_design.rules.insert_rules import check_inserts
from phytac_design.rules.receptor_spacing import check_ends, check_footprints, check_receptor_gaps
from phytac_design.rules.sizes import (
    check_count,
    check_receptor_sizes,
    check_switch_sizes,
    check_training,
    check_wall_size,
)
from phytac_design.solids.receptor_tubes import root_depth_mm
from phytac_shapes.errors import DesignError, PhytacError


def _hollow(sensor: Sensor) -> None:
    # Facets follow the wall's thickness: those of a vanishing one fill the memory in later rules.
    vanishing_share = 0.05
    wall, rules = sensor.design.wall, sensor.design.print_rules
    if wall.thickness_mm < vanishing_share * rules.wall_min_mm:
        check_wall_size(sensor.design)
    check_wall(sensor.design, sensor.surface)


def _sharp(sensor: Sensor) -> None:
    for camera in sensor.cameras:
        sharpness(sensor.design.camera, camera, sensor.surface, sensor.markers)


Rule = tuple[Callable[[Sensor], object], str]
"""What checks a rule, and the rules without which it has no meaning."""

RULES: dict[str, Rule] = {
    "count": (lambda sensor: check_count(sensor.design), ""),
    "wall_size": (lambda sensor: check_wall_size(sensor.design), ""),
    "tubes": (lambda sensor: check_receptor_sizes(sensor.design), ""),
    "switches": (lambda sensor: check_switch_sizes(sensor.design), "tubes"),
    "wall": (_hollow, ""),
    "markers": (lambda sensor: sensor.markers, "count wall"),
    "marks": (lambda sensor: place_reference_marks(sensor.design, sensor.surface), "wall"),
    "regions": (lambda sensor: design_regions(sensor.design), "wall"),
    "heights": (check_heights, "markers"),
    "reach": (check_reach, "heights"),
    "ends": (check_ends, "markers"),
    "gaps": (check_receptor_gaps, "heights tubes"),
    "inserts": (check_inserts, "markers tubes switches"),
    "footprints": (check_footprints, "markers switches"),
    "roots": (root_depth_mm, "heights"),
    "training": (check_training, "markers"),
    "fixtures": (check_fixtures, "reach tubes"),
    "paints": (lambda sensor: check_paints(sensor.design), ""),
    "cameras": (check_cameras, "heights"),
    "sharpness": (_sharp, "cameras"),
    "rubber": (lambda sensor: rubbers_of(sensor.design), ""),
    "hardware": (lambda sensor: check_hardware(sensor.design, sensor.surface), "reach tubes"),
}
"""Rules in their order."""


def check_design(design: Design) -> Sensor:
    """Check everything that makes a design impossible to print or to see.

    Returns
    -------
    sensor : Sensor
        The design with its surface, markers and cameras.

    Raises
    ------
    DesignError
        At the first rule that the design breaks: what failed, what was got, and the fix.
    """
    sensor = Sensor(design)
    try:
        for check, _ in RULES.values():
            check(sensor)
    except DesignError as error:
        raise with_unit_hints(error, design.model_dump()) from None
    return sensor


def broken_rules(design: Design, more: Mapping[str, Rule] | None = None) -> list[PhytacError]:
    """Errors of all rules that a design breaks, but for those that follow from others.

    ``more`` rules, by name, are checked after ``RULES``.
    """
    sensor, broken = Sensor(design), set[str]()
    faults: dict[str, PhytacError] = {}
    for name, (check, needs) in (RULES | dict(more or {})).items():
        if broken & set(needs.split()):
            broken.add(name)
            continue
        try:
            check(sensor)
        except PhytacError as error:
            broken.add(name)
            # Markers or cameras that cannot be placed raise the same error in several rules.
            faults.setdefault(str(error), error)
    return list(faults.values())
