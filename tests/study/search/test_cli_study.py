"""The commands `phytac sweep` and `phytac optimise`."""

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from phytac_design.cli.study_commands import optimise, sweep
from phytac_design.study.search.measures import MEASURES
from phytac_shapes.errors import DesignError, InputError, OutputError

APP = typer.Typer()
APP.command()(sweep)
APP.command()(optimise)
STUDY = """
name = "walls"
design = "cylinder60"
[fixed]
"shape.length_mm" = 60.0
"layout.rows" = 8
"layout.height_far_mm" = 6.0
[[variable]]
field = "wall.thickness_mm"
low = 0.7
high = 1.2
[[objective]]
measure = "mass_g"
goal = "min"
[sampling]
batch = 2
start = 2
[budget]
candidates = 4
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "walls.toml"
    path.write_text(STUDY)
    return path


def test_a_sweep_writes_rows_page_and_summary(study: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = CliRunner().invoke(APP, ["sweep", str(study), "--out", str(out), "--json"])
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["candidates"] == facts["new"] == 4
    assert len(facts["front"]) == 1
    assert {path.name for path in out.iterdir()} >= {
        "results.parquet", "report.html", "summary.json", "study.json"
    }  # fmt: skip
    again = CliRunner().invoke(APP, ["sweep", str(study), "--out", str(out), "--candidates", "5"])
    assert "5 candidates (5 ok), 1 of them now" in again.stdout
    assert "trial" in again.stdout


def test_optimise_resumes(study: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "out")
    for candidates in ("2", "4"):
        done = CliRunner().invoke(
            APP, ["optimise", str(study), "--out", out, "--candidates", candidates]
        )
        assert done.exit_code == 0, done.output
    assert "4 candidates (4 ok), 2 of them now" in done.stdout


def test_measures_and_studies_are_listed() -> None:
    done = CliRunner().invoke(APP, ["sweep", "--measures", "--json"])
    assert [one["name"] for one in json.loads(done.stdout)] == list(MEASURES)
    plain = CliRunner().invoke(APP, ["sweep", "--measures"])
    assert all(name in plain.stdout for name in MEASURES)
    assert "dense-cylinder" in CliRunner().invoke(APP, ["optimise"]).stdout


def test_a_scheduler_that_is_not_there_is_refused_before_anything_is_written(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    from phytac_design.study.search.dask_pool import DaskPool

    out = tmp_path / "out"
    monkeypatch.setattr(DaskPool, "connect_s", 0.5)
    words = ["sweep", str(study), "--out", str(out), "--scheduler", "tcp://127.0.0.1:9"]
    done = CliRunner().invoke(APP, words)
    assert isinstance(done.exception, InputError)
    assert "no scheduler at tcp://127.0.0.1:9" in str(done.exception)
    assert not out.exists()
    both = CliRunner().invoke(APP, [*words, "--workers", "2"])
    assert isinstance(both.exception, DesignError)
    assert "exclude each other" in str(both.exception)


def test_a_sweep_says_why_candidates_were_dropped(study: Path, tmp_path: Path) -> None:
    study.write_text(STUDY + '[[constraint]]\nmeasure = "mass_g"\nmax = 1.0\n')
    done = CliRunner().invoke(APP, ["sweep", str(study), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    assert "4 for a reason such as: mass_g is " in done.stdout
    assert "no candidate meets all rules and constraints" in done.output
    facts = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [one["count"] for one in facts["reasons"]] == [4]


def test_what_differs_from_the_study_in_the_folder_is_named(study: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert CliRunner().invoke(APP, ["sweep", str(study), "--out", str(out)]).exit_code == 0
    study.write_text(STUDY.replace("0.7", "0.8").replace('"min"', '"max"'))
    with pytest.raises(OutputError, match=r"differs in: objective, variable; .*Only name"):
        CliRunner().invoke(APP, ["sweep", str(study), "--out", str(out)], catch_exceptions=False)
    study.write_text(STUDY.replace('name = "walls"', 'name = "other"'))
    assert CliRunner().invoke(APP, ["sweep", str(study), "--out", str(out)]).exit_code == 0
    with pytest.raises(OutputError, match="a study of phytac sweep, and this is phytac optimise"):
        CliRunner().invoke(APP, ["optimise", str(study), "--out", str(out)], catch_exceptions=False)


def test_ctrl_c_says_that_a_study_can_be_resumed(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("phytac_design.study.search.driver.run_study", stopped)
    done = CliRunner().invoke(APP, ["sweep", str(study), "--out", str(tmp_path / "out")])
    assert done.exit_code == 130
    assert "run the same command again to resume" in done.output


def test_candidates_that_are_left_or_too_many_are_named(study: Path, tmp_path: Path) -> None:
    call = ["sweep", str(study), "--out", str(tmp_path / "out")]
    CliRunner().invoke(APP, [*call, "--candidates", "2"])
    part = CliRunner().invoke(APP, [*call, "--seconds", "1e-6"])
    assert "the time is up, 2 of 4 candidates are left" in part.output
    whole = CliRunner().invoke(APP, call)
    assert "4 candidates (4 ok), 2 of them now" in whole.stdout
    assert "is up" not in whole.output
    assert "warning" not in whole.output
    assert "has 4 candidates already, more than the 1 wanted" in (
        CliRunner().invoke(APP, [*call, "--candidates", "1"]).output
    )


def test_a_grid_ends_at_its_own_size(study: Path, tmp_path: Path) -> None:
    grid = STUDY.replace("[sampling]", '[sampling]\nsweep = "grid"')
    study.write_text(grid.replace("high = 1.2", "high = 1.2\npoints = 3"))
    call = ["sweep", str(study), "--out", str(tmp_path / "out"), "--seconds", "3600"]
    done = CliRunner().invoke(APP, [*call, "--candidates", "3"])
    assert done.exit_code == 0, done.output
    assert "left" not in done.output
    with pytest.raises(OutputError, match=r"differs in: the number of candidates, which"):
        CliRunner().invoke(APP, [*call, "--candidates", "9"], catch_exceptions=False)


def test_a_study_without_an_objective_has_no_front_and_no_warning(
    study: Path, tmp_path: Path
) -> None:
    study.write_text(STUDY.replace('[[objective]]\nmeasure = "mass_g"\ngoal = "min"\n', ""))
    done = CliRunner().invoke(APP, ["sweep", str(study), "--out", str(tmp_path / "out")])
    assert "4 candidates (4 ok)" in done.stdout
    assert "warning" not in done.output
