"""How far linear theory is off at a design's largest force, from a press on a coarse mesh."""

import numpy as np

from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.large.quasi_newton import LINEAR_ERROR_SAFETY, QuasiNewtonSolver
from phytac_design.mechanics.meshing.mesh import marker_size_mm, plain_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.simulation.scenario.scene_scope import Scope

NEARLY_LINEAR = 0.3
"""Error of linear theory up to which a wall is taken as nearly linear, and as one that does not
snap: at a limit point the expansion is off by more."""


def linear_error(sensor: Sensor, scope: Scope | None) -> float:
    """Error of linear theory at the largest force, over the largest motion, with its safety factor.

    The worst of up to three presses on a coarse mesh: in the middle of each region, or of the whole
    surface, where the wall is softest. Takes less than a second.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    mesh = plain_mesh(
        surface,
        thickness_mm=design.wall.thickness_mm,
        size_mm=marker_size_mm(surface, markers.count, refine=2),
    )
    model = sensor_model(design, markers, mesh, receptors=not unknown_receptors(design))
    training = design.training
    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    if scope is None:
        places = surface.domain.mean(axis=1)[None]
    else:
        places = np.array([window.at(np.array([[0.5, 0.5]]))[0] for window in scope.windows[:3]])
    loads = training.force_max_N * patch_loads(mesh, surface, places, radius).toarray()
    shell = QuasiNewtonSolver(model)
    errors = [shell.expand(loads[:, k]).error for k in range(len(places))]
    return LINEAR_ERROR_SAFETY * float(max(errors))
