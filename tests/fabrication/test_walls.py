import numpy as np
import pytest
from hypothesis import example, given, settings

import phytac_shapes
from phytac_design.design.spec import WallSection
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_facts import (
    expected_genus,
    manifold_facts,
    shell_facts,
    trimesh_facts,
)
from phytac_design.solids.solid_mesh import (
    painted_manifolds,
    shell_manifold,
    to_manifold,
    to_triangles,
)
from phytac_design.solids.wall_mesh import wall_mesh
from tests.fabrication.cases import FAMILIES, Barrel, family_design
from tests.fabrication.walls import rims_mm3, steiner_mm3
from tests.refusals import refused
from tests.test_shapes import draw, every_shape, safe_depth, seeds

VOLUME_REL = 1e-3
"""Asked of every shape at the default tolerance; coarse meshes of the tests below keep it too."""
families = pytest.mark.parametrize("name", sorted(FAMILIES))


@families
@pytest.mark.parametrize("flange", [0.0, 1.6])
def test_wall_and_rims_have_the_volume_of_their_closed_form(name: str, flange: float) -> None:
    surface = family_design(name).surface()
    for rim in (0.0, 4.0):
        wall = WallSection(rim_length_mm=rim, rim_flange_mm=flange)
        mesh = wall_mesh(surface, wall, tolerance_mm=0.01)
        closed = steiner_mm3(surface, wall.thickness_mm)
        closed += rims_mm3(surface, wall) if rim > 0.0 else 0.0
        # Far inside the 1e-3 that is asked: a rim that is missing or twisted shows.
        assert mesh.volume_mm3 == pytest.approx(closed, rel=5e-5)


@families
@pytest.mark.parametrize("tolerance", [0.1, 0.01])
def test_no_corner_and_no_facet_strays(name: str, tolerance: float) -> None:
    surface = family_design(name).surface()
    mesh = wall_mesh(surface, WallSection(rim_length_mm=0.0), tolerance_mm=tolerance)
    for points in (mesh.vertices_mm, mesh.corners_mm.mean(axis=1)):
        foot = surface.chart(points)
        (u0, u1), (v0, v1) = surface.domain
        inside = np.clip(foot, [u0, v0], [u1, v1])
        height = np.sum((points - surface.point(inside)) * surface.normal(inside), axis=1)
        # Side faces (between outer and inner) have no place but these two depths.
        on_edge = np.zeros(len(points), dtype=bool)
        for axis, end in surface.edges():
            beyond = np.abs(foot[:, axis] - surface.domain[axis, end])
            on_edge |= beyond * np.sqrt(surface.metric(inside)[:, axis, axis]) < 2.0 * tolerance
        gap = np.minimum(np.abs(height), np.abs(height + 0.8))
        assert gap[~on_edge].max(initial=0.0) <= 1.05 * tolerance


def drawn_wall(surface: phytac_shapes.Surface) -> WallSection:
    depth = min(safe_depth(surface), 0.8)
    return WallSection(thickness_mm=depth, rim_length_mm=depth, rim_flange_mm=depth / 2.0)


@every_shape
@settings(max_examples=2, deadline=None)
@given(seed=seeds)
@example(seed=5000)
def test_every_drawn_wall_is_one_closed_body(kind: str, seed: int) -> None:
    surface, _, size = draw(kind, seed)
    wall = drawn_wall(surface)
    # Faces may stray by the tolerance: of a long thin wall (seed 5000) that must be little.
    tolerance_mm = min(2e-4 * size, wall.thickness_mm / 8.0)
    mesh = wall_mesh(surface, wall, tolerance_mm=tolerance_mm)
    facts, other = manifold_facts(to_manifold(mesh)), trimesh_facts(mesh)
    tube = surface.periodic[1] and not any(surface.poles)
    assert (facts.bodies, facts.genus) == (other.bodies, other.genus) == (1, int(tube))
    assert other.watertight
    closed = steiner_mm3(surface, wall.thickness_mm) + rims_mm3(surface, wall)
    assert facts.volume_mm3 == pytest.approx(closed, rel=10 * VOLUME_REL)
    assert mesh.volume_mm3 == pytest.approx(facts.volume_mm3, rel=1e-9)


@families
def test_shell_with_receptors_is_one_body_of_the_right_genus(name: str) -> None:
    case = family_design(name)
    surface = case.surface()
    markers = make_markers(case, surface)
    solid = shell_manifold(Sensor.of(case, surface, markers), tolerance_mm=0.03)
    facts = shell_facts(solid, surface, markers)
    tube = name in {"cylinder", "cone", "cuboid", "grip"}
    assert facts.genus == markers.count + tube == expected_genus(surface, markers)
    bodies = painted_manifolds(Sensor.of(case, surface, markers), tolerance_mm=0.03)
    assert list(bodies) == ["resin", "blue", "green"]
    total = sum(body.volume() for body in bodies.values())
    assert total == pytest.approx(facts.volume_mm3, rel=1e-9)


def test_the_pole_is_one_vertex_and_no_triangle_is_degenerate() -> None:
    surface = phytac_shapes.Hemisphere(diameter_outer_mm=40.0)
    mesh = wall_mesh(surface, WallSection(), tolerance_mm=0.02)
    on_axis = np.hypot(*mesh.vertices_mm[:, :2].T) < 1e-6
    assert sorted(mesh.vertices_mm[on_axis, 2]) == pytest.approx([19.2, 20.0], abs=1e-9)
    a, b, c = np.moveaxis(mesh.corners_mm, 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-6


def test_a_sheet_has_a_mitred_frame_on_all_four_sides() -> None:
    surface = phytac_shapes.Plane(width_mm=30.0, height_mm=20.0)
    solid = to_manifold(wall_mesh(surface, WallSection(), tolerance_mm=0.01))
    low, high = np.array(solid.bounding_box()).reshape(2, 3)
    np.testing.assert_allclose(low, [-19.0, -14.0, -0.8], atol=1e-12)
    np.testing.assert_allclose(high, [19.0, 14.0, 1.6], atol=1e-12)
    closed = 30.0 * 20.0 * 0.8 + (38.0 * 28.0 - 30.0 * 20.0) * 2.4
    assert solid.volume() == pytest.approx(closed, rel=1e-12)
    # The pad itself stays free of the frame: its outer face is at 0.
    above = [v for v in to_triangles(solid).vertices_mm if v[2] > 0.1]
    assert min(max(abs(x) / 15.0, abs(y) / 10.0) for x, y, _ in above) >= 1.0 - 1e-12


def test_a_saddle_is_split_though_its_chart_lines_are_straight() -> None:
    grid = (((-20.0, -20.0, 44.0), (20.0, -20.0, 36.0)), ((-20.0, 20.0, 36.0), (20.0, 20.0, 44.0)))
    surface = phytac_shapes.Patch(points_mm=grid)
    wall = WallSection(rim_length_mm=0.0)
    mesh = wall_mesh(surface, wall, tolerance_mm=0.02)
    assert mesh.volume_mm3 == pytest.approx(steiner_mm3(surface, 0.8), rel=1e-4)
    foot = surface.chart(mesh.corners_mm.mean(axis=1))
    height = np.sum(
        (mesh.corners_mm.mean(axis=1) - surface.point(foot)) * surface.normal(foot), axis=1
    )
    inside = np.all((foot > 0.01) & (foot < 0.99), axis=1)
    assert np.minimum(abs(height), abs(height + 0.8))[inside].max() <= 0.02


def test_a_rim_that_meets_itself_is_refused() -> None:
    surface = phytac_shapes.Cone(diameter_near_mm=40.0, diameter_far_mm=4.0, length_mm=20.0)
    with refused("rim-folds"):
        wall_mesh(surface, WallSection(), tolerance_mm=0.05)
    fine = wall_mesh(surface, WallSection(rim_length_mm=0.5), tolerance_mm=0.05)
    assert fine.volume_mm3 > 0.0


def test_a_corner_too_sharp_for_its_mitre_is_refused() -> None:
    grid = (((0.0, 0.0, 40.0), (40.0, 0.0, 40.0)), ((200.0, 40.0, 40.0), (240.0, 40.0, 40.0)))
    with refused("rim-corner-too-sharp"):
        wall_mesh(phytac_shapes.Patch(points_mm=grid), WallSection(), tolerance_mm=0.05)


class Ring(Barrel):
    @property
    def periodic(self) -> tuple[bool, bool]:
        return (True, True)


class Ball(Barrel):
    @property
    def poles(self) -> tuple[bool, bool]:
        return (True, True)


@pytest.mark.parametrize("surface", [Ring(), Ball()])
def test_surfaces_without_an_opening_are_refused(surface: phytac_shapes.Surface) -> None:
    with refused("surface-topology-unsupported"):
        wall_mesh(surface, WallSection(), tolerance_mm=0.01)
