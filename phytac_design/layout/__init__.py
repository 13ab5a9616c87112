"""Where the markers sit: receptors on a surface, the single source for every stage."""

from phytac_design.layout.heights import profile_heights_mm
from phytac_design.layout.lattice import lattice_neighbours, make_lattice
from phytac_design.layout.line_of_sight import clearance_mm, sight_heights_mm
from phytac_design.layout.marker_layout import make_markers, with_heights
from phytac_design.layout.markers import NEIGHBOUR_STEPS, Lattice, Markers

__all__ = [
    "NEIGHBOUR_STEPS",
    "Lattice",
    "Markers",
    "clearance_mm",
    "lattice_neighbours",
    "make_lattice",
    "make_markers",
    "profile_heights_mm",
    "sight_heights_mm",
    "with_heights",
]
