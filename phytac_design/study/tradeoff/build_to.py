"""Builds to a tolerance or within a time, with predicted and achieved error and time."""

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from phytac_design.core.json_values import finite
from phytac_design.design.spec import Design
from phytac_design.rules.check import check_design
from phytac_design.stages.build import BuildResult, build
from phytac_design.study.tradeoff.budget import choose_budget, run_budget
from phytac_design.study.tradeoff.choose import Choice, achieved, choose_tolerance
from phytac_design.study.tradeoff.force import ForceError
from phytac_design.study.tradeoff.settings import Quantity
from phytac_shapes.errors import DesignError, OutputError

Progress = Callable[[str], None]
AUDIT = Path("report") / "trade.json"
"""File of a build with predicted and achieved error and time."""


def build_to(
    design: Design,
    out: Path,
    *,
    tolerance: float | None = None,
    of: Quantity = "force",
    budget_s: float | None = None,
    seed: int = 0,
    force: bool = False,
    progress: Progress = print,
) -> tuple[BuildResult, Choice]:
    """Build with the cheapest setting within a tolerance, or the finest within a time.

    Writes ``report/trade.json``: predicted and achieved error and time.

    Parameters
    ----------
    design : Design
        The sensor.
    out : Path
        As of :func:`phytac_design.stages.build.build`; likewise ``seed`` and ``force``.
    tolerance : float, optional
        Relative error, as a fraction.
    of : str
        Quantity of the tolerance: ``force``, ``visibility``, ``volume``.
    budget_s : float, optional
        Wall seconds of the build. Exactly one of the two must be given.

    Raises
    ------
    DesignError
        If the design cannot be built, or no setting is within the tolerance or budget.
    """
    if (tolerance is None) == (budget_s is None):
        raise DesignError("options-exclusive", "give a tolerance or a budget, and not both")
    check_design(design)
    if budget_s is not None:
        plan, seconds = choose_budget(design, budget_s, seed=seed)
        first = plan.setting
        ran = run_budget(plan, force=force, progress=progress)
        result = build(
            design, out, accuracy=plan.setting, seed=seed, force=force, progress=progress
        )
        result = replace(
            result,
            ran=tuple(name for name in result.timing_s if name in ran),
            cached=tuple(name for name in result.timing_s if name not in ran),
            seconds=time.perf_counter() - plan.begin,
        )
        choice = Choice(
            accuracy=plan.setting,
            quantity="time",
            wanted=budget_s,
            predicted_error=None,
            predicted_s=seconds,
            achieved_s=ran,
        )
        write_audit(out, choice, result.seconds, first_plan=first.as_dict())
        return result, choice
    error = ForceError(design)
    choice = choose_tolerance(design, tolerance or 0.0, of=of, error=error, progress=progress)
    result = build(design, out, accuracy=choice.accuracy, seed=seed, force=force, progress=progress)
    progress(f"audit: the {of} error against the reference")
    choice = replace(
        choice,
        achieved_s={name: result.timing_s[name] for name in result.ran},
        achieved_error=achieved(choice, error),
    )
    write_audit(out, choice, result.seconds)
    return result, choice


def write_audit(out: Path, choice: Choice, wall_s: float, **more: Any) -> None:
    """Write ``report/trade.json``.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    path = out / AUDIT
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(finite(choice.as_dict() | {"wall_s": wall_s} | more), indent=1)
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {path}: {error.strerror}; choose another --out"
        ) from None


def audit_lines(choice: Choice, wall_s: float) -> list[str]:
    """Predicted and achieved error and time, for people."""
    first = f"time: wanted at most {choice.wanted:.0f} s, took {wall_s:.0f} s"
    if choice.predicted_error is not None and choice.achieved_error is not None:
        first = (
            f"{choice.quantity} error: wanted {100.0 * choice.wanted:.3g} %, "
            f"predicted {100.0 * choice.predicted_error:.3g} %, "
            f"achieved {100.0 * choice.achieved_error:.3g} %"
        )
    ran = sum(choice.achieved_s.values())
    return [first, f"stages: predicted {choice.seconds:.1f} s, took {ran:.1f} s"]


def read_tolerance(text: str) -> float:
    """Tolerance as a fraction, from ``2%`` or ``0.02``.

    Raises
    ------
    DesignError
        If it is neither.
    """
    plain = text.strip()
    value = _number(plain.removesuffix("%")) / (100.0 if plain.endswith("%") else 1.0)
    if not 0.0 < value <= 1.0:
        raise DesignError(
            "tolerance-invalid",
            f"a tolerance is above 0 and at most 100 %: 2% or 0.02 (got {text!r})",
        )
    return value


def read_seconds(text: str) -> float:
    """Seconds from ``60s``, ``2min`` or ``60``.

    Raises
    ------
    DesignError
        If it is none of these.
    """
    plain = text.strip().removesuffix("s")
    value = _number(plain.removesuffix("min")) * (60.0 if plain.endswith("min") else 1.0)
    if not 0.0 < value < float("inf"):
        raise DesignError(
            "budget-invalid", f"a budget is a time above zero: 60s or 2min (got {text!r})"
        )
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
