"""The closed form of a dent against solutions of shells and plates, and against finite elements."""

import numpy as np
import pytest

from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.study.search.fidelity_levels import Candidate, mechanics, rules, sampled
from phytac_design.study.search.surrogate import (
    Flat,
    MetricLengths,
    Wall,
    deflection_under_disc,
    tip_basis,
    waves_along,
)
from tests.designs import changed, small
from tests.study.search.studies import tiny

WALL = Wall(thickness=0.8, modulus=2200.0, poisson=0.38)


def at_load(wall: Wall, flat: Flat, radius_mm: float, waves: int) -> float:
    dent = deflection_under_disc(wall, flat, flat.length / 2.0, radius_mm, waves)
    along = waves_along(flat.length, np.array([flat.length / 2.0]), waves)
    return float(dent.motion(along, np.zeros(1))[0, 0])


def test_a_point_load_on_a_sphere_is_reissners() -> None:
    radius = 30.0
    flat = Flat(length=120.0, girth=120.0, closed=True, k_u=1 / radius, k_v=1 / radius)
    exact = np.sqrt(12.0 * (1.0 - WALL.poisson**2)) * radius
    exact /= 8.0 * WALL.modulus * WALL.thickness**2
    assert at_load(WALL, flat, 0.0, 256) == pytest.approx(exact, rel=2e-3)


def test_a_square_plate_under_a_point_load_is_naviers() -> None:
    side = 40.0
    # Of twice the width it closes, so that a row of plates stands side by side: the middle of a
    # wide one, alpha = 0.01695 for a strip (Timoshenko, table 23, b/a = inf).
    flat = Flat(length=side, girth=8.0 * side, closed=False, k_u=0.0, k_v=0.0)
    assert at_load(WALL, flat, 0.0, 512) == pytest.approx(
        0.01695 * side**2 / WALL.stiffness, rel=5e-3
    )


def test_motion_and_slopes_agree_with_differences() -> None:
    flat = Flat(length=50.0, girth=90.0, closed=True, k_u=0.01, k_v=0.03)
    dent = deflection_under_disc(WALL, flat, 20.0, 4.0)

    def motion(x: float, y: float) -> np.ndarray:
        return dent.motion(waves_along(50.0, np.array([x])), np.array([y]))[0]

    step = 1e-5
    along = (motion(24.0 + step, 3.0)[0] - motion(24.0 - step, 3.0)[0]) / (2 * step)
    around = (motion(24.0, 3.0 + step)[0] - motion(24.0, 3.0 - step)[0]) / (2 * step)
    assert motion(24.0, 3.0)[1:] == pytest.approx([along, around], rel=1e-6)


def test_curvatures_and_lengths_of_a_cone_and_a_dome() -> None:
    cone = changed("cone").surface()
    uv = np.array([[np.mean(cone.domain[0]), 1.0]])
    flat = MetricLengths(cone).at(uv)[0]
    slope = 12.0 / 90.0
    radius = 24.0  # halfway from ø60 to ø36
    assert flat.k_u == pytest.approx(0.0, abs=1e-6)
    assert flat.k_v == pytest.approx(1.0 / (radius * np.hypot(1.0, slope)), rel=1e-3)
    assert flat.length == pytest.approx(np.hypot(90.0, 12.0), rel=1e-6)
    dome = changed("hemisphere").surface()
    middle = np.array([np.mean(dome.domain[0]), 1.0])
    found = MetricLengths(dome).at(middle[None])[0]
    assert (found.k_u, found.k_v) == pytest.approx((0.05, 0.05), rel=1e-4)


def test_a_deflection_under_disc_the_cylinder_is_near_finite_elements() -> None:
    design = small()
    candidate = Candidate(design, tiny())
    surface, markers = candidate.sensor.surface, candidate.sensor.markers
    mesh = marker_mesh(surface, markers, thickness_mm=design.wall.thickness_mm, refine=4)
    model = sensor_model(design, markers, mesh, receptors=False)
    middle = int(np.argmin(np.abs(markers.mid_mm[:, 2] - 30.0)))
    load = patch_loads(mesh, surface, markers.uv[[middle]], 5.0).toarray()
    motion = model.solve(load).motion[mesh.marker_nodes][middle, :3, 0]
    exact = -float(motion @ markers.normal[middle])
    unrolled = MetricLengths(surface)
    place = markers.uv[middle]
    x = unrolled.x_mm(place[None])
    dent = deflection_under_disc(WALL, unrolled.at(place[None])[0], float(x[0]), 5.0)
    along = waves_along(float(unrolled.along[-1]), x)
    found = float(dent.motion(along, np.zeros(1))[0, 0])
    assert found == pytest.approx(exact, rel=0.25)


def test_tips_lean_as_in_finite_elements() -> None:
    """Away from where the wall moves in farther: a sign that makes them lean towards it fails."""
    design = small()
    sensor = Candidate(design, tiny()).sensor
    surface, markers = sensor.surface, sensor.markers
    mesh = marker_mesh(surface, markers, thickness_mm=design.wall.thickness_mm, refine=4)
    model = sensor_model(design, markers, mesh, receptors=False)
    middle = int(np.argmin(np.abs(markers.mid_mm[:, 2] - 30.0)))
    load = patch_loads(mesh, surface, markers.uv[[middle]], 5.0).toarray()
    motion = model.solve(load).motion[mesh.marker_nodes][..., 0]
    tips = motion[:, :3] + np.cross(motion[:, 3:], markers.tip_mm - markers.mid_mm)
    unrolled, place = MetricLengths(surface), markers.uv[middle]
    here = float(unrolled.x_mm(place[None])[0])
    dent = deflection_under_disc(WALL, unrolled.at(place[None])[0], here, 5.0)
    along = waves_along(float(unrolled.along[-1]), unrolled.x_mm(markers.uv))
    waves = dent.motion(along, unrolled.y_mm(markers.uv, place))
    found = np.einsum("nij,nj->ni", tip_basis(sensor), waves)
    tangents = surface.tangents(markers.uv)
    for axis in range(2):
        unit = tangents[:, axis] / np.linalg.norm(tangents[:, axis], axis=1, keepdims=True)
        own, exact = (np.sum(one * unit, axis=1) for one in (found, tips))
        assert np.corrcoef(own, exact)[0, 1] > 0.9


def test_it_puts_walls_in_the_order_of_finite_elements() -> None:
    order = []
    few = {"rows": 6, "columns": 10, "height_far_mm": 4.0}
    camera = {"width_px": 648, "height_px": 486, "focal_px": 242.5}
    for thickness in (0.6, 1.4):
        design = small(wall={"thickness_mm": thickness}, layout=few, camera=camera)
        candidate = Candidate(design, tiny())
        rules(candidate)
        cheap, dear = sampled(candidate), mechanics(candidate)
        order.append((cheap["surrogate_force_sd_N"], dear["force_sd_N"]))
        assert cheap["surrogate_force_sd_N"] == pytest.approx(dear["force_sd_N"], rel=0.6)
    assert order == sorted(order)
    assert [dear for _, dear in order] == sorted(dear for _, dear in order)
