"""Tolerances on random designs: is the achieved error within them, and does the cost rise."""

import multiprocessing
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.harness import Table
from benchmarks.tradeoff_designs import random_designs
from benchmarks.tradeoff_journal import once
from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_design.study.tradeoff.choose import choose_tolerance
from phytac_design.study.tradeoff.force import ForceError, rms
from phytac_shapes.errors import DesignError, PhytacError

TOLERANCES = (0.10, 0.05, 0.02, 0.01, 0.005)
DESIGNS, SEED = 40, 40
WITHIN = 95.0
"""Share of choices, %, whose achieved error must be within the tolerance."""
REFERENCE_IS = "large displacements extrapolated from two meshes that are not the setting's"


def judge(data: dict[str, Any]) -> dict[str, Any]:
    """All tolerances on one design: what is predicted and what comes."""
    design = parse_design(data, "random design")
    return once(design, "tolerance", lambda: _judged(design))


def _judged(design: Design) -> dict[str, Any]:
    error = ForceError(design)
    out: dict[str, Any] = {
        "name": design.name,
        "markers": error.sensor.markers.count,
        "choices": {},
    }
    for tolerance in TOLERANCES:
        try:
            choice = choose_tolerance(design, tolerance, error=error)
        except DesignError as refused:
            out["choices"][f"{tolerance:g}"] = {"refused": str(refused)}
            continue
        except PhytacError as failed:
            out["choices"][f"{tolerance:g}"] = {"failed": str(failed)}
            continue
        out["choices"][f"{tolerance:g}"] = {
            "predicted": choice.predicted_error,
            "achieved": rms(error.errors(choice.accuracy)),
            "seconds": choice.seconds,
            "mechanics_s": sum(
                choice.predicted_s[name]
                for name in ("places", "response", "resolution", "underload", "mesh")
            ),
            "settings": choice.accuracy.as_dict(),
        }
    return out


def add_rows(table: Table, *, quick: bool) -> None:
    """Add the rows of every tolerance."""
    count = 3 if quick else DESIGNS
    asked = [design.model_dump(mode="json") for design in random_designs(count, SEED)]
    found: list[dict[str, Any]] = []
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for result in pool.imap(judge, asked):
            found.append(result)
            print(f"  {len(found)} of {count}: {result['name']}", flush=True)
    for tolerance in TOLERANCES:
        _add_tolerance(table, tolerance, found)
    rising = [_rises(result) for result in found]
    row = (
        f"force tolerance: predicted seconds rise from each tolerance to the next, {count} designs"
    )
    source = "own target: a tighter tolerance never costs less"
    table.add(row, 100.0 * float(np.mean(rising)), "%", 100.0, source, ">= 100")
    whole = [c for result in found for c in result["choices"].values() if "achieved" in c]
    row = "force tolerance: achieved error over predicted, median of all choices"
    source = "1 is no safety"
    note = (
        f"90 % from {np.percentile([c['achieved'] / c['predicted'] for c in whole], 5):.2f} "
        f"to {np.percentile([c['achieved'] / c['predicted'] for c in whole], 95):.2f}"
    )
    value = float(np.median([c["achieved"] / c["predicted"] for c in whole]))
    table.add(row, value, "ratio", 1.0, source, note=note)


def _add_tolerance(table: Table, tolerance: float, found: list[dict[str, Any]]) -> None:
    choices = [result["choices"][f"{tolerance:g}"] for result in found]
    chosen = [choice for choice in choices if "achieved" in choice]
    refused = sum("refused" in choice for choice in choices)
    failed = [choice["failed"] for choice in choices if "failed" in choice]
    label = f"force tolerance {100.0 * tolerance:g} %"
    row = f"{label}: designs for which a setting was found"
    source = "all that were drawn"
    note = f"{refused} refused, their best setting being predicted worse" + (
        f"; {len(failed)} not solved: {failed[0][:120]}" if failed else ""
    )
    table.add(row, len(chosen), "designs", len(found), source, note=note)
    if not chosen:
        return
    within = [choice["achieved"] <= tolerance for choice in chosen]
    row = f"{label}: of these, achieved error within the tolerance"
    source = f"{len(chosen)} random designs of all shapes"
    note = (
        f"largest {100.0 * max(c['achieved'] for c in chosen):.3g} %, median "
        f"{100.0 * float(np.median([c['achieved'] for c in chosen])):.3g} %"
    )
    value = 100.0 * float(np.mean(within))
    table.add(row, value, "%", REFERENCE_IS, source, f">= {WITHIN:g}", note)
    row = f"{label}: predicted seconds of meshes, tables and presses, median"
    value = float(np.median([choice["mechanics_s"] for choice in chosen]))
    table.add(row, value, "s", "-", "cost model")


def _rises(result: dict[str, Any]) -> bool:
    spent = [c["seconds"] for c in result["choices"].values() if "seconds" in c]
    return all(b >= 0.999 * a for a, b in pairwise(spent))
