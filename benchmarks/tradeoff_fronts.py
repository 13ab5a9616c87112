"""Fronts of three sensors, and what the presets are by them."""

import json
from typing import Any

from benchmarks.harness import RESULTS, Table
from benchmarks.tradeoff_journal import folder
from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.design_file import load_design
from phytac_design.study.tradeoff.front import MeasuredSetting, beaten_by, joint_fronts, knee
from phytac_design.study.tradeoff.points import accuracy_of
from phytac_design.study.tradeoff.run_tradeoff import presets_of, tradeoff

DESIGNS = ("cylinder60", "hemisphere", "grip")
FRONTS = RESULTS / "tradeoff_fronts.json"
"""Every joint setting as measured; the presets are checked against it."""
DOMINATED = 0.10
ALLOWED: dict[str, dict[str, float]] = {
    "draft": {"force": 0.20, "visibility": 0.25, "volume": 0.01, "score": 0.50},
    "standard": {"force": 0.05, "visibility": 0.10, "volume": 0.001, "score": 0.15},
}
"""Errors that a preset may have. 20 % of force and a quarter of a gap (linear presses on thin
walls) show whether a sensor works; 5 % and a tenth of a gap are small beside print scatter; a score
of 50 contacts is known to a seventh."""
FINE_s = 600.0
"""Build time of the finest preset."""
DIGITS = 6
PICTURES = RESULTS.parents[1] / "docs" / "images"


def add_rows(table: Table, *, quick: bool) -> None:
    """Measure the fronts."""
    fronts: dict[str, list[MeasuredSetting]] = {}
    for name in DESIGNS[1:2] if quick else DESIGNS:
        out = folder() / name
        done = tradeoff(load_design(name), out, only=("joint",), quick=quick)
        fronts[name] = done.joint
        for quantity in ("force", "visibility"):
            at = knee(done.joint, quantity)
            row = f"{name}: front of {quantity}: knee"
            source = f"{len(done.joint)} joint settings"
            note = f"error {100.0 * at.errors[quantity]:.3g} %; " + ", ".join(
                f"{k} {v}" for k, v in at.settings.items()
            )
            table.add(row, at.seconds, "s", "-", source, note=note)
    if not quick:
        FRONTS.write_text(json.dumps(compact(fronts), separators=(",", ":")) + "\n")


def compact(fronts: dict[str, list[MeasuredSetting]]) -> dict[str, Any]:
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


def committed_fronts() -> dict[str, list[MeasuredSetting]]:
    """The fronts that are committed."""
    out = {}
    for design, data in json.loads(FRONTS.read_text(encoding="utf-8")).items():
        count = len(data["settings"])
        out[design] = [
            MeasuredSetting(
                settings=_by_today(dict(zip(data["settings"], row, strict=False))),
                seconds=row[count],
                cpu_s=row[count + 1],
                peak_MB=row[count + 2],
                errors=dict(zip(data["errors"], row[count + 3 :], strict=True)),
            )
            for row in data["rows"]
        ]
    return out


def _by_today(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings by their names of today: ``tools`` was ``print_tools``, and meant checks alone.

    From before ``step`` was one of them: as in the grid, it goes with these. The seconds have those
    of molds and documents, and then of STEP files, in all of them.
    """
    old = dict(settings)
    old.setdefault("tools", old.pop("print_tools", None))
    return {"step": old["tools"]} | old


def preset_problems(fronts: dict[str, list[MeasuredSetting]]) -> list[str]:
    """Presets that are not what the fronts say; empty if all are.

    ``draft`` and ``standard`` are the cheapest settings, by the seconds of all designs together,
    within :data:`ALLOWED` on every design. ``fine`` has the smallest errors among those that are
    built in :data:`FINE_s`. All but ``draft`` check every printed part.
    """
    each: dict[Accuracy, list[MeasuredSetting]] = {}
    for points in fronts.values():
        for point in points:
            each.setdefault(accuracy_of(point.settings), []).append(point)
    shared = {setting: own for setting, own in each.items() if len(own) == len(fronts)}
    checked = {setting: own for setting, own in shared.items() if setting.tools}
    best = {}
    for name, allowed in ALLOWED.items():
        good = {
            setting: sum(p.seconds for p in own)
            for setting, own in (shared if name == "draft" else checked).items()
            if all(p.errors[q] <= limit for p in own for q, limit in allowed.items())
        }
        best[name] = min(good, key=good.__getitem__)
    order = ("force", "visibility", "score", "volume")
    timely = {
        setting: (*(max(p.errors[q] for p in own) for q in order), sum(p.seconds for p in own))
        for setting, own in checked.items()
        if max(p.seconds for p in own) <= FINE_s
    }
    best["fine"] = min(timely, key=timely.__getitem__)
    return [
        f"{name} should be {best[name].as_dict()}"
        for name, preset in PRESETS.items()
        if preset != best[name]
    ]


def add_presets(table: Table, *, quick: bool) -> None:
    """Add what the rule makes of the committed fronts, and where presets are on them."""
    fronts = committed_fronts()
    problems = preset_problems(fronts)
    table.add(
        "presets: the cheapest within their errors, and the most accurate in ten minutes",
        float(not problems),
        "yes",
        reference=1.0,
        source="benchmarks/results/tradeoff_fronts.json",
        target="== 1",
        note="; ".join(problems),
    )
    for design, points in fronts.items():
        found = presets_of(points)
        for name, point in found.items():
            errors = "; ".join(f"{q} {100.0 * e:.3g} %" for q, e in point.errors.items())
            row = f"{design}, {name}: whole build, sum of stages"
            source = "each stage in a process of its own"
            note = f"errors: {errors}; peak {point.peak_MB:.0f} MB"
            table.add(row, point.seconds, "s", "-", source, note=note)
            row = f"{design}, {name}: time saved by a setting that is worse in nothing"
            source = f"{len(points)} joint settings; reference: its own seconds"
            value = 100.0 * beaten_by(point, points)
            table.add(row, value, "%", point.seconds, source, f"<= {100.0 * DOMINATED:g}")
        if not quick:
            picture = joint_fronts(design, points, found)
            (PICTURES / f"tradeoff-front-{design}.png").write_bytes(picture)
