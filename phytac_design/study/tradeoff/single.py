"""Knobs one at a time: time of the stages that each touches, and the error it alone makes."""

from collections.abc import Sequence
from typing import Any

from phytac_design.study.tradeoff.front import Measured
from phytac_design.study.tradeoff.joint import score_error
from phytac_design.study.tradeoff.points import Point, Points
from phytac_design.study.tradeoff.room import visibility_error
from phytac_design.study.tradeoff.settings import Knob


def measure_knob(points: Points, knob: Knob) -> list[Measured]:
    """Every value of a knob, all others as in ``draft`` (and ideal, for the force error)."""
    each = [_settings(knob, value) for value in knob.values]
    if not knob.of_build:
        runs = [points.get(Point(kind="use", name=knob.name, settings=one)) for one in each]
        errors = [float(run["error"]) for run in runs]
    else:
        name = ",".join(knob.stages)
        runs = [points.get(Point(kind="stages", name=name, settings=one)) for one in each]
        errors = _errors(points, knob, each, runs)
    return [
        Measured(
            settings=one,
            seconds=run["seconds"],
            cpu_s=run["cpu_s"],
            peak_MB=run["peak_MB"],
            errors={knob.quantity: error},
        )
        for one, run, error in zip(each, runs, errors, strict=True)
    ]


def _settings(knob: Knob, value: float | str) -> dict[str, Any]:
    return {knob.name: bool(value) if knob.name == "receptors" else value}


def _errors(
    points: Points, knob: Knob, each: list[dict[str, Any]], runs: list[dict[str, Any]]
) -> list[float]:
    """Errors that a knob of the build alone makes."""
    if knob.quantity == "force":
        found = points.get(Point(kind="alone", name=knob.name, settings={"each": each}))
        return [float(error) for error in found["errors"]]
    if knob.quantity == "volume":
        got = [float(run["facts"]["shell"]["volume_mm3"]) for run in runs]
        return [abs(value / got[-1] - 1.0) for value in got]
    if knob.quantity == "visibility":
        return [visibility_error(run["room"], runs[-1]["room"]) for run in runs]
    if knob.name == "truth_refine":
        found = points.get(Point(kind="truth", name="truth", settings={"each": each}))
        return [float(error) for error in found["errors"]]
    many = {"sample_share": 1e9, "frames": 10**9}
    return [score_error(points.design, many | one, 0.0) for one in each]


def as_table(knob: Knob, rows: Sequence[Measured]) -> list[str]:
    """Lines for people."""
    lines = [f"{knob.name} ({knob.says}); error of {knob.quantity}, {knob.unit}"]
    lines += [
        f"  {next(iter(row.settings.values()))!s:>8}  {row.seconds:8.2f} s  {row.cpu_s:8.2f} s CPU"
        f"  {row.peak_MB:6.0f} MB  {row.errors[knob.quantity]:.3g}"
        for row in rows
    ]
    return lines
