"""``phytac tradeoff``: measure every knob and the joint fronts of a design, resumable."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phytac_design.core.json_values import finite
from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.rules.check import check_design
from phytac_design.study.tradeoff.front import Measured, beaten_by, knee, pareto
from phytac_design.study.tradeoff.joint import Joint, accuracy_of
from phytac_design.study.tradeoff.points import Points
from phytac_design.study.tradeoff.settings import KNOBS, QUANTITIES, Knob, knob_named
from phytac_design.study.tradeoff.single import as_table, measure_knob

JOINT = "joint"
"""Name of the joint fronts beside those of the knobs."""


def presets_of(joint: Sequence[Measured]) -> dict[str, Measured]:
    """Presets among joint settings."""
    return {
        name: point
        for name, preset in PRESETS.items()
        for point in joint
        if accuracy_of(point.settings) == preset
    }


@dataclass(frozen=True, kw_only=True)
class Tradeoff:
    """What was measured.

    Attributes
    ----------
    design : Design
        The sensor.
    knobs : dict
        Values of each knob, cheapest to finest.
    joint : list of Measured
        Joint settings of the whole build; empty if not asked for.
    """

    design: Design
    knobs: dict[str, tuple[Knob, list[Measured]]]
    joint: list[Measured]

    @property
    def presets(self) -> dict[str, Measured]:
        """Presets among the joint settings."""
        return presets_of(self.joint)

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        plain: dict[str, Any] = finite(
            {
                "design": {"name": self.design.name, "hash": design_hash(self.design)},
                "quantities": dict(QUANTITIES),
                "knobs": {
                    name: {
                        "quantity": knob.quantity,
                        "unit": knob.unit,
                        "stages": list(knob.stages),
                        "values": [point.as_dict() for point in points],
                    }
                    for name, (knob, points) in self.knobs.items()
                },
                "joint": [point.as_dict() for point in self.joint],
                "presets": {
                    name: point.as_dict() | {"beaten_by": beaten_by(point, self.joint)}
                    for name, point in self.presets.items()
                },
            }
        )
        return plain

    def text(self) -> str:
        """Tables for people."""
        lines: list[str] = []
        for knob, points in self.knobs.values():
            lines += as_table(knob, points)
        if self.joint:
            lines += self._joint_lines()
        return "\n".join(lines)

    def _joint_lines(self) -> list[str]:
        lines = []
        for quantity in QUANTITIES:
            front = pareto(self.joint, quantity)
            at = knee(self.joint, quantity)
            lines.append(f"whole build, front of {quantity} (knee at {at.seconds:.0f} s)")
            lines += [
                f"  {point.seconds:8.1f} s  {point.peak_MB:6.0f} MB  {point.errors[quantity]:.3g}  "
                + ", ".join(f"{k}={v}" for k, v in point.settings.items())
                for point in front
            ]
        for name, point in self.presets.items():
            errors = ", ".join(f"{key} {value:.3g}" for key, value in point.errors.items())
            saved = 100.0 * beaten_by(point, self.joint)
            lines.append(
                f"preset {name}: {point.seconds:.1f} s, {errors}; another that is no worse in "
                f"anything saves {saved:.0f} %"
            )
        return lines


def tradeoff(
    design: Design,
    out: Path,
    *,
    only: Sequence[str] = (),
    quick: bool = False,
    progress: Callable[[str], None] = print,
) -> Tradeoff:
    """Measure a design's knobs and fronts into ``out``; what is measured already is not again.

    Parameters
    ----------
    design : Design
        The sensor.
    out : Path
        Folder of journal, ``tradeoff.json``, ``tradeoff.txt`` and pictures.
    only : sequence of str
        Knobs, and ``joint`` for the whole build; all if empty.
    quick : bool
        Few joint settings.

    Raises
    ------
    DesignError
        If the design cannot be built, or there is no such knob.
    """
    names = list(only) or [knob.name for knob in KNOBS] + [JOINT]
    chosen = [knob_named(name) for name in names if name != JOINT]
    check_design(design)
    points = Points(design, out / ".work", progress)
    done = Tradeoff(
        design=design,
        knobs={knob.name: (knob, measure_knob(points, knob)) for knob in chosen},
        joint=Joint(points, quick=quick).measured() if JOINT in names else [],
    )
    write(out, done)
    return done


def write(out: Path, done: Tradeoff) -> None:
    """Write JSON, tables and pictures."""
    from phytac_design.study.tradeoff.plots import knob_fronts, whole_front

    text = json.dumps(done.as_dict(), indent=1, ensure_ascii=False)
    (out / "tradeoff.json").write_text(text + "\n", encoding="utf-8")
    (out / "tradeoff.txt").write_text(done.text() + "\n", encoding="utf-8")
    name = done.design.name
    if done.knobs:
        (out / "knobs.png").write_bytes(knob_fronts(name, done.knobs))
    if done.joint:
        (out / "front.png").write_bytes(whole_front(name, done.joint, done.presets))


def settings_of_point(point: Measured) -> Accuracy:
    """All settings of a joint point."""
    return accuracy_of(point.settings)
