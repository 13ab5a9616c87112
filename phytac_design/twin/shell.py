"""The simulated sensor's own mesh: finer than the decoder's and not nested in it."""

import numpy as np

from phytac_design.mechanics.mesh import ShellMesh, chart_mesh
from phytac_design.mechanics.solve import ShellModel, clamped_model
from phytac_design.spec import Design
from shapes import Surface


def truth_shell(design: Design, surface: Surface, refine: int) -> tuple[ShellMesh, ShellModel]:
    """Mesh and linear model of the simulated sensor; equally spaced, blind to the markers.

    ``refine`` elements per column around; along, the count that makes elements about square.
    """
    (u0, u1), (v0, v1) = surface.domain
    around = refine * design.layout.columns
    corner = surface.unwrap(np.array([[u0, v0], [u1, v0], [u0, v1]]))
    width = np.abs(corner[2, 0] - corner[0, 0]) / around
    along = max(round(float(np.abs(corner[1, 1] - corner[0, 1]) / width)), 2)
    mesh = chart_mesh(
        surface, thickness_mm=design.wall.thickness_mm, n_along=along, n_around=around
    )
    model = clamped_model(
        mesh, modulus_MPa=design.material.modulus_MPa, poisson=design.material.poisson
    )
    return mesh, model
