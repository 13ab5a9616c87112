"""Fronts of three sensors, and what the presets are by them."""

import json
from typing import Any

from benchmarks.harness import RESULTS, Table
from benchmarks.tradeoff_journal import folder
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.study.tradeoff.derive import derive
from phytac_design.study.tradeoff.front import Measured, beaten_by, knee
from phytac_design.study.tradeoff.plots import whole_front
from phytac_design.study.tradeoff.run import presets_of, tradeoff

DESIGNS = ("cylinder60", "hemisphere", "grip")
FRONTS = RESULTS / "tradeoff_fronts.json"
"""Every joint setting as measured; the presets are derived from it."""
DOMINATED = 0.10
DIGITS = 6
PICTURES = RESULTS.parents[1] / "docs" / "images"


def add_rows(table: Table, *, quick: bool) -> None:
    """Measure the fronts."""
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
    """Add what the rule makes of the committed fronts, and where presets are on them."""
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
    for design, points in fronts.items():
        found = presets_of(points)
        for name, point in found.items():
            errors = "; ".join(f"{q} {100.0 * e:.3g} %" for q, e in point.errors.items())
            table.add(
                f"{design}, {name}: whole build, sum of stages",
                point.seconds,
                "s",
                reference="-",
                source="each stage in a process of its own",
                note=f"errors: {errors}; peak {point.peak_MB:.0f} MB",
            )
            table.add(
                f"{design}, {name}: time saved by a setting that is worse in nothing",
                100.0 * beaten_by(point, points),
                "%",
                reference=point.seconds,
                source=f"{len(points)} joint settings; reference: its own seconds",
                target=f"<= {100.0 * DOMINATED:g}",
            )
        if not quick:
            picture = whole_front(design, points, found)
            (PICTURES / f"tradeoff-front-{design}.png").write_bytes(picture)
