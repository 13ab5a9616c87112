"""The closed form of a dent against solutions of shells and plates, and against finite elements."""

import numpy as np
import pytest

from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.study.advice.force_precision import force_sd_N
from phytac_design.study.search.fidelity_levels import Candidate, mechanics, rules, sampled
from phytac_design.study.search.surrogate import (
    Deflection,
    Flat,
    MetricLengths,
    Wall,
    deflections_under_discs,
    predict,
    spread_out,
    tip_basis,
    wall_of,
    waves,
)
from tests.designs import changed, small
from tests.study.search.studies import tiny

MODULUS, POISSON, THICKNESS = 2200.0, 0.38, 0.8
WALL = Wall(
    bending=MODULUS * THICKNESS**3 / (12.0 * (1.0 - POISSON**2)),
    stretching=MODULUS * THICKNESS,
    thickness=THICKNESS,
)


def under_disc(
    wall: Wall, flat: Flat, x: float, y: float, radius_mm: float, count: int = 36
) -> Deflection:
    x_mm, y_mm, radii = (np.array([each]) for each in (x, y, radius_mm))
    return deflections_under_discs(wall, [flat], x_mm, y_mm, radii, count)[0]


def at_load(wall: Wall, flat: Flat, radius_mm: float, count: int) -> float:
    x, y = flat.length / 2.0, 0.0 if flat.closed else flat.girth / 2.0
    dent = under_disc(wall, flat, x, y, radius_mm, count)
    return float(dent.motion(dent.along.at(np.array([x])), np.array([y]))[0, 0])


def test_a_point_load_on_a_sphere_is_reissners() -> None:
    radius = 30.0
    flat = Flat(length=120.0, girth=120.0, closed=True, k_u=1 / radius, k_v=1 / radius)
    exact = np.sqrt(12.0 * (1.0 - POISSON**2)) * radius / (8.0 * MODULUS * THICKNESS**2)
    assert at_load(WALL, flat, 0.0, 256) == pytest.approx(exact, rel=1e-2)


@pytest.mark.parametrize(("sides", "alpha"), [(1.0, 0.0056), (2.0, 0.00722), (8.0, 0.00725)])
def test_clamped_plates_under_a_point_load_are_timoshenkos(sides: float, alpha: float) -> None:
    """w = alpha P a²/D (Theory of plates and shells, table 37); the diagonal is up to 6 % off."""
    flat = Flat(length=40.0, girth=sides * 40.0, closed=False, k_u=0.0, k_v=0.0)
    found = at_load(WALL, flat, 0.0, 200)
    assert found == pytest.approx(alpha * 40.0**2 / WALL.bending, rel=0.06)


def test_modes_of_a_clamped_beam() -> None:
    """Clamped at both ends, orthonormal, and with the frequencies of the literature."""
    modes, x = waves(2.0, closed=False, count=40), np.linspace(0.0, 2.0, 20001)
    assert np.sqrt(np.sqrt(modes.fourth[:3])) * 2.0 == pytest.approx(
        [4.73004, 7.85320, 10.99561], abs=1e-5
    )
    value, slope = modes.at(x)
    assert np.abs(value[[0, -1]]).max() < 1e-9
    assert np.abs(slope[[0, -1]]).max() < 1e-6
    ends = np.full(len(x), 1.0)
    ends[[0, -1]] = 0.5  # trapezoids
    product = value.T @ (ends[:, None] * value) * (x[1] - x[0]) / 2.0
    assert product == pytest.approx(np.eye(40), abs=1e-3)
    assert np.trapezoid(slope**2, x, axis=0) / 2.0 == pytest.approx(modes.second, rel=1e-3)


@pytest.mark.parametrize("closed", [True, False])
def test_motion_slopes_and_curvature_agree_with_differences(closed: bool) -> None:
    flat = Flat(length=50.0, girth=90.0, closed=closed, k_u=0.01, k_v=0.03)
    dent = under_disc(WALL, flat, 20.0, 0.0 if closed else 40.0, 4.0)

    def motion(x: float, y: float) -> np.ndarray:
        return dent.motion(dent.along.at(np.array([x])), np.array([y]))[0]

    step = 1e-5
    along = (motion(24.0 + step, 43.0)[0] - motion(24.0 - step, 43.0)[0]) / (2 * step)
    around = (motion(24.0, 43.0 + step)[0] - motion(24.0, 43.0 - step)[0]) / (2 * step)
    assert motion(24.0, 43.0)[1:] == pytest.approx([along, around], rel=1e-6)
    bent = [
        (motion(24.0 + step, 43.0)[1] - motion(24.0 - step, 43.0)[1]) / (2 * step),
        (motion(24.0, 43.0 + step)[2] - motion(24.0, 43.0 - step)[2]) / (2 * step),
    ]
    assert dent.curvature(24.0, 43.0) == pytest.approx(np.abs(bent).max(), rel=1e-5)


def test_curvatures_and_lengths_of_a_cone_and_a_dome() -> None:
    cone = changed("cone").surface()
    uv = np.array([[np.mean(cone.domain[0]), 1.0]])
    flat = MetricLengths(cone).at(uv)[0]
    slope = 12.0 / 90.0
    radius = 24.0  # halfway from ø60 to ø36
    assert flat.k_u == pytest.approx(0.0, abs=1e-6)
    assert flat.k_v == pytest.approx(1.0 / (radius * np.hypot(1.0, slope)), rel=1e-3)
    assert flat.length == pytest.approx(np.hypot(90.0, 12.0), rel=1e-6)
    assert flat.closed
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
    dent = under_disc(WALL, unrolled.at(place[None])[0], float(x[0]), 0.0, 5.0)
    found = float(dent.motion(dent.along.at(x), np.zeros(1))[0, 0])
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
    shell = model.solve(load).motion[mesh.marker_nodes][..., 0]
    tips = shell[:, :3] + np.cross(shell[:, 3:], markers.tip_mm - markers.mid_mm)
    unrolled, place = MetricLengths(surface), markers.uv[middle]
    here = float(unrolled.x_mm(place[None])[0])
    dent = under_disc(WALL, unrolled.at(place[None])[0], here, 0.0, 5.0)
    along = dent.along.at(unrolled.x_mm(markers.uv))
    motion = dent.motion(along, unrolled.y_mm(markers.uv, place))
    found = np.einsum("nij,nj->ni", tip_basis(sensor), motion)
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


@pytest.mark.parametrize("name", ["plane", "cuboid"])
def test_flat_walls_are_as_stiff_as_by_finite_elements(name: str) -> None:
    """Within a factor of 1.7; before edges were clamped and counted they were 3 to 9 times off."""
    design = changed(name)
    sensor = Candidate(design, tiny()).sensor
    seen = np.ones(sensor.markers.count, dtype=bool)
    found = float(np.median(predict(sensor, sensor.cameras, seen).bound.force_N))
    exact = force_sd_N(design)
    assert exact / 1.7 < found < 1.7 * exact


def test_receptors_change_the_wall() -> None:
    """Tubes stiffen its bending and holes weaken its stretching; unknown ones change nothing."""
    design = changed("plane")
    sensor = Candidate(design, tiny()).sensor
    found = wall_of(design, sensor.markers, sensor.surface.area_mm2())
    assert found.bending > 1.05 * WALL.bending
    assert found.stretching < 0.95 * WALL.stretching
    thick = changed("plane", wall={"thickness_mm": 3.0})
    bare = wall_of(thick, sensor.markers, sensor.surface.area_mm2())
    assert bare.stretching == pytest.approx(MODULUS * 3.0)


def test_glued_inserts_stiffen_the_wall() -> None:
    """Their tubes are wider than painted ones."""
    bending = []
    for colouring in ("paint", "insert"):
        sensor = Sensor(changed("cylinder60", receptor={"colouring": colouring}))
        wall = wall_of(sensor.design, sensor.markers, sensor.surface.area_mm2())
        bending.append(wall.bending)
    assert bending[1] > 1.05 * bending[0]


def test_places_of_the_bound_are_even_along_and_vary_across() -> None:
    x, v = (each.ravel() for each in np.meshgrid(np.arange(10.0), np.arange(13.0), indexing="ij"))
    chosen = spread_out(x, v, 5)
    assert np.all(np.diff(x[chosen]) > 0.0)
    assert len(set(v[chosen])) >= 4
    assert list(spread_out(x[:3], v[:3], 5)) == [0, 1, 2]
