"""Positions, patches and files on every family: seams, poles, corners and curved edges."""

import shutil
import subprocess
from pathlib import Path

import meshio
import numpy as np
import pytest

from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import ShellMesh, node_mesh, plain_mesh
from phytac_design.mechanics.shell.loads import curved_points, patch_loads
from phytac_design.mechanics.shell.mesh_writers import write_inp, write_msh, write_vtu
from phytac_design.mechanics.shell.pressure_sharing import on_shell_share
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes import Cuboid, Plane, Surface
from phytac_shapes.arrays import FloatArray
from tests.mechanics.families import DOMES, FAMILIES, WALL_MM, golden
from tests.refusals import refused

MESHES = {
    name: node_mesh(surface, golden(surface, 30), thickness_mm=WALL_MM, size_mm=4.0)
    for name, surface in FAMILIES.items()
    if name != "sharp"
}
every_family = pytest.mark.parametrize("name", MESHES)


def model(mesh: ShellMesh) -> ShellModel:
    fixed = np.zeros((len(mesh.nodes_mm), 6), dtype=np.bool_)
    fixed[mesh.clamped] = True
    return ShellModel(
        mesh.nodes_mm,
        mesh.quads,
        mesh.normals,
        thickness_mm=WALL_MM,
        modulus_MPa=2200.0,
        poisson=0.38,
        fixed=fixed,
    )


def spots(surface: Surface, count: int) -> FloatArray:
    """Random places, with the chart's corners (so its seam and pole too) first."""
    low, high = surface.domain.T
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [low[0], high[1]], high])
    return np.concatenate([corners, np.random.default_rng(3).uniform(low, high, (count, 2))])


@every_family
def test_places_lie_on_the_normal_through_them(name: str) -> None:
    surface, mesh = FAMILIES[name], MESHES[name]
    uv = spots(surface, 1500)
    nodes, weights = locate(mesh, uv)
    assert weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    gap = np.einsum("ni,nix->nx", weights, mesh.nodes_mm[nodes]) - surface.point(uv, -WALL_MM / 2)
    normal = surface.normal(uv)
    along = np.sum(gap * normal, axis=1)
    aside = np.linalg.norm(gap - along[:, None] * normal, axis=1)
    # Rims of leaning faces: between nodes the rim's chord stands off by its sagitta.
    slack = 0.02 if name in ("cone", "capped", "grip") else 1e-10
    assert aside.max() < slack
    assert np.quantile(aside, 0.98) < 1e-10
    assert np.abs(along).max() < 0.5
    own, share = locate(mesh, mesh.uv)
    hit = np.where(own == np.arange(len(own))[:, None], share, 0.0).sum(axis=1)
    np.testing.assert_allclose(hit, 1.0, atol=1e-7)
    if surface.periodic[1]:
        turned = uv + np.array([0.0, np.ptp(surface.domain[1])])
        again, other = locate(mesh, turned)
        dense = np.zeros((2, len(uv), len(mesh.uv)))
        for k, (where, what) in enumerate(((nodes, weights), (again, other))):
            np.add.at(dense[k], (np.arange(len(uv))[:, None], where), what)
        np.testing.assert_allclose(dense[0], dense[1], atol=1e-7)


def test_the_wall_behind_is_never_found() -> None:
    thin = Cuboid(width_mm=60.0, depth_mm=3.0, length_mm=60.0, edge_radius_mm=1.4)
    mesh = plain_mesh(thin, thickness_mm=WALL_MM, size_mm=8.0)
    uv = spots(thin, 500)
    nodes, weights = locate(mesh, uv)
    facing = np.einsum("ni,nix,nx->n", weights, mesh.normals[nodes], thin.normal(uv))
    assert facing.min() > 0.9


def test_all_of_v_at_a_pole_is_one_place() -> None:
    for name in DOMES:
        mesh = MESHES[name]
        pole = int(np.argmax(mesh.nodes_mm[:, 2]))
        uv = np.column_stack([np.full(9, FAMILIES[name].domain[0, 1]), np.linspace(0.0, 8.0, 9)])
        nodes, weights = locate(mesh, uv)
        top = np.sum(weights * mesh.nodes_mm[nodes, 2], axis=1)
        np.testing.assert_allclose(top, top[0], atol=1e-12)
        assert top[0] == pytest.approx(mesh.nodes_mm[pole, 2], abs=0.2)
        loads = patch_loads(mesh, FAMILIES[name], uv, 5.0).toarray()
        np.testing.assert_allclose(loads, loads[:, :1] + 0.0 * loads, atol=1e-12)


@every_family
@pytest.mark.parametrize("radius", [0.0, 0.2, 2.0, 6.0])
def test_patches_press_one_newton_wherever_they_are(name: str, radius: float) -> None:
    surface, mesh = FAMILIES[name], MESHES[name]
    uv = spots(surface, 40)
    force = patch_loads(mesh, surface, uv, radius).toarray().reshape(-1, 6, len(uv))
    assert np.all(force[:, 3:] == 0.0)
    inward = -surface.normal(uv)
    total = force[:, :3].sum(axis=0).T
    np.testing.assert_allclose(np.sum(total * inward, axis=1), 1.0, atol=1e-12)
    # The pressure's centre is where the patch is, unless a rim or an edge cuts it.
    weight = np.einsum("nxm,mx->nm", force[:, :3], inward)
    centre = np.einsum("nm,nx->mx", weight, mesh.nodes_mm)
    free = on_shell_share(surface, uv, 1.3 * radius + 1e-9) > 1.0 - 1e-9
    assert free.sum() > 5
    if name != "cuboid":
        off = centre - surface.point(uv, -WALL_MM / 2.0)
        off -= np.sum(off * inward, axis=1)[:, None] * inward
        assert np.linalg.norm(off[free], axis=1).max() < 0.25


def test_sheets_lose_area_at_sides_and_corners() -> None:
    plane, mesh = FAMILIES["plane"], MESHES["plane"]
    assert isinstance(plane, Plane)
    uv = np.array([[30.0, 40.0], [30.0, 0.0], [0.0, -40.0], [27.0, 38.0], [0.0, 0.0], [-28.0, 1.0]])
    share = on_shell_share(plane, uv, 5.0)
    np.testing.assert_allclose(share[[0, 1, 2, 4]], [0.25, 0.5, 0.5, 1.0], atol=1e-12)
    points = np.random.default_rng(1).uniform(-5.0, 5.0, (400_000, 2))
    points = points[np.hypot(*points.T) < 5.0]
    for k in (3, 5):
        inside = np.all(np.abs(uv[k] + points) <= [30.0, 40.0], axis=1)
        assert share[k] == pytest.approx(inside.mean(), abs=0.003)
    load = patch_loads(mesh, plane, uv[:1], 5.0).toarray().reshape(-1, 6)[:, :3]
    centre = -np.sum(load * mesh.normals, axis=1) @ mesh.uv
    # Centroid of a quarter disc: 4r/3π from both sides.
    np.testing.assert_allclose(centre, uv[0] - 20.0 / 3.0 / np.pi, atol=0.1)


def test_a_pole_is_no_rim() -> None:
    dome = FAMILIES["hemisphere"]
    uv = np.array([[dome.domain[0, 1], 0.3], [dome.domain[0, 1] - 1.0, 0.3], [0.0, 0.3]])
    np.testing.assert_allclose(on_shell_share(dome, uv, 6.0), [1.0, 1.0, 0.5], atol=1e-12)


def test_curved_points_are_exact_for_second_order_faces() -> None:
    rng = np.random.default_rng(0)
    flat = np.array([[-1.0, -1.0], [1.2, -0.9], [0.8, 1.1], [-1.1, 0.7]])
    bend = np.array([[0.03, 0.01], [0.01, -0.02]]) * 1e-4
    height = 0.5 * np.einsum("ni,ij,nj->n", flat, bend, flat)
    normal = np.column_stack([-flat @ bend, np.ones(4)])
    weights = rng.dirichlet(np.ones(4), 20)
    corner = np.column_stack([flat, height])
    got = curved_points(corner[None], normal[None], weights)[0][0]
    want = 0.5 * np.einsum("ni,ij,nj->n", got[:, :2], bend, got[:, :2])
    assert np.abs(got[:, 2] - want).max() < 1e-4 * np.abs(height).max()


def test_the_back_of_a_thin_sensor_is_not_pressed() -> None:
    thin = FAMILIES["capped"]
    pole = np.array([[thin.domain[0, 1] - 8.0, 0.0]])
    load = patch_loads(MESHES["capped"], thin, pole, 30.0).toarray().reshape(-1, 6)[:, :3]
    behind = MESHES["capped"].normals @ thin.normal(pole)[0] < -0.3
    assert behind.any()
    assert np.all(load[behind] == 0.0)


def test_places_off_an_open_side_are_refused() -> None:
    plane = FAMILIES["plane"]
    with refused("position-outside-mesh"):
        locate(MESHES["plane"], np.array([[0.0, 40.1]]))
    with refused("position-outside-mesh"):
        patch_loads(MESHES["plane"], plane, np.array([[31.0, 0.0]]), 2.0)


@every_family
def test_files_hold_the_edges_each_shape_has(name: str, tmp_path: Path) -> None:
    surface, mesh = FAMILIES[name], MESHES[name]
    load = np.zeros((len(mesh.nodes_mm), 6))
    load[mesh.marker_nodes[0], 0] = 1.0
    text = write_inp(
        tmp_path / "a.inp", mesh, modulus_MPa=2200.0, poisson=0.38, load=load, name=name
    ).read_text()
    rims = {
        "TOP": (0, 1) in surface.edges(),
        "BOTTOM": (0, 0) in surface.edges(),
        "LEFT": (1, 0) in surface.edges(),
        "RIGHT": (1, 1) in surface.edges(),
    }
    back = meshio.read(write_msh(tmp_path / "a.msh", mesh))
    grid = meshio.read(write_vtu(tmp_path / "a.vtu", mesh))
    tags = back.cell_data_dict["gmsh:physical"]["line"]
    for key, present in rims.items():
        assert (f"*NSET, NSET={key}\n" in text) == present
        assert (key in back.field_data) == present
        if present:
            lines = back.cells_dict["line"][tags == back.field_data[key][0]]
            np.testing.assert_array_equal(np.unique(lines), np.sort(mesh.sets[key]))
    np.testing.assert_array_equal(np.flatnonzero(grid.point_data["CLAMPED"]), mesh.clamped)
    assert "\nCLAMPED, 1, 6\n" in text


@pytest.mark.parametrize("name", ["hemisphere", "capped", "plane", "cuboid", "patch"])
def test_ccx_runs_the_file_and_agrees(name: str, tmp_path: Path) -> None:
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not on PATH; apt install calculix-ccx")
    surface, mesh = FAMILIES[name], MESHES[name]
    load = patch_loads(mesh, surface, mesh.uv[mesh.marker_nodes[[14]]], 8.0)
    write_inp(tmp_path / "a.inp", mesh, modulus_MPa=2200.0, poisson=0.38, load=load, name=name)
    run = subprocess.run(
        ["ccx", "a"], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120
    )
    assert "*ERROR" not in run.stdout
    rows = [line.split() for line in (tmp_path / "a.dat").read_text().splitlines()]
    table = {int(r[0]): [float(x) for x in r[1:]] for r in rows if len(r) == 4 and r[0].isdigit()}
    ours = model(mesh).solve(load).motion[mesh.marker_nodes, :3, 0]
    theirs = np.array([table[node + 1] for node in mesh.marker_nodes])
    # S4 in CalculiX is stiff on coarse, skewed elements; a wrong mesh or set is off by far more.
    assert np.abs(ours - theirs).max() < 0.15 * np.abs(ours).max()
