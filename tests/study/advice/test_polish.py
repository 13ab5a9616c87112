"""Refinement gains, keeps margins, stops, and resumes; the command."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from phytac_design.cli.advise_command import advise as command
from phytac_design.design.design_file import load_design, to_toml
from phytac_design.stages import loaded_views_stage
from phytac_design.study.advice import design_evaluation as judging
from phytac_design.study.advice.design_changes import broken_margin
from phytac_design.study.advice.design_evaluation import LIMITS, evaluate_design
from phytac_design.study.advice.design_variables import DesignVariable
from phytac_design.study.advice.local_model import SENSITIVE, Sensitivity
from phytac_design.study.advice.refinement import (
    RefinedDesign,
    refine,
    step_of,
)
from phytac_shapes.errors import DesignError
from tests.refusals import refused
from tests.study.advice.cases import DRAFT, tube, with_long_row

ONLY = ["wall", "layout.height_far_mm"]


@pytest.fixture(scope="module")
def done() -> RefinedDesign:
    return refine(tube(), DRAFT, only=ONLY, rounds=2)


def slope_of(name: str, *, force: float, gap: float, strain: float = 0.0) -> Sensitivity:
    variable = DesignVariable(
        name=name, unit="mm", value=1.0, step=0.1, reach=1.0, why="", kind="free",
        fields=lambda _: {},
    )  # fmt: skip
    rate = dict.fromkeys(SENSITIVE, force) | {"gap_px": gap, "load_gap_px": gap, "strain": strain}
    return Sensitivity(variable=variable, rate=rate)


def test_a_step_keeps_the_gap_and_the_strain() -> None:
    figures = {"gap_px": 5.5, "load_gap_px": 5.5, "strain": 0.01, "force_middle_N": 1.0}
    finer = slope_of("a", force=-0.1, gap=-4.0)
    # Room of 5.5 - 3 - 0.5 px over 4 px/mm, in whole tenths.
    assert step_of(figures, [finer], 1.0) == pytest.approx([0.5])
    wider = slope_of("b", force=0.001, gap=10.0)
    both = step_of(figures, [finer, wider], 1.0)
    assert both[0] == pytest.approx(1.0)
    assert 5.5 - 4.0 * both[0] + 10.0 * both[1] >= LIMITS["gap_px"] + 0.5 - 10.0 * 0.1
    bent = slope_of("c", force=-0.1, gap=0.0, strain=2.0)
    assert step_of(figures, [bent], 1.0) == pytest.approx([np.trunc(np.log(2.0) / 2.0 * 10) / 10])
    assert step_of(figures, [finer], 0.25) == pytest.approx([0.2])


def test_polish_gains_within_margins(done: RefinedDesign) -> None:
    taken = [step for step in done.steps if not step.reason]
    assert taken
    assert all(step.gain >= 0.01 for step in taken)
    assert done.figures["force_middle_N"] < 0.9 * done.before["force_middle_N"]
    assert not broken_margin(done.before, done.figures)
    assert evaluate_design(done.design, DRAFT).figures == done.figures
    assert done.design.name == f"{tube().name}-polished"


def test_polish_resumes(done: RefinedDesign, monkeypatch: pytest.MonkeyPatch) -> None:
    def again(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr(judging, "views_at_rest", again)
    monkeypatch.setattr(loaded_views_stage, "press_and_see", again)
    assert refine(tube(), DRAFT, only=ONLY, rounds=2) == done


def test_polish_requires_a_design_without_faults() -> None:
    with refused("design-not-repaired") as caught:
        refine(with_long_row(2, 3.5), DRAFT)
    caught.match("--polish")


def test_command(tmp_path: Path, done: RefinedDesign) -> None:
    app = typer.Typer()
    app.command()(command)
    path = tmp_path / "tube.toml"
    path.write_text(to_toml(tube()))
    out = tmp_path / "out"
    runner = CliRunner()
    args = [str(path), "--only", "camera", "--checks", "1", "--out", str(out)]
    plain = runner.invoke(app, args)
    assert plain.exit_code == 0, plain.output
    assert "Advice, each change applied and evaluated" in plain.output
    machine = runner.invoke(app, [*args, "--json"])
    assert json.loads(machine.stdout) == json.loads((out / "advice.json").read_text())
    asked = [str(path), "--polish", "--only", ",".join(ONLY), "--rounds", "2", "--out", str(out)]
    polished = runner.invoke(app, asked)
    assert polished.exit_code == 0, polished.output
    assert load_design(str(out / f"{done.design.name}.toml")) == done.design
    bad = runner.invoke(app, [str(path), "--only", "wal"])
    assert isinstance(bad.exception, DesignError)
