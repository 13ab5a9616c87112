"""Known defects get advice that repairs them; a change that breaks a rule is no advice."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import load_design
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.check import check_design
from phytac_design.stages import loaded_views_stage
from phytac_design.study.advice import advise as advising
from phytac_design.study.advice import design_changes
from phytac_design.study.advice import design_evaluation as judging
from phytac_design.study.advice.advice_report import as_dict, text, write_advice
from phytac_design.study.advice.advise import Advice, ChangeTester, advise
from phytac_design.study.advice.design_changes import (
    SWITCHES,
    Change,
    broken_margin,
    costs_of,
    gain_of,
)
from phytac_design.study.advice.design_evaluation import evaluate_design, faults_of
from phytac_design.study.advice.design_variables import (
    COUNT,
    as_explicit,
    named_rows,
    row_variables,
    together,
    variables_of,
    with_fields,
)
from phytac_design.workflows import design_check, switch_feasibility
from phytac_shapes.errors import DesignError
from tests.refusals import refused
from tests.study.advice.cases import DRAFT, ROWS, judged_tube, tube, with_long_row


@pytest.fixture(autouse=True, scope="module")
def _bowls_fit() -> Iterator[None]:
    """Bowls are solved for in ``test_switch_feasibility``."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(switch_feasibility, "misfit", lambda *_: "")
        patch.setattr(switch_feasibility, "far_too_high", lambda *_: "")
        yield


@pytest.fixture(scope="module")
def of_thick_wall() -> Advice:
    return advise(tube(wall={"thickness_mm": 1.4}), DRAFT, only=["wall", "camera"], checks=4)


def test_a_wall_too_thick_is_to_be_thinned(of_thick_wall: Advice) -> None:
    first = of_thick_wall.pieces[0]
    assert first.variable.name == "wall.thickness_mm"
    assert first.amount < 0.0
    assert first.gain > 0.1
    assert first.gain / first.predicted_gain == pytest.approx(1.0, abs=0.25)
    assert first.design is not None
    before = evaluate_design(of_thick_wall.design, DRAFT).figures["force_middle_N"]
    after = evaluate_design(first.design, DRAFT).figures["force_middle_N"]
    assert 1.0 - after / before == pytest.approx(gain_of("force_middle_N", of_thick_wall.figures,
                                                         first.achieved))  # fmt: skip
    assert after < 0.9 * before


def test_a_hidden_row_is_repaired_at_the_row() -> None:
    design = with_long_row(2, 3.5)
    assert evaluate_design(design, DRAFT).figures["occluded"] == 8
    found = advise(design, DRAFT, only=["rows"], checks=3)
    names = [trial.variable.name for trial in found.pieces]
    lower = [
        trial
        for trial in found.pieces
        if trial.variable.name == "rows.row 2 height" and trial.amount < 0.0
    ]
    assert lower, names
    assert lower[0].goal == "faults"
    assert lower[0].design is not None
    after = evaluate_design(lower[0].design, DRAFT).figures
    assert after["occluded"] == 0
    assert faults_of(after) == 0
    assert "row 2 height by -" in text(found)


def test_a_camera_too_close_is_to_be_moved_back() -> None:
    near = tube(camera={"stand_off_mm": 15.0})
    with refused("rim-outside-view"):
        check_design(near)
    found = advise(near, DRAFT, only=["camera"], checks=2)
    assert "cannot see the near rim" in found.refused
    back = [trial for trial in found.pieces if trial.variable.name == "camera.stand_off_mm"]
    assert back
    assert back[0].amount > 0.0
    assert back[0].goal == "rules"
    assert back[0].design is not None
    assert evaluate_design(back[0].design, DRAFT).faults == 0


def test_advice_breaks_nothing(of_thick_wall: Advice) -> None:
    assert of_thick_wall.pieces
    for trial in of_thick_wall.pieces:
        assert trial.design is not None
        check_design(trial.design)
        assert not broken_margin(of_thick_wall.figures, trial.achieved)
        assert trial.gain > 0.0
    for trial in of_thick_wall.tried:
        assert trial.reason
    # A spacer shorter than the image allows is tried and said to break that.
    lost = [t for t in of_thick_wall.tried if t.variable.name == "camera.stand_off_mm"]
    assert any("rim" in trial.reason for trial in lost)


def test_faults_of_switches_are_those_of_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    assert advising.check_thresholds is switch_feasibility.check_thresholds
    assert advising.unreadable_fault is design_check.unreadable_fault
    base, deeper = judged_tube(), {"switch.tip_recess_mm": 0.4}
    monkeypatch.setattr(advising, "unreadable_fault", lambda *_: DesignError("a-b", "30 of 40"))
    monkeypatch.setattr(
        advising,
        "readable_changes",
        lambda *_, **__: [
            Change(variable=together(deeper, "deeper"), amount=1.0, goal=SWITCHES, predicted={},
                   predicted_gain=0.5),
            Change(variable=together({}, "none"), amount=1.0, goal=SWITCHES, predicted={},
                   predicted_gain=0.0, reason="40 of 40 remain so"),
        ],
    )  # fmt: skip
    many = base.figures | {"switch_unreadable": 30, "switch_unreadable_share": 0.75}
    monkeypatch.setattr(advising, "evaluate_design", lambda design, *_, **__: replace(
        base, figures=many if design.switch.tip_recess_mm == 0.3 else base.figures))  # fmt: skip
    # Other advice, which takes most of the time.
    monkeypatch.setattr(advising, "sensitivities", lambda *_: [])
    monkeypatch.setattr(advising, "row_sensitivities", lambda *_: [])
    found = advise(tube(), DRAFT, checks=0)
    shown = text(found)
    assert "rejected by `phytac check`: 30 of 40" in shown
    assert "1. deeper: 0 switches cannot be read then, 100% fewer" in shown
    assert "none: 40 of 40 remain so" in shown
    (piece,) = found.pieces
    assert piece.design == with_fields(tube(), deeper)
    # A change after which no bowl has the thresholds breaks a rule.
    monkeypatch.setattr(advising, "check_thresholds", cannot)
    tester = ChangeTester(base.sensor, base.figures, DRAFT, castable=True)
    assert tester.test(piece).reason.startswith("breaks a rule: no bowl fits")


def cannot(*_: object, **__: object) -> None:
    raise DesignError("switch-infeasible", "no bowl fits; raise the footprint")


def test_a_change_that_hides_switches_breaks_a_margin() -> None:
    good = dict(judged_tube().figures)
    assert good["switch_unreadable_share"] == good["switch_unreadable"] / 40 == 0.0
    assert broken_margin(good, good | {"switch_unreadable_share": 0.25}) == ""
    assert "cannot be read 0.3" in broken_margin(good, good | {"switch_unreadable_share": 0.3})


def test_a_move_that_hides_markers_is_no_advice() -> None:
    base = judged_tube()
    (variable,) = [
        k for k in row_variables(base.sensor, base.markers.row, [2]) if k.name.endswith("height")
    ]
    move = Change(
        variable=variable, amount=3.5, goal="force_middle_N", predicted={}, predicted_gain=0.05
    )
    trial = ChangeTester(base.sensor, base.figures, DRAFT).test(move)
    assert trial.achieved["occluded"] == 8
    assert "hidden markers at rest 8 (at most 0)" in trial.reason


def test_broken_compares_with_what_was() -> None:
    good = dict(judged_tube().figures)
    assert broken_margin(good, good) == ""
    assert "gap" in broken_margin(good, good | {"gap_px": 2.9})
    assert broken_margin(good | {"gap_px": 2.0}, good | {"gap_px": 2.0}) == ""
    assert "strain" in broken_margin(good, good | {"strain": 0.03})
    assert "disturbance" in broken_margin(good, good | {"crosstalk_px": 0.2})
    for name in ("occluded", "fused", "load_hidden", "load_fused"):
        assert broken_margin(good, good | {name: 1})
        assert broken_margin(good | {name: 2}, good | {name: 1}) == ""


def test_conflicts_are_reported() -> None:
    good = dict(judged_tube().figures)
    finer = good | {"force_middle_N": 0.5 * good["force_middle_N"], "gap_px": good["gap_px"] - 9.0}
    (said,) = costs_of(good, finer)
    assert "gap of one colour at rest" in said
    assert costs_of(good, good) == ()
    # Not a fault, as in a build, but said.
    (said,) = costs_of(good, good | {"switch_unreadable": 1})
    assert "switches that cannot be read 0 → 1" in said


def test_faults_count_markers_and_crosstalk() -> None:
    good = dict(judged_tube().figures)
    assert faults_of(good) == 0
    assert faults_of(good | {"occluded": 2, "load_fused": 3, "crosstalk_px": 0.2}) == 6


def test_evaluations_are_cached(monkeypatch: pytest.MonkeyPatch) -> None:
    base = judged_tube()

    def again(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr(judging, "views_at_rest", again)
    monkeypatch.setattr(loaded_views_stage, "press_and_see", again)
    assert evaluate_design(base.design, DRAFT).figures == base.figures
    # Another resin is seen as before, and pressed again.
    with pytest.raises(AssertionError):
        evaluate_design(with_fields(base.design, {"material.modulus_MPa": 2000.0}), DRAFT)
    monkeypatch.undo()
    monkeypatch.setattr(judging, "views_at_rest", again)
    evaluate_design(with_fields(base.design, {"material.modulus_MPa": 2000.0}), DRAFT)


def test_listed_markers_are_the_same() -> None:
    design = tube(switch={"regions": [{"threshold_N": 0.8, "rows": [1, 2]}]})
    markers = make_markers(design, design.surface())
    same = as_explicit(Sensor(design))
    listed = make_markers(same, same.surface())
    assert np.array_equal(listed.colour, markers.colour)
    assert listed.tip_mm == pytest.approx(markers.tip_mm, abs=1e-9)
    assert same.switch.regions[0].markers == tuple(range(8, 24))
    taller = variables_of(Sensor(same))[2].moved(same, 0.05)
    assert taller.layout.position_heights_mm == pytest.approx(1.05 * markers.height_mm)


@pytest.mark.parametrize("name", ["cylinder60", "hemisphere", "grip", "plane", "cuboid", "cone"])
def test_variables_change_what_they_name(name: str) -> None:
    design = load_design(name)
    markers = make_markers(design, design.surface())
    variables = variables_of(Sensor(design))
    assert len({variable.name for variable in variables}) == len(variables) > 6
    for variable in variables:
        for amount in (*variable.amounts(1.0), *variable.amounts(-1.0)):
            assert abs(amount) <= max(variable.reach, variable.step) + 1e-9
            assert amount / variable.step == pytest.approx(round(amount / variable.step))
        moved = variable.moved(design, variable.step)
        assert moved != design
        if variable.kind != COUNT:
            assert len(make_markers(moved, moved.surface()).uv) == markers.count


def test_unknown_names_and_bad_folders_are_refused(of_thick_wall: Advice, tmp_path: Path) -> None:
    with refused("variable-unknown") as caught:
        advise(tube(), DRAFT, only=["wal"])
    caught.match("wall.thickness_mm")
    with refused("row-out-of-range") as caught:
        advise(tube(), DRAFT, only=["rows.9"])
    caught.match(r"rows\.9")
    assert named_rows(["rows.3", "wall"], judged_tube().markers.row) == {3}
    (tmp_path / "file").write_text("")
    with refused("output-not-writable"):
        write_advice(of_thick_wall, tmp_path / "file")


def test_files_rebuild_each_piece(of_thick_wall: Advice, tmp_path: Path) -> None:
    write_advice(of_thick_wall, tmp_path)
    assert load_design(str(tmp_path / "advice_1.toml")) == of_thick_wall.pieces[0].design
    assert len(as_dict(of_thick_wall)["advice"]) == len(of_thick_wall.pieces)
    assert len(as_dict(of_thick_wall)["rows"]) == ROWS


@dataclass(frozen=True)
class Move:
    """A change of so many steps, of which each gains 1."""

    amount: float
    predicted: dict[str, float]
    reason: str = ""

    @property
    def predicted_gain(self) -> float:
        return self.amount


def test_a_change_is_rejected_for_what_it_broke_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """And not for what a larger one broke."""
    slope: Any = SimpleNamespace(variable=SimpleNamespace(amounts=lambda _: [4.0, 2.0, 1.0]))
    base: Any = SimpleNamespace(figures={})
    monkeypatch.setattr(design_changes, "change_by", lambda _a, _b, _c, steps: Move(steps, {}))
    monkeypatch.setattr(design_changes, "least_gain", lambda _: 2.0)
    monkeypatch.setattr(design_changes, "broken_margin", lambda *_: "too thin")
    found = design_changes._largest(base, slope, "goal", 1.0)
    assert (found.amount, found.reason) == (2.0, "too thin")
