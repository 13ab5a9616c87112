"""``phytac tradeoff``: measure every setting and the joint fronts of a design, resumable."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from phytac_design.core.json_values import finite
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.rules.check import check_design
from phytac_design.study.tradeoff.front import (
    MeasuredSetting,
    beaten_by,
    joint_fronts,
    knee,
    pareto,
    setting_fronts,
)
from phytac_design.study.tradeoff.joint import joint_settings, score_error
from phytac_design.study.tradeoff.pilot import visibility_error
from phytac_design.study.tradeoff.points import Point, Points, accuracy_of
from phytac_design.study.tradeoff.settings import QUANTITIES, SETTINGS, Setting, setting_named


@dataclass(frozen=True, kw_only=True)
class Tradeoff:
    """What was measured.

    Attributes
    ----------
    design : Design
        The sensor.
    settings : list of (Setting, list of Measured)
        Values of each setting, cheapest to finest.
    joint : list of Measured
        Joint settings of the whole build; empty if not measured.
    """

    design: Design
    settings: list[tuple[Setting, list[MeasuredSetting]]]
    joint: list[MeasuredSetting]

    @property
    def presets(self) -> dict[str, MeasuredSetting]:
        """Presets among the joint settings."""
        return presets_of(self.joint)

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        plain: dict[str, Any] = finite(
            {
                "design": {"name": self.design.name, "hash": design_hash(self.design)},
                "quantities": dict(QUANTITIES),
                "knobs": {
                    setting.name: {
                        "quantity": setting.quantity,
                        "unit": setting.unit,
                        "stages": list(setting.stages),
                        "values": [asdict(point) for point in points],
                    }
                    for setting, points in self.settings
                },
                "joint": [asdict(point) for point in self.joint],
                "presets": {
                    name: asdict(point) | {"beaten_by": beaten_by(point, self.joint)}
                    for name, point in self.presets.items()
                },
            }
        )
        return plain

    def text(self) -> str:
        """Tables for people."""
        lines = []
        for setting, points in self.settings:
            lines.append(
                f"{setting.name} ({setting.description}); error of {setting.quantity}, "
                f"{setting.unit}"
            )
            lines += [
                f"  {next(iter(p.settings.values()))!s:>8}  {p.seconds:8.2f} s  {p.cpu_s:8.2f} s "
                f"CPU  {p.peak_MB:6.0f} MB  {p.errors[setting.quantity]:.3g}"
                for p in points
            ]
        for quantity in QUANTITIES if self.joint else ():
            at = knee(self.joint, quantity)
            lines.append(f"whole build, front of {quantity} (knee at {at.seconds:.0f} s)")
            lines += [
                f"  {p.seconds:8.1f} s  {p.peak_MB:6.0f} MB  {p.errors[quantity]:.3g}  "
                + ", ".join(f"{k}={v}" for k, v in p.settings.items())
                for p in pareto(self.joint, quantity)
            ]
        for name, point in self.presets.items():
            errors = ", ".join(f"{key} {value:.3g}" for key, value in point.errors.items())
            saved = 100.0 * beaten_by(point, self.joint)
            lines.append(
                f"preset {name}: {point.seconds:.1f} s, {errors}; the cheapest setting without a "
                f"larger error saves {saved:.0f} %"
            )
        return "\n".join(lines)


def presets_of(joint: Sequence[MeasuredSetting]) -> dict[str, MeasuredSetting]:
    """Presets among joint settings."""
    return {
        name: point
        for name, preset in PRESETS.items()
        for point in joint
        if accuracy_of(point.settings) == preset
    }


def tradeoff(
    design: Design,
    out: Path,
    *,
    only: Sequence[str] = (),
    quick: bool = False,
    progress: Callable[[str], None] = print,
) -> Tradeoff:
    """Measure a design's settings and fronts into ``out``; measured points are not repeated.

    Parameters
    ----------
    design : Design
        The sensor.
    out : Path
        Folder of journal, ``tradeoff.json``, ``tradeoff.txt`` and pictures.
    only : sequence of str
        Settings, and ``joint`` for the whole build; all if empty.
    quick : bool
        Few joint settings.

    Raises
    ------
    DesignError
        If the design cannot be built, or there is no such setting.
    """
    names = list(only) or [setting.name for setting in SETTINGS] + ["joint"]
    chosen = [setting_named(name) for name in names if name != "joint"]
    check_design(design)
    points = Points(design, out / ".work", progress)
    done = Tradeoff(
        design=design,
        settings=[(setting, measure_setting(points, setting)) for setting in chosen],
        joint=joint_settings(points, quick=quick) if "joint" in names else [],
    )
    write(out, done)
    return done


def write(out: Path, done: Tradeoff) -> None:
    """Write JSON, tables and pictures."""
    text = json.dumps(done.as_dict(), indent=1, ensure_ascii=False)
    (out / "tradeoff.json").write_text(text + "\n", encoding="utf-8")
    (out / "tradeoff.txt").write_text(done.text() + "\n", encoding="utf-8")
    name = done.design.name
    if done.settings:
        (out / "knobs.png").write_bytes(setting_fronts(name, done.settings))
    if done.joint:
        (out / "front.png").write_bytes(joint_fronts(name, done.joint, done.presets))


def measure_setting(points: Points, setting: Setting) -> list[MeasuredSetting]:
    """Every value of a setting, the others as in ``draft`` (for the force error: ideal)."""
    each: list[dict[str, Any]] = [
        {setting.name: bool(value) if setting.name == "receptors" else value}
        for value in setting.values
    ]
    if setting.of_build:
        name = ",".join(setting.stages)
        runs = [points.get(Point(kind="stages", name=name, settings=one)) for one in each]
        errors = _errors(points, setting, each, runs)
    else:
        runs = [points.get(Point(kind="use", name=setting.name, settings=one)) for one in each]
        errors = [float(run["error"]) for run in runs]
    return [
        MeasuredSetting(
            settings=one,
            seconds=run["seconds"],
            cpu_s=run["cpu_s"],
            peak_MB=run["peak_MB"],
            errors={setting.quantity: error},
        )
        for one, run, error in zip(each, runs, errors, strict=True)
    ]


def _errors(
    points: Points, setting: Setting, each: list[dict[str, Any]], runs: list[dict[str, Any]]
) -> list[float]:
    """Errors due to one setting of the build alone."""
    if setting.quantity == "volume":
        return [abs(run["volume_mm3"] / runs[-1]["volume_mm3"] - 1.0) for run in runs]
    if setting.quantity == "visibility":
        return [visibility_error(run["clearance"], runs[-1]["clearance"]) for run in runs]
    if setting.name in {"sample_share", "frames"}:
        many = {"sample_share": 1e9, "frames": 10**9}
        return [score_error(points.design, many | one, 0.0) for one in each]
    point = (
        Point(kind="alone", name=setting.name, settings={"each": each})
        if setting.quantity == "force"
        else Point(kind="truth", name="truth", settings={"each": each})
    )
    return [float(error) for error in points.get(point)["errors"]]
