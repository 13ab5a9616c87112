"""All rules of a design in one place, checked before anything is computed or written."""

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.hardware_assembly import check_hardware
from phytac_design.layout.mark_placement import place_reference_marks
from phytac_design.layout.region_chart import design_regions
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.switch.switch_inputs import rubber_of
from phytac_design.optics.separability import check_paints
from phytac_design.optics.sharpness import sharpness
from phytac_design.rules.body_rules import check_cameras, check_fixtures
from phytac_design.rules.clearance import check_heights, check_reach, check_wall
from phytac_design.rules.receptor_spacing import check_ends, check_footprints, check_receptor_gaps
from phytac_design.rules.sizes import check_sizes, check_training
from phytac_design.solids.receptor_tubes import root_depth_mm


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
    check_sizes(design)
    check_wall(design, sensor.surface)
    markers = sensor.markers
    place_reference_marks(design, sensor.surface)
    design_regions(design)
    check_heights(sensor)
    check_reach(sensor)
    check_ends(sensor)
    check_receptor_gaps(sensor)
    check_footprints(sensor)
    root_depth_mm(sensor)
    check_training(sensor)
    check_fixtures(sensor)
    check_paints(design)
    check_cameras(sensor)
    for camera in sensor.cameras:
        sharpness(design.camera, camera, sensor.surface, markers)
    rubber_of(design)
    check_hardware(design, sensor.surface)
    return sensor
