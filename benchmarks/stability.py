"""Verification at the extremes: counts, worst errors, balances, units, symmetry, single precision.

``python -m benchmarks.stability [--quick]`` runs ``python -m pytest verification -n 2`` and makes
the rows of the outcomes that it writes.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.harness import Table, run_parts
from verification.case import unreadable

WALL_MAX_S = 1200.0
KINDS = {
    "reference": ("worst error against a reference", "text-book, published, or another program"),
    "units": ("worst difference in other units", "the same case in its own units"),
    "balance": ("worst balance of forces, moments or energy", "equilibrium"),
    "symmetry": ("worst difference under symmetry or other axes", "the same case unturned"),
    "float32": ("worst loss in single precision", "the same data in double precision"),
}
Outcome = dict[str, Any]


def run(*, quick: bool) -> list[Outcome]:
    """Outcomes of the cases, or of the fast subset."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "outcomes.jsonl"
        words = ["-m", "fast"] if quick else ["-n", "2"]
        command = [sys.executable, "-m", "pytest", "verification", "--outcomes", str(path), *words]
        subprocess.run(command, check=False)
        return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def nearest(outcomes: Sequence[Outcome], kind: str) -> dict[str, Any] | None:
    """Of all findings of a kind that have a tolerance, the one nearest to it."""
    found = [
        finding
        for outcome in outcomes
        for finding in outcome["findings"]
        if finding["kind"] == kind and finding["tolerance"] > 0.0
    ]
    return max(found, key=lambda f: float(f["error"] / f["tolerance"]), default=None)


def add_rows(table: Table, outcomes: Sequence[Outcome], seconds: float) -> None:
    """All rows of a run."""
    wrong = [o for o in outcomes if o["verdict"] == "wrong"]
    refused = [o for o in outcomes if o["verdict"] == "refused"]
    poor = [o for o in refused if unreadable(o["message"])]
    note = "; ".join(f"{o['group']}: {o['name']}: {o['why']}" for o in wrong)[:1000]
    table.goal("cases over all groups and shapes", len(outcomes), "cases", ">= 1400")
    table.goal("wrong", len(wrong), "cases", "== 0", note=note)
    source = f"{len(refused)} refusals: a sentence with a figure or a field, and the fix"
    table.goal("refusals that a user cannot understand", len(poor), "cases", "== 0", source=source)
    for group in dict.fromkeys(o["group"] for o in outcomes):
        own = [o for o in outcomes if o["group"] == group]
        name = group.replace("_", " ")
        counts = {v: sum(o["verdict"] == v for o in own) for v in ("right", "refused", "wrong")}
        said = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
        table.add(f"{name}: cases", len(own), "cases", reference="verdicts", source=said)
        for kind, (what, source) in KINDS.items():
            worst = nearest(own, kind)
            if worst:
                row = f"{name}: {what}"
                value = worst["error"]
                target = f"<= {worst['tolerance']:g}"
                table.add(
                    row,
                    value,
                    "",
                    0.0,
                    f"{source}: {worst['reference']}",
                    target,
                    "of all findings the one nearest to its own tolerance",
                )
        numbers = [o["facts"]["condition"] for o in own if "condition" in o["facts"]]
        if numbers:
            row = f"{name}: largest condition number"
            table.add(row, max(numbers), "", min(numbers), "smallest of the group")
    spent = sum(o["seconds"] for o in outcomes)
    table.add("processor time of all cases", spent, "s", reference="none", source="sum of workers")
    table.goal("wall time, 2 workers", seconds, "s", f"<= {WALL_MAX_S:g}")


def add_cases(table: Table, *, quick: bool) -> None:
    """Run the cases, and add the rows."""
    start = time.perf_counter()
    outcomes = run(quick=quick)
    add_rows(table, outcomes, time.perf_counter() - start)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Return the only part."""
    return {"cases": partial(add_cases, quick=quick)}


if __name__ == "__main__":
    run_parts("stability", parts, __doc__ or "")
