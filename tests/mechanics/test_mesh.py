"""Meshes: markers are nodes, elements are sound, whatever the lattice."""

from typing import Any

import numpy as np
import pytest

from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.mechanics.meshing.locate import _inverse_bilinear, locate
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh, marker_mesh
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.cylinder import Cylinder
from tests.refusals import refused

SHAPE = {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 120.0}


def build(refine: int, **layout: Any) -> tuple[Surface, Markers, ShellMesh]:
    design = Design.model_validate({"name": "x", "shape": SHAPE, "layout": layout})
    surface = design.surface()
    markers = make_markers(design, surface)
    return surface, markers, marker_mesh(surface, markers, thickness_mm=0.8, refine=refine)


LAYOUTS = [
    {},
    {"kind": "straight"},
    {"rows": 1},
    {"rows": 2, "columns": 3, "spiral_angle_deg": -77.0},
    {"rows": 60, "columns": 20, "spiral_angle_deg": 14.0},
]


@pytest.mark.parametrize("refine", [1, 3, 4])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_marker_is_a_node_of_a_sound_mesh(layout: dict[str, Any], refine: int) -> None:
    _, markers, mesh = build(refine, **layout)
    np.testing.assert_allclose(mesh.nodes_mm[mesh.marker_nodes], markers.mid_mm, atol=1e-9)
    assert len(np.unique(mesh.marker_nodes)) == markers.count
    # A closed band of quads: V - E + F = 0, every rim node on two elements, inner ones on four.
    edges = np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], -1).reshape(-1, 2)
    assert len(mesh.nodes_mm) - len(np.unique(np.sort(edges), axis=0)) + len(mesh.quads) == 0
    uses = np.bincount(mesh.quads.ravel(), minlength=len(mesh.nodes_mm))
    rim = np.concatenate([mesh.sets["TOP"], mesh.sets["BOTTOM"]])
    assert set(uses[rim]) == {2}
    assert set(np.delete(uses, rim)) <= {4}
    assert np.ptp(mesh.nodes_mm[mesh.sets["BOTTOM"], 2]) == 0.0
    assert mesh.nodes_mm[mesh.sets["TOP"], 2] == pytest.approx(120.0)
    # Elements face outward and no element leans by more than half its width.
    corner = mesh.nodes_mm[mesh.quads]
    facing = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    out = mesh.normals[mesh.quads].mean(axis=1)
    assert np.all(np.sum(facing * out, axis=1) > 0.4 * np.linalg.norm(facing, axis=1))
    angle = np.arctan2(corner[..., 1], corner[..., 0])
    lean = np.angle(np.exp(1j * (angle[:, 3] - angle[:, 0])))
    width = np.abs(np.angle(np.exp(1j * (angle[:, 1] - angle[:, 0]))))
    assert np.all(np.abs(lean) <= 0.5 * width + 1e-9)


def test_elements_are_about_square_and_half_as_long_at_the_rims() -> None:
    _, _, mesh = build(4)
    corner = mesh.nodes_mm[mesh.quads]
    width = np.linalg.norm(corner[:, 1] - corner[:, 0], axis=1)
    height = np.ptp(corner[:, :, 2], axis=1)
    at_rim = np.arange(len(height)) // 64
    at_rim = (at_rim < 2) | (at_rim >= at_rim.max() - 1)
    inner = (height / width)[~at_rim]
    assert np.all((inner > 0.6) & (inner < 1.6))
    np.testing.assert_allclose(height[at_rim], 120 / 23 / 4)


def test_chart_mesh_is_the_middle_face() -> None:
    mesh = chart_mesh(
        Cylinder(diameter_outer_mm=60.0, length_mm=120.0), thickness_mm=0.8, n_along=7, n_around=40
    )
    assert np.hypot(*mesh.nodes_mm[:, :2].T) == pytest.approx(29.6)
    assert len(mesh.quads) == 280
    assert len(mesh.marker_nodes) == 0


def test_locate_interpolates_linear_chart_functions_and_wraps() -> None:
    _surface, _, mesh = build(3)
    rng = np.random.default_rng(2)
    uv = np.column_stack([rng.uniform(0, 120, 500), rng.uniform(-7, 14, 500)])
    uv[:4] = [[0.0, 0.0], [120.0, 2 * np.pi], [60.0, -1e-12], [60.0, 6.2831]]
    nodes, weights = locate(mesh, uv)
    assert weights.min() > -1e-6
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    u = np.sum(weights * mesh.uv[nodes, 0], axis=1)
    np.testing.assert_allclose(u, uv[:, 0], atol=1e-8)
    # On the chord of an arc of width w, bilinear weights stand for angles up to w³/64.
    off = np.angle(np.exp(1j * (mesh.uv[nodes, 1] - uv[:, 1:])))
    np.testing.assert_allclose(np.sum(weights * off, axis=1), 0.0, atol=(2 * np.pi / 48) ** 3 / 58)
    own, share = locate(mesh, mesh.uv)
    hit = np.where(own == np.arange(len(own))[:, None], share, 0.0).sum(axis=1)
    np.testing.assert_allclose(hit, 1.0, atol=1e-9)


def test_inverse_bilinear_map_of_any_convex_quad() -> None:
    rng = np.random.default_rng(4)
    square = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    corners = square + rng.uniform(-0.4, 0.4, (300, 4, 2))
    rs = rng.uniform(-1, 1, (300, 2))
    h = 0.25 * (1 + rs[:, :1] * square[:, 0]) * (1 + rs[:, 1:] * square[:, 1])
    target = np.einsum("ni,nik->nk", h, corners)
    np.testing.assert_allclose(_inverse_bilinear(corners, target), rs, atol=1e-10)


def test_a_chart_that_turns_the_other_way_still_faces_outward() -> None:
    class Mirrored(Cylinder):
        def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
            return super().point(uv * [1.0, -1.0], offset_mm)

        def normal(self, uv: FloatArray) -> FloatArray:
            return super().normal(uv * [1.0, -1.0])

    surface = Mirrored(diameter_outer_mm=60.0, length_mm=120.0)
    mesh = chart_mesh(surface, thickness_mm=0.8, n_along=4, n_around=12)
    corner = mesh.nodes_mm[mesh.quads]
    facing = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    assert np.all(np.sum(facing * mesh.normals[mesh.quads].mean(axis=1), axis=1) > 0.0)


def test_positions_off_the_shell_are_refused() -> None:
    _, _, mesh = build(1)
    with refused("position-outside-mesh"):
        locate(mesh, np.array([[121.0, 0.0]]))
    with refused("position-not-finite"):
        locate(mesh, np.array([[np.nan, 0.0]]))


def test_what_cannot_be_meshed_is_refused() -> None:
    surface, markers, _ = build(1)

    class Ring(Cylinder):
        periodic = (True, True)

    with refused("mesh-closed-along-u"):
        chart_mesh(
            Ring(diameter_outer_mm=9.0, length_mm=9.0), thickness_mm=1, n_along=3, n_around=3
        )
    with refused("mesh-marker-off-node"):
        marker_mesh(surface, markers, thickness_mm=0.9, refine=2)
    with refused("mesh-too-coarse"):
        marker_mesh(surface, markers, thickness_mm=0.8, refine=0)
    with refused("wall-exceeds-curvature"):
        chart_mesh(surface, thickness_mm=70.0, n_along=3, n_around=8)
