"""Every refusal of a design in one place, before anything is written or computed."""

from phytac_shapes import Surface

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.assembly import check_hardware
from phytac_design.layout import Markers
from phytac_design.layout.cameras import cameras_of, refuse_swallowed
from phytac_design.mechanics.switch.receptor import rubber_of
from phytac_design.optics.separability import check_paints
from phytac_design.optics.sharpness import sharpness
from phytac_design.rules import check_cameras
from phytac_design.rules import check_design as check_rules


def check_design(design: Design) -> tuple[Surface, Markers]:
    """Surface and markers of a design that can be printed and seen at all.

    Raises
    ------
    DesignError
        With what is wrong, what was got, and what would mend it.
    """
    surface, markers = check_rules(design)
    check_paints(design)
    cameras = cameras_of(design, surface)
    check_cameras(design, surface, markers, cameras)
    for camera in cameras:
        sharpness(design.camera, camera, surface, markers)
    refuse_swallowed(design, surface, markers)
    rubber_of(design)
    check_hardware(design, surface)
    return surface, markers
