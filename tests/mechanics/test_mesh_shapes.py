"""Meshes of every family: they close, markers anywhere are nodes, bodies are free or held."""

import numpy as np
import pytest

from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.mechanics.meshing.mesh import (
    SETTINGS,
    ShellMesh,
    chart_mesh,
    marker_mesh,
    node_mesh,
    plain_mesh,
)
from phytac_design.mechanics.meshing.quad_grid import EDGE_NAMES, place
from phytac_design.mechanics.shell.compliance import column_turn
from phytac_design.mechanics.shell.shell_element import element_stiffness
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.shell.sparse_assembly import assemble, make_pattern
from phytac_shapes import Cuboid, Hemisphere, Surface
from tests.mechanics.families import DOMES, FAMILIES, WALL_MM, golden
from tests.refusals import refused
from verification.shells import rigid_modes

every_family = pytest.mark.parametrize("name", FAMILIES)


def check_sound(surface: Surface, mesh: ShellMesh) -> None:
    """Nodes on the middle face, a closed manifold but for the open edges, facing outward."""
    np.testing.assert_allclose(mesh.nodes_mm, surface.point(mesh.uv, -WALL_MM / 2.0), atol=1e-12)
    np.testing.assert_allclose(mesh.normals, surface.normal(mesh.uv), atol=1e-12)
    ends = np.sort(np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], -1), axis=2)
    edges, uses = np.unique(ends.reshape(-1, 2), axis=0, return_counts=True)
    assert set(uses) == {1, 2}
    closed = surface.periodic[1] and not any(surface.poles)
    assert len(mesh.nodes_mm) - len(edges) + len(mesh.quads) == (0 if closed else 1)
    np.testing.assert_array_equal(np.unique(edges[uses == 1]), mesh.sets["CLAMPED"])
    np.testing.assert_array_equal(mesh.clamped, mesh.sets["CLAMPED"])
    for axis, end in surface.edges():
        rim = mesh.sets[EDGE_NAMES[axis, end]]
        assert np.ptp(mesh.uv[rim, axis]) == 0.0
        assert mesh.uv[rim[0], axis] == surface.domain[axis, end]
    # No two nodes in one place: poles and seams are shared, not doubled.
    side = np.linalg.norm(np.diff(mesh.nodes_mm[edges], axis=1), axis=2)
    assert len(np.unique(np.round(mesh.nodes_mm / (0.2 * side.min())), axis=0)) == len(mesh.uv)
    assert mesh.scaled_jacobian().min() >= SETTINGS.min_scaled_jacobian


@every_family
def test_plain_meshes_close_with_even_elements(name: str) -> None:
    surface = FAMILIES[name]
    mesh = plain_mesh(surface, thickness_mm=WALL_MM, size_mm=4.0)
    check_sound(surface, mesh)
    assert mesh.scaled_jacobian().min() > 0.8
    corner = mesh.nodes_mm[mesh.quads]
    side = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2)
    assert 2.0 < np.median(side) < 4.5
    assert side.max() < (7.0 if name in DOMES else 4.001)
    cross = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    area = 0.5 * np.linalg.norm(cross, axis=1).sum()
    assert area == pytest.approx(surface.area_mm2(-WALL_MM / 2.0), rel=0.01)
    # Next to a clamped edge elements are short.
    at_rim = np.isin(mesh.quads, mesh.clamped)
    assert side[at_rim.sum(axis=1) >= 2].min(axis=1).max() < 0.75 * 4.0


@every_family
@pytest.mark.parametrize("count", [1, 60])
def test_markers_anywhere_are_nodes(name: str, count: int) -> None:
    surface = FAMILIES[name]
    uv = golden(surface, count)
    mesh = node_mesh(surface, uv, thickness_mm=WALL_MM, size_mm=4.0)
    check_sound(surface, mesh)
    wanted = surface.point(uv, -WALL_MM / 2.0)
    assert np.abs(mesh.nodes_mm[mesh.marker_nodes] - wanted).max() < 1e-9
    assert len(np.unique(mesh.marker_nodes)) == count
    np.testing.assert_array_equal(mesh.sets["MARKERS"], np.sort(mesh.marker_nodes))


def test_a_marker_on_the_pole_and_markers_on_rims() -> None:
    for name in DOMES:
        surface = FAMILIES[name]
        uv = golden(surface, 40)
        uv[-1] = [surface.domain[0, 1], 2.0]
        uv[0] = [0.0, 1.234]
        mesh = node_mesh(surface, uv, thickness_mm=WALL_MM, size_mm=4.0)
        check_sound(surface, mesh)
        pole = mesh.nodes_mm[mesh.marker_nodes[-1]]
        assert np.hypot(*pole[:2]) < 1e-12
        assert pole[2] == mesh.nodes_mm[:, 2].max()
        assert mesh.marker_nodes[0] in mesh.sets["BOTTOM"]
        uv[0] = [0.3, 1.234]
        check_sound(surface, node_mesh(surface, uv, thickness_mm=WALL_MM, size_mm=4.0))
    plane = FAMILIES["plane"]
    corner = np.array([[-30.0, -40.0], [30.0, 3.3], [0.7, 40.0], [5.0, 5.0]])
    check_sound(plane, node_mesh(plane, corner, thickness_mm=WALL_MM, size_mm=4.0))


def test_a_marker_beside_a_rim_takes_the_rim_along() -> None:
    plane = FAMILIES["plane"]
    plain = plain_mesh(plane, thickness_mm=WALL_MM, size_mm=4.0)
    rim = np.sort(plain.uv[plain.sets["TOP"], 1])
    beside = np.array([[29.5, 0.52 * rim[9] + 0.48 * rim[10]], [3.3, 5.1], [-9.7, 14.2]])
    mesh = node_mesh(plane, beside, thickness_mm=WALL_MM, size_mm=4.0)
    assert len(mesh.quads) == len(plain.quads)  # no finer mesh was needed
    assert mesh.scaled_jacobian().min() > 0.6
    corners = np.abs(mesh.uv) @ np.array([1.0, 1.0]) == 70.0
    assert corners.sum() == 4


def test_two_thousand_markers_on_a_dome() -> None:
    surface = FAMILIES["hemisphere"]
    uv = golden(surface, 2000, margin=0.01)
    mesh = node_mesh(surface, uv, thickness_mm=WALL_MM, size_mm=1.0)
    check_sound(surface, mesh)
    assert len(np.unique(mesh.marker_nodes)) == 2000


@pytest.mark.parametrize("gap_mm", [1e-9, 0.02])
def test_markers_too_close_are_refused_by_name(gap_mm: float) -> None:
    surface = FAMILIES["hemisphere"]
    uv = golden(surface, 30)
    uv[7] = uv[19] + [gap_mm, 0.0]
    with refused("mesh-quality-too-low"):
        node_mesh(surface, uv, thickness_mm=WALL_MM, size_mm=6.0)


def test_marker_mesh_refuses_what_is_too_coarse() -> None:
    shape = {"kind": "hemisphere", "diameter_outer_mm": 60.0}
    design = Design.model_validate({"name": "x", "shape": shape, "layout": {"rows": 3}})
    surface = design.surface()
    with refused("mesh-refine-invalid"):
        marker_mesh(surface, make_markers(design, surface), thickness_mm=WALL_MM, refine=0)
    with refused("mesh-size-not-positive"):
        plain_mesh(surface, thickness_mm=WALL_MM, size_mm=0.0)
    with refused("mesh-pole-unsupported"):
        chart_mesh(surface, thickness_mm=WALL_MM, n_along=4, n_around=8)


@pytest.mark.parametrize("name", ["capped", "hemisphere", "plane", "cuboid", "sharp", "patch"])
def test_marker_meshes_of_straight_layouts(name: str) -> None:
    surface = FAMILIES[name]
    shape = {
        key: getattr(surface, key) for key in type(surface).__dataclass_fields__ if key != "name"
    } | {"kind": surface.name}
    layout = {"kind": "straight", "rows": 5, "columns": 8}
    design = Design.model_validate({"name": "x", "shape": shape, "layout": layout})
    markers = make_markers(design, surface)
    meshes = [marker_mesh(surface, markers, thickness_mm=WALL_MM, refine=k) for k in (2, 4)]
    for mesh in meshes:
        check_sound(surface, mesh)
        np.testing.assert_allclose(mesh.nodes_mm[mesh.marker_nodes], markers.mid_mm, atol=1e-9)
    assert len(meshes[1].quads) > 1.4 * len(meshes[0].quads)
    if name in ("plane", "patch"):
        # Rows and columns of a sheet are lines of the mesh: nothing had to move.
        plain = meshes[1].scaled_jacobian().min()
        assert plain > 0.99


def test_edges_of_a_box_are_resolved_however_sharp() -> None:
    for radius in (0.5, 2.0, 12.0):
        box = Cuboid(width_mm=50.0, depth_mm=40.0, length_mm=30.0, edge_radius_mm=radius)
        mesh = plain_mesh(box, thickness_mm=WALL_MM / 2.0, size_mm=5.0)
        normal = mesh.normals[mesh.quads]
        turn = np.degrees(np.arccos(np.clip(np.sum(normal[:, 0] * normal[:, 1], axis=1), -1, 1)))
        assert turn.max() < 23.0


def test_spacing_follows_the_wanted_size_and_meets_stops() -> None:
    x = np.linspace(0.0, 10.0, 401)
    out = place(x, 0.1 + 0.2 * x, np.array([3.0, 7.5]))
    assert {3.0, 7.5} <= set(out)
    assert out[0] == 0.0
    assert out[-1] == 10.0
    step = np.diff(out)
    assert np.all(step <= 1.1 * (0.1 + 0.2 * out[1:]))
    assert np.all(step > 0.4 * (0.1 + 0.2 * out[:-1]))


@pytest.mark.parametrize("name", ["capped", "hemisphere", "plane", "cuboid", "patch"])
def test_unsupported_meshes_have_six_zero_energy_modes(name: str) -> None:
    surface = FAMILIES[name]
    uv = golden(surface, 5, margin=0.2)
    mesh = node_mesh(surface, uv, thickness_mm=WALL_MM, size_mm=15.0)
    element = element_stiffness(mesh.nodes_mm, mesh.quads, mesh.normals, poisson=0.38)
    K = assemble(
        make_pattern(mesh.quads, len(mesh.nodes_mm)),
        element.combine(modulus_MPa=2200.0, thickness_mm=3.0),
    ).toarray()
    scale = 1.0 / np.sqrt(np.diag(K))
    values = np.linalg.eigvalsh(scale[:, None] * K * scale)
    assert np.all(np.abs(values[:6]) < 1e-12)
    assert values[6] > 1e-8
    modes = rigid_modes(mesh.nodes_mm).reshape(len(K), 6)
    assert np.abs(K @ modes).max() < 1e-10 * np.abs(K).max() * np.abs(modes).max()


def test_domes_are_no_turned_copies_of_themselves() -> None:
    surface = FAMILIES["hemisphere"]
    mesh = node_mesh(surface, golden(surface, 16), thickness_mm=WALL_MM, size_mm=5.0)
    fixed = np.zeros((len(mesh.nodes_mm), 6), dtype=np.bool_)
    fixed[mesh.clamped] = True
    model = ShellModel(
        mesh.nodes_mm,
        mesh.quads,
        mesh.normals,
        thickness_mm=WALL_MM,
        modulus_MPa=2200.0,
        poisson=0.38,
        fixed=fixed,
    )
    assert mesh.around is None
    assert column_turn(model, mesh, 8) is None


def test_a_surface_with_two_poles_is_refused() -> None:
    class Ball(Hemisphere):
        poles = (True, True)

    with refused("mesh-pole-missing"):
        plain_mesh(Ball(diameter_outer_mm=9.0), thickness_mm=0.5, size_mm=1.0)
