"""Changes of a design that sensitivities predict a gain of; gains, costs and margins of changes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from phytac_design.design.spec import Design
from phytac_design.rules.check import check_design
from phytac_design.study.advice.design_evaluation import (
    FIGURES,
    FORCES,
    LIMITS,
    EvaluatedDesign,
    faults_of,
    strain_of,
)
from phytac_design.study.advice.design_sensitivity import Sensitivity
from phytac_design.study.advice.design_variables import SIZE, DesignVariable
from phytac_shapes.errors import PhytacError

GOALS = ("force_middle_N", "force_worst_N", "gap_px", "load_gap_px")
"""Goals of a design without faults; gaps only while they are below ``WANTED_GAP_px``."""
FAULTS = "faults"
"""Goal where markers are hidden, fused or disturbed."""
RULES = "rules"
"""Goal where a rule rejects the design."""
WANTED_GAP_px = 8.0
FAULTLESS = {name: 0.0 if FIGURES[name].less else float("inf") for name in LIMITS}
"""Figures to compare with if a rule rejects the design: all margins count."""


@dataclass(frozen=True)
class Change:
    """A change of one variable for a goal, as predicted and as evaluated.

    Attributes
    ----------
    predicted : dict
        Predicted figures.
    predicted_gain, gain : float
        Share of force or of faults, px of gaps; NaN where it was not evaluated.
    achieved : dict
        Figures of the changed design; empty where a rule rejects it.
    costs : tuple of str
        What gets worse, in words.
    reason : str
        Why it is no advice; "" if it is.
    design : Design or None
        The changed design.
    """

    variable: DesignVariable
    amount: float
    goal: str
    predicted: dict[str, float]
    predicted_gain: float
    slope: Sensitivity | None = None
    gain: float = float("nan")
    achieved: dict[str, float] = field(default_factory=dict)
    costs: tuple[str, ...] = ()
    reason: str = ""
    design: Design | None = None

    @property
    def words(self) -> str:
        """The change, for a reader."""
        return self.variable.words(self.amount)


def rank_of(goal: str, gain: float) -> float:
    """Gains of all goals on one scale: repaired faults come first, then shares."""
    if goal in {FAULTS, RULES}:
        return 10.0 + gain
    return gain if goal in FORCES else gain / WANTED_GAP_px


def least_gain(goal: str) -> float:
    """Least gain of a goal that is reported: a share, or px of gaps."""
    return 0.01 if goal in {*FORCES, FAULTS, RULES} else 0.5


def gain_of(goal: str, before: Mapping[str, float], after: Mapping[str, float]) -> float:
    """Gain of a goal: share of force or faults, px of gaps."""
    if goal == FAULTS:
        return 1.0 - faults_of(after) / max(faults_of(before), 1)
    if goal in FORCES:
        return 1.0 - after[goal] / before[goal]
    return after[goal] - before[goal]


def changes_of(
    base: EvaluatedDesign, slopes: Sequence[Sensitivity]
) -> tuple[list[Change], list[Change]]:
    """Changes with a predicted gain, in the order to test them; and those that a rule rejects."""
    best: dict[tuple[str, float], Change] = {}
    rejected: dict[str, Change] = {}
    for slope in slopes:
        if slope.stuck:
            continue
        name = slope.variable.name
        for goal in GOALS:
            if goal not in FORCES and base.figures[goal] >= WANTED_GAP_px:
                continue
            better = -1.0 if FIGURES[goal].less else 1.0
            sign = better if slope.rate[goal] > 0.0 else -better
            change = _largest(base, slope, goal, sign)
            if change.reason:
                rejected.setdefault(name, change)
            elif change.predicted_gain >= least_gain(goal):
                known = best.get((name, sign))
                if known is None or _predicted_rank(change) > _predicted_rank(known):
                    best[name, sign] = change
    found = {name for name, _ in best}
    order = sorted(best.values(), key=_predicted_rank, reverse=True)
    return _mixed(order), [one for name, one in rejected.items() if name not in found]


def _predicted_rank(change: Change) -> float:
    return rank_of(change.goal, change.predicted_gain)


def _mixed(order: Sequence[Change]) -> list[Change]:
    """Changes mixed by goal and by like fields; those of the body's size come last."""

    def place(number: int) -> tuple[bool, int]:
        change, prefix = order[number], len("layout.height")
        same_goal = sum(other.goal == change.goal for other in order[:number])
        like = sum(
            other.variable.name[:prefix] == change.variable.name[:prefix]
            for other in order[:number]
        )
        return change.variable.kind == SIZE, same_goal + 2 * like

    return [order[number] for number in sorted(range(len(order)), key=place)]


def change_by(base: Mapping[str, float], slope: Sensitivity, goal: str, amount: float) -> Change:
    """Change of a variable, with what its sensitivity predicts."""
    predicted = slope.predict(base, amount)
    gain = gain_of(goal, base, predicted)
    return Change(slope.variable, amount, goal, predicted, gain, slope)


def _largest(base: EvaluatedDesign, slope: Sensitivity, goal: str, sign: float) -> Change:
    """Largest change within the rules and the predicted margins, or the reason against it."""
    why = ""
    for amount in slope.variable.amounts(sign):
        change = change_by(base.figures, slope, goal, amount)
        if change.predicted_gain < least_gain(goal):
            break
        why = broken_margin(base.figures, change.predicted)
        if not why:
            try:
                design = slope.variable.moved(base.design, amount)
                strain = strain_of(check_design(design))
                why = broken_margin(base.figures, {"strain": strain})
            except PhytacError as error:
                why = str(error)
        if not why:
            break
    return replace(change, reason=why)


def broken_margin(before: Mapping[str, float], after: Mapping[str, float]) -> str:
    """A margin that a change breaks, in words; what was outside before may stay as it was."""
    for name, limit in LIMITS.items():
        if name not in after:
            continue
        sign = 1.0 if FIGURES[name].less else -1.0
        bound = max(sign * limit, sign * before[name])
        if sign * after[name] > bound + 1e-9:
            unit = f" {FIGURES[name].unit}".rstrip()
            word = "at most" if sign > 0 else "at least"
            return (
                f"breaks a margin: {FIGURES[name].doc} {after[name]:.3g}{unit} ({word} "
                f"{sign * bound:.3g}{unit})"
            )
    return ""


def costs_of(before: Mapping[str, float], after: Mapping[str, float]) -> tuple[str, ...]:
    """What a change makes worse, in words."""
    out = []
    for name, figure in FIGURES.items():
        if figure.reported is None:
            continue
        least, old, new = figure.reported, before[name], after[name]
        worse = (new - old) if figure.less else (old - new)
        share = name in FORCES or name == "strain" or name.endswith("gap_px")
        if worse > (least * abs(old) if share else least):
            out.append(f"{figure.doc} {old:.3g} → {new:.3g} {figure.unit}".rstrip())
    return tuple(out)


def gain_words(goal: str, gain: float) -> str:
    """A gain, for a reader."""
    if goal in FORCES:
        return f"force {100.0 * gain:.1f} % finer"
    return f"{gain:+.0%} of the faults repaired" if goal == FAULTS else f"gap {gain:+.2f} px"
