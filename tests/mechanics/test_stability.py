"""Stability of converged states, and jumps that must not pass unseen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from phytac_design.mechanics.large import load_path
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Equilibrium, System
from phytac_design.mechanics.large.stability import negative_pivots, path_deviation
from phytac_design.mechanics.shell.solve import SUPERLU, ShellModel
from tests.refusals import refused
from verification import large_shells as large_cases
from verification.path_tracing import trace_arc, trace_displacement

LIMIT = 0.7408
"""Limit load of the thick roof at 8 elements a side (its own arc-length path)."""


@pytest.fixture(scope="module")
def roof() -> tuple[ShellModel, np.ndarray, int]:
    return large_cases.hinged_roof(8, thickness=12.7)


def sag(state: Equilibrium, middle: int) -> float:
    return float(-state.state.displacement_mm[middle, 2])


def exact_negatives(model: ShellModel, load: np.ndarray, state: Equilibrium) -> int:
    system = System(model, load)
    local = system.shell.local(state.state)
    K = system.shell.tangent(local).toarray()
    K = (system.scale[:, None] * K * system.scale)[np.ix_(system.free, system.free)]
    return int(np.sum(np.linalg.eigvalsh(0.5 * (K + K.T)) < 0.0))


@pytest.mark.parametrize("negative", [0, 1, 7, 40])
@pytest.mark.parametrize("zero_diagonal", [False, True])
def test_pivots_count_negative_eigenvalues(negative: int, zero_diagonal: bool) -> None:
    rng = np.random.default_rng(negative)
    Q = np.linalg.qr(rng.normal(size=(40, 40)))[0]
    values = rng.uniform(0.5, 2.0, 40) * np.where(np.arange(40) < negative, -1.0, 1.0)
    A = (Q * values) @ Q.T
    if zero_diagonal:  # SuperLU has to leave the diagonal
        A[np.diag_indices(40)] = np.where(np.arange(40) % 3 == 0, 0.0, A.diagonal())
        A[0, 0] = 1e-12
    matrix = csc_matrix(0.5 * (A + A.T))
    expected = int(np.sum(np.linalg.eigvalsh(matrix.toarray()) < 0.0))
    found = negative_pivots(splu(matrix, **SUPERLU), matrix)
    if zero_diagonal:
        assert found in (expected, None)
    else:
        assert found == expected


def test_pivots_off_the_diagonal_are_put_back_or_not_believed() -> None:
    for corner, expected in ((1e-3, 1), (0.0, None)):
        matrix = csc_matrix(np.array([[corner, 1.0], [1.0, 2.0 * corner]]))
        factor = splu(matrix, **(SUPERLU | {"diag_pivot_thresh": 1.0}))
        assert not np.array_equal(factor.perm_r, factor.perm_c)
        assert negative_pivots(factor, matrix) == expected


def test_arc_length_finds_the_roof_unstable_between_its_limit_points(
    roof: tuple[ShellModel, np.ndarray, int],
) -> None:
    model, load, middle = roof
    states = trace_arc(
        model,
        load,
        first_mm=0.5,
        longest_mm=1.0,
        stop=lambda s: sag(s, middle) > 25.0,
    )
    factor = np.array([s.load_factor for s in states])
    stable = np.array([s.stable for s in states])
    top, bottom = int(np.argmax(factor[: len(factor) // 2])), int(np.argmin(factor[3:])) + 3
    # The state nearest to a limit point may lie on either side of it.
    assert stable[:top].all()
    assert not stable[top + 1 : bottom].any()
    assert stable[bottom + 1 :].all()
    assert bottom - top > 3
    assert not any(s.jumped for s in states)
    for state in states[::4]:
        assert state.negative_pivots == exact_negatives(model, load, state)


def test_displacement_control_passes_the_limit_without_a_jump(
    roof: tuple[ShellModel, np.ndarray, int],
) -> None:
    model, load, middle = roof
    stops = [-8.0, -15.0, -24.0]
    states = trace_displacement(model, load, dof=6 * middle + 2, stops_mm=stops)
    assert [s.stable for s in states] == [True, False, True]
    assert not any(s.jumped for s in states)


def test_displacement_control_across_a_snap_back_is_marked() -> None:
    model, load, middle = large_cases.hinged_roof(8, thickness=6.35)
    stops = [-10.0, -16.0, -18.5]
    states = trace_displacement(model, load, dof=6 * middle + 2, stops_mm=stops)
    assert [s.jumped for s in states] == [False, False, True]


@pytest.mark.parametrize(
    "share",
    [*(pytest.param(share, marks=pytest.mark.long) for share in (0.3, 0.9)), 0.99, 1.05, 2.0],
)
def test_load_control_marks_what_lies_beyond_the_limit(
    roof: tuple[ShellModel, np.ndarray, int], share: float
) -> None:
    model, load, middle = roof
    end, after = solve_large(model, load, factors=[share * LIMIT, share * LIMIT + 0.02])
    assert end.jumped == (share > 1.0)
    assert (sag(end, middle) > 20.0) == (share > 1.0)
    assert end.stable
    assert after.jumped == (share * LIMIT + 0.02 > LIMIT)


@pytest.mark.long
def test_a_sharp_bend_of_the_path_is_no_jump() -> None:
    """The pulled cylinder: past half its load the path bends sharply; its dip is 0.001 deep."""
    model, load, top = large_cases.open_cylinder(16, 12)
    states = solve_large(model, load, factors=[0.5, 0.52, 0.6])
    assert not any(s.jumped for s in states)
    assert all(s.stable for s in states)
    path = trace_arc(model, load, first_mm=0.1, longest_mm=0.03, stop=lambda s: s.load_factor > 0.6)
    factor = np.array([s.load_factor for s in path])
    pulled = np.array([s.state.displacement_mm[top, 2] for s in path])
    for state in states:
        above = int(np.argmax(factor > state.load_factor))
        assert pulled[above - 1] < state.state.displacement_mm[top, 2] < pulled[above]


def test_a_sharp_bend_is_marked_without_a_path_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    model, load, _ = large_cases.open_cylinder(16, 12)
    monkeypatch.setattr(load_path, "_follow", lambda *_: None)
    assert [s.jumped for s in solve_large(model, load, factors=[0.5, 0.6])] == [False, True]


def test_a_shallow_arch_snaps() -> None:
    model, load, crown = large_cases.hinged_arch(16)
    stops = np.arange(-0.25, -2.0, -0.25)
    path = trace_displacement(model, load, dof=6 * crown + 2, stops_mm=stops)
    assert [s.negative_pivots for s in path] == [0, 0, 0, 0, 0, 1, 1]
    limit = max(s.load_factor for s in path)
    (below,) = solve_large(model, load, factors=[0.97 * limit])
    (above,) = solve_large(model, load, factors=[1.5 * limit])
    assert (below.jumped, above.jumped) == (False, True)
    assert sag(below, crown) < 1.25
    assert sag(above, crown) > 5.0


def test_without_the_guard_the_same_jump_is_silent(
    roof: tuple[ShellModel, np.ndarray, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, load, middle = roof
    monkeypatch.setattr(load_path, "PATH_DEVIATION_MAX", np.inf)
    end = solve_large(model, load, factors=[1.05 * LIMIT])[0]
    assert sag(end, middle) > 20.0
    assert not end.jumped


def test_a_pressed_shell_and_a_bending_strip_are_not_marked() -> None:
    strip, force, _ = large_cases.cantilever(8, moment=False)
    rolled, moment, _ = large_cases.cantilever(12, moment=True)
    for model, load in ((strip, force), (rolled, moment)):
        end = solve_large(model, load)[0]
        assert (end.stable, end.jumped) == (True, False)


def test_the_path_check_rejects_a_changed_sign_and_a_control_that_does_not_move(
    roof: tuple[ShellModel, np.ndarray, int],
) -> None:
    before, after = solve_large(roof[0], roof[1], factors=[0.3, 0.33])
    check = load_path.PathCheck(pace=lambda _: 1.0, mark=lambda state: state.negative_pivots)
    still = load_path.PathCheck(pace=lambda _: 0.0, mark=lambda state: state.negative_pivots)
    assert not check.deviates(before, after, 0.03)
    assert check.deviates(before, replace(after, negative_pivots=1), 0.03)
    assert check.deviates(before, after, 0.003)
    assert still.deviates(before, after, 0.03)


def test_increments_do_not_go_on_for_ever(
    roof: tuple[ShellModel, np.ndarray, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(load_path, "SETTINGS", replace(load_path.SETTINGS, max_increments=2))
    with refused("no-equilibrium"):
        solve_large(roof[0], roof[1], factors=[0.99 * LIMIT])


def test_stray_is_zero_on_a_straight_path_and_of_second_order_on_a_curved_one() -> None:
    def departure(step: float) -> float:
        at = np.array([1.0, 1.0 + step])
        x, rate = np.stack([np.exp(at), np.sin(at)], 1), np.stack([np.exp(at), np.cos(at)], 1)
        return path_deviation(x[1] - x[0], step * rate[0], step * rate[1])

    one = np.ones(3)
    assert path_deviation(2.0 * one, 2.0 * one, 2.0 * one) == 0.0
    assert np.log2(departure(0.1) / departure(0.05)) == pytest.approx(2.0, abs=0.1)
    assert path_deviation(100.0 * one, one, one) == pytest.approx(0.99)
