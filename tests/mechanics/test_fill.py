"""The factor keeps the fill that minimum degree finds on the full 6 × 6 blocks."""

import numpy as np

from phytac_design.layout import make_markers
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.solve import clamped_model
from tests.designs import small


def test_scaling_keeps_the_block_structure() -> None:
    """Dropping the zeros inside blocks doubles the fill and more than triples the time."""
    design = small()
    surface = design.surface()
    markers = make_markers(design, surface)
    mesh = marker_mesh(surface, markers, thickness_mm=0.8, refine=4)
    model = clamped_model(mesh, modulus_MPa=2200.0, poisson=0.38)
    scaled = model.factor.scaled
    free = np.flatnonzero(~model.fixed.ravel())
    assert scaled.nnz == model.stiffness[free][:, free].nnz
    assert np.allclose(scaled.diagonal(), 1.0)
    assert abs(scaled - scaled.T).max() < 1e-12
    assert model.factor.backend.L.nnz < 120 * len(free)
