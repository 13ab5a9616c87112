"""The simulated sensor's own mesh: finer than the decoder's and not nested in it."""

from phytac_design.accuracy import Accuracy
from phytac_design.mechanics.mesh import ShellMesh, chart_mesh
from phytac_design.mechanics.solve import ShellModel, clamped_model
from phytac_design.spec import Design
from shapes import Surface


def truth_shell(
    design: Design, surface: Surface, accuracy: Accuracy
) -> tuple[ShellMesh, ShellModel]:
    """Mesh and linear model of the simulated sensor; equally spaced, blind to the markers."""
    mesh = chart_mesh(
        surface,
        thickness_mm=design.wall.thickness_mm,
        n_along=accuracy.truth_along,
        n_around=accuracy.truth_around,
    )
    model = clamped_model(
        mesh, modulus_MPa=design.material.modulus_MPa, poisson=design.material.poisson
    )
    return mesh, model
