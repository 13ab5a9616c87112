"""A first look on a coarse mesh, before anything is planned: how far linear theory is off."""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.mechanics.large.linear_error import LINEAR_ERROR_SAFETY, check_linear
from phytac_design.mechanics.meshing.mesh import marker_size_mm, plain_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.simulation.scene_scope import Scope
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

REFINE = 2
"""Elements per marker pitch of the pilot's mesh."""
PRESSES = 3


def linear_error(design: Design, surface: Surface, markers: Markers, scope: Scope | None) -> float:
    """Error of linear theory at the greatest force, over the greatest motion, with its safety.

    Of the worst of a few presses: in the middle of each region, or of the whole surface, where the
    wall is softest. Takes less than a second.
    """
    mesh = plain_mesh(
        surface,
        thickness_mm=design.wall.thickness_mm,
        size_mm=marker_size_mm(surface, markers.count, REFINE),
    )
    model = sensor_model(design, markers, mesh, receptors=not unknown_receptors(design))
    training = design.training
    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    places = _middles(surface, scope)[:PRESSES]
    loads = training.force_max_N * patch_loads(mesh, surface, places, radius).toarray()
    errors = [check_linear(model, loads[:, k]).error for k in range(len(places))]
    return LINEAR_ERROR_SAFETY * float(max(errors))


def _middles(surface: Surface, scope: Scope | None) -> FloatArray:
    """Middle (k, 2) of every region; of the whole surface without."""
    if scope is None:
        return np.asarray(surface.domain.mean(axis=1))[None]
    middle = [window.at(np.array([[0.5, 0.5]]))[0] for window in scope.windows]
    return np.asarray(middle)
