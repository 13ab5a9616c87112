"""Solids with true receptors near a contact and a smeared wall elsewhere."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phytac_design.design.spec import Design
from phytac_design.engine.stage import graphics_libraries
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.shell import receptor_stiffness as rc
from phytac_design.mechanics.solid.load import solid_patch_load
from phytac_design.mechanics.solid.solid_mesh_tets import SolidSizes
from phytac_design.mechanics.solid.tetrahedra import jacobian_ratio
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from tests.designs import changed
from tests.mechanics.test_solid import volume
from tests.refusals import refused
from verification import calculix
from verification.partial_solid import PartMesh, PartSizes, part_mesh, smeared, subset
from verification.tip_motion import tips_motion, tips_turn

PRESSED, RADIUS_MM = 7, 3.0
COARSE = SolidSizes(wall_mm=1.5, foot_mm=1.1, tube_mm=1.5, contact_mm=1.1)
SIZES = PartSizes(near=COARSE, middle=COARSE, far_mm=2.0, near_mm=2.0, reach_mm=6.0)
PART_TOL = 0.04
"""One true receptor of twelve, of the peak; the sensor is small, so most of it is smeared."""

pytestmark = pytest.mark.skipif(
    not all(graphics_libraries().values()), reason="CadQuery's graphics libraries are missing"
)


@dataclass(frozen=True, kw_only=True)
class SmallSensor:
    design: Design
    surface: Surface
    markers: Markers

    def part(self, sizes: PartSizes, *, smear: tuple[float, float] | None = (1.0, 1.0)) -> PartMesh:
        return part_mesh(
            self.design,
            self.surface,
            self.markers,
            contacts_uv=self.markers.uv[[PRESSED]],
            radii_mm=np.array([RADIUS_MM]),
            sizes=sizes,
            smear=smear,
        )


@pytest.fixture(scope="module")
def sensor() -> SmallSensor:
    pytest.importorskip("gmsh", reason="gmsh is not installed")
    design = changed(
        shape={"diameter_outer_mm": 24.0, "length_mm": 14.0},
        layout={"rows": 2, "columns": 6, "height_near_mm": 1.0, "height_far_mm": 3.0},
    )
    surface = design.surface()
    return SmallSensor(design=design, surface=surface, markers=make_markers(design, surface))


@pytest.fixture(scope="module")
def mesh(sensor: SmallSensor) -> PartMesh:
    return sensor.part(SIZES)


def test_part_has_the_receptors_within_reach(sensor: SmallSensor, mesh: PartMesh) -> None:
    gap = sensor.surface.point(sensor.markers.uv)
    gap = gap - gap[PRESSED]
    near = np.flatnonzero(np.linalg.norm(gap, axis=1) <= SIZES.reach_mm)
    np.testing.assert_array_equal(mesh.kept, near)
    assert 1 <= len(near) < sensor.markers.count
    assert len(mesh.tips) == len(near)
    for k, i in enumerate(mesh.kept.tolist()):
        middle = mesh.nodes_mm[mesh.sets[f"TIP_{k}"]].mean(axis=0)
        assert np.linalg.norm(middle - sensor.markers.tip_mm[i]) < 0.2
    assert jacobian_ratio(mesh).min() > 0.0


def test_unsmeared_part_has_the_volume_of_its_cad(sensor: SmallSensor) -> None:
    from phytac_design.solids.cad import cad_facts, shell_cad

    mesh = sensor.part(SIZES, smear=None)
    wall = sensor.design.wall.model_copy(update={"rim_length_mm": 0.0})
    bare = sensor.design.model_copy(update={"wall": wall})
    cad = shell_cad(Sensor.of(bare, sensor.surface, subset(sensor.markers, mesh.kept)))
    assert volume(mesh) == pytest.approx(cad_facts(cad).volume_mm3, rel=3e-3)
    assert (mesh.modulus_ratio == 1.0).all()


def test_smeared_wall_has_the_mean_stiffness_of_the_mixture() -> None:
    design = changed(layout={"height_near_mm": 4.0, "height_far_mm": 4.0001})
    surface = design.surface()
    markers = make_markers(design, surface)
    kept = np.flatnonzero(np.linalg.norm(markers.mid_mm - markers.mid_mm[184], axis=1) < 20.0)
    v = np.linspace(0.0, 2.0 * np.pi, 50)
    points = surface.point(np.column_stack([np.full(50, 60.0), v]), -0.4)
    thickness, modulus = smeared(design, surface, markers, kept, points)
    share = np.pi / 4.0 * 3.0**2 * markers.count / surface.area_mm2()
    membrane, bending = rc.receptor_effect(3.0 / 0.8, 1.6 / 3.0, 4.0 / 0.8)
    far = np.linalg.norm(points - markers.mid_mm[184], axis=1) > 30.0
    assert far.sum() > 20
    for power, effect, mixing in (
        (1, membrane, rc.MIXING_MEMBRANE),
        (3, bending, rc.MIXING_BENDING),
    ):
        wanted = rc.mixture(np.array(share), effect, mixing)
        # Rows end before the rims, so at half height the share is a little above the mean.
        np.testing.assert_allclose((modulus * thickness**power)[far], wanted, rtol=0.02)
        assert abs(float(wanted) - 1.0) > 0.04
    on_tubes = smeared(design, surface, markers, kept, markers.tip_mm[kept])
    inner = np.linalg.norm(markers.mid_mm[kept] - markers.mid_mm[184], axis=1) < 15.0
    assert all((ratio[inner] == 1.0).all() for ratio in on_tubes)


def test_tips_follow_rigid_motion_exactly(sensor: SmallSensor, mesh: PartMesh) -> None:
    turn = Rotation.from_rotvec([0.2, -0.3, 0.25])
    shift = np.array([0.5, -1.0, 2.0])

    def moved(points: FloatArray) -> FloatArray:
        return np.asarray(turn.apply(points) + shift - points)

    found = tips_motion(mesh, sensor.markers, moved(mesh.nodes_mm), far_mm=2.5)
    wanted = moved(sensor.markers.tip_mm)
    left = np.setdiff1d(np.arange(sensor.markers.count), mesh.kept)
    np.testing.assert_allclose(found[left], wanted[left], atol=1e-9)
    np.testing.assert_allclose(found, wanted, atol=1e-3)  # rings of triangles are not quite round
    vectors = tips_turn(mesh, moved(mesh.nodes_mm))
    np.testing.assert_allclose(vectors, np.tile(turn.as_rotvec(), (len(vectors), 1)), atol=1e-9)


def test_too_few_nodes_under_a_left_out_receptor_are_refused(
    sensor: SmallSensor, mesh: PartMesh
) -> None:
    with refused("tip-nodes-too-few"):
        tips_motion(mesh, sensor.markers, np.zeros_like(mesh.nodes_mm), far_mm=0.2)


def test_no_receptor_within_reach_is_refused(sensor: SmallSensor) -> None:
    sizes = PartSizes(near=COARSE, middle=COARSE, far_mm=2.0, near_mm=2.0, reach_mm=0.1)
    with refused("partial-solid-without-receptor"):
        part_mesh(
            sensor.design,
            sensor.surface,
            sensor.markers,
            contacts_uv=sensor.markers.uv[[PRESSED]] + 1.0,
            radii_mm=np.array([RADIUS_MM]),
            sizes=sizes,
        )


def solved(
    sensor: SmallSensor, mesh: PartMesh, path: Path, *, force: float = 1.0, large: bool = False
) -> FloatArray:
    load = force * solid_patch_load(mesh, sensor.surface, sensor.markers.uv[PRESSED], RADIUS_MM)
    calculix.write_reference_inp(
        path,
        mesh,
        modulus_MPa=2200.0 * mesh.modulus_ratio,
        poisson=0.38,
        load=load,
        name="test",
        large=large,
        first=1.0,
    )
    nodes, found = calculix.run_ccx(path)[-1]["displacements", "ALL"]
    motion = np.zeros_like(mesh.nodes_mm)
    motion[nodes] = found
    return tips_motion(mesh, sensor.markers, motion, far_mm=2.5)


def test_part_moves_as_the_whole_in_ccx(
    sensor: SmallSensor, mesh: PartMesh, tmp_path: Path
) -> None:
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not on PATH; apt install calculix-ccx")
    whole_sizes = PartSizes(near=COARSE, middle=COARSE, far_mm=2.0, near_mm=2.0, reach_mm=99.0)
    whole = solved(sensor, sensor.part(whole_sizes), tmp_path / "whole.inp")
    peak = np.linalg.norm(whole, axis=1).max()
    part = solved(sensor, mesh, tmp_path / "part.inp")
    assert np.linalg.norm(part - whole, axis=1).max() / peak < PART_TOL
    # A thousandth of a newton is linear; its job is one with increments.
    large = solved(sensor, mesh, tmp_path / "large.inp", force=1e-3, large=True)
    np.testing.assert_allclose(1e3 * large, part, atol=1e-3 * peak)
    went = calculix.read_convergence(tmp_path / "large.inp")
    assert went.factor == 1.0
    assert went.increments == 1
    assert 1 <= went.iterations <= 4
    assert went.residual < calculix.TIGHT[0]
    with refused("calculix-no-increments"):
        calculix.read_convergence(tmp_path / "absent.inp")
    assert calculix.ccx_version().count(".") == 1


def test_bands_of_modulus_are_written_within_their_rounding(
    sensor: SmallSensor, mesh: PartMesh, tmp_path: Path
) -> None:
    path = calculix.write_reference_inp(
        tmp_path / "bands.inp",
        mesh,
        modulus_MPa=2200.0 * mesh.modulus_ratio,
        poisson=0.38,
        load=np.zeros_like(mesh.nodes_mm),
        name="test",
    )
    parts = path.read_text().split("*ELSET, ELSET=BAND_")[1:]
    assert len(parts) > 3
    modulus = np.full(len(mesh.tets), np.nan)
    for part in parts:
        labels, rest = part.split("*MATERIAL", 1)
        members = np.array(labels.split("\n", 1)[1].replace(",", " ").split(), dtype=np.int64) - 1
        assert np.isnan(modulus[members]).all()
        modulus[members] = float(rest.split("*ELASTIC\n", 1)[1].split(",", 1)[0])
    step = calculix.BAND * 2200.0 * mesh.modulus_ratio.max()
    assert np.abs(modulus - 2200.0 * mesh.modulus_ratio).max() <= 0.5001 * step


def test_convergence_is_that_of_the_last_increment_and_iteration(tmp_path: Path) -> None:
    head = "SUMMARY OF JOB INFORMATION\n  STEP      INC     ATT  ITRS     TOT TIME\n"
    (tmp_path / "a.sta").write_text(
        f"{head}     1          1     1     2  0.250000E+00  0.250000E+00  0.250000E+00\n"
        "     1          2     1     1  0.875000E+00  0.875000E+00  0.625000E+00\n"
    )
    (tmp_path / "a.cvg").write_text(
        "SUMMARY OF C0NVERGENCE INFORMATION\n  STEP   INC  ATT   ITER     CONT.   RESID.\n"
        "     1     1     1     1        0  0.2981E+04  0.1000E+03  0.0000E+00  0.0000E+00\n"
        "     1     1     1     2        0  0.8767E+01  0.4177E+01  0.0000E+00  0.0000E+00\n"
        "     1     2     1     1        0  0.1606E+00  0.7053E+00  0.0000E+00  0.0000E+00\n"
    )
    assert calculix.read_convergence(tmp_path / "a.inp") == calculix.Convergence(
        factor=0.875, increments=2, iterations=3, residual=0.001606, correction=0.007053
    )
