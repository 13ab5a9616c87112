"""The simulated sensor's own shell: its mesh is finer than the decoder's and not nested in it."""

import numpy as np

from phytac_design.layout import make_markers
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh, plain_mesh
from phytac_design.mechanics.receptors import sensor_model, unknown_receptors
from phytac_design.mechanics.solve import ShellModel
from phytac_design.spec import Design
from shapes import Surface


def truth_shell(design: Design, surface: Surface, refine: int) -> tuple[ShellMesh, ShellModel]:
    """Mesh and linear model of the simulated sensor, blind to the markers.

    The wall has its receptors' stiffness, as the real one does, wherever that is known. On shapes
    that close around, ``refine`` elements per column around, and along the count that makes them
    about square; on others ``refine`` elements for each side of a marker's cell.
    """
    markers = make_markers(design, surface)
    wall = design.wall.thickness_mm
    if markers.lattice and surface.periodic[1] and not any(surface.poles):
        (u0, u1), (v0, v1) = surface.domain
        around = refine * markers.lattice.columns
        corner = surface.unwrap(np.array([[u0, v0], [u1, v0], [u0, v1]]))
        width = np.abs(corner[2, 0] - corner[0, 0]) / around
        along = max(round(float(np.abs(corner[1, 1] - corner[0, 1]) / width)), 2)
        mesh = chart_mesh(surface, thickness_mm=wall, n_along=along, n_around=around)
    else:
        cell = float(np.sqrt(surface.area_mm2() / markers.count))
        mesh = plain_mesh(surface, thickness_mm=wall, size_mm=cell / refine)
    return mesh, sensor_model(design, markers, mesh, receptors=not unknown_receptors(design))
