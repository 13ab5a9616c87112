"""Budgets on random designs: is a build done in the time it was given."""

from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import Table
from benchmarks.tradeoff_designs import random_designs
from benchmarks.tradeoff_journal import empty_cache, once
from phytac_design.design.spec import Design
from phytac_design.study.tradeoff.build_to import build_to
from phytac_shapes.errors import DesignError, PhytacError

BUDGETS_s = (30.0, 45.0, 60.0, 90.0, 120.0)
DESIGNS, SEED = 24, 5
OVER = 1.2
MET = 90.0


def built(design: Design, budget_s: float) -> dict[str, Any]:
    """One build in a time: seconds taken, or why not."""
    with empty_cache() as folder:
        try:
            result, choice = build_to(
                design, folder / "out", budget_s=budget_s, force=True, progress=lambda _: None
            )
        except DesignError as refused:
            return {"refused": str(refused)}
        except PhytacError as failed:
            return {"failed": str(failed)}
    return {
        "seconds": result.seconds,
        "predicted": choice.seconds,
        "settings": choice.accuracy.as_dict(),
        "stages": choice.achieved_s,
    }


def add_rows(table: Table, *, quick: bool) -> None:
    """Add the rows of all budgets together."""
    count = 2 if quick else DESIGNS
    runs = []
    for number, design in enumerate(random_designs(count, SEED)):
        budget = BUDGETS_s[number % len(BUDGETS_s)]
        run = once(design, f"budget {budget:g}", partial(built, design, budget))
        runs.append(run | {"budget": budget})
        spent = run.get("seconds")
        print(f"  {design.name}, {budget:g} s: {spent or run}", flush=True)
    done = [run for run in runs if "seconds" in run]
    refused = sum("refused" in run for run in runs)
    failed = [run["failed"] for run in runs if "failed" in run]
    if not done:
        return
    ratio = np.array([run["seconds"] / run["budget"] for run in done])
    row = f"budgets of {BUDGETS_s[0]:g} to {BUDGETS_s[-1]:g} s: builds done within 1.2 times theirs"
    source = f"{len(done)} builds of random designs, empty cache"
    note = (
        f"from {ratio.min():.2f} to {ratio.max():.2f} times the budget, median "
        f"{float(np.median(ratio)):.2f}; {refused} refused beforehand as too short"
        + (f"; {len(failed)} could not be built: {failed[0][:120]}" if failed else "")
    )
    table.add(row, 100.0 * float(np.mean(ratio <= OVER)), "%", 100.0, source, f">= {MET:g}", note)
    first = np.array([run["seconds"] / run["predicted"] for run in done])
    row = "budgets: seconds taken over those of the first plan, median distance from 1"
    source = "cost model, before anything ran"
    note = f"from {first.min():.2f} to {first.max():.2f}"
    table.add(row, 100.0 * float(np.median(np.abs(first - 1.0))), "%", 0.0, source, note=note)
