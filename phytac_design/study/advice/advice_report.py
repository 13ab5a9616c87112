"""Advice for readers and for machines."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from phytac_design.core.json_values import finite
from phytac_design.study.advice.advise import Advice
from phytac_design.study.advice.changes import FAULTS, RULES, Trial
from phytac_design.study.advice.design_evaluation import FIGURES, FORCES
from phytac_design.study.advice.refinement import RefinedDesign
from phytac_design.study.advice.sensitivity import Sensitivity
from phytac_design.study.search.surrogate import FORCE_N

SHOWN = ("force_middle_N", "force_worst_N", "gap_px", "load_gap_px")
"""Figures whose slopes the text shows."""
ROWS = 3
"""Rows that the text names."""


def as_dict(advice: Advice) -> dict[str, Any]:
    """Plain values, for JSON."""
    out: dict[str, Any] = finite(
        {
            "design": advice.design.name,
            "force_N": FORCE_N,
            "refused": advice.refused,
            "figures": advice.figures,
            "slopes": [_slope(slope) for slope in advice.slopes],
            "rows": [{"row": one.row, "share_per_step": one.share} for one in advice.rows],
            "advice": [_trial(trial) for trial in advice.pieces],
            "tried": [_trial(trial) for trial in advice.tried],
        }
    )
    return out


def _slope(slope: Sensitivity) -> dict[str, Any]:
    knob = slope.knob
    return {
        "knob": knob.name,
        "unit": knob.unit,
        "value": knob.value,
        "step": knob.step,
        "step_is": knob.why,
        "per_unit": slope.rate,
        "per_step": {name: slope.per_step(name) for name in slope.rate},
        "stuck": slope.stuck,
    }


def _trial(trial: Trial) -> dict[str, Any]:
    move = trial.move
    return {
        "knob": move.knob.name,
        "kind": move.knob.kind,
        "unit": move.knob.unit,
        "from": move.knob.value,
        "by": move.amount,
        "goal": move.goal,
        "gain_predicted": move.gain,
        "gain": trial.gain,
        "predicted": move.predicted,
        "achieved": trial.achieved,
        "costs": list(trial.costs),
        "reason": trial.reason,
    }


def text(advice: Advice) -> str:
    """Whole report of a terminal."""
    lines = [f"{advice.design.name}: {_state(advice)}"]
    if advice.slopes:
        lines += ["", "What a step does:", *_slopes(advice)]
    if advice.rows:
        lines += ["", _rows(advice)]
    lines += ["", "Advice, each piece applied and judged again:"]
    lines += [_piece(number, trial) for number, trial in enumerate(advice.pieces, start=1)]
    if not advice.pieces:
        lines.append("  none: nothing that was tried helps without breaking something")
    if advice.tried:
        lines += ["", "Tried, and no advice:"]
        lines += [f"  {_what(trial)}: {trial.reason}" for trial in advice.tried]
    return "\n".join(lines)


def _state(advice: Advice) -> str:
    if advice.refused:
        return f"a rule refuses it: {advice.refused}"
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
        f"height (nine in ten below {figures['force_p90_N']:.3g}, worst "
        f"{figures['force_worst_N']:.3g}); least gap {figures['gap_px']:.3g} px, pressed "
        f"{figures['load_gap_px']:.3g} px; least visible {figures['visible_least']:.2f}, pressed "
        f"{figures['load_visible_least']:.2f}; crosstalk {figures['crosstalk_px']:.2g} px"
        + (f"; {', '.join(wrong)}" if wrong else "")
    )


def _slopes(advice: Advice) -> list[str]:
    heads = ("force, middle", "force, worst", "gap", "gap, pressed")
    lines = ["  " + f"{'':32s}{'now':>10s}{'step':>9s}" + "".join(f"{head:>15s}" for head in heads)]
    for slope in advice.slopes:
        knob = slope.knob
        start = f"  {knob.name:32s}{knob.value:10.5g}{knob.step:9.4g}"
        if slope.stuck:
            lines.append(f"{start}  cannot move: {slope.stuck[:80]}")
            continue
        cells = [
            f"{_neat(100.0 * slope.per_step(name)):+13.2f} %"
            if name in FORCES
            else f"{_neat(slope.per_step(name)):+12.2f} px"
            for name in SHOWN
        ]
        lines.append(start + "".join(cells))
    return lines


def _neat(value: float) -> float:
    """Two decimals, and no minus before a zero."""
    return round(value, 2) + 0.0


def _rows(advice: Advice) -> str:
    best = ", ".join(f"row {one.row} {100.0 * one.share:+.2f} %" for one in advice.rows[:ROWS])
    return f"Raising one row by 0.5 mm changes the force over the middle heights most at: {best}"


def _what(trial: Trial) -> str:
    return trial.move.knob.words(trial.move.amount)


def _piece(number: int, trial: Trial) -> str:
    move = trial.move
    gains = {
        FAULTS: f"mends {trial.gain:.0%} of what hides, fuses or disturbs (foretold "
        f"{move.gain:.0%})",
        RULES: "every rule passes, and every marker is seen",
    }
    if move.goal in FORCES:
        gain = (
            f"{FIGURES[move.goal].doc} {100.0 * trial.gain:.1f} % finer (foretold "
            f"{100.0 * move.gain:.1f} %)"
        )
    else:
        gain = gains.get(move.goal) or (
            f"{FIGURES[move.goal].doc} {trial.gain:+.2f} px (foretold {move.gain:+.2f})"
        )
    also = _also(move.goal, trial.achieved) if move.goal in {FAULTS, RULES} else ""
    costs = f"; costs: {', '.join(trial.costs)}" if trial.costs else ""
    return f"  {number}. {_what(trial)}: {gain}{also}{costs}"


def _also(_: str, achieved: Mapping[str, float]) -> str:
    return (
        f"; then force {achieved['force_middle_N']:.3g} N, least gap {achieved['gap_px']:.3g} px, "
        f"least visible {achieved['visible_least']:.2f}"
    )


def polished_dict(done: RefinedDesign) -> dict[str, Any]:
    """Plain values, for JSON."""
    out: dict[str, Any] = finite(
        {
            "design": done.design.name,
            "before": done.before,
            "figures": done.figures,
            "steps": [asdict(step) for step in done.steps],
            "why": done.why,
        }
    )
    return out


def polish_text(done: RefinedDesign) -> str:
    """Report of a polish for a terminal."""
    lines = []
    for step in done.steps:
        moved = ", ".join(f"{name} {by:+.4g}" for name, by in step.moved.items())
        end = f"not taken: {step.reason}" if step.reason else "taken"
        lines.append(
            f"{moved}: force {100.0 * step.gain:.1f} % finer (foretold "
            f"{100.0 * step.predicted:.1f} %); {end}"
        )
    before, after = done.before, done.figures
    changes = ", ".join(
        f"{FIGURES[name].doc} {before[name]:.3g} → {after[name]:.3g} {FIGURES[name].unit}".rstrip()
        for name in (*SHOWN, "visible_least", "crosstalk_px", "strain")
    )
    return "\n".join([*lines, f"{done.why}; {changes}"])
