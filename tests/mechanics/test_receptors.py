"""Receptor stiffening: bounds and identities, and the cell models that it comes from."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phytac_design.design.accuracy import PRESETS
from phytac_design.engine.stage import Context, write_arrays
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.mechanics.meshing.mesh import chart_mesh, marker_mesh
from phytac_design.mechanics.shell.receptor_stiffness import (
    DIAMETER_OVER_T,
    EFFECT_BENDING,
    EFFECT_MEMBRANE,
    HEIGHT_OVER_T,
    HOLE_OVER_DIAMETER,
    MIXING_BENDING,
    MIXING_MEMBRANE,
    ReceptorStiffness,
    mixture,
    receptor_effect,
    receptor_stiffness,
    tube_cover,
    unknown_receptors,
)
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_design.simulation.instance_shell import truth_shell
from phytac_design.simulation.linear_response import rigid_slope
from phytac_design.stages.response_stage import RESPONSE, TWIN, run_response
from phytac_shapes.arrays import FloatArray
from tests.designs import changed, small
from tests.mechanics.conftest import Prototype
from tests.refusals import refused
from verification.receptor_cell import Cell, cell_stiffness, plain, ratio

CELL_TOL = 0.015
"""Table, interpolation and mixture against a new cell, as a share of its stiffness."""


def needs_cells() -> None:
    pytest.importorskip("gmsh", reason="gmsh is not installed")
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not on PATH; apt install calculix-ccx")


def test_section_matches_both_factors_exactly() -> None:
    rng = np.random.default_rng(0)
    factors = ReceptorStiffness(
        membrane=rng.uniform(0.2, 4.0, 50), bending=rng.uniform(0.2, 4.0, 50)
    )
    wall = rng.uniform(0.5, 1.0, 50)
    t, E = factors.section(thickness_mm=wall, modulus_MPa=2200.0)
    np.testing.assert_allclose(E * t, 2200.0 * wall * factors.membrane, rtol=1e-13)
    np.testing.assert_allclose(E * t**3, 2200.0 * wall**3 * factors.bending, rtol=1e-13)


def test_effect_reproduces_the_tables_and_stops_at_their_ends() -> None:
    d, q, h = np.meshgrid(DIAMETER_OVER_T, HOLE_OVER_DIAMETER, HEIGHT_OVER_T, indexing="ij")
    membrane, bending = receptor_effect(d, q, h)
    np.testing.assert_allclose(membrane, EFFECT_MEMBRANE, atol=1e-12)
    np.testing.assert_allclose(bending, EFFECT_BENDING, atol=1e-12)
    assert receptor_effect(3.0, 0.5, 3.0) == receptor_effect(3.0, 0.5, 50.0)
    for wrong in ((1.0, 0.5, 1.0), (20.0, 0.5, 1.0), (3.0, 0.9, 1.0)):
        with refused("receptor-stiffness-range"):
            receptor_effect(*wrong)


def test_effect_has_the_signs_of_physics() -> None:
    d = np.linspace(1.5, 12.0, 9)[:, None]
    pin = receptor_effect(d, 0.0, np.array([0.5, 1.0, 3.0]))
    assert np.all(pin[0] > 0.0)
    assert np.all(pin[1] > pin[0])  # a pin on one face stiffens bending most
    assert np.all(np.diff(pin[1], axis=1) > 0.0)  # taller is stiffer
    hole = receptor_effect(d, np.array([0.3, 0.5, 0.7]), 0.0)
    for part in hole:
        assert np.all(part < 0.0)
        assert np.all(np.diff(part, axis=1) < 0.0)  # wider is softer
    # A hole of small area fraction c costs membrane stiffness about 3 c (E/(1 + 3 c), any text).
    assert hole[0][-1, 0] == pytest.approx(-3.0 * 0.3**2, rel=0.1)


def test_mixture_is_bounded_monotone_and_dilute_at_first() -> None:
    share = np.linspace(0.0, 1.0, 101)
    for effect in (-3.0, -0.5, 0.0, 0.8, 2.1):
        factor = mixture(share, np.array(effect), MIXING_BENDING)
        assert factor[0] == 1.0
        assert np.all((factor >= 0.05) & (factor <= 10.0))
        assert np.all(np.sign(effect) * np.diff(factor) >= 0.0)
        assert mixture(np.array(1e-6), np.array(effect), MIXING_MEMBRANE) - 1.0 == pytest.approx(
            1e-6 * effect, rel=1e-4
        )


def test_dense_holes_soften_a_sheet_as_a_perforated_one() -> None:
    # Perforated sheet: E(f)/E = (1 - f)/(1 + 2 f) for round holes, whatever ν (Hashin and Shtrikman
    # 1963; Thorpe and Jasiuk 1992), which starts as 1 - 3 f.
    share = np.array([0.1, 0.2, 0.3, 0.4])
    exact = (1.0 - share) / (1.0 + 2.0 * share)
    np.testing.assert_allclose(mixture(share, np.array(-3.0), MIXING_MEMBRANE), exact, rtol=0.05)


def test_shares_add_up_to_the_tubes_on_any_mesh(cylinder60: Prototype) -> None:
    surface, markers = cylinder60.surface, cylinder60.markers
    meshes = [
        cylinder60.mesh,
        marker_mesh(surface, markers, thickness_mm=0.8, refine=7),
        chart_mesh(surface, thickness_mm=0.8, n_along=61, n_around=83),
    ]
    for mesh in meshes:
        inside, owner = tube_cover(mesh, markers, 1.5)
        share = inside.mean(axis=1)
        corner = mesh.nodes_mm[mesh.quads]
        cross = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
        area = np.linalg.norm(cross, axis=1) / 2.0
        assert share @ area == pytest.approx(368 * np.pi * 1.5**2, rel=0.02)
        assert share.min() == 0.0
        away = np.linalg.norm(corner.mean(axis=1)[:, None] - markers.mid_mm[owner], axis=2)
        assert away[inside > 0.0].max() < 4.0


def test_factors_of_a_design_are_one_away_from_receptors(cylinder60: Prototype) -> None:
    mesh = marker_mesh(cylinder60.surface, cylinder60.markers, thickness_mm=0.8, refine=6)
    factors = receptor_stiffness(cylinder60.design, cylinder60.markers, mesh)
    inside, cell_owner = tube_cover(mesh, cylinder60.markers, 1.5)
    share, owner = inside.mean(axis=1), cell_owner[:, 0]
    bare = share == 0.0
    assert np.all(factors.membrane[bare] == 1.0)
    assert np.all(factors.bending[bare] == 1.0)
    covered = share > 0.9
    assert np.all(factors.membrane[covered] < 0.8)  # the hole of 1.6 in a tube of 3 softens it
    tall = covered & (cylinder60.markers.height_mm[owner] > 2.0)
    assert np.all(factors.bending[tall] > 1.5)
    t, E = factors.section(thickness_mm=0.8, modulus_MPa=2200.0)
    load = np.zeros(6 * len(mesh.nodes_mm))
    at = int(mesh.marker_nodes[184])
    load[6 * at : 6 * at + 3] = -mesh.normals[at]

    def pressed(thickness: FloatArray | float, modulus: FloatArray | float) -> float:
        model = clamped_model(mesh, modulus_MPa=modulus, poisson=0.38, thickness_mm=thickness)
        return float(-model.solve(load).motion[at, :3, 0] @ mesh.normals[at])

    assert 0.7 < pressed(t, E) / pressed(0.8, 2200.0) < 0.95


def test_receptors_beyond_the_tables_are_refused() -> None:
    design = small(receptor={"diameter_outer_mm": 0.9, "diameter_hole_mm": 0.5})
    surface = design.surface()
    markers = make_markers(design, surface)
    mesh = marker_mesh(surface, markers, thickness_mm=0.8, refine=3)
    with refused("receptor-stiffness-range"):
        receptor_stiffness(changed(receptor={"diameter_outer_mm": 0.9}), markers, mesh)
    assert "tube diameter over wall thickness" in unknown_receptors(design)
    assert unknown_receptors(small()) == ""
    # The simulated sensor of such a design has a plain wall rather than a guessed one.
    assert np.ptp(truth_shell(design, surface, 3)[1].thickness_mm) == 0.0
    assert np.ptp(truth_shell(small(), surface, 3)[1].thickness_mm) > 0.1


def test_the_decoder_takes_them_as_its_preset_says(tmp_path: Path) -> None:
    size: dict[str, float] = {}
    lines: list[str] = []
    for name, receptors in (("with", True), ("without", False), ("unknown", True)):
        narrow = {"diameter_outer_mm": 0.9, "diameter_hole_mm": 0.5} if name == "unknown" else {}
        accuracy = replace(PRESETS["draft"], receptors=receptors)
        context = Context(
            design=small(receptor=narrow),
            accuracy=accuracy,
            seed=0,
            folders={"views": tmp_path},
            progress=lines.append,
        )
        read_by = np.zeros(context.markers.count, dtype=np.int64)
        (camera,) = cameras_of(context.design, context.surface)
        slope = rigid_slope(
            camera.jacobian(context.markers.tip_mm),
            context.markers.tip_mm - context.markers.mid_mm,
        )
        seen = {
            "paint_point_mm": context.markers.tip_mm,
            "paint_slope": slope,
            "camera": read_by,
        }
        write_arrays(tmp_path, seen)
        out = tmp_path / name
        out.mkdir()
        run_response(context, out)
        done = replace(context, folders={"response": out})
        assert done.facts("response")["receptors"] == (name == "with")
        size[name] = float(np.linalg.norm(done.arrays("response")["compliance_px"]))
    assert 0.9 < size["with"] / size["without"] < 0.995
    (line,) = lines
    assert "the wall is taken as plain: receptor stiffness: tube diameter" in line
    used = "receptors" in RESPONSE.settings, "receptors" in TWIN.settings
    assert used == (True, False)  # the simulated truth has them whatever the preset


def test_cell_without_receptor_is_the_plain_wall() -> None:
    needs_cells()
    found = cell_stiffness(cell(height_mm=0.0, diameter_outer_mm=0.0, diameter_hole_mm=0.0))
    np.testing.assert_allclose(found.membrane, plain(0.38), atol=1e-5)
    np.testing.assert_allclose(found.bending, plain(0.38), atol=1e-5)
    np.testing.assert_allclose(found.coupling, 0.0, atol=1e-6)


def test_table_predicts_a_new_cell() -> None:
    needs_cells()
    receptor = {"height_mm": 1.7, "diameter_outer_mm": 3.0, "diameter_hole_mm": 1.6}
    one = cell(**receptor)
    found = cell_stiffness(one, size_mm=0.25)
    assert np.abs(found.membrane - found.membrane.T).max() < 2e-3  # Betti
    share = np.array(np.pi / 4 * 3.0**2 / (one.pitch_x_mm * one.pitch_y_mm))
    membrane, bending = receptor_effect(3.0 / 0.8, 1.6 / 3.0, 1.7 / 0.8)
    expected = mixture(share, membrane, MIXING_MEMBRANE), mixture(share, bending, MIXING_BENDING)
    assert ratio(found.membrane, 0.38) == pytest.approx(expected[0].item(), rel=CELL_TOL)
    assert ratio(found.bending, 0.38) == pytest.approx(expected[1].item(), rel=CELL_TOL)
    # Each of the two is far from the wall without receptors.
    assert ratio(found.membrane, 0.38) < 0.95
    assert ratio(found.bending, 0.38) > 1.08


@pytest.mark.parametrize("name", ["holes", "pins"])
def test_dense_cells_follow_the_mixture(name: str) -> None:
    # Where receptors fill a third of the wall the mixture's two shares differ by 4 to 8 %.
    needs_cells()
    hole, height = {"holes": (2.4, 0.0), "pins": (0.0, 2.0)}[name]
    one = cell(
        pitch_x_mm=4.5,
        pitch_y_mm=4.5,
        height_mm=height,
        diameter_outer_mm=3.0,
        diameter_hole_mm=hole,
    )
    found = cell_stiffness(one, size_mm=0.3)
    share = np.array(np.pi / 4 * (3.0 / 4.5) ** 2)
    membrane, bending = receptor_effect(3.0 / 0.8, hole / 3.0, height / 0.8)
    if name == "holes":
        expected = mixture(share, membrane, MIXING_MEMBRANE).item()
        assert ratio(found.membrane, 0.38) == pytest.approx(expected, rel=CELL_TOL)
    else:
        expected = mixture(share, bending, MIXING_BENDING).item()
        assert ratio(found.bending, 0.38) == pytest.approx(expected, rel=CELL_TOL)


def cell(**changes: float) -> Cell:
    """The middle rows of cylinder60: 5.2 × 11.8 mm."""
    base = {"pitch_x_mm": 5.217, "pitch_y_mm": 11.78, "thickness_mm": 0.8, "poisson": 0.38}
    return Cell(**(base | changes))
