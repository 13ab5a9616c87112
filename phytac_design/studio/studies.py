"""Studies of the workplace: their candidates and front, and any of them back in the controls."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.core.json_values import finite
from phytac_design.report.figure_names import NAMES
from phytac_design.studio.files import walk
from phytac_design.study.search.measures import MEASURES
from phytac_design.study.search.rebuild import rebuild
from phytac_design.study.search.report import Results, read_results
from phytac_design.study.search.study_folder import RESULTS, STUDY, read_study
from phytac_shapes.errors import InputError, PhytacError

ROWS_MAX = 2000
"""Candidates that the page gets: the front, then those that met everything, then the others."""

Json = dict[str, Any]


def studies(root: Path) -> list[Json]:
    """Folders below a workplace that hold a study with results."""
    out = []
    for path in walk(root, STUDY):
        folder = path.parent
        if path.name != STUDY or not _has_results(folder):
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


def _has_results(folder: Path) -> bool:
    return (folder / RESULTS).is_file() or any((folder / "parts").glob("*.parquet"))


def study_table(folder: Path) -> Json:
    """Rows of a study as the page shows them: variables, objectives, status, front.

    Raises
    ------
    InputError
        If the folder holds no study or no results, or they cannot be read.
    """
    results = _results(folder)
    front = results.front()
    order = np.lexsort((np.arange(len(front)), ~results.ok, ~front))[:ROWS_MAX]
    goals = {one.measure: one.goal for one in results.study.objective}
    shown = list(dict.fromkeys([*results.variables, *goals]))
    table: Json = finite(
        {
            "name": results.study.name,
            "variables": list(results.variables),
            "goals": goals,
            "docs": {name: _doc(name) for name in shown},
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


def _results(folder: Path) -> Results:
    try:
        return read_results(folder)
    except PhytacError:
        raise
    except (OSError, ValueError, KeyError, TypeError, NotImplementedError) as error:
        # What a Parquet reader says of a damaged file is a ValueError or an OSError.
        text = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise InputError(
            f"{folder.name} has results that cannot be read ({text}); run the study again"
        ) from None


def trial_design(folder: Path, trial: int) -> Json:
    """Tables of one candidate's design.

    Raises
    ------
    InputError
        If there is no such candidate.
    DesignError
        If it cannot be made any more.
    """
    try:
        return rebuild(folder, trial).model_dump(mode="json")
    except (OSError, ValueError, KeyError, TypeError, NotImplementedError) as error:
        text = str(error).splitlines()[0][:200]
        raise InputError(f"{folder.name} cannot be read ({text}); run the study again") from None


def _doc(name: str) -> str:
    return MEASURES[name].doc if name in MEASURES else NAMES.get(name, name)


def _plain(value: Any) -> Any:
    if isinstance(value, str) or value is None:
        return value
    number = float(value)
    return float(f"{number:.6g}") if math.isfinite(number) else None
