"""Results of a study: front, importance, agreement of levels, and a page of them."""

import json
import re
from collections import Counter
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.core.json_values import finite
from phytac_design.study.search.measures import MEASURES, measures_up_to
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.study_folder import read_columns, read_study
from phytac_design.study.search.successive_halving import OK, front
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import OutputError


@dataclass(frozen=True, kw_only=True)
class Results:
    """Rows of a study by column: arrays (n,), NaN where empty, or lists of text."""

    study: Study
    variables: tuple[str, ...]
    columns: dict[str, Any]

    @property
    def ok(self) -> BoolArray:
        """Feasible rows (n,)."""
        return np.array([status == OK for status in self.columns["status"]], dtype=np.bool_)

    def objectives(self) -> FloatArray:
        """Objectives (n, k) to minimise."""
        columns = [
            self.columns[one.measure] * (1.0 if one.goal == "min" else -1.0)
            for one in self.study.objective
        ]
        return np.stack(columns, axis=1) if columns else np.zeros((len(self.ok), 0))

    def front(self) -> BoolArray:
        """Rows (n,) on the Pareto front of the feasible ones, each design once."""
        values, out = self.objectives(), np.zeros(len(self.ok), dtype=np.bool_)
        feasible = np.flatnonzero(self.ok & np.isfinite(values).all(axis=1))
        if values.shape[1] and len(feasible):
            first: dict[tuple[Any, ...], int] = {}
            for row in feasible[front(values[feasible])].tolist():
                design = tuple(self.columns[name][row] for name in self.variables)
                first.setdefault(design, row)  # optimisers propose some designs again
            out[list(first.values())] = True
        return out

    def shares(self, name: str) -> FloatArray:
        """Values of a variable (n,) as numbers: text by its alphabetical place."""
        column = self.columns[name]
        if isinstance(column, np.ndarray):
            return column
        return np.unique(column, return_inverse=True)[1].astype(np.float64)


def read_results(folder: Path) -> Results:
    """Results of a study so far.

    Raises
    ------
    InputError
        If the folder holds no study or no results.
    """
    study, _, _ = read_study(folder)
    variables = tuple(variable.field for variable in study.variable)
    measures = measures_up_to(study.levels)
    seconds = [f"seconds.{level}" for level in study.levels]
    names = ["trial", *variables, *measures, "status", "rung", "reason", *seconds]
    return Results(study=study, variables=variables, columns=read_columns(folder, names))


def importance(values: FloatArray, of: FloatArray) -> float:
    """Share of the variance of ``values`` (n,) explained by a variable (n,), 0 to 1.

    First-order Sobol index from the means over bins of equal count, corrected for what bins would
    explain by chance (Archer, Saltelli, Sobol 1997; epsilon squared).
    """
    n, bins = len(values), 12
    if n < 8 or float(np.ptp(values)) == 0.0:
        return 0.0
    levels, group = np.unique(of, return_inverse=True)
    if len(levels) > bins:
        group = np.argsort(np.argsort(of, kind="stable")) * min(bins, n // 2) // n
    count = np.bincount(group)
    mean = np.bincount(group, weights=values) / count
    between = float((count * (mean - values.mean()) ** 2).sum())
    total = float(((values - values.mean()) ** 2).sum())
    if n <= len(count):
        return 0.0
    within = (total - between) / (n - len(count))
    return max(0.0, (between - (len(count) - 1) * within) / total)


def agreement(results: Results) -> list[dict[str, Any]]:
    """Rank correlation (Spearman) of each measure with its proxy of a lower level.

    Over the candidates that have both, also those that missed a constraint.
    """
    from scipy.stats import spearmanr

    out = []
    for name in measures_up_to(results.study.levels):
        earlier = MEASURES[name].proxy
        if not earlier:
            continue
        pair = np.stack([results.columns[earlier], results.columns[name]])
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        if pair.shape[1] < 8 or float(np.ptp(pair, axis=1).min()) == 0.0:
            continue
        out.append(
            {
                "earlier": earlier,
                "later": name,
                "spearman": float(spearmanr(pair[0], pair[1]).statistic),
                "candidates": int(pair.shape[1]),
            }
        )
    return out


def level_statistics(results: Results) -> list[dict[str, Any]]:
    """How many candidates tried and passed each level, and its processor time."""
    out, reached = [], len(results.ok)
    stopped_at = np.array(results.columns["rung"])[~results.ok]
    for level in results.study.levels:
        stopped = int(np.sum(stopped_at == level))
        seconds = results.columns[f"seconds.{level}"]
        tried = np.isfinite(seconds)
        out.append(
            {
                "rung": level,
                "tried": reached,
                "went_on": reached - stopped,
                "seconds_each": float(seconds[tried].mean()) if tried.any() else 0.0,
                "seconds": float(seconds[tried].sum()),
            }
        )
        reached -= stopped
    return out


def speedup(statistics: list[dict[str, Any]]) -> float:
    """Processor time of all candidates on all levels, over the time that was spent."""
    full = sum(level["seconds_each"] for level in statistics) * statistics[0]["tried"]
    spent = sum(level["seconds"] for level in statistics)
    return float(full / spent) if spent > 0.0 else 1.0


def reasons(results: Results) -> list[dict[str, Any]]:
    """Return why candidates were dropped, most frequent first: count, and an example.

    Reasons that differ in their numbers alone are one.
    """
    texts = [text for text in results.columns["reason"] if text]
    alike = [re.sub(r"-?\d[\d.]*", "#", text) for text in texts]
    return [
        {"count": count, "example": texts[alike.index(kind)]}
        for kind, count in Counter(alike).most_common()
    ]


def summary(results: Results) -> dict[str, Any]:
    """Figures of a study."""
    statistics = level_statistics(results)
    goals = [one.measure for one in results.study.objective]
    columns = results.columns
    front_rows = []
    for row in np.flatnonzero(results.front()):
        values = {name: columns[name][row] for name in (*results.variables, *goals)}
        plain = {k: v if isinstance(v, str) else float(v) for k, v in values.items()}
        front_rows.append({"trial": int(columns["trial"][row]), **plain})
    shares = {}
    for goal in goals:
        use = np.isfinite(columns[goal])
        shares[goal] = {
            name: importance(columns[goal][use], results.shares(name)[use])
            for name in results.variables
        }
    return {
        "study": results.study.name,
        "candidates": len(results.ok),
        "statuses": dict(Counter(columns["status"]).most_common()),
        "reasons": reasons(results),
        "front": front_rows,
        "importance": shares,
        "agreement": agreement(results),
        "ladder": statistics,
        "times_saved": speedup(statistics),
    }


def write_page(folder: Path) -> Path:
    """Write the self-contained ``report.html``, and ``summary.json``, of a study's folder.

    Raises
    ------
    OutputError
        If they cannot be written.
    """
    results = read_results(folder)
    study, columns = results.study, results.columns
    figures = finite(summary(results))
    goals = {one.measure: one.goal for one in study.objective}
    named = dict.fromkeys([*results.variables, *goals, *measures_up_to(study.levels)])
    # Empty and constant columns show nothing.
    shown = [name for name in named if len(set(_rounded(columns[name])) - {None}) > 1]
    data = {
        "name": study.name,
        "description": study.description,
        "variables": [name for name in shown if name in results.variables],
        "goals": goals,
        "docs": {
            name: f"{MEASURES[name].doc} (level {MEASURES[name].rung})" if name in MEASURES else ""
            for name in shown
        },
        "columns": {name: _rounded(columns[name]) for name in shown},
        "trial": [int(trial) for trial in columns["trial"]],
        "status": columns["status"],
        "front": [int(row) for row in np.flatnonzero(results.front())],
        "summary": {key: value for key, value in figures.items() if key != "front"},
    }
    template = resources.files("phytac_design.report") / "study.html"
    # "</" would end the script that holds the data.
    text = json.dumps(finite(data), ensure_ascii=False).replace("</", "<\\/")
    page = template.read_text(encoding="utf-8").replace("/*DATA*/null", text)
    path = folder / "report.html"
    try:
        path.write_text(page, encoding="utf-8")
        (folder / "summary.json").write_text(
            json.dumps(figures, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {path}: {error.strerror}; free disk space"
        ) from None
    return path


def _rounded(column: Any) -> list[Any]:
    """Values with five digits, so that a page of ten thousand rows stays small."""
    if not isinstance(column, np.ndarray):
        return list(column)
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in column.tolist()]
