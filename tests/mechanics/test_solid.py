"""Solid meshes of the true CAD: geometry in closed form, loads, files, an independent solver."""

import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np
import pytest

from phytac_design.design.spec import Design
from phytac_design.engine.stage import graphics_libraries
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import chart_mesh
from phytac_design.mechanics.pressing.contact_patch import ContactPatch
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_design.mechanics.solid import mesh_files
from phytac_design.mechanics.solid import solid_writers as solid_export
from phytac_design.mechanics.solid import tetrahedra as solid_tets
from phytac_design.mechanics.solid.load import solid_patch_load
from phytac_design.mechanics.solid.mesh_files import write_solid_files
from phytac_design.mechanics.solid.solid_mesh_tets import (
    SETTINGS,
    SolidMesh,
    SolidSizes,
    coarsened,
    default_sizes,
    expected_nodes,
    solid_mesh,
)
from phytac_design.mechanics.solid.tetrahedra import Tetrahedra, jacobian_ratio, shape_tet
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from tests.designs import changed
from tests.refusals import refused
from verification import calculix
from verification.tip_motion import tip_means

SIZES = SolidSizes(wall_mm=1.5, foot_mm=1.1, tube_mm=1.5, contact_mm=1.1)
GEOMETRY_TOL = 2e-3
"""Quadratic edges on circles of this mesh: area and volume."""
NODES_TOL = 0.27
"""Expected nodes: they decide between minutes and hours, not more."""
REACH = 2.2
"""mm around the middle of a contact that its motion is fitted in."""
SHELL_TOL = 0.035
"""Shell against plain solid at t/R = 0.04: of 2.6 %, 1.5 % go with three times finer tetrahedra."""

pytestmark = pytest.mark.skipif(
    not all(graphics_libraries().values()), reason="CadQuery's graphics libraries are missing"
)


@dataclass(frozen=True, kw_only=True)
class SmallSensor:
    design: Design
    surface: Surface
    markers: Markers


@pytest.fixture(scope="module")
def sensor() -> SmallSensor:
    return make_sensor(diameter=24.0, length=14.0, rows=2, columns=6)


def make_sensor(
    *, diameter: float, length: float, rows: int, columns: int, wall: float = 0.8
) -> SmallSensor:
    pytest.importorskip("gmsh", reason="gmsh is not installed")
    heights = {"height_near_mm": 1.0, "height_far_mm": 3.0}
    design = changed(
        shape={"diameter_outer_mm": diameter, "length_mm": length},
        layout={"rows": rows, "columns": columns, **heights},
        wall={"thickness_mm": wall},
    )
    surface = design.surface()
    return SmallSensor(design=design, surface=surface, markers=make_markers(design, surface))


@pytest.fixture(scope="module")
def mesh(sensor: SmallSensor) -> SolidMesh:
    return solid_mesh(
        Sensor.of(sensor.design, sensor.surface, sensor.markers),
        sizes=SIZES,
        contacts_uv=sensor.markers.uv[[2]],
        contact_radius_mm=3.0,
    )


def volume(mesh: Tetrahedra) -> float:
    """By four-point Gauss quadrature, exact to second order."""
    a, b = (5.0 + 3.0 * np.sqrt(5.0)) / 20.0, (5.0 - np.sqrt(5.0)) / 20.0
    X, total = mesh.nodes_mm[mesh.tets], 0.0
    for k in range(4):
        L = np.full(4, b)
        L[k] = a
        total += np.linalg.det(np.einsum("ai,eik->eak", shape_tet(L)[1], X)).sum() / 24.0
    return float(total)


def area(mesh: SolidMesh, faces: np.ndarray) -> float:
    corner = mesh.nodes_mm[mesh.triangles[faces]]
    from phytac_design.mechanics.solid.load import cell_areas, cells

    return float(cell_areas(corner, cells(12))[1].sum())


def test_volume_is_that_of_the_cad(sensor: SmallSensor, mesh: SolidMesh) -> None:
    from phytac_design.solids.cad import cad_facts, shell_cad

    wall = sensor.design.wall.model_copy(update={"rim_length_mm": 0.0})
    bare = sensor.design.model_copy(update={"wall": wall})
    cad = cad_facts(shell_cad(Sensor.of(bare, sensor.surface, sensor.markers)))
    assert volume(mesh) == pytest.approx(cad.volume_mm3, rel=GEOMETRY_TOL)
    assert jacobian_ratio(mesh).min() > 0.0
    assert len(np.unique(mesh.tets)) == len(mesh.nodes_mm)


def test_faces_have_their_closed_formcell_areas(sensor: SmallSensor, mesh: SolidMesh) -> None:
    outer, hole = 3.0, 1.6
    assert len(mesh.tips) == sensor.markers.count == 12
    for part in mesh.tips:
        assert area(mesh, part) == pytest.approx(np.pi / 4 * (outer**2 - hole**2), rel=5e-3)
    openings = 12 * np.pi / 4 * hole**2
    whole = sensor.surface.area_mm2() - openings
    assert area(mesh, mesh.outer) == pytest.approx(whole, rel=GEOMETRY_TOL)
    rims = {"BOTTOM": 0.0, "TOP": 14.0}
    for key, z in rims.items():
        nodes = mesh.nodes_mm[mesh.sets[key]]
        np.testing.assert_allclose(nodes[:, 2], z, atol=1e-6)
        radius = np.hypot(nodes[:, 0], nodes[:, 1])
        assert radius.min() == pytest.approx(11.2, abs=1e-6)
        assert radius.max() == pytest.approx(12.0, abs=1e-6)
    np.testing.assert_array_equal(mesh.sets["TIP_7"], np.unique(mesh.triangles[mesh.tips[7]]))


def test_tip_means_are_exact_for_rigid_and_linear_motion(
    sensor: SmallSensor, mesh: SolidMesh
) -> None:
    rng = np.random.default_rng(0)
    gradient, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    mean = tip_means(mesh) @ (mesh.nodes_mm @ gradient.T + shift)
    expected = sensor.markers.tip_mm @ gradient.T + shift
    assert np.abs(mean - expected).max() < 1e-3 * np.abs(gradient).max()  # rings not quite round


def test_patch_presses_with_one_newton_at_its_centre(sensor: SmallSensor, mesh: SolidMesh) -> None:
    uv = np.array([7.3, 0.4])  # no marker's position: a hole cut off at one side would shift it
    centre, inward = sensor.surface.point(uv[None])[0], -sensor.surface.normal(uv[None])[0]
    load = solid_patch_load(mesh, sensor.surface, uv, 3.0)
    assert load.sum(axis=0) @ inward == pytest.approx(1.0, rel=1e-12)
    loaded = np.flatnonzero(np.abs(load).max(axis=1) > 0.0)
    assert np.isin(loaded, mesh.triangles[mesh.outer]).all()
    assert np.linalg.norm(mesh.nodes_mm[loaded] - centre, axis=1).max() < 3.0 + 2.0 * SIZES.wall_mm
    with refused("solid-contact-off-mesh"):
        solid_patch_load(mesh, sensor.surface, np.array([40.0, 0.0]), 3.0)


def test_patch_on_a_plain_wall_has_its_resultant_at_the_centre(sensor: SmallSensor) -> None:
    mesh = plain_mesh(sensor)
    uv = np.array([7.0, 0.4])
    load = solid_patch_load(mesh, sensor.surface, uv, 3.0)
    inward = -sensor.surface.normal(uv[None])[0]
    np.testing.assert_allclose(load.sum(axis=0), inward, atol=0.01)
    arm = mesh.nodes_mm - sensor.surface.point(uv[None])[0]
    assert np.abs(np.cross(arm, load).sum(axis=0)).max() < 0.03  # N mm of 1 N on a 3 mm patch


def plain_mesh(sensor: SmallSensor) -> SolidMesh:
    return solid_mesh(
        Sensor.of(sensor.design, sensor.surface, sensor.markers),
        sizes=SIZES.scaled(0.8),
        contacts_uv=np.array([[7.0, 0.4]]),
        contact_radius_mm=3.0,
        receptors=False,
    )


def needs_ccx() -> None:
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not on PATH; apt install calculix-ccx")


def test_plain_solid_in_ccx_moves_as_our_shell(tmp_path: Path) -> None:
    needs_ccx()
    sensor = make_sensor(diameter=40.0, length=14.0, rows=2, columns=6)
    mesh = plain_mesh(sensor)
    assert mesh.tips == ()
    uv, force = np.array([[7.0, 0.4]]), 5.0
    spot = sensor.surface.point(uv, -0.4)[0]
    near = np.linalg.norm(mesh.nodes_mm - spot, axis=1) < REACH
    mesh = replace(mesh, sets={**mesh.sets, "SPOT": np.flatnonzero(near)})
    path = job(
        tmp_path / "plain.inp",
        mesh,
        sensor,
        force * solid_patch_load(mesh, sensor.surface, uv[0], 3.0),
    )
    text = path.read_text().replace("*END STEP", "*NODE PRINT, NSET=SPOT\nU\n*END STEP")
    path.write_text(text)
    nodes, motion = calculix.run_ccx(path)[0]["displacements", "SPOT"]
    inward = -sensor.surface.normal(uv)[0]
    theirs = at_spot(mesh.nodes_mm[nodes] - spot, motion @ inward, inward)
    shell = chart_mesh(sensor.surface, thickness_mm=0.8, n_along=28, n_around=240)
    model = clamped_model(shell, modulus_MPa=2200.0, poisson=0.38)
    load = force * patch_loads(shell, sensor.surface, uv, 3.0)
    pressed = model.solve(load).motion[:, :3, 0] @ inward
    ball = np.linalg.norm(shell.nodes_mm - spot, axis=1) < REACH
    ours = at_spot(shell.nodes_mm[ball] - spot, pressed[ball], inward)
    assert len(nodes) > 40
    assert ours == pytest.approx(theirs, rel=SHELL_TOL)


def at_spot(arm: FloatArray, values: FloatArray, inward: FloatArray) -> float:
    """Value in the middle of scattered ones, by a least-squares polynomial of fourth order."""
    x, y, z = arm[:, 2], arm @ np.cross([0.0, 0.0, 1.0], inward), arm @ inward
    basis = [x**i * y**j for i in range(5) for j in range(5 - i)]
    if np.ptp(z) > 0.5:  # a solid: it has a thickness
        basis += [z, z * z, z * x, z * y]
    return float(np.linalg.lstsq(np.column_stack(basis), values, rcond=None)[0][0])


def job(path: Path, mesh: SolidMesh, sensor: SmallSensor, load: FloatArray) -> Path:
    material = sensor.design.material
    return solid_export.write_solid_inp(
        path,
        mesh,
        modulus_MPa=material.modulus_MPa,
        poisson=material.poisson,
        load=load,
        name="test",
    )


def test_job_with_receptors_runs_linear_and_large(tmp_path: Path) -> None:
    needs_ccx()
    sensor = make_sensor(diameter=12.0, length=7.0, rows=1, columns=3)
    mesh = solid_mesh(Sensor.of(sensor.design, sensor.surface, sensor.markers), sizes=SIZES)
    small = 1e-3 * solid_patch_load(mesh, sensor.surface, sensor.markers.uv[2], 3.0)
    linear = job(tmp_path / "linear.inp", mesh, sensor, small)
    large = calculix.write_reference_inp(
        tmp_path / "large.inp",
        mesh,
        modulus_MPa=np.full(len(mesh.tets), sensor.design.material.modulus_MPa),
        poisson=sensor.design.material.poisson,
        load=small,
        name="test",
        large=True,
    )
    motion = []
    for path, key in ((linear, "TIPS"), (large, "ALL")):
        assert max(len(line) for line in path.read_text().splitlines()) <= 80
        nodes, found = calculix.run_ccx(path)[-1]["displacements", key]
        everywhere = np.zeros_like(mesh.nodes_mm)
        everywhere[nodes] = found
        motion.append(tip_means(mesh) @ everywhere)
    pressed = np.linalg.norm(motion[0], axis=1)
    assert np.argmax(pressed) == 2
    # A thousandth of a newton is linear: both steps solve the same problem.
    np.testing.assert_allclose(motion[1], motion[0], atol=1e-3 * pressed.max())


def test_ccx_that_fails_is_reported(sensor: SmallSensor, mesh: SolidMesh, tmp_path: Path) -> None:
    needs_ccx()
    path = job(tmp_path / "bad.inp", mesh, sensor, np.zeros_like(mesh.nodes_mm))
    path.write_text(path.read_text().replace("*ELASTIC", "*NO SUCH CARD"))
    with refused("calculix-failed"):
        calculix.run_ccx(path)


def test_files_read_back(mesh: SolidMesh, tmp_path: Path) -> None:
    back = meshio.read(solid_export.write_solid_msh(tmp_path / "a.msh", mesh))
    np.testing.assert_allclose(back.points, mesh.nodes_mm, rtol=1e-12)
    np.testing.assert_array_equal(back.cells_dict["tetra10"], mesh.tets)
    assert {"SHELL", "TOP", "BOTTOM", "OUTER", "TIP_0", "TIP_11"} <= set(back.field_data)
    tag = back.field_data["TIP_5"][0]
    faces = back.cells_dict["triangle6"][back.cell_data_dict["gmsh:physical"]["triangle6"] == tag]
    np.testing.assert_array_equal(faces, mesh.triangles[mesh.tips[5]])
    motion = np.random.default_rng(0).normal(size=mesh.nodes_mm.shape)
    back = meshio.read(solid_export.write_solid_vtu(tmp_path / "a.vtu", mesh, motion=motion))
    np.testing.assert_array_equal(back.point_data["displacement_mm"], motion)
    np.testing.assert_array_equal(
        np.flatnonzero(back.point_data["receptor"] == 3), mesh.sets["TIP_3"]
    )


def test_bad_load_is_refused(sensor: SmallSensor, mesh: SolidMesh, tmp_path: Path) -> None:
    with refused("load-vector-invalid"):
        job(tmp_path / "a.inp", mesh, sensor, np.full_like(mesh.nodes_mm, np.nan))


def test_same_inputs_same_mesh(sensor: SmallSensor) -> None:
    np.testing.assert_array_equal(plain_mesh(sensor).nodes_mm, plain_mesh(sensor).nodes_mm)


def test_expected_nodes_are_about_right_and_bounded(sensor: SmallSensor, mesh: SolidMesh) -> None:
    parts = sensor.design, sensor.surface, sensor.markers
    assert expected_nodes(Sensor.of(*parts), SIZES) == pytest.approx(
        len(mesh.nodes_mm), rel=NODES_TOL
    )
    factor, sizes, nodes = coarsened(Sensor.of(*parts), None)
    assert (factor, sizes) == (1.0, default_sizes(sensor.design))
    assert nodes == expected_nodes(Sensor.of(*parts), sizes)
    long = changed(layout={"rows": 20})
    surface = long.surface()
    large = long, surface, make_markers(long, surface)
    factor, _, nodes = coarsened(Sensor.of(*large), None)
    assert 1.5 < factor < SETTINGS.max_factor
    assert nodes <= SETTINGS.aimed_nodes
    with refused("solid-too-many-nodes"):
        coarsened(Sensor.of(*large), 0.7)
    for wrong in (0.0, 2.1, np.nan):
        with refused("solid-size-factor"):
            coarsened(Sensor.of(*large), wrong)


@pytest.mark.parametrize(
    ("shape", "wall", "factor", "made"),
    [
        # diameter, length, rows, columns; nodes that Gmsh made
        ((24.0, 14.0, 2, 6), 0.4, 1.5, 38674),
        ((24.0, 14.0, 2, 6), 0.8, 1.0, 33563),
        ((60.0, 30.0, 3, 16), 3.0, 1.5, 130884),
        ((60.0, 50.0, 2, 4), 3.0, 1.0, 304911),
        ((60.0, 30.0, 2, 6), 5.0, 2.0, 54640),
        ((60.0, 30.0, 2, 6), 5.0, 1.0, 292928),
    ],
)
def test_expected_nodes_hold_for_thin_and_thick_walls(
    shape: tuple[float, float, int, int], wall: float, factor: float, made: int
) -> None:
    diameter, length, rows, columns = shape
    case = make_sensor(diameter=diameter, length=length, rows=rows, columns=columns, wall=wall)
    sensor = Sensor.of(case.design, case.surface, case.markers)
    sizes = default_sizes(case.design).scaled(factor)
    assert expected_nodes(sensor, sizes) == pytest.approx(made, rel=NODES_TOL)


def test_a_mesh_of_too_many_nodes_is_refused_before_it_is_written(
    sensor: SmallSensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Expected nodes may be too few."""
    large = SimpleNamespace(nodes_mm=np.zeros((SETTINGS.max_nodes + 1, 3)))
    monkeypatch.setattr(mesh_files, "solid_mesh", lambda *_, **__: large)
    parts = Sensor.of(sensor.design, sensor.surface, sensor.markers)
    place = ContactPatch(uv=sensor.markers.uv[2], radius_mm=3.0, force_N=1.0)
    with refused("solid-too-many-nodes"):
        write_solid_files(tmp_path, parts, place)
    assert not list(tmp_path.iterdir())


def test_default_sizes_resolve_the_wall(sensor: SmallSensor) -> None:
    sizes = default_sizes(sensor.design)
    assert sizes.foot_mm <= 0.7  # the tube's own wall, thinner than the shell's 0.8
    assert sizes.wall_mm <= 2.0 * 0.8
    assert sizes.contact_mm < sizes.wall_mm


def test_without_gmsh_the_fix_is_named(
    sensor: SmallSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "gmsh", None)
    with refused("missing-library"):
        solid_mesh(Sensor.of(sensor.design, sensor.surface, sensor.markers))


def test_folded_element_is_straightened_or_refused() -> None:
    corner = np.vstack([np.zeros(3), np.eye(3)])
    middle = np.array([(corner[i] + corner[j]) / 2.0 for i, j in solid_tets.EDGES])
    nodes = np.vstack([corner, middle])
    straight = Tetrahedra(
        nodes_mm=nodes, tets=np.arange(10)[None], triangles=np.zeros((0, 6), dtype=np.int64)
    )
    assert jacobian_ratio(straight)[0] == pytest.approx(1.0)
    bent = nodes.copy()
    bent[4] += 0.6 * np.array([-0.5, 1.0, 1.0])
    folded = replace(straight, nodes_mm=bent)
    assert jacobian_ratio(folded)[0] < 0.0
    np.testing.assert_allclose(solid_tets._straighten(folded).nodes_mm, nodes, atol=1e-15)


def test_gmsh_failure_is_ours() -> None:
    pytest.importorskip("gmsh", reason="gmsh is not installed")
    with refused("gmsh-failed"):
        solid_tets.tetrahedra(
            lambda gmsh: gmsh.model.occ.importShapes("/nonexistent.step"), lambda _: 0
        )
