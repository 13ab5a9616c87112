"""What a study's page and summary say."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from phytac_design.study.search.driver import run_study
from phytac_design.study.search.search_report import (
    Results,
    agreement,
    importance,
    level_statistics,
    read_results,
    speedup,
    write_page,
)
from tests.refusals import refused
from tests.study.search.studies import space_of, tiny


def test_importance_is_the_share_of_variance() -> None:
    rng = np.random.default_rng(0)
    a, b, noise = rng.uniform(size=(3, 4000))
    values = 3.0 * a + b
    assert importance(values, a) == pytest.approx(0.9, abs=0.02)
    assert importance(values, b) == pytest.approx(0.1, abs=0.02)
    assert importance(values, noise) < 0.01
    assert importance(values, np.round(a)) == pytest.approx(0.675, abs=0.02)
    assert importance(np.ones(100), a[:100]) == 0.0


def test_the_front_has_each_design_once() -> None:
    """Trials 0, 1 and 3 are one design; trial 2 is another with equal objectives."""
    study = tiny(objective=[{"measure": "marker_count", "goal": "min"}])
    names = tuple(variable.field for variable in study.variable)
    columns: dict[str, object] = {name: np.array([1.0, 1.0, 2.0, 1.0, 1.0]) for name in names}
    columns["marker_count"] = np.array([8.0, 8.0, 8.0, 8.0, 9.0])
    columns["status"] = ["ok"] * 5
    results = Results(study=study, variables=names, columns=columns)
    assert np.flatnonzero(results.front()).tolist() == [0, 2]


FEW = [{"measure": "marker_count", "max": 120}]


def test_page_and_summary_of_a_study(tmp_path: Path) -> None:
    goals = [
        {"measure": "surrogate_force_sd_N", "goal": "min"},
        {"measure": "marker_count", "goal": "max"},
    ]
    study = tiny(constraint=FEW, objective=goals, description="a </script> in words")
    run_study(study, space_of(study), tmp_path, kind="sweep")
    page = write_page(tmp_path).read_text()
    assert "http" not in page
    found = re.search(r"const D = (.*);\n", page)
    assert found is not None
    data = json.loads(found[1])
    assert data["description"] == study.description
    assert len(data["trial"]) == len(data["columns"]["marker_count"]) == 24
    figures = json.loads((tmp_path / "summary.json").read_text())
    results = read_results(tmp_path)
    assert data["front"] == np.flatnonzero(results.front()).tolist()
    assert [row["trial"] for row in figures["front"]] == data["front"]
    best = max(row["marker_count"] for row in figures["front"])
    assert best == results.columns["marker_count"][results.ok].max()
    assert figures["ladder"][0]["tried"] == 24
    assert figures["ladder"][1]["tried"] == figures["ladder"][0]["went_on"] < 24
    assert sum(figures["statuses"].values()) == 24
    assert figures["importance"]["marker_count"]["layout.columns"] > 0.1


def made(**columns: object) -> Results:
    study = tiny(objective=[{"measure": "gap_px", "goal": "max"}])
    return Results(study=study, variables=(), columns=dict(columns))


def test_agreement_is_of_candidates_that_reached_both() -> None:
    later = np.arange(12.0)
    earlier = later**3
    later[9:] = np.nan
    earlier[9:] = -1.0
    nothing = np.full(12, np.nan)
    others = (
        "pitch_least_mm",
        "density_least_per_cm2",
        "density_mean_per_cm2",
        "visible_least",
        "sampled_visible_least",
        "occluded",
        "sampled_hidden",
    )
    unknown = dict.fromkeys(others, nothing)
    results = made(sampled_gap_px=earlier, gap_px=later, **unknown)
    assert agreement(results) == [
        {
            "earlier": "sampled_gap_px",
            "later": "gap_px",
            "spearman": pytest.approx(1.0),
            "candidates": 9,
        }
    ]


def test_speedup_of_successive_halving() -> None:
    results = made(
        status=["refused", "ok", "unfit", "ok"],
        rung=["rules", "exact", "sampled", "exact"],
        **{
            "seconds.rules": np.array([0.1, 0.1, 0.1, 0.1]),
            "seconds.sampled": np.array([np.nan, 0.2, 0.2, 0.2]),
            "seconds.exact": np.array([np.nan, 2.0, np.nan, 2.0]),
        },
    )
    levels = level_statistics(results)
    assert [level["tried"] for level in levels] == [4, 3, 2]
    assert [level["went_on"] for level in levels] == [3, 2, 2]
    assert speedup(levels) == pytest.approx(4 * 2.3 / 5.0)


def test_a_folder_without_results_says_so(tmp_path: Path) -> None:
    with refused("study-not-found"):
        read_results(tmp_path)
