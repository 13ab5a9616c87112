"""Advice and refined designs as text, JSON and files."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from phytac_design.core.json_values import finite
from phytac_design.design.design_file import to_toml
from phytac_design.study.advice.advise import Advice
from phytac_design.study.advice.design_changes import (
    GOALS,
    STIFFNESS,
    SWITCHES,
    THRESHOLDS,
    Change,
)
from phytac_design.study.advice.design_evaluation import FIGURES, FORCES, faults_of
from phytac_design.study.advice.local_model import Sensitivity
from phytac_design.study.advice.refinement import RefinedDesign
from phytac_design.study.search.surrogate import FORCE_N
from phytac_shapes.errors import OutputError


def as_dict(advice: Advice) -> dict[str, Any]:
    """Plain values, for JSON."""
    out: dict[str, Any] = finite(
        {
            "design": advice.design.name,
            "force_N": FORCE_N,
            "refused": advice.refused,
            "switch_faults": advice.switch_faults,
            "figures": advice.figures,
            "slopes": [_slope_dict(slope) for slope in advice.slopes],
            "rows": [{"row": one.row, "share_per_step": one.share} for one in advice.rows],
            "advice": [_change_dict(one) for one in advice.pieces],
            "tried": [_change_dict(one) for one in advice.tried],
        }
    )
    return out


def _slope_dict(slope: Sensitivity) -> dict[str, Any]:
    variable = slope.variable
    return {
        "knob": variable.name,
        "unit": variable.unit,
        "value": variable.value,
        "step": variable.step,
        "step_is": variable.why,
        "per_unit": slope.rate,
        "per_step": {name: slope.per_step(name) for name in slope.rate},
        "stuck": slope.stuck,
    }


def _change_dict(change: Change) -> dict[str, Any]:
    variable = change.variable
    return {
        "knob": variable.name,
        "kind": variable.kind,
        "unit": variable.unit,
        "from": variable.value,
        "by": change.amount,
        "goal": change.goal,
        "gain_predicted": change.predicted_gain,
        "gain": change.gain,
        "predicted": change.predicted,
        "achieved": change.achieved,
        "costs": list(change.costs),
        "reason": change.reason,
    }


def refined_dict(done: RefinedDesign) -> dict[str, Any]:
    """Plain values, for JSON."""
    out: dict[str, Any] = finite(asdict(done) | {"design": done.design.name})
    return out


def text(advice: Advice) -> str:
    """Report for a terminal."""
    lines = [f"{advice.design.name}: {_state(advice)}"]
    lines += [f"  rejected by `phytac check`: {fault}" for fault in advice.switch_faults]
    lines += [f"  {advice.stiff}"] if advice.stiff else []
    if advice.slopes:
        lines += ["", "Effect of a step:", *_slope_lines(advice.slopes)]
    if advice.rows:
        best = ", ".join(f"row {one.row} {100.0 * one.share:+.2f} %" for one in advice.rows[:3])
        lines += ["", f"Rows whose height changes the force most, per 0.5 mm: {best}"]
    lines += ["", "Advice, each change applied and evaluated:"]
    lines += [f"  {number}. {_piece(one)}" for number, one in enumerate(advice.pieces, start=1)]
    if not advice.pieces:
        lines.append("  none: no change that was tried helps without breaking something")
    if advice.tried:
        lines += ["", "Tried, and no advice:"]
        lines += [f"  {one.words}: {one.reason}" for one in advice.tried]
    return "\n".join(lines)


def _state(advice: Advice) -> str:
    if advice.refused:
        return f"a rule rejects it: {advice.refused}"
    figures = advice.figures
    wrong = [
        f"{figures[name]:.0f} {FIGURES[name].doc}"
        for name in ("occluded", "fused", "load_hidden", "load_fused", "switch_unreadable")
        if figures[name]
    ]
    return (
        f"{figures['marker_count']:.0f} markers; bound of force at {FORCE_N:g} N: "
        f"{figures['force_middle_N']:.3g} N over the middle heights (mean; worst "
        f"{figures['force_middle_worst_N']:.3g}), {figures['force_mean_N']:.3g} N over the full "
        f"height (90th percentile {figures['force_p90_N']:.3g}, worst "
        f"{figures['force_worst_N']:.3g}); least gap {figures['gap_px']:.3g} px, pressed "
        f"{figures['load_gap_px']:.3g} px; least visible {figures['visible_least']:.2f}, pressed "
        f"{figures['load_visible_least']:.2f}; crosstalk {figures['crosstalk_px']:.2g} px"
        + (f"; {', '.join(wrong)}" if wrong else "")
    )


def _slope_lines(slopes: list[Sensitivity]) -> list[str]:
    heads = ("force, middle", "force, worst", "gap", "gap, pressed")
    lines = ["  " + f"{'':32s}{'now':>10s}{'step':>9s}" + "".join(f"{head:>15s}" for head in heads)]
    for slope in slopes:
        variable = slope.variable
        line = f"  {variable.name:32s}{variable.value:10.5g}{variable.step:9.4g}"
        if slope.stuck:
            lines.append(f"{line}  cannot change: {slope.stuck[:80]}")
            continue
        for name in GOALS:  # + 0.0: no minus before a zero
            if name in FORCES:
                line += f"{round(100.0 * slope.per_step(name), 2) + 0.0:+13.2f} %"
            else:
                line += f"{round(slope.per_step(name), 2) + 0.0:+12.2f} px"
        lines.append(line)
    return lines


def _piece(change: Change) -> str:
    goal, gain, predicted = change.goal, change.gain, change.predicted_gain
    if goal == "faults":
        words = f"repairs {gain:.0%} of the faults (predicted {predicted:.0%})"
    elif goal == "rules":
        words = "every rule passes, and every marker is visible"
    elif goal == THRESHOLDS:
        words = "bowls have the thresholds"
    elif goal == SWITCHES:
        words = (
            f"{change.achieved['switch_unreadable']:.0f} switches cannot be read then, "
            f"{gain:.0%} fewer"
        )
    elif goal == STIFFNESS:
        share = change.predicted["force_max_sd_share"]
        words = (
            f"the largest force is read to about {share:.1%} (predicted), and "
            f"{FIGURES['force_middle_N'].doc} {100.0 * gain:.1f} % finer"
        )
    elif goal in FORCES:
        finer, expected = 100.0 * gain, 100.0 * predicted
        words = f"{FIGURES[goal].doc} {finer:.1f} % finer (predicted {expected:.1f} %)"
    else:
        words = f"{FIGURES[goal].doc} {gain:+.2f} px (predicted {predicted:+.2f})"
    if goal in {"faults", "rules"}:
        after = change.achieved
        words += (
            f"; then force {after['force_middle_N']:.3g} N, least gap {after['gap_px']:.3g} px, "
            f"least visible {after['visible_least']:.2f}"
        )
    costs = f"; costs: {', '.join(change.costs)}" if change.costs else ""
    return f"{change.words}: {words}{costs}"


def next_words(advice: Advice, name: str, folder: Path | None) -> str:
    """What to run after advice for the design ``name``, which was written to ``folder`` or not."""
    if advice.pieces:
        return (
            f"phytac check {folder / 'advice_1.toml'}"
            if folder
            else f"phytac advise {name} --out advice writes the changed designs (evaluated already)"
        )
    if advice.refused:
        return f"correct what the rule names, then phytac check {name}"
    wrong = advice.switch_faults or faults_of(advice.figures)
    return f"phytac check {name}" if wrong else f"phytac build {name}"


def refined_text(done: RefinedDesign) -> str:
    """Report of a refinement for a terminal."""
    lines = []
    for step in done.steps:
        moved = ", ".join(f"{name} {by:+.4g}" for name, by in step.moved.items())
        end = f"rejected: {step.reason}" if step.reason else "accepted"
        lines.append(
            f"{moved}: force {100.0 * step.gain:.1f} % finer (predicted "
            f"{100.0 * step.predicted:.1f} %); {end}"
        )
    before, after = done.before, done.figures
    changes = ", ".join(
        f"{FIGURES[name].doc} {before[name]:.3g} → {after[name]:.3g} {FIGURES[name].unit}".rstrip()
        for name in (*GOALS, "visible_least", "crosstalk_px", "strain")
    )
    return "\n".join([*lines, f"{done.why}; {changes}"])


def write_advice(advice: Advice, folder: Path) -> Path:
    """Write ``advice.json`` and ``advice_N.toml``, the design with change N; the folder.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    texts = {"advice.json": _json(as_dict(advice))}
    for number, one in enumerate(advice.pieces, start=1):
        if one.design is not None:
            texts[f"advice_{number}.toml"] = to_toml(one.design)
    return _write(texts, folder)


def write_refined(done: RefinedDesign, folder: Path) -> Path:
    """Write ``polish.json`` and ``NAME.toml``, the refined design; the design's path.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    name = f"{done.design.name}.toml"
    return (
        _write({"polish.json": _json(refined_dict(done)), name: to_toml(done.design)}, folder)
        / name
    )


def _json(facts: dict[str, Any]) -> str:
    return json.dumps(facts, indent=1, ensure_ascii=False) + "\n"


def _write(texts: dict[str, str], folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("advice_*.toml"):  # of an earlier run
            if old.name not in texts:
                old.unlink()
        for name, content in texts.items():
            (folder / name).write_text(content, encoding="utf-8")
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {folder}: {error.strerror}; choose another --out"
        ) from None
    return folder
