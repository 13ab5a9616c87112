"""What the search saves with few rays, coarse polygons and few cells, it loses little by."""

import numpy as np

from phytac_design.design.design_file import load_design
from phytac_design.optics.density import density_of
from phytac_design.optics.render_scene import build_scene
from phytac_design.optics.sampled_visibility import sampled_fraction
from phytac_design.rules.check import check_design
from phytac_design.study.search.fidelity_levels import DENSITY_MAP, sampled_fractions, tolerance_mm


def test_coarse_fractions_and_densities_are_near_fine_ones() -> None:
    sensor = check_design(load_design("cone"))
    (camera,) = sensor.cameras
    fine = build_scene(sensor, tolerance_mm=tolerance_mm(camera, sensor.markers))
    exact = sampled_fraction(fine, camera, rays=10**9).fraction
    errors = [
        float(np.sqrt(np.mean((sampled_fractions(sensor, coarse=coarse)[0] - exact) ** 2)))
        for coarse in (2.5, 8.0, 100.0)
    ]
    assert errors[0] < errors[1] < 0.006 < errors[2]
    many = density_of(sensor.surface, sensor.markers).local_min_per_cm2
    few = density_of(sensor.surface, sensor.markers, **DENSITY_MAP).local_min_per_cm2
    assert 0.0 < abs(few / many - 1.0) < 0.03
