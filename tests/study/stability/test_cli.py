"""The command, its table, and what it does where something is wrong."""

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from phytac_design.cli.stability_command import stability
from phytac_design.study.stability import run as runs
from phytac_design.study.stability.case import Case, Evidence, Outcome
from phytac_design.study.stability.judge import judge
from phytac_design.study.stability.rooms import ROOMS
from phytac_design.study.stability.table import page

app = typer.Typer()
app.command()(stability)


@pytest.fixture(autouse=True)
def without_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases are judged here: starting a process takes longer than they do."""

    def here(cases: list[Case], **options: object) -> list[Outcome]:
        out = [judge(case, ROOMS[case.room].checks) for case in cases]
        for number, outcome in enumerate(out, start=1):
            options["done"](number, outcome)  # type: ignore[operator]
        return out

    monkeypatch.setattr(runs, "run_cases", here)


def test_counts_table_and_json(tmp_path: Path) -> None:
    words = ["--room", "print rules", "--shape", "plane", "--table", str(tmp_path / "page.md")]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path), "--json"])
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    count = sum(data["counts"]["print rules"].values())
    assert count == len(runs.choose(room="print rules", shape="plane")) == data["fresh"]
    assert json.loads((tmp_path / "stability.json").read_text()) == data
    text = (tmp_path / "page.md").read_text()
    assert f"{count} cases, seed 0" in text
    assert "**0 wrong**" in text
    assert "## Not covered" in text
    assert "plane: gap between parallel tubes, just kept" in text
    assert "the printer needs a gap of 0.3 mm" in text


def test_a_wrong_case_ends_with_an_error_and_stands_on_the_page() -> None:
    wrong = Outcome(room="shell", name="a | b", shape="", verdict="wrong", why="off by 3")
    report = runs.Report(outcomes=[wrong], seconds=1.0, workers=1, seed=0, fresh=1)
    assert r"- shell: *a \| b*: off by 3" in page(report)
    assert "**1 wrong**" in page(report)


def test_exit_code_of_a_wrong_case(monkeypatch: pytest.MonkeyPatch) -> None:
    def off(_: object, found: Evidence) -> None:
        found.add("reference", 2.0, 1.0)

    room = ROOMS["print rules"]
    monkeypatch.setitem(room.checks, "rule", off)
    done = CliRunner().invoke(app, ["--room", "print rules", "--cases", "2"])
    assert done.exit_code == 1
    assert done.stdout.count("wrong: print rules: ") == 2
    assert "2 cases in" in done.stdout


def test_a_page_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    words = ["--room", "print rules", "--cases", "2", "--table", str(tmp_path / "no" / "page.md")]
    done = CliRunner().invoke(app, words)
    assert "choose another file" in str(done.exception)
