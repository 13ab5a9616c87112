"""The wall of one virtual sensor under the touches of a sample, whatever they are."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.pressure import Holes, indentation_loads
from phytac_design.mechanics.shell.receptor_stiffness import unknown_receptors
from phytac_design.simulation import instance_shell as shell_module
from phytac_design.simulation import solver as solver_module
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.instance_shell import (
    instance_model,
    instance_shells,
    local_mesh,
    truth_levels,
    truth_mesh,
    truth_shell,
)
from phytac_design.simulation.linear_response import point_motions, turned_points
from phytac_design.simulation.pressed_series import RATIO_MAX
from phytac_design.simulation.receptor_kinematics import ReceptorKinematics
from phytac_design.simulation.sample_plan import ChartBox
from phytac_design.simulation.scenario.contact_placement import contact_box
from phytac_design.simulation.scenario.instance_scatter import (
    draw_sensor_instance,
)
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from phytac_design.simulation.sensor_instance import SensorInstance, thickness_factor
from phytac_design.simulation.solver import Displacement, SampleMotion, Solver, _LinearMotion
from phytac_shapes.errors import NumericalError
from tests.designs import small
from verification.quadratic_shell import element_uv

DESIGN = small()
SURFACE = DESIGN.surface()
REFINE = 3
MIDDLE = (30.0, np.pi)


def unit_of(design: Design, number: int = 0, **changes: Any) -> SensorInstance:
    surface = design.surface()
    section = SensorInstanceSection(number=number, **changes)
    return draw_sensor_instance(
        Sensor.of(design, surface, make_markers(design, surface)), section, seed=5
    )


def touching(*rows: tuple[float, float, float, float]) -> Contacts:
    """Contacts (u, v, radius, force) of one sample."""
    table = np.array(rows, dtype=float).reshape(-1, 4)
    return Contacts.flat(
        sample=np.zeros(len(table), dtype=np.int64),
        uv=table[:, :2],
        radius_mm=table[:, 2],
        force_N=table[:, 3],
        samples=1,
    )


def solved(solver: Solver, *rows: tuple[float, float, float, float]) -> SampleMotion:
    touches = touching(*rows)
    return solver.solve(touches, touches.force_N)


def got(motion: SampleMotion) -> np.ndarray:
    assert motion.motion is not None, motion.reason
    return motion.motion


@pytest.fixture(scope="module", params=[REFINE, 6], ids=["one mesh", "two meshes"])
def large(request: pytest.FixtureRequest) -> Solver:
    return Solver(DESIGN, SURFACE, unit_of(DESIGN), refine=request.param, displacement="large")


@pytest.mark.parametrize("name", ["small", "hemisphere"])
def test_instance_zero_is_the_design(name: str) -> None:
    design = DESIGN if name == "small" else load_design(name)
    surface = design.surface()
    mesh, model = truth_shell(design, surface, 2)
    (mine, own), pair = instance_shells(design, surface, unit_of(design), 2)
    assert pair is None
    np.testing.assert_array_equal(mine.nodes_mm, mesh.nodes_mm)
    np.testing.assert_array_equal(mine.quads, mesh.quads)
    np.testing.assert_array_equal(own.stiffness.data, model.stiffness.data)


def test_a_print_has_its_own_wall_material_and_receptors() -> None:
    unit = unit_of(DESIGN)
    mesh = truth_mesh(DESIGN, SURFACE, REFINE)
    plain = instance_model(DESIGN, SURFACE, unit, mesh)
    soft = instance_model(DESIGN, SURFACE, replace(unit, modulus=0.8), mesh)
    np.testing.assert_allclose(soft.stiffness.data, 0.8 * plain.stiffness.data, atol=1e-9)
    thick = instance_model(DESIGN, SURFACE, replace(unit, wall=replace(unit.wall, mean=1.1)), mesh)
    np.testing.assert_allclose(thick.thickness_mm, 1.1 * np.asarray(plain.thickness_mm))
    # Walls of varying thickness: each element has that of its place, also over the seam.
    uneven = unit_of(DESIGN, 3, marker_mm=0.0, height_mm=0.0, thickness_wave_share=0.05).wall
    wavy = instance_model(DESIGN, SURFACE, replace(unit, wall=uneven), mesh)
    ratio = np.asarray(wavy.thickness_mm) / np.asarray(plain.thickness_mm)
    centre = element_uv(mesh).mean(axis=1)
    np.testing.assert_allclose(ratio, thickness_factor(uneven, centre), atol=1e-9)
    assert np.ptp(ratio) > 0.05
    # Receptors stiffen the wall where they are printed, and are read there.
    assert not unknown_receptors(DESIGN)
    moved = replace(
        unit_of(DESIGN, 3, marker_mm=1.0, height_mm=0.0), wall=unit.wall, modulus=unit.modulus
    )
    there = Solver(DESIGN, SURFACE, moved, refine=REFINE, displacement="linear")
    assert np.abs(there.model.stiffness - plain.stiffness).max() > 0.01 * plain.stiffness.max()
    touches = touching((*MIDDLE, 4.0, 5.0))
    receptor = DESIGN.receptor
    holes = Holes.of(SURFACE, moved.markers.uv, receptor.diameter_hole_mm / 2.0)
    load = indentation_loads(there.mesh, SURFACE, touches, holes=holes) @ touches.force_N
    field = there.model.solve(load).motion.ravel()
    receptors = ReceptorKinematics(
        there.mesh, SURFACE, moved.markers.uv, receptor.diameter_outer_mm / 2.0
    )
    at = receptors.linear(field)
    np.testing.assert_allclose(got(there.solve(touches, touches.force_N)), at, atol=1e-12)


def test_rest_linear_large_and_auto(large: Solver) -> None:
    for still in (solved(large), large.solve(touching((*MIDDLE, 4.0, 9.0)), np.zeros(1))):
        assert (still.status, still.theory, still.error_estimate) == ("ok", "rest", 0.0)
        assert got(still).shape == (large.count, 6)
        assert not got(still).any()
    quads = {len(truth_mesh(DESIGN, SURFACE, n).quads): n for n in (REFINE, 6)}
    refine = quads[len(large.mesh.quads)]
    whole: dict[str, Any] = {"refine": refine, "local": False}
    unit = unit_of(DESIGN)
    linear = Solver(DESIGN, SURFACE, unit, displacement="linear", **whole)
    a, b = (*MIDDLE, 4.0, 20.0), (15.0, 0.3, 5.0, 9.0)
    both = solved(linear, a, b)
    assert both.theory == "linear"
    assert np.isnan(both.error_estimate)
    np.testing.assert_allclose(
        got(both), got(solved(linear, a)) + got(solved(linear, b)), atol=1e-12
    )
    assert both.status == "ok"
    deep = solved(linear, (*MIDDLE, 4.0, 200.0))
    assert (deep.status, deep.theory) == ("flagged", "linear")
    assert "more than its thickness of 0.8 mm" in deep.reason
    np.testing.assert_allclose(got(deep), 10.0 * got(solved(linear, a)), rtol=1e-9)
    strong = solved(large, a, b)
    assert strong.theory == "large"
    apart = np.linalg.norm(got(strong)[:, :3] - got(both)[:, :3], axis=1).max()
    peak = np.linalg.norm(got(strong)[:, :3], axis=1).max()
    assert 0.05 < apart / peak < 0.5
    auto = Solver(DESIGN, SURFACE, unit, displacement="auto", tolerance=0.02, **whole)
    light, heavy = solved(auto, (*MIDDLE, 4.0, 0.5)), solved(auto, a, b)
    assert light.theory == "linear"
    assert 0.0 < light.error_estimate <= 0.02
    np.testing.assert_array_equal(got(light), got(solved(linear, (*MIDDLE, 4.0, 0.5))))
    assert heavy.theory == "large"
    np.testing.assert_array_equal(got(heavy), got(strong))


@pytest.mark.parametrize(
    "rows",
    [
        [(*MIDDLE, 4.0, 0.05)],
        [(*MIDDLE, 5.0, 60.0)],
        [(0.0, 1.0, 4.0, 60.0), (60.0, 4.0, 4.0, 25.0)],  # on both rims
        [(30.0, 0.0, 4.0, 20.0), (20.0, 2.0 * np.pi, 4.0, 10.0)],  # on the seam
        [(u, v, 4.0, 10.0) for u in (8.0, 20.0, 40.0, 52.0) for v in (0.2, 1.5, 2.7, 4.0, 5.2)],
        [(*MIDDLE, 40.0, 25.0)],  # wider than the sensor
    ],
    ids=["light", "60 N", "rims", "seam", "200 N all over", "wide"],
)
def test_extremes_are_solved(large: Solver, rows: list[tuple[float, float, float, float]]) -> None:
    found = solved(large, *rows)
    assert (found.status, found.reason, found.theory) == ("ok", "", "large")
    assert found.error_estimate <= 1e-4
    # Half a step of the force ahead and back brings the linear motion back, so nothing snapped.
    half = large.solve(touching(*rows), 1e-3 * touching(*rows).force_N)
    ratio = np.linalg.norm(got(found)) / (1e3 * np.linalg.norm(got(half)))
    assert 0.8 < ratio < 2.0


def force_seen(found: SampleMotion, truth: np.ndarray) -> float:
    """Force that the motion stands for over the true one, as least squares see it."""
    moved = got(found)[:, :3]
    return float(np.vdot(truth, moved) / np.vdot(truth, truth))


@pytest.mark.parametrize(
    ("number", "displacement", "at_most"),
    [(0, "linear", 0.35), pytest.param(3, "large", 0.6, marks=pytest.mark.long)],
)
def test_motion_is_that_of_a_much_finer_mesh(
    number: int,
    displacement: Displacement,
    at_most: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By force, and for the tip that is worst, over the error of the mesh alone."""
    unit = unit_of(DESIGN, number)

    def solver(refine: int, *, extrapolate: bool) -> Solver:
        return Solver(
            DESIGN,
            SURFACE,
            unit,
            refine=refine,
            displacement=displacement,
            extrapolate=extrapolate,
        )

    rows = [(*MIDDLE, 4.0, 20.0), (12.0, 0.5, 4.0, 12.0)]
    plain, mine = solver(7, extrapolate=False), solver(7, extrapolate=True)
    finer = [got(solved(solver(n, extrapolate=False), *rows))[:, :3] for n in (12, 6)]
    truth = finer[0] + (finer[0] - finer[1]) / 3.0
    off = [abs(force_seen(solved(each, *rows), truth) - 1.0) for each in (plain, mine)]
    assert off[0] > 0.005
    assert off[1] < at_most * off[0]
    peak = np.linalg.norm(truth, axis=1).max()
    worst = [
        np.linalg.norm(got(solved(each, *rows))[:, :3] - truth, axis=1).max() / peak
        for each in (plain, mine)
    ]
    assert worst[1] < at_most * worst[0]
    # With a correction alone, and no more force, large displacements stay as stiff as the mesh.
    monkeypatch.setattr(solver_module, "force_ratio", lambda *_: 1.0)
    added = abs(force_seen(solved(mine, *rows), truth) - 1.0)
    assert displacement == "linear" or off[1] < 0.9 * added


def test_a_little_force_moves_the_wall_by_the_extrapolated_linear_motion() -> None:
    unit = unit_of(DESIGN)
    large, linear = (
        Solver(DESIGN, SURFACE, unit, refine=6, displacement=theory)
        for theory in ("large", "linear")
    )
    touch = touching((*MIDDLE, 4.0, 1e-4))
    a, b = (got(each.solve(touch, touch.force_N)) for each in (large, linear))
    np.testing.assert_allclose(a, b, atol=1e-3 * np.abs(b).max())


@pytest.mark.parametrize(("found", "used"), [(-3.0, 1.0 / RATIO_MAX), (9.0, RATIO_MAX)])
def test_meshes_that_differ_much_do_not_change_the_force_by_more_than_half(
    found: float, used: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    solver = Solver(DESIGN, SURFACE, unit_of(DESIGN), refine=6, displacement="large")
    monkeypatch.setattr(solver_module, "force_ratio", lambda *_: used)
    expected = got(solved(solver, (*MIDDLE, 4.0, 5.0)))
    monkeypatch.setattr(solver_module, "force_ratio", lambda *_: found)
    np.testing.assert_array_equal(got(solved(solver, (*MIDDLE, 4.0, 5.0))), expected)


def test_a_correction_is_scaled_down_where_the_wall_stiffens() -> None:
    one = np.ones((2, 6))
    limit = _LinearMotion(extrapolated=1.2 * one, own=one, ratio=1.1)
    np.testing.assert_allclose(limit.corrected(0.6 * one), 0.6 + 0.5 * (1.2 - 1.1))
    np.testing.assert_allclose(limit.corrected(2.4 * one), 2.4 + (1.2 - 1.1))


@pytest.mark.parametrize("displacement", ["linear", "large"])
def test_too_coarse_a_mesh_is_not_extrapolated(displacement: Displacement) -> None:
    assert [truth_levels(n) for n in (1, 4, 5)] == [None] * 3
    assert [truth_levels(n) for n in (6, 7, 9, 13)] == [(6, 4), (7, 4), (9, 5), (13, 7)]
    unit = unit_of(DESIGN)
    a, b = (
        Solver(DESIGN, SURFACE, unit, refine=5, displacement=displacement, extrapolate=extrapolate)
        for extrapolate in (False, True)
    )
    row = (*MIDDLE, 4.0, 20.0)
    np.testing.assert_array_equal(got(solved(a, row)), got(solved(b, row)))


def test_what_cannot_be_solved_says_why(large: Solver, monkeypatch: pytest.MonkeyPatch) -> None:
    for rows, reason in (
        ([(*MIDDLE, 4.0, 5000.0)], "too strong for this wall"),
        ([(*MIDDLE, 4.0, np.nan)], "not finite"),
        ([(*MIDDLE, 4.0, 1e300)], "too strong for this wall"),
        ([(61.0, 1.0, 4.0, 5.0)], "u"),
        ([(*MIDDLE, -1.0, 5.0)], "radius"),
    ):
        found = solved(large, *rows)
        assert (found.status, found.motion) == ("failed", None)
        assert reason in found.reason
        assert np.isnan(found.error_estimate)

    def broken(*_: Any, **__: Any) -> None:
        raise NumericalError("no-such-luck", "no such luck")

    monkeypatch.setattr(solver_module, "indentation_loads", broken)
    assert solved(large, (*MIDDLE, 4.0, 5.0)).reason == "no such luck"


def test_samples_do_not_know_each_other(large: Solver) -> None:
    rows = [(*MIDDLE, 4.0, 25.0), (10.0, 1.0, 3.0, 12.0), (45.0, 5.0, 5.0, 3.0)]
    first = [got(solved(large, row)) for row in rows]
    again = [got(solved(large, row)) for row in rows[::-1]][::-1]
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)


TOUCHED = {
    "quarter": touching(*((u, v, 3.0, 12.0) for u in (3.0, 30.0, 57.0) for v in (2.5, 3.8))),
    "over the seam": touching(*((u, v, 3.0, 12.0) for u in (12.0, 48.0) for v in (6.0, 0.5))),
    "rim": touching((4.0, 3.0, 3.0, 12.0), (9.0, 3.6, 3.0, 20.0)),
}


def on_one_mesh(refine: int) -> Solver:
    return Solver(
        DESIGN, SURFACE, unit_of(DESIGN), refine=refine, displacement="linear", extrapolate=False
    )


@pytest.fixture(scope="module")
def finest() -> Solver:
    return on_one_mesh(11)


@pytest.fixture(scope="module")
def coarse() -> Solver:
    return on_one_mesh(6)


@pytest.mark.parametrize("where", TOUCHED)
def test_only_the_touched_part_is_fine(where: str, finest: Solver) -> None:
    touches, refine = TOUCHED[where], 5
    region = contact_box(SURFACE, touches.uv, touches.radius_mm)
    unit = unit_of(DESIGN)
    both = [
        Solver(
            DESIGN,
            SURFACE,
            unit,
            refine=refine,
            displacement="linear",
            region=part,
            extrapolate=False,
        )
        for part in (region, None)
    ]
    part, whole = both
    assert part.nodes < 0.8 * whole.nodes
    assert part.mesh.scaled_jacobian().min() > 0.99

    def sides(mesh: ShellMesh) -> np.ndarray:
        corner = mesh.nodes_mm[mesh.quads]
        return np.asarray(np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1))

    centre = part.mesh.nodes_mm[part.mesh.quads].mean(axis=1)
    gap = np.linalg.norm(centre[:, None] - SURFACE.point(touches.uv), axis=2).min(axis=1)
    fine = sides(whole.mesh).max()
    assert sides(part.mesh)[gap < 6.0].max() < 1.02 * fine
    assert 1.5 * fine < sides(part.mesh).max() < 2.6 * fine
    a, b, truth = (got(one.solve(touches, touches.force_N))[:, :3] for one in (*both, finest))
    peak = np.linalg.norm(truth, axis=1).max()
    local, fine = (np.linalg.norm(found - truth, axis=1).max() / peak for found in (a, b))
    assert local < 1.5 * fine + 0.005
    assert fine < 0.1


@pytest.mark.parametrize("refine", [6, 9])
@pytest.mark.parametrize("where", TOUCHED)
def test_the_touched_part_is_extrapolated(
    where: str, refine: int, finest: Solver, coarse: Solver
) -> None:
    touches, unit = TOUCHED[where], unit_of(DESIGN)
    region = contact_box(SURFACE, touches.uv, touches.radius_mm)
    linear = partial(
        Solver, DESIGN, SURFACE, unit, refine=refine, displacement="linear", region=region
    )
    nearer = got(finest.solve(touches, touches.force_N))[:, :3]
    other = got(coarse.solve(touches, touches.force_N))[:, :3]
    truth = nearer + (nearer - other) / ((11.0 / 6.0) ** 2 - 1.0)
    plain, mine = (
        abs(force_seen(linear(extrapolate=each).solve(touches, touches.force_N), truth) - 1.0)
        for each in (False, True)
    )
    assert mine < (0.85 if (where, refine) == ("rim", 6) else 0.6) * plain
    _, pair = instance_shells(DESIGN, SURFACE, unit, refine, region)
    _, whole = instance_shells(DESIGN, SURFACE, unit, refine)
    assert pair is not None
    assert whole is not None
    assert pair.ratio == whole.ratio
    # Both are fine in that part alone.
    for part, full in zip(pair.each, whole.each, strict=True):
        assert len(part[0].quads) < 0.85 * len(full[0].quads)


def test_both_meshes_are_local_or_neither() -> None:
    low, high = SURFACE.domain.T
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    seen = set()
    for share in (0.2, 0.35, 0.5, 0.65, 0.8):
        region = ChartBox(
            low=middle - share * half, high=middle + share * half, whole=np.zeros(2, bool)
        )
        _, pair = instance_shells(DESIGN, SURFACE, unit_of(DESIGN), 9, region)
        assert pair is not None
        fine, coarse = (
            len(mesh.quads) < len(truth_mesh(DESIGN, SURFACE, n).quads)
            for (mesh, _), n in zip(pair.each, (9, 5), strict=True)
        )
        assert fine == coarse
        seen.add(fine)
    assert seen == {False, True}


def test_a_coarser_mesh_that_is_refused_is_done_without(monkeypatch: pytest.MonkeyPatch) -> None:
    made, row = shell_module.truth_mesh, (*MIDDLE, 4.0, 20.0)
    plain = solved(Solver(DESIGN, SURFACE, unit_of(DESIGN), refine=6, extrapolate=False), row)

    def refused(missing: int) -> Any:
        def make(design: Any, surface: Any, refine: int, markers: Any = None) -> ShellMesh:
            if refine == missing:
                raise NumericalError("mesh-distorted", "its elements are too irregular")
            return made(design, surface, refine, markers)

        return make

    monkeypatch.setattr(shell_module, "truth_mesh", refused(4))
    found = solved(Solver(DESIGN, SURFACE, unit_of(DESIGN), refine=6), row)
    np.testing.assert_array_equal(got(found), got(plain))
    # Nor is anything divided by the difference of two meshes that are alike.
    monkeypatch.setattr(shell_module, "truth_mesh", lambda *given: made(*given[:2], 6, given[3]))
    found = solved(Solver(DESIGN, SURFACE, unit_of(DESIGN), refine=6), row)
    np.testing.assert_array_equal(got(found), got(plain))
    monkeypatch.setattr(shell_module, "truth_mesh", refused(6))
    with pytest.raises(NumericalError):
        Solver(DESIGN, SURFACE, unit_of(DESIGN), refine=6)


def test_where_a_local_mesh_is_none() -> None:
    mesh = truth_mesh(DESIGN, SURFACE, REFINE)
    all_over = ChartBox(low=SURFACE.domain[:, 0], high=SURFACE.domain[:, 1], whole=np.ones(2, bool))
    nearly = replace(all_over, low=np.array([2.0, 0.0]), whole=np.array([False, True]))
    for region in (all_over, nearly):
        assert local_mesh(DESIGN, SURFACE, mesh, region) is mesh
    dome = load_design("hemisphere")
    surface = dome.surface()
    small_part = replace(all_over, high=all_over.low + 0.1, whole=np.zeros(2, bool))
    whole = truth_mesh(dome, surface, 2)
    assert local_mesh(dome, surface, whole, small_part) is whole
    sheet = load_design("patch")
    face = sheet.surface()
    spot = contact_box(face, face.domain.mean(axis=1)[None], np.array([4.0]))
    whole = truth_mesh(sheet, face, 4)
    assert len(local_mesh(sheet, face, whole, spot).nodes_mm) < 0.8 * len(whole.nodes_mm)


def test_points_on_rigid_arms_turn_with_the_wall() -> None:
    rng = np.random.default_rng(3)
    arm, shift = rng.normal(size=(7, 3)), rng.normal(size=(7, 3))
    turn = np.array([0.0, 0.0, np.pi / 2.0])
    found = turned_points(np.column_stack([shift, np.tile(turn, (7, 1))]), arm)
    quarter = np.column_stack([-arm[:, 1], arm[:, 0], arm[:, 2]])
    np.testing.assert_allclose(found, shift + quarter - arm, atol=1e-14)
    tiny = np.column_stack([1e-9 * shift, 1e-9 * rng.normal(size=(7, 3))])
    np.testing.assert_allclose(turned_points(tiny, arm), point_motions(tiny, arm), atol=1e-16)
