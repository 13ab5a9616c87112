"""Unit costs of whole builds: random designs at random settings, timed."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from pprint import pformat
from typing import Any

import numpy as np

from benchmarks.harness import Table
from benchmarks.tradeoff_designs import random_designs
from benchmarks.tradeoff_journal import empty_cache, once
from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.spec import Design
from phytac_design.stages import STAGES
from phytac_design.stages.build import run_stages
from phytac_design.study.planning import unit_costs
from phytac_design.study.planning.cost import Amounts, Workload, features, fit, predict, probe_s
from phytac_shapes.errors import PhytacError

DESIGNS, SEED = 16, 11
HELD_OUT = 4
"""One in so many builds is not fitted to, but predicted."""


def random_setting(number: int) -> Accuracy:
    """Settings between the cheapest and nearly the finest, drawn at random."""
    rng = np.random.default_rng([SEED, number])

    def one(*values: float) -> float:
        return float(rng.choice(np.array(values)))

    return replace(
        PRESETS["draft"],
        cad_tolerance_mm=one(0.05, 0.02, 0.01),
        refine=int(one(2, 3, 4, 5)),
        truth_refine=int(one(5, 7, 9)),
        sample_share=one(0.3, 1.0),
        frames=int(one(5, 15, 30)),
        place_share=one(0.8, 0.55),
        place_orders=int(one(1, 3, 4)),
        press_places=int(one(8, 20, 40)),
        press_tolerance=one(1.0, 1.0, 0.05),
        tools=bool(one(0, 1)),
        step=bool(one(0, 1)),
    )


def timed(design: Design, setting: Accuracy) -> dict[str, Any]:
    """Seconds of every stage of a build, and of the machine's probe beside it."""
    with empty_cache():
        before = probe_s.__wrapped__(time.perf_counter)
        try:
            _, _, seconds = run_stages(
                design, STAGES, accuracy=setting, seed=0, force=True, progress=lambda _: None
            )
        except PhytacError as failed:
            return {"failed": str(failed)}
        return {"seconds": seconds, "probe_s": min(before, probe_s.__wrapped__(time.perf_counter))}


def add_rows(table: Table, *, quick: bool) -> None:
    """Time builds, fit the model, write it, and add its error on the other builds."""
    fitted: dict[str, list[tuple[Amounts, float]]] = {s.name: [] for s in STAGES}
    held_out: list[tuple[dict[str, Amounts], dict[str, float]]] = []
    probes = []
    for number, design in enumerate(random_designs(2 if quick else DESIGNS, SEED)):
        setting = random_setting(number)
        found = once(design, f"costs {number}", partial(timed, design, setting))
        print(
            f"  {design.name}: {found.get('failed') or sum(found['seconds'].values())}", flush=True
        )
        if "failed" in found:
            continue
        probes.append(found["probe_s"])
        amounts = features(Workload(design).counts(setting), setting, design)
        if number % HELD_OUT == HELD_OUT - 1:
            held_out.append((amounts, found["seconds"]))
            continue
        for name, own in amounts.items():
            fitted[name].append((own, found["seconds"][name]))
    model = fit(fitted)
    if not quick:
        write_units(WALL_s=model, PROBE_s=float(np.median(probes)))
    off = [
        sum(predict(model, amounts).values()) / sum(seconds.values()) - 1.0
        for amounts, seconds in held_out
    ]
    if off:
        row = "cost model: whole builds not fitted to, mean distance from their seconds"
        source = f"{len(off)} random designs at random settings"
        note = f"largest {100.0 * float(np.max(np.abs(off))):.0f} %"
        table.add(row, 100.0 * float(np.mean(np.abs(off))), "%", 0.0, source, "<= 20", note)


def write_units(**new: Any) -> None:
    """Write ``unit_costs.py`` with some of its tables replaced.

    The other tables are scaled by the new probe's time, if there is one.
    """
    path = Path(os.fspath(unit_costs.__file__))
    text = path.read_text(encoding="utf-8")
    head, docs = text[: text.index("PROBE_s")], text.split('"""')[3::2]
    scale = new.get("PROBE_s", unit_costs.PROBE_s) / unit_costs.PROBE_s
    tables: dict[str, Any] = {"PROBE_s": new.get("PROBE_s", unit_costs.PROBE_s)}
    for name, factor in (("WALL_s", scale), ("CPU_s", scale), ("MEMORY_MB", 1.0)):
        old: dict[str, dict[str, float]] = getattr(unit_costs, name)
        tables[name] = new.get(name) or {
            stage: {term: float(f"{factor * value:.4g}") for term, value in own.items()}
            for stage, own in old.items()
        }
    kind = "dict[str, dict[str, float]]"
    for (name, value), doc in zip(tables.items(), docs, strict=True):
        shown = f"{value:.4g}" if name == "PROBE_s" else pformat(value, width=96)
        head += f'{name}{"" if name == "PROBE_s" else ": " + kind} = {shown}\n"""{doc}"""\n'
    path.write_text(head, encoding="utf-8")
    subprocess.run([sys.executable, "-m", "ruff", "format", "-q", str(path)], check=False)
