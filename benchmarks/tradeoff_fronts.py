"""Fronts of three sensors, and what the presets are by them."""

import json
from typing import Any

from benchmarks.harness import RESULTS, Table
from benchmarks.tradeoff_journal import folder
from phytac_design.accuracy import PRESETS
from phytac_design.design_file import load_design
from phytac_design.study.trade.derive import derive, most_beaten
from phytac_design.study.trade.front import Measured, knee
from phytac_design.study.trade.levels import accuracy_of
from phytac_design.study.trade.run import tradeoff

DESIGNS = ("cylinder60", "hemisphere", "grip")
FRONTS = RESULTS / "tradeoff_fronts.json"
"""Every joint setting as measured; the presets are derived from it."""
DOMINATED = 0.10
DIGITS = 6
PICTURES = RESULTS.parents[1] / "docs" / "images"


def add_rows(table: Table, *, quick: bool) -> None:
    """Measure the fronts; add each preset's place on them."""
    fronts: dict[str, list[Measured]] = {}
    for name in DESIGNS[1:2] if quick else DESIGNS:
        out = folder() / name
        done = tradeoff(load_design(name), out, only=("joint",), quick=quick)
        fronts[name] = done.joint
        for quantity in ("force", "visibility"):
            at = knee(done.joint, quantity)
            table.add(
                f"{name}: front of {quantity}: knee",
                at.seconds,
                "s",
                reference="-",
                source=f"{len(done.joint)} joint settings",
                note=f"error {100.0 * at.errors[quantity]:.3g} %; "
                + ", ".join(f"{k} {v}" for k, v in at.settings.items()),
            )
        for preset, point in done.presets.items():
            errors = "; ".join(f"{q} {100.0 * e:.3g} %" for q, e in point.errors.items())
            table.add(
                f"{name}, {preset}: whole build, sum of stages",
                point.seconds,
                "s",
                reference="-",
                source="each stage in a process of its own",
                note=f"errors: {errors}; peak {point.peak_MB:.0f} MB",
            )
        if not quick:
            for picture in ("front",):
                png = (out / f"{picture}.png").read_bytes()
                (PICTURES / f"tradeoff-{picture}-{name}.png").write_bytes(png)
    if not quick:
        FRONTS.write_text(json.dumps(compact(fronts), separators=(",", ":")) + "\n")


def compact(fronts: dict[str, list[Measured]]) -> dict[str, Any]:
    """Fronts as short JSON: names once, rows of values."""
    return {
        design: {
            "settings": list(points[0].settings),
            "errors": list(points[0].errors),
            "rows": [
                [
                    *p.settings.values(),
                    round(p.seconds, 3),
                    round(p.cpu_s, 3),
                    round(p.peak_MB),
                    *(float(f"{e:.{DIGITS}g}") for e in p.errors.values()),
                ]
                for p in points
            ],
        }
        for design, points in fronts.items()
    }


def committed_fronts() -> dict[str, list[Measured]]:
    """The fronts that are committed."""
    out = {}
    for design, data in json.loads(FRONTS.read_text(encoding="utf-8")).items():
        count = len(data["settings"])
        out[design] = [
            Measured(
                settings=dict(zip(data["settings"], row, strict=False)),
                seconds=row[count],
                cpu_s=row[count + 1],
                peak_MB=row[count + 2],
                errors=dict(zip(data["errors"], row[count + 3 :], strict=True)),
            )
            for row in data["rows"]
        ]
    return out


def add_presets(table: Table, *, quick: bool) -> None:
    """Add what the rule makes of the committed fronts, and by how much a preset is beaten."""
    del quick
    fronts = committed_fronts()
    derived = derive(fronts)
    for name, preset in PRESETS.items():
        same = derived[name] == preset
        own = derived[name].as_dict()
        other = {k: own[k] for k, v in preset.as_dict().items() if own[k] != v}
        table.add(
            f"preset {name}: is what the rule makes of the fronts",
            float(same),
            "yes",
            reference=1.0,
            source="benchmarks/results/tradeoff_fronts.json",
            target="== 1",
            note="" if same else f"the rule gives {other}",
        )
    for (name, design), share in most_beaten(PRESETS, fronts).items():
        best = next(p for p in fronts[design] if accuracy_of(p.settings) == PRESETS[name])
        table.add(
            f"{design}, {name}: time saved by a setting that is worse in nothing",
            100.0 * share,
            "%",
            reference=best.seconds,
            source=f"{len(fronts[design])} joint settings; reference: its own seconds",
            target=f"<= {100.0 * DOMINATED:g}",
        )
