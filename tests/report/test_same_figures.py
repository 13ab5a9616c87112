"""One figure has one value and one name: build, report, comparison, bundle and evaluation."""

import html
import json
import re
from pathlib import Path

import pytest

from phytac_decoder.io.bundle import load_bundle
from phytac_design.cli import build_command
from phytac_design.design.design_file import load_design
from phytac_design.report.built_sensors import FIGURES, read_builds
from phytac_design.report.report_sections import forces_up_to
from phytac_design.report.verdict import best_of, decoded
from phytac_design.stages.build import BuildResult
from phytac_design.training.evaluation.tables import COLUMNS_MD


@pytest.fixture(scope="module")
def page(built: BuildResult) -> str:
    """The report as running text."""
    text = (built.out / "report" / "report.html").read_text("utf-8")
    text = re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)).split())


def test_the_error_of_the_forces(built: BuildResult, page: str) -> None:
    report = json.loads((built.out / "report" / "report.json").read_text())
    best = best_of(report)
    points, frames = report["decoder"][best], report["decoder_frames"][best]
    relative, absolute = f"{100.0 * points['relative_error']:.1f} %", f"{points['mae_N']:.2f} N"
    sentence = decoded(report)
    assert f"relative error of {relative} and an absolute error of {absolute}" in sentence
    assert f"in rendered frames of {100.0 * frames['relative_error']:.1f} %" in sentence
    # The command, the page's first lines and its table, the comparison.
    assert sentence in build_command._verdict(report, 10.0)
    assert sentence in page
    row = rf"{best} {100.0 * points['relative_error']:.4g} {points['mae_N']:.4g} "
    assert len(re.findall(row, page)) == 1
    (build,) = read_builds([built.out])
    compared = {figure.key: figure.of(build.report) for figure in FIGURES}
    assert compared["error_percent"] == pytest.approx(100.0 * points["relative_error"])
    assert compared["error_N"] == pytest.approx(points["mae_N"])
    assert compared["error_frames_percent"] == pytest.approx(100.0 * frames["relative_error"])
    assert load_bundle(built.out / "decoder").model.best == best


def test_figures_of_a_linear_wall_say_so(built: BuildResult) -> None:
    report = json.loads((built.out / "report" / "report.json").read_text())
    real = [text for text in report["limits"] if not text.startswith("linear-tables")]
    assert "this wall is not linear" not in decoded(report | {"limits": real})
    bent = [*real, "linear-tables: 52 % off at 10 N"]
    assert "this wall is not linear, and a real one is decoded worse" in decoded(
        report | {"limits": bent}
    )


def test_the_bound_of_ten_newtons(built: BuildResult, page: str) -> None:
    report = json.loads((built.out / "report" / "report.json").read_text())
    median = f"{report['resolution']['bound']['10 N']['force_N_median']:.2f} N"
    assert f"standard deviation of {median} (median" in build_command._verdict(report, 10.0)
    (build,) = read_builds([built.out])
    compared = {figure.key: figure.of(build.report) for figure in FIGURES}
    assert compared["bound_10N_worst_N"] == report["resolution"]["bound"]["10 N"]["force_N_worst"]


def test_bounds_are_listed_up_to_the_largest_force() -> None:
    assert forces_up_to(["10 N", "1 N", "25 N", "8 N"], 8.0) == ["1 N", "8 N"]


def test_maps_are_of_the_largest_force(built: BuildResult, page: str) -> None:
    report = json.loads((built.out / "report" / "report.json").read_text())
    force = f"{load_design(str(built.out / 'design.toml')).training.force_max_N:g} N"
    assert force != "10 N"
    viewer = json.loads((built.out / "report" / "viewer.json").read_text())
    (item,) = [one for one in viewer["colourings"] if one["key"] == "bound_N"]
    assert item["label"] == f"resolution of {force}"
    assert f"of {force}, the design's largest force" in item["note"]
    worst = report["resolution"]["bound"][force]["force_N_worst"]
    assert item["high"] == pytest.approx(worst)
    assert worst != pytest.approx(report["resolution"]["bound"]["10 N"]["force_N_worst"], rel=1e-3)
    assert f"Smallest standard deviation of a force of {force}, the design's largest" in page


def test_names_of_errors_are_the_same_everywhere(page: str) -> None:
    titles = {title for title, *_ in COLUMNS_MD}
    assert {"relative error (%)", "absolute error (N)"} <= titles
    assert "estimator relative error (%) absolute error (N)" in page
    labels = {figure.key: figure.label for figure in FIGURES}
    assert labels["error_percent"].startswith("relative error, ")
    assert labels["error_N"].startswith("absolute error, ")
    assert labels["error_frames_percent"].startswith("relative error, ")
    readme = (Path(__file__).parents[2] / "README.md").read_text("utf-8")
    rows = re.findall(r"^\| (.*?contacts\).*?|nominal print.*?) \|", readme, re.MULTILINE)
    assert len(rows) > 2
    assert [row for row in rows if not row.endswith("mean relative error")] == []
