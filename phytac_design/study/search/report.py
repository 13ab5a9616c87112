"""A study's results for a reader: front, importance, agreement of rungs, and a page of all that."""

import json
from collections import Counter
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from phytac_design.core.json_values import finite
from phytac_design.study.search.measures import MEASURES, measures_up_to
from phytac_design.study.search.pareto import front
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.study_folder import read_columns, read_study
from phytac_design.study.search.successive_halving import OK
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import OutputError

BINS = 12
"""Slices of a variable, by rank, for its importance."""
LEAST_ROWS = 8
"""Rows below which nothing is said about importance or agreement."""
DIGITS = 5


@dataclass(frozen=True, kw_only=True)
class Results:
    """A study's rows by column, n of them.

    Attributes
    ----------
    study : Study
        Which it is.
    variables : tuple of str
        Fields that vary.
    columns : dict
        Arrays (n,), NaN where a row has no value; lists of text for words.
    """

    study: Study
    variables: tuple[str, ...]
    columns: dict[str, Any]

    @property
    def ok(self) -> BoolArray:
        """Rows (n,) that met everything."""
        return np.array([status == OK for status in self.columns["status"]], dtype=np.bool_)

    def objectives(self) -> FloatArray:
        """Objectives (n, k), less is better."""
        columns = [
            self.columns[one.measure] * (1.0 if one.goal == "min" else -1.0)
            for one in self.study.objective
        ]
        return np.stack(columns, axis=1) if columns else np.zeros((len(self.ok), 0))

    def front(self) -> BoolArray:
        """Rows (n,) that met everything and that no other such row is better than."""
        values, out = self.objectives(), np.zeros(len(self.ok), dtype=np.bool_)
        able = np.flatnonzero(self.ok & np.isfinite(values).all(axis=1))
        if values.shape[1] and len(able):
            out[able] = front(values[able])
        return out

    def shares(self, name: str) -> FloatArray:
        """Values of a variable (n,) as numbers: choices by their place."""
        column = self.columns[name]
        if isinstance(column, np.ndarray):
            return column
        known = {value: place for place, value in enumerate(dict.fromkeys(sorted(column)))}
        return np.array([known[value] for value in column], dtype=np.float64)


def read_results(folder: Path) -> Results:
    """All that a study has done so far.

    Raises
    ------
    InputError
        If the folder holds no study or no results.
    """
    study, _, _ = read_study(folder)
    variables = tuple(variable.field for variable in study.variable)
    measures = measures_up_to(study.rungs)
    seconds = [f"seconds.{rung}" for rung in study.rungs]
    names = ["trial", *variables, *measures, "status", "rung", "reason", *seconds]
    return Results(study=study, variables=variables, columns=read_columns(folder, names))


def importance(values: FloatArray, of: FloatArray) -> float:
    """Share of the variance of ``values`` (n,) that slices of a variable (n,) explain, 0 to 1.

    The first-order Sobol index, from means over ``BINS`` slices of equal count, less what slices
    of no meaning would explain by chance (Archer, Saltelli, Sobol 1997; epsilon squared).
    """
    n = len(values)
    if n < LEAST_ROWS or float(np.ptp(values)) == 0.0:
        return 0.0
    known = np.unique(of)
    if len(known) <= BINS:
        group = np.searchsorted(known, of)
    else:
        group = np.argsort(np.argsort(of, kind="stable")) * min(BINS, n // 2) // n
    count = np.bincount(group).astype(np.float64)
    filled = count > 0
    mean = np.bincount(group, weights=values)[filled] / count[filled]
    between = float((count[filled] * (mean - values.mean()) ** 2).sum())
    total = float(((values - values.mean()) ** 2).sum())
    slices = int(filled.sum())
    if n <= slices:
        return 0.0
    within = (total - between) / (n - slices)
    return max(0.0, (between - (slices - 1) * within) / total)


def agreement(results: Results) -> list[dict[str, Any]]:
    """Rank correlation (Spearman) of each measure with the one that it predicts on a later rung.

    Over candidates that reached both, also those that then missed a constraint.
    """
    out = []
    for name in measures_up_to(results.study.rungs):
        earlier = MEASURES[name].proxy
        if not earlier:
            continue
        pair = np.stack([results.columns[earlier], results.columns[name]])
        pair = pair[:, np.isfinite(pair).all(axis=0)]
        if pair.shape[1] < LEAST_ROWS or float(np.ptp(pair, axis=1).min()) == 0.0:
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


def ladder_of(results: Results) -> list[dict[str, Any]]:
    """How many candidates tried each rung, how many went on, and what one costs there."""
    out, reached = [], len(results.ok)
    for rung in results.study.rungs:
        stopped = sum(
            1
            for where, status in zip(
                results.columns["rung"], results.columns["status"], strict=True
            )
            if where == rung and status != OK
        )
        seconds = results.columns[f"seconds.{rung}"]
        tried = np.isfinite(seconds)
        out.append(
            {
                "rung": rung,
                "tried": reached,
                "went_on": reached - stopped,
                "seconds_each": float(seconds[tried].mean()) if tried.any() else 0.0,
                "seconds": float(seconds[tried].sum()),
            }
        )
        reached -= stopped
    return out


def saved(ladder: list[dict[str, Any]]) -> float:
    """Processor time that all candidates on all rungs would take, over what they took."""
    all_of_them = sum(rung["seconds_each"] for rung in ladder) * ladder[0]["tried"]
    spent = sum(rung["seconds"] for rung in ladder)
    return float(all_of_them / spent) if spent > 0.0 else 1.0


def summary(results: Results) -> dict[str, Any]:
    """Figures of a study."""
    ladder = ladder_of(results)
    goals = [one.measure for one in results.study.objective]
    able = results.ok
    best = np.flatnonzero(results.front())
    return {
        "study": results.study.name,
        "candidates": len(able),
        "statuses": dict(Counter(results.columns["status"]).most_common()),
        "front": [
            {
                "trial": int(results.columns["trial"][row]),
                **{name: _plain(results.columns[name][row]) for name in results.variables},
                **{name: _plain(results.columns[name][row]) for name in goals},
            }
            for row in best
        ],
        "importance": {
            goal: {
                name: importance(
                    results.columns[goal][use := np.isfinite(results.columns[goal])],
                    results.shares(name)[use],
                )
                for name in results.variables
            }
            for goal in goals
        },
        "agreement": agreement(results),
        "ladder": ladder,
        "times_saved": saved(ladder),
    }


def _plain(value: Any) -> Any:
    return value if isinstance(value, str) else float(value)


def write_page(folder: Path) -> Path:
    """Write ``report.html`` and ``summary.json`` of a study's folder; needs no other file.

    Raises
    ------
    OutputError
        If they cannot be written.
    """
    results = read_results(folder)
    figures = finite(summary(results))
    goals = [one.measure for one in results.study.objective]
    shown = list(dict.fromkeys([*results.variables, *goals, *measures_up_to(results.study.rungs)]))
    # What no row has, and what all rows have alike, shows nothing.
    shown = [name for name in shown if _varies(results.columns[name])]
    data = {
        "name": results.study.name,
        "description": results.study.description,
        "variables": [name for name in shown if name in results.variables],
        "goals": {one.measure: one.goal for one in results.study.objective},
        "docs": {name: _doc(name) for name in shown},
        "columns": {name: _short(results.columns[name]) for name in shown},
        "trial": [int(trial) for trial in results.columns["trial"]],
        "status": results.columns["status"],
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
        raise OutputError(f"cannot write {path}: {error.strerror}; make room") from None
    return path


def _varies(column: Any) -> bool:
    if isinstance(column, np.ndarray):
        known = column[np.isfinite(column)]
        return bool(len(known) and float(np.ptp(known)) > 0.0)
    return len(set(column)) > 1


def _doc(name: str) -> str:
    if name not in MEASURES:
        return ""
    measure = MEASURES[name]
    return f"{measure.doc} (rung {measure.rung})"


def _short(column: Any) -> list[Any]:
    """Values with few digits; a page of ten thousand rows stays small."""
    if not isinstance(column, np.ndarray):
        return list(column)
    return [
        float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None for value in column.tolist()
    ]
