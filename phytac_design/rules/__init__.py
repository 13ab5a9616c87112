"""Whether a design can be built at all: cheap checks made before any solid, mesh or picture.

Every check is a function that returns nothing or raises one :class:`DesignError` which says what
fails, by how much, and what mends it. Rows and columns are counted from 0, row 0 nearest the
camera. Cameras are checked in ``phytac_design.optics``.
"""

from phytac_shapes import Surface

from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.rules.bodies import check_cameras, check_fixtures
from phytac_design.rules.clearance import check_heights, check_reach, check_wall
from phytac_design.rules.receptor_spacing import check_ends, check_footprints, check_receptor_gaps
from phytac_design.rules.sizes import MARKERS_MAX, check_sizes, check_training
from phytac_design.solids.receptor_tubes import root_depth_mm


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
    check_training(design, surface, markers)
    check_fixtures(design, surface, markers)
    return surface, markers


__all__ = ["MARKERS_MAX", "check_cameras", "check_design"]
