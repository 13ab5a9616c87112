"""Builds to a tolerance or in a time, end to end."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from phytac_design.cli.app import app
from phytac_design.cli.tradeoff_command import build_within
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import to_toml
from phytac_design.stages.build import BuildResult, build
from phytac_design.study.tradeoff import budget as budget_module
from phytac_design.study.tradeoff import build_to as module
from phytac_design.study.tradeoff.build_to import AUDIT, build_to
from phytac_design.study.tradeoff.choose import Choice
from tests.designs import small
from tests.refusals import refused


def quiet(_: str) -> None:
    """No progress."""


def test_a_budget_takes_what_the_cache_has(
    built: BuildResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cached draft costs nothing; nothing else fits so few seconds."""
    build(small(), tmp_path / "draft", accuracy="draft", progress=quiet)
    monkeypatch.setattr(budget_module, "machine_factor", lambda: 10.0)
    result, choice = build_to(small(), tmp_path / "out", budget_s=5.0, progress=quiet)
    assert choice.accuracy == PRESETS["draft"]
    assert choice.seconds == 0.0
    assert result.ran == ()
    data = json.loads((tmp_path / "out" / AUDIT).read_text())
    assert data["wanted"] == 5.0
    assert data["wall_s"] == pytest.approx(result.seconds)
    assert (tmp_path / "out" / "report" / "report.html").is_file()


def test_a_tolerance_is_built_and_audited(
    built: BuildResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    def chosen(design: object, tolerance: float, **_: object) -> Choice:
        return Choice(
            accuracy=PRESETS["draft"],
            quantity="force",
            wanted=tolerance,
            predicted_error=0.9 * tolerance,
            predicted_s={"views": 1.0},
        )

    monkeypatch.setattr(module, "choose_tolerance", chosen)
    monkeypatch.setattr(module, "achieved", lambda choice, _: 0.8 * choice.wanted)
    path = tmp_path / "small.toml"
    path.write_text(to_toml(small()), encoding="utf-8")
    arguments = ["build", str(path), "--out", str(tmp_path / "out"), "--tolerance", "20%"]
    run = CliRunner().invoke(app, arguments)
    assert run.exit_code == 0
    assert "force error: wanted 20 %, predicted 18 %, achieved 16 %" in run.stdout
    data = json.loads((tmp_path / "out" / AUDIT).read_text())
    assert data["achieved_error"] == pytest.approx(0.16)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["accuracy"] == "draft"


def test_exactly_one_of_the_two_is_required(tmp_path: Path) -> None:
    for more in ({}, {"tolerance": 0.1, "budget_s": 60.0}):
        with refused("options-exclusive"):
            build_to(small(), tmp_path / "out", progress=quiet, **more)
    assert not (tmp_path / "out").exists()
    with refused("tolerance-kind-unknown"):
        build_within(
            small(), tmp_path, tolerance="2%", tolerance_of="taste", budget=None, seed=0,
            force=False,
        )  # fmt: skip


def test_a_choice_is_plain_json() -> None:
    choice = Choice(
        accuracy=PRESETS["fine"], quantity="time", wanted=60.0, predicted_error=None,
        predicted_s={"views": 2.0, "frames": 3.0},
    )  # fmt: skip
    data = choice.as_dict()
    assert data["predicted_total_s"] == 5.0
    assert data["achieved_total_s"] is None
    done = replace(choice, achieved_s={"views": 4.0}).as_dict()
    assert done["achieved_total_s"] == 4.0
