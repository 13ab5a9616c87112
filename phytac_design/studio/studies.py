"""Studies of the project folder: their candidates and fronts, and the design of a candidate."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.core.json_values import finite
from phytac_design.report.figure_names import NAMES
from phytac_design.studio.files import walk
from phytac_design.study.search.measures import MEASURES
from phytac_design.study.search.search_report import read_results
from phytac_design.study.search.study_folder import RESULTS, STUDY, read_study, rebuild
from phytac_shapes.errors import InputError, PhytacError

Json = dict[str, Any]


def studies(root: Path) -> list[Json]:
    """Folders below the project folder that hold a study with results."""
    out = []
    for path in walk(root, STUDY):
        folder = path.parent
        parts = (folder / "parts").glob("*.parquet")
        if path.name != STUDY or not ((folder / RESULTS).is_file() or any(parts)):
            continue
        try:
            study, base, kind = read_study(folder)
        except (PhytacError, ValueError):
            continue
        out.append(
            {
                "folder": folder.relative_to(root).as_posix(),
                "name": study.name,
                "description": study.description,
                "kind": kind,
                "design": str(base.get("name", "")),
                "page": (folder / "report.html").is_file(),
            }
        )
    return out


def study_table(folder: Path) -> Json:
    """Up to 2000 rows of a study: the front, then the feasible ones, then the others.

    Raises
    ------
    InputError
        If the folder holds no study or no results, or they cannot be read.
    """
    with _readable(folder):
        results = read_results(folder)
    front = results.front()
    order = np.lexsort((np.arange(len(front)), ~results.ok, ~front))[:2000]
    goals = {one.measure: one.goal for one in results.study.objective}
    shown = list(dict.fromkeys([*results.variables, *goals]))
    table: Json = finite(
        {
            "name": results.study.name,
            "variables": list(results.variables),
            "goals": goals,
            "docs": {
                name: MEASURES[name].doc if name in MEASURES else NAMES.get(name, name)
                for name in shown
            },
            "units": {name: MEASURES[name].unit for name in shown if name in MEASURES},
            "candidates": len(front),
            "rows": [
                {
                    "trial": int(results.columns["trial"][row]),
                    "status": results.columns["status"][row],
                    "reason": results.columns["reason"][row] or "",
                    "front": bool(front[row]),
                    "values": [_plain(results.columns[name][row]) for name in shown],
                }
                for row in order
            ],
        }
    )
    return table


def trial_design(folder: Path, trial: int) -> Json:
    """Tables of one candidate's design.

    Raises
    ------
    InputError
        If there is no such candidate.
    DesignError
        If this version of the program makes another design of it.
    """
    with _readable(folder):
        return rebuild(folder, trial).model_dump(mode="json")


@contextmanager
def _readable(folder: Path) -> Iterator[None]:
    """Turn what a Parquet reader raises for a damaged file into :class:`InputError`."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, NotImplementedError) as error:
        text = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise InputError(
            "study-results-unreadable",
            f"{folder.name} has results that cannot be read ({text}); run the study again",
        ) from None


def _plain(value: Any) -> Any:
    if isinstance(value, str) or value is None:
        return value
    number = float(value)
    return float(f"{number:.6g}") if math.isfinite(number) else None
