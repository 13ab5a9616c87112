"""Equilibrium paths: published large displacements, invariance, controls, and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_design.mechanics.large import load_path, newton
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Control, Equilibrium, System
from phytac_design.mechanics.shell.solve import ShellModel
from tests.refusals import refused
from verification import large_shells as large_cases
from verification.path_tracing import trace_arc, trace_displacement

LENGTH = 10.0
TABLE = 0.01
"""The issue's tolerance: 1 % of the tabulated value (of the length where that is 0)."""


@pytest.mark.parametrize("moment", [False, True])
def test_cantilever(moment: bool) -> None:
    table = large_cases.END_MOMENT if moment else large_cases.END_FORCE
    found = large_cases.cantilever_tip(24, moment=moment)
    for factor, reference in table.items():
        np.testing.assert_allclose(found[factor], reference, rtol=TABLE, atol=1e-6 * LENGTH)


def test_hemisphere() -> None:
    # 24 elements a side: 1.2 % below the table at most; the benchmark shows 1 % at 40.
    found = large_cases.hemisphere_points(24)
    for factor, reference in large_cases.HEMISPHERE.items():
        np.testing.assert_allclose(found[factor], reference, rtol=0.0125)


def test_roof_snaps_through_under_displacement_control() -> None:
    model, load, middle = large_cases.hinged_roof(16, thickness=12.7)
    stops = [-11.293, -19.852, -25.0]
    path = trace_displacement(model, load, dof=6 * middle + 2, stops_mm=stops)
    limit, minimum, beyond = (state.load_factor for state in path)
    table = large_cases.ROOF[12.7]
    assert limit == pytest.approx(table["limit"], rel=TABLE)
    assert minimum == pytest.approx(table["minimum"], rel=0.02)  # 16 a side; finer: benchmark
    assert beyond > minimum
    assert [s.state.displacement_mm[middle, 2] for s in path] == pytest.approx(stops, abs=1e-9)


@pytest.mark.long
def test_roof_snaps_back_under_arc_length() -> None:
    turns = large_cases.roof_path(16, thickness=6.35).turns
    table = large_cases.ROOF[6.35]
    for key in ("limit", "farthest", "minimum", "back to"):
        assert turns[key] == pytest.approx(table[key], rel=TABLE), key


def strip() -> tuple[ShellModel, np.ndarray, int]:
    return large_cases.cantilever(8, moment=False)


def test_rotating_the_model_and_renumbering_its_nodes_change_nothing() -> None:
    model, load, tip = strip()
    rng = np.random.default_rng(0)
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    Q *= np.linalg.det(Q)
    new = rng.permutation(len(model.nodes_mm))  # new[k]: new number of node k
    old = np.argsort(new)
    turned = ShellModel(
        (model.nodes_mm @ Q.T)[old],
        np.roll(new[model.quads], 1, axis=1),
        (model.directors @ Q.T)[old],
        thickness_mm=0.1,
        modulus_MPa=1.2e6,
        poisson=0.0,
        fixed=model.fixed[old],
    )
    there = (load.reshape(-1, 2, 3) @ Q.T)[old]
    one = solve_large(model, load)[0].state.displacement_mm
    two = solve_large(turned, there.ravel())[0].state.displacement_mm
    np.testing.assert_allclose(two[new] @ Q, one, atol=1e-6)
    assert np.linalg.norm(one[tip]) > 0.7 * LENGTH


def test_a_tiny_load_gives_the_linear_answer() -> None:
    model, load, _ = strip()
    linear = model.solve(1e-9 * load).motion[:, :, 0]
    large = solve_large(model, 1e-9 * load)[0].state.motion
    np.testing.assert_allclose(large, linear, atol=1e-8 * np.abs(linear).max())


def test_reactions_balance_the_load() -> None:
    model, load, _ = strip()
    end = solve_large(model, load)[0]
    applied = load.reshape(-1, 6)
    np.testing.assert_allclose(end.reactions[:, :3].sum(axis=0), [0, 0, -4.0], atol=1e-4)
    place = model.nodes_mm + end.state.displacement_mm
    torque = np.cross(place, applied[:, :3] + end.reactions[:, :3]).sum(axis=0)
    np.testing.assert_allclose(torque + end.reactions[:, 3:].sum(axis=0), 0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("load", "code"),
    [
        (np.zeros(108), "load-zero"),
        (np.zeros(7), "load-vector-invalid"),
        (np.full(108, np.nan), "load-vector-invalid"),
    ],
)
def test_bad_loadings_are_refused(load: np.ndarray, code: str) -> None:
    with refused(code):
        solve_large(strip()[0], load)


def test_bad_controls_are_refused() -> None:
    model, load, _ = strip()
    for dof in (0, 3, 10_000):
        with refused("path-dof-invalid"):
            trace_displacement(model, load, dof=dof, stops_mm=[1.0])
    with refused("path-stop-not-finite"):
        solve_large(model, load, factors=[np.nan])
    with refused("tracing-increments-exhausted"):
        trace_arc(
            model,
            load,
            first_mm=0.1,
            longest_mm=0.1,
            stop=lambda _: False,
            max_increments=3,
        )


def test_what_does_not_converge_is_an_error_with_its_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, load, _ = strip()
    monkeypatch.setattr(newton, "SETTINGS", replace(newton.SETTINGS, max_iterations=1))
    with refused("no-equilibrium"):
        solve_large(model, load)
    with refused("path-ended-early"):
        trace_arc(model, load, first_mm=1.0, longest_mm=1.0, stop=lambda _: True)


@pytest.mark.parametrize(
    ("bound", "loosened", "figure"),
    [
        ("residual_tolerance", "step_tolerance", "residual"),
        ("step_tolerance", "residual_tolerance", "last_step"),
    ],
)
def test_either_tolerance_alone_stops_a_loose_answer(
    bound: str, loosened: str, figure: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        load_path, "PATH_DEVIATION_MAX", np.inf
    )  # it would refuse the loose answers, too
    model, load, _ = strip()
    usual = solve_large(model, load)[0]
    assert usual.residual <= 1e-6
    assert usual.last_step <= 1e-4
    tight = replace(newton.SETTINGS, **{loosened: np.inf, bound: 1e-9})
    monkeypatch.setattr(newton, "SETTINGS", tight)
    end = solve_large(model, load)[0]
    assert getattr(end, figure) <= 1e-9
    loose = replace(newton.SETTINGS, **{loosened: np.inf, bound: np.inf})
    monkeypatch.setattr(newton, "SETTINGS", loose)
    assert getattr(solve_large(model, load)[0], figure) > 1e-6


def test_a_failed_increment_is_cut_and_the_answer_is_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, load, tip = strip()
    whole = solve_large(model, load)[0].state.displacement_mm[tip]
    assert solve_large(model, load)[0].iterations > 4
    monkeypatch.setattr(newton, "SETTINGS", replace(newton.SETTINGS, max_iterations=4))
    cut = solve_large(model, load)[0].state.displacement_mm[tip]
    np.testing.assert_allclose(cut, whole, atol=1e-4 * LENGTH)


def test_the_line_search_alone_also_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    model, load, tip = strip()
    whole = solve_large(model, load)[0].state.displacement_mm[tip]
    plain = newton._iterate

    def only_searched(
        system: System, start: Equilibrium, control: Control, *, predict: bool
    ) -> Equilibrium:
        if predict:
            raise newton.NotConvergedError("left-out", "left out")
        return plain(system, start, control, predict=False)

    monkeypatch.setattr(newton, "_iterate", only_searched)
    other = solve_large(model, load)[0].state.displacement_mm[tip]
    np.testing.assert_allclose(other, whole, atol=1e-4 * LENGTH)


@pytest.mark.parametrize(("size", "stiffer"), [(1e-3, 1.0), (1e4, 1e-9), (1.0, 1e6)])
def test_units_make_no_difference(size: float, stiffer: float) -> None:
    model, load, tip = strip()
    scaled = ShellModel(
        size * model.nodes_mm,
        model.quads,
        model.directors,
        thickness_mm=0.1 * size,
        modulus_MPa=1.2e6 * stiffer,
        poisson=0.0,
        fixed=model.fixed,
    )
    one = solve_large(model, load)[0]
    two = solve_large(scaled, size**2 * stiffer * load)[0]
    moved = two.state.displacement_mm[tip] / size
    np.testing.assert_allclose(moved, one.state.displacement_mm[tip], atol=1e-9 * LENGTH)
    assert one.iterations == two.iterations


def test_a_shell_too_thin_for_the_digits_there_are_is_refused() -> None:
    model, load, _ = strip()
    thin = ShellModel(
        model.nodes_mm,
        model.quads,
        model.directors,
        thickness_mm=1e-5,
        modulus_MPa=1.2e6,
        poisson=0.0,
        fixed=model.fixed,
    )
    with refused("stiffness-ill-conditioned"):
        solve_large(thin, 1e-12 * load)
