"""Builds side by side: figures, differences, one scale, what cannot be compared, the page."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from phytac_design.cli.compare_command import compare
from phytac_design.report.built_sensors import FIGURES, Build, read_builds
from phytac_design.report.compare import (
    answers,
    best,
    compare_page,
    comparison,
    differences,
    figures_table,
    same_scales,
)
from phytac_design.stages.build import BuildResult
from phytac_shapes.errors import InputError, OutputError
from tests.refusals import refused
from tests.report.conftest import Tab


def edit(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


@pytest.fixture(scope="module")
def folders(built: BuildResult, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The built sensor, and a copy that says it has shorter receptors, and is worse."""
    other = tmp_path_factory.mktemp("builds") / "other"
    other.mkdir()
    shutil.copytree(built.out / "report", other / "report")
    text = (built.out / "design.toml").read_text()
    changed = text.replace("height_far_mm = 6.0", "height_far_mm = 5.0")
    assert changed != text
    (other / "design.toml").write_text(changed)

    def worse(report: dict[str, Any]) -> None:
        report["visibility"]["fused"] = 3
        report["resolution"]["bound"]["10 N"]["force_N_worst"] /= 2.0
        report["under_load"]["least_gap_same_colour_px"] = None

    def taller(data: dict[str, Any]) -> None:
        (height,) = (item for item in data["colourings"] if item["key"] == "height_mm")
        height["high"] = 50.0
        data["colourings"] = [item for item in data["colourings"] if item["key"] != "softness"]

    edit(other / "report" / "report.json", worse)
    edit(other / "report" / "viewer.json", taller)
    return built.out, other


@pytest.fixture(scope="module")
def builds(folders: tuple[Path, Path]) -> list[Build]:
    return read_builds(folders)


def test_figures_and_differences(builds: list[Build], folders: tuple[Path, Path]) -> None:
    assert [build.label for build in builds] == ["small (small)", "small (other)"]
    assert differences(builds) == {"layout.height_far_mm": [6.0, 5.0]}
    assert answers(builds[0])["seen"] == "yes"
    assert answers(builds[1])["seen"] == "no"
    report = json.loads((folders[0] / "report" / "report.json").read_text())
    figures = comparison(builds)["builds"][0]["figures"]
    assert figures["markers"] == 112
    assert figures["error_N"] == report["decoder"]["auto"]["mae_N"]
    assert figures["error_percent"] == 100.0 * report["decoder"]["auto"]["relative_error"]
    assert figures["bound_10N_worst_N"] == report["resolution"]["bound"]["10 N"]["force_N_worst"]
    html = compare_page(builds)
    worst = report["resolution"]["bound"]["10 N"]["force_N_worst"] / 2.0
    assert f"<td><strong>{worst:.4g}</strong></td>" in html
    assert '<th scope="row">fused markers</th><td><strong>0</strong></td><td>3</td>' in html
    assert "layout.height_far_mm" in html


def test_broken_print_rules_are_compared_of_the_same_parts_alone(builds: list[Build]) -> None:
    def row(tools: bool) -> str:
        each = []
        for build, broken, own in zip(builds, (2, 0), (True, tools), strict=True):
            facts = {**build.report["fabrication"], "print_violations": broken}
            accuracy = {**build.report["accuracy"], "tools": own}
            each.append(
                replace(build, report={**build.report, "fabrication": facts, "accuracy": accuracy})
            )
        (found,) = re.findall("places that break print rules.*?</tr>", figures_table(each))
        return str(found)

    assert "<td><strong>0</strong></td>" in row(tools=True)
    assert "strong" not in row(tools=False)


def test_the_best_is_marked_where_there_is_one() -> None:
    assert best([1.0, 3.0, 3.0], "more") == [False, True, True]
    assert best([1.0, 3.0], "less") == [True, False]
    assert best([2.0, 2.0], "less") == [False, False]
    assert best([1.0, None], "less") == [False, False]
    assert best([1.0, float("nan")], "more") == [False, False]
    assert best([1.0, 2.0], "") == [False, False]


def test_colours_mean_the_same_in_all(builds: list[Build]) -> None:
    data = same_scales([build.viewer for build in builds])
    tables = [{item["key"]: item for item in each["colourings"]} for each in data]
    assert set(tables[0]) == set(tables[1])
    assert "softness" not in tables[0]  # only one has it
    for key, item in tables[0].items():
        assert (item["low"], item["high"], item["log"]) == tuple(
            tables[1][key][name] for name in ("low", "high", "log")
        )
    assert tables[0]["height_mm"]["high"] == 50.0


def damage_report(change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    return lambda folder: edit(folder / "report" / "report.json", change)


DAMAGE: dict[str, Callable[[Path], Any]] = {
    "no whole build": lambda folder: (folder / "report" / "viewer.json").unlink(),
    "damaged": lambda folder: (folder / "report" / "report.json").write_text("{"),
    "RecursionError": lambda folder: (folder / "report" / "viewer.json").write_text("[" * 10**5),
    "holds NaN": lambda folder: (folder / "report" / "viewer.json").write_text('{"a": NaN}'),
    "KeyError": damage_report(lambda report: report.pop("under_load")),
    "is no number": damage_report(lambda report: report["markers"].update(count="many")),
    "TOMLDecodeError": lambda folder: (folder / "design.toml").write_text("a = ["),
    "TypeError": lambda folder: (folder / "report" / "viewer.json").write_text("[]"),
    "UnicodeDecodeError": lambda folder: (folder / "design.toml").write_bytes(b"\xff\xfe\x00"),
}


@pytest.mark.parametrize("said", sorted(DAMAGE))
def test_what_is_no_build_is_refused(said: str, folders: tuple[Path, Path], tmp_path: Path) -> None:
    folder = tmp_path / "build"
    shutil.copytree(folders[1], folder)
    read_builds([folders[0], folder])
    DAMAGE[said](folder)
    code = "build-incomplete" if said == "no whole build" else "build-report-invalid"
    with refused(code) as caught:
        read_builds([folders[0], folder])
    assert str(folder) in str(caught.value)
    assert said in str(caught.value)
    assert "phytac build" in str(caught.value) or "build it again" in str(caught.value)


def test_the_command(folders: tuple[Path, Path], tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(compare)
    runner, names = CliRunner(), [str(folder) for folder in folders]
    out = tmp_path / "page.html"
    shown = runner.invoke(app, [*names, "--out", str(out)])
    assert shown.exit_code == 0
    assert out.read_text().startswith("<!doctype html>")
    printed = runner.invoke(app, [*names, "--json"])
    found = json.loads(printed.stdout)
    assert len(found["builds"]) == 2
    assert set(found["builds"][0]["figures"]) == {figure.key for figure in FIGURES}
    few = runner.invoke(app, names[:1])
    assert isinstance(few.exception, InputError)
    nowhere = runner.invoke(app, [*names, "--out", str(tmp_path / "no" / "page.html")])
    assert isinstance(nowhere.exception, OutputError)


def test_the_page_in_a_browser(
    opened: Callable[..., Tab], builds: list[Build], tmp_path: Path
) -> None:
    path = tmp_path / "comparison.html"
    path.write_text(compare_page(builds), encoding="utf-8")
    tab = opened(path)
    explorers = "[...document.querySelectorAll('.explorer')].map(root => root.explorer)"
    tab.page.get_by_label("Colour by").first.select_option("density")
    seen = "[...document.querySelectorAll('.explorer')].map(root => root.dataset.colouring)"
    assert tab.page.evaluate(seen) == ["density", "density"]
    start = tab.page.evaluate(f"{explorers}.map(one => one.shell.view())")
    tab.page.evaluate(f"{explorers}[1].shell.turn(0.5, 0.1)")
    turned = tab.page.evaluate(f"{explorers}.map(one => one.shell.view())")
    assert turned[0] == pytest.approx(turned[1], abs=1e-9)
    assert turned[0] != pytest.approx(start[0], abs=0.1)
    assert tab.errors == []
    assert tab.foreign == []
