"""Settings by tolerance and by budget: chosen, rejected, predicted and achieved."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phytac_design.design.accuracy import PRESETS, RANGES, Accuracy
from phytac_design.engine.stage import Stage
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.compliance import turns_of
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model, unknown_receptors
from phytac_design.simulation.instance_shell import truth_mesh
from phytac_design.stages import STAGES
from phytac_design.study.planning.cost import Workload, features, fit
from phytac_design.study.planning.unit_costs import WALL_s
from phytac_design.study.tradeoff import budget as budget_module
from phytac_design.study.tradeoff import choose as choose_module
from phytac_design.study.tradeoff.budget import (
    GROUPS,
    LEVELS,
    BudgetPlan,
    choose_budget,
    fields_used_by,
    run_budget,
)
from phytac_design.study.tradeoff.build_to import (
    audit_lines,
    read_seconds,
    read_tolerance,
    write_audit,
)
from phytac_design.study.tradeoff.choose import achieved, choose_tolerance, wall_seconds
from phytac_design.study.tradeoff.force import ForceError
from phytac_design.study.tradeoff.pilot import ForcePilot
from tests.designs import DRAWN, drawn, small
from tests.refusals import refused

DRAFT = PRESETS["draft"]


@pytest.fixture(scope="module")
def error() -> ForceError:
    return ForceError(drawn("hemisphere", 1), count=6)


def test_work_on_the_simulated_sensor_is_that_of_its_meshes() -> None:
    design, surface = small(), small().surface()
    work = Workload(design)
    each = {n: len(truth_mesh(design, surface, n).nodes_mm) for n in (4, 5, 6)}
    assert work.truth_nodes(5) == each[5]
    assert work.truth_nodes(6) == each[6] + each[4]


@pytest.mark.long
def test_tighter_tolerances_cost_more_and_hold(error: ForceError) -> None:
    choices = [
        choose_tolerance(error.design, tolerance, error=error) for tolerance in (0.2, 0.08, 0.04)
    ]
    cost = [choice.seconds for choice in choices]
    assert cost == sorted(cost)
    assert choices[0].accuracy != choices[2].accuracy
    for choice in choices:
        assert choice.predicted_error is not None
        assert achieved(choice, error) <= choice.predicted_error <= choice.wanted
        others = replace(
            choice.accuracy,
            **{k: getattr(DRAFT, k) for k in ("refine", "place_orders", "place_share")},
        )
        assert others == replace(DRAFT, tools=True)


def test_unreachable_tolerance_is_rejected_with_the_best(
    error: ForceError, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = [replace(DRAFT, refine=refine) for refine in (2, 3)]
    monkeypatch.setattr(choose_module, "pilot_of", lambda _, error: (ForcePilot(error), few))
    with refused("tolerance-not-reachable"):
        choose_tolerance(error.design, 1e-7, error=error)
    for bad in (0.0, -0.1, 1.5, float("nan")):
        with refused("tolerance-invalid"):
            choose_tolerance(error.design, bad, error=error)


@pytest.mark.parametrize("of", ["volume", "visibility"])
def test_other_quantities_hold_too(of: str) -> None:
    error = ForceError(drawn("hemisphere", 1), count=2)
    tolerance = {"volume": 2e-3, "visibility": 0.1}[of]
    choice = choose_tolerance(error.design, tolerance, of=of, error=error)  # type: ignore[arg-type]
    assert achieved(choice, error) <= tolerance
    assert choice.accuracy.refine == DRAFT.refine or of == "visibility"


def test_unit_costs_match_the_amounts() -> None:
    design = drawn("plane", 1)
    amounts = features(Workload(design).counts(DRAFT), DRAFT, design)
    assert set(amounts) == set(WALL_s) == {stage.name for stage in STAGES}
    for name, own in amounts.items():
        assert set(WALL_s[name]) <= set(own), name
        assert min(own.values()) >= 0.0


def test_cost_rises_with_every_setting() -> None:
    work = Workload(small())
    for finer in (
        replace(DRAFT, refine=6),
        replace(DRAFT, place_orders=3),
        replace(DRAFT, place_orders=3, place_share=0.4),
        replace(DRAFT, frames=50),
        replace(DRAFT, press_tolerance=0.05),
        replace(DRAFT, truth_refine=9),
        replace(DRAFT, tools=True),
    ):
        assert sum(wall_seconds(work, finer).values()) > sum(wall_seconds(work, DRAFT).values())


def test_budget_seconds_scale_with_the_machine_and_skip_the_cache(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    work = Workload(small())
    monkeypatch.setattr(budget_module, "cached_stages", lambda *_: frozenset({"views"}))
    plan = BudgetPlan(work=work, budget_s=1.0, seed=0, begin=0.0, factor=2.0)
    seconds = plan.seconds(DRAFT)
    assert seconds["views"] == 0.0
    assert seconds["frames"] == pytest.approx(2.0 * wall_seconds(work, DRAFT)["frames"])


def test_fit_finds_what_made_the_seconds() -> None:
    rng = np.random.default_rng(0)
    counts = np.column_stack([np.ones(30), rng.uniform(0.0, 5.0, (30, 2))])
    seconds = counts @ np.array([1.0, 0.5, 2.0])
    rows = [
        (dict(zip("abc", row.tolist(), strict=True)), float(value))
        for row, value in zip(counts, seconds, strict=True)
    ]
    assert fit({"x": rows})["x"] == pytest.approx({"a": 1.0, "b": 0.5, "c": 2.0}, rel=1e-3)


@pytest.mark.parametrize("kind", sorted(DRAWN))
def test_tables_are_counted_as_the_build_solves_them(kind: str) -> None:
    design = drawn(kind, 2)
    work = Workload(design)
    wall = design.wall.thickness_mm
    mesh = marker_mesh(work.surface, work.markers, thickness_mm=wall, refine=2)
    model = sensor_model(design, work.markers, mesh, receptors=not unknown_receptors(design))
    columns = work.markers.lattice.columns if work.markers.lattice else 1
    sectors, _ = turns_of(model, mesh, columns)
    assert work.table_sectors() == sectors
    assert work.repeats in {1, sectors}
    placed, solved = work.place_rings(0.8, None)
    assert solved < placed if sectors > 1 else solved == placed
    assert work.nodes(2) == len(mesh.nodes_mm)


def test_groups_hold_every_stage_once_and_every_setting() -> None:
    stages = [name for names in GROUPS for name in names]
    assert sorted(stages) == sorted(stage.name for stage in STAGES)
    assert fields_used_by(stages) == set(DRAFT.as_dict())
    for level in LEVELS:
        for name, (low, high) in RANGES.items():
            assert low <= getattr(level, name) <= high


def test_levels_cost_more_and_more() -> None:
    work = Workload(small())
    seconds = [sum(wall_seconds(work, level).values()) for level in LEVELS]
    assert seconds == sorted(seconds)
    assert {*PRESETS.values()} <= {*LEVELS}


def test_budgets_are_planned_and_planned_again(monkeypatch: pytest.MonkeyPatch) -> None:
    design = small()
    calls: list[Accuracy] = []
    monkeypatch.setattr(budget_module, "machine_factor", lambda: 1.0)
    monkeypatch.setattr(budget_module, "cached_stages", lambda *_: frozenset())
    with refused("budget-not-reachable"):
        choose_budget(design, 1.0)
    with refused("budget-invalid"):
        choose_budget(design, -5.0)
    work = Workload(design)
    rich, first = choose_budget(design, 1e5)
    assert rich.setting == LEVELS[-1]
    assert sum(first.values()) == pytest.approx(sum(wall_seconds(work, LEVELS[-1]).values()))

    # A machine four times as slow as the plan thinks: later groups take coarser levels.
    clock = [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: clock[0])

    def run(
        _: object, stages: list[Stage], *, accuracy: Accuracy, **more: object
    ) -> tuple[None, list[str], dict[str, float]]:
        own = next(names for names in GROUPS if set(names) & {s.name for s in stages})
        seconds = {name: 4.0 * wall_seconds(work, accuracy)[name] for name in own}
        clock[0] += sum(seconds.values())
        calls.append(accuracy)
        return None, list(seconds), seconds

    monkeypatch.setattr(budget_module, "run_stages", run)
    monkeypatch.setattr(budget_module, "select_stages", lambda names: [
        stage for stage in STAGES if stage.name in names
    ])  # fmt: skip
    total = sum(wall_seconds(work, PRESETS["standard"]).values())
    plan, _ = choose_budget(design, 1.1 * total)
    run_budget(plan, force=True, progress=lambda _: None)
    assert calls[0] == PRESETS["standard"]
    assert plan.setting.frames < PRESETS["standard"].frames
    assert 3.0 < plan.factor < 4.0
    assert clock[0] <= 1.2 * max(1.1 * total, 4.0 * sum(wall_seconds(work, LEVELS[0]).values()))


def test_prediction_and_result_are_written(tmp_path: Path, error: ForceError) -> None:
    choice = choose_tolerance(error.design, 0.2, error=error)
    choice = replace(choice, achieved_error=0.1, achieved_s={"views": 2.0})
    write_audit(tmp_path, choice, 3.0)
    data = json.loads((tmp_path / "report" / "trade.json").read_text())
    assert data["wanted"] == 0.2
    assert data["achieved_error"] == 0.1
    assert data["achieved_total_s"] == 2.0
    assert data["predicted_total_s"] == pytest.approx(choice.seconds)
    assert data["accuracy"]["refine"] == choice.accuracy.refine
    assert "wanted 20 %" in audit_lines(choice, 3.0)[0]


def test_tolerances_and_times_are_parsed() -> None:
    assert read_tolerance("2%") == pytest.approx(0.02)
    assert read_tolerance(" 0.5 %") == pytest.approx(0.005)
    assert read_tolerance("0.1") == pytest.approx(0.1)
    assert read_seconds("60s") == 60.0
    assert read_seconds("2min") == 120.0
    assert read_seconds("45") == 45.0
    for bad in ("", "x%", "0%", "200%", "nan"):
        with refused("tolerance-invalid"):
            read_tolerance(bad)
    for bad in ("", "-3s", "soon", "inf"):
        with refused("budget-invalid"):
            read_seconds(bad)
