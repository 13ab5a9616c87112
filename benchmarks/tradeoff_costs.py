"""Coefficients of the cost model: whole builds of random designs at random settings, timed."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Table
from benchmarks.tradeoff_budget import empty_cache
from benchmarks.tradeoff_designs import random_designs
from benchmarks.tradeoff_journal import once
from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.spec import Design
from phytac_design.stages import STAGES
from phytac_design.stages.build import run_stages
from phytac_design.study.tradeoff import coefficients
from phytac_design.study.tradeoff.cost import Work, fit, probe_s, terms
from phytac_shapes.errors import PhytacError

DESIGNS, SEED = 16, 11
HELD_OUT = 4
"""Every so many builds one is not fitted to, but judged on."""


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
        print_tools=bool(one(0, 1)),
    )


def timed(design: Design, setting: Accuracy) -> dict[str, Any]:
    """Seconds of every stage of a build, and of the machine's probe beside it."""
    with empty_cache():
        before = probe_s()
        try:
            _, _, seconds = run_stages(
                design, STAGES, accuracy=setting, seed=0, force=True, progress=lambda _: None
            )
        except PhytacError as failed:
            return {"failed": str(failed)}
        return {"seconds": seconds, "probe_s": min(before, probe_s())}


def add_rows(table: Table, *, quick: bool) -> None:
    """Time builds, fit the model, write it, and say how well it foretells builds not fitted to."""
    fitted: dict[str, list[tuple[list[float], float]]] = {s.name: [] for s in STAGES}
    judged: list[tuple[Work, Accuracy, dict[str, float]]] = []
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
        work = Work(design)
        if number % HELD_OUT == HELD_OUT - 1:
            judged.append((work, setting, found["seconds"]))
            continue
        for name, counts in terms(work, setting).items():
            fitted[name].append((counts, found["seconds"][name]))
    model = fit(fitted)
    if not quick:
        write(model, float(np.median(probes)))
    off = []
    for work, setting, seconds in judged:
        own = terms(work, setting)
        foretold = sum(float(np.dot(model[name], own[name])) for name in model)
        off.append(foretold / sum(seconds.values()) - 1.0)
    if off:
        table.add(
            "cost model: whole builds not fitted to, mean distance from their seconds",
            100.0 * float(np.mean(np.abs(off))),
            "%",
            reference=0.0,
            source=f"{len(off)} random designs at random settings",
            target="<= 20",
            note=f"largest {100.0 * float(np.max(np.abs(off))):.0f} %",
        )


def write(model: dict[str, list[float]], probe: float) -> None:
    """Write ``coefficients.py``."""
    command = "python -m benchmarks.tradeoff --parts costs"
    lines = [
        f'"""Coefficients of the cost model; made by ``{command}``."""',
        "",
        f"PROBE_S = {probe:.4g}",
        '"""Seconds of the probe on the machine that they are of."""',
        "COEFFICIENTS: dict[str, list[float]] = {",
        *(f'    "{name}": {values},' for name, values in model.items()),
        "}",
        '"""Seconds of each term of a stage; see :func:`cost.terms`."""',
    ]
    path = Path(os.fspath(coefficients.__file__))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
