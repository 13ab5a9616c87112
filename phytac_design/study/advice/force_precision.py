"""How well the largest force is read at best: the linear shell of a draft build, without pictures.

A Cramér-Rao bound as in the stage ``resolution``, where every marker is taken as seen, at some of
the receptors. The closed form of studies is faster, and up to five times off beside rims and on
flat sides.
"""

import numpy as np

from phytac_decoder.camera.camera import stack_views
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.spec import Design
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.rules.check import check_design
from phytac_design.simulation.cramer_rao import cell_prior, contact_signals
from phytac_design.simulation.linear_response import motion_responses
from phytac_shapes.arrays import FloatArray


def force_sd_N(design: Design, *, receptors: int = 12) -> float:
    """Smallest standard deviation of the largest force, N: the median over some receptors.

    Parameters
    ----------
    receptors : int
        Number of receptors at most, evenly from the near end to the far one.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    """
    sensor, settings, training = check_design(design), PRESETS["draft"], design.training
    surface, markers = sensor.surface, sensor.markers
    mesh = marker_mesh(
        surface, markers, thickness_mm=design.wall.thickness_mm, refine=settings.refine
    )
    with_receptors = settings.receptors and not unknown_receptors(design)
    model = sensor_model(design, markers, mesh, receptors=with_receptors)
    slopes = np.nan_to_num(stack_views(sensor.cameras, markers.tip_mm))
    arm = markers.tip_mm - markers.mid_mm

    def shifts(uv: FloatArray, radius_mm: FloatArray) -> FloatArray:
        motion = motion_responses(model, mesh, surface, markers, uv=uv, radius_mm=radius_mm)
        tips = motion[..., :3] + np.cross(motion[..., 3:], arm)
        return np.asarray(np.einsum("nij,cnj->cni", slopes, tips))

    order = np.argsort(surface.unwrap(markers.uv)[:, 1], kind="stable")
    place = (np.arange(receptors) + 0.5) / receptors * markers.count
    chosen = np.unique(order[place.astype(int)])
    radius_mm = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    signals = contact_signals(surface, shifts, uv=markers.uv[chosen], radius_mm=radius_mm)
    prior = cell_prior(
        surface.area_mm2(),
        markers.count,
        training.patch_radius_min_mm,
        training.patch_radius_max_mm,
    )
    noise_px = design.camera.noise_centroid_px
    bound = signals.bound(training.force_max_N, noise_px=noise_px, prior=prior)
    return float(np.median(bound.force_N))
