"""Every refusal of a design in one place, before anything is written or computed."""

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.hardware_assembly import check_hardware
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import cameras_of, check_bar_clearance
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
from phytac_shapes import Surface


def check_design(design: Design) -> tuple[Surface, Markers]:
    """Check everything that makes a design impossible to print or to see.

    Returns
    -------
    surface : Surface
        The sensing surface.
    markers : Markers
        The markers on it.

    Raises
    ------
    DesignError
        At the first rule that the design breaks: what is wrong, what was got, and the fix.
    """
    surface, markers = _check_geometry(design)
    check_paints(design)
    cameras = cameras_of(design, surface)
    check_cameras(Sensor.of(design, surface, markers), cameras)
    for camera in cameras:
        sharpness(design.camera, camera, surface, markers)
    check_bar_clearance(design, surface, markers)
    rubber_of(design)
    check_hardware(design, surface)
    return surface, markers


def _check_geometry(design: Design) -> tuple[Surface, Markers]:
    """Check everything that needs no camera."""
    check_sizes(design)
    surface = design.surface()
    check_wall(design, surface)
    markers = make_markers(design, surface)
    design_regions(design)
    check_heights(Sensor.of(design, surface, markers))
    check_reach(Sensor.of(design, surface, markers))
    check_ends(Sensor.of(design, surface, markers))
    check_receptor_gaps(Sensor.of(design, surface, markers))
    check_footprints(Sensor.of(design, surface, markers))
    root_depth_mm(Sensor.of(design, surface, markers))
    check_training(Sensor.of(design, surface, markers))
    check_fixtures(Sensor.of(design, surface, markers))
    return surface, markers
