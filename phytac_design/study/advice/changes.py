"""Moves that slopes promise something of, what they gain, cost and may not break."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from phytac_design.design.spec import Design
from phytac_design.layout.cameras import cameras_of, stand_off_mm
from phytac_design.rules.check import check_design
from phytac_design.study.advice.design_evaluation import (
    CROSSTALK_PX,
    FIGURES,
    FORCES,
    GAP_PX,
    STRAIN,
    EvaluatedDesign,
    faults_of,
    strain_of,
)
from phytac_design.study.advice.design_variables import SIZE, DesignVariable
from phytac_design.study.advice.sensitivity import Sensitivity
from phytac_shapes.errors import PhytacError

GOALS = ("force_middle_N", "force_worst_N", "gap_px", "load_gap_px")
"""What advice is for, where nothing is wrong; gaps only while they are below ``GAP_WANTED_PX``."""
FAULTS = "faults"
"""What it is for where markers hide, fuse or disturb each other."""
RULES = "rules"
"""What it is for where a rule refuses the design."""
GAP_WANTED_PX = 8.0
LEAST = {"force": 0.01, "gap": 0.5}
"""Least gain that is worth a word: a share of force, px of gaps."""
NOTHING: dict[str, float] = {
    "gap_px": float("inf"),
    "load_gap_px": float("inf"),
    "crosstalk_px": 0.0,
    "strain": 0.0,
    "occluded": 0,
    "fused": 0,
    "load_hidden": 0,
    "load_fused": 0,
}
"""What a design is compared with that a rule refused: margins count as they are."""
COSTS = {
    "force_middle_N": 0.01,
    "force_worst_N": 0.01,
    "visible_least": 0.02,
    "gap_px": 0.1,
    "load_visible_least": 0.02,
    "load_gap_px": 0.1,
    "crosstalk_px": 0.02,
    "strain": 0.05,
    "switch_unreadable": 0.0,
    "marker_count": 0.0,
}
"""Changes for the worse that are said: shares of force, gaps, strain; else absolute."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """A knob to move, by how much, what for, and what its slope (if any) foretells."""

    knob: DesignVariable
    amount: float
    goal: str
    predicted: dict[str, float]
    gain: float
    slope: Sensitivity | None = None


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A move that was looked into.

    Attributes
    ----------
    gain : float
        Achieved: share of force or of faults, px of gaps; NaN where it was not judged.
    achieved : dict
        Figures of the changed design; empty where a rule refused it.
    costs : tuple of str
        What gets worse, in words.
    reason : str
        Why it is no advice; "" if it is.
    design : Design or None
        The changed design.
    """

    move: Change
    gain: float = float("nan")
    achieved: dict[str, float] = field(default_factory=dict)
    costs: tuple[str, ...] = ()
    reason: str = ""
    design: Design | None = None

    @property
    def hit(self) -> float:
        """Achieved over predicted gain."""
        return self.gain / self.move.gain if self.move.gain else float("nan")


def stand_off_of(base: EvaluatedDesign) -> float:
    """Stand-off of a design's first camera, mm."""
    return stand_off_mm(base.design, base.surface, cameras_of(base.design, base.surface)[0])


def rank_of(goal: str, gain: float) -> float:
    """Gains of all kinds on one scale: a fault mended comes before all, then shares."""
    if goal in {FAULTS, RULES}:
        return 10.0 + gain
    return gain if goal in FORCES else gain / GAP_WANTED_PX


def least_of(goal: str) -> float:
    """Least gain of a goal that is worth a word."""
    return LEAST["force" if goal in {*FORCES, FAULTS, RULES} else "gap"]


def gain_of(goal: str, before: Mapping[str, float], after: Mapping[str, float]) -> float:
    """Gain of a goal: share of force or faults, px of gaps."""
    if goal == FAULTS:
        return 1.0 - faults_of(after) / max(faults_of(before), 1)
    if goal in FORCES:
        return 1.0 - after[goal] / before[goal]
    return after[goal] - before[goal]


def moves_of(
    base: EvaluatedDesign, slopes: Sequence[Sensitivity]
) -> tuple[list[Change], list[Trial]]:
    """Moves that slopes promise something of, the most first; and those that a rule refuses."""
    found: dict[tuple[str, float], Change] = {}
    lost: list[Trial] = []
    for slope in slopes:
        if slope.stuck:
            continue
        for goal in GOALS:
            if goal not in FORCES and base.figures[goal] >= GAP_WANTED_PX:
                continue
            better = -1.0 if FIGURES[goal].less else 1.0
            sign = better if slope.rate[goal] > 0.0 else -better
            move, why = _largest(base, slope, goal, sign)
            key = (slope.knob.name, sign)
            if why:
                if not any(trial.move.knob.name == slope.knob.name for trial in lost):
                    lost.append(Trial(move=move, reason=why))
            elif move.gain >= least_of(goal):
                known = found.get(key)
                if known is None or rank_of(goal, move.gain) > rank_of(known.goal, known.gain):
                    found[key] = move
    kept = [trial for trial in lost if not any(name == trial.move.knob.name for name, _ in found)]
    order = sorted(found.values(), key=lambda move: -rank_of(move.goal, move.gain))
    return _mixed(order), kept


def _mixed(order: Sequence[Change]) -> list[Change]:
    """Moves such that those of one goal, or of like fields, do not come all at once.

    What the hand holds is moved last.
    """

    def family(move: Change) -> str:
        return move.knob.name[: len("layout.height")]

    def place(number: int) -> tuple[bool, int]:
        move, before = order[number], order[:number]
        same_goal = sum(other.goal == move.goal for other in before)
        like = sum(family(other) == family(move) for other in before)
        return move.knob.kind == SIZE, same_goal + 2 * like

    return [order[number] for number in sorted(range(len(order)), key=place)]


def move_by(base: Mapping[str, float], slope: Sensitivity, goal: str, amount: float) -> Change:
    """Move of a slope's knob, with what that foretells."""
    predicted = slope.predict(base, amount)
    return Change(
        knob=slope.knob,
        amount=amount,
        goal=goal,
        predicted=predicted,
        gain=gain_of(goal, base, predicted),
        slope=slope,
    )


def _largest(
    base: EvaluatedDesign, slope: Sensitivity, goal: str, sign: float
) -> tuple[Change, str]:
    """Largest move of a knob that keeps to the rules and, as foretold, the margins; or why none."""
    why = ""
    for amount in slope.knob.amounts(sign):
        move = move_by(base.figures, slope, goal, amount)
        if move.gain < least_of(goal):
            return move, why
        why = broken_margin(base.figures, move.predicted) or _refusal(base, move)
        if not why:
            return move, ""
    return move, why


def _refusal(base: EvaluatedDesign, move: Change) -> str:
    """The rule that a moved design breaks, found without judging it; "" if none."""
    try:
        design = move.knob.moved(base.design, move.amount)
        surface, markers = check_design(design)
    except PhytacError as error:
        return str(error)
    return broken_margin(base.figures, {"strain": strain_of(design, surface, markers)})


def broken_margin(before: Mapping[str, float], after: Mapping[str, float]) -> str:
    """What gets worse than it may be, in words; what was bad already may stay as it is."""
    for name, limit, sign in (
        ("gap_px", GAP_PX, -1.0),
        ("load_gap_px", GAP_PX, -1.0),
        ("crosstalk_px", CROSSTALK_PX, 1.0),
        ("strain", STRAIN, 1.0),
        ("occluded", 0.0, 1.0),
        ("fused", 0.0, 1.0),
        ("load_hidden", 0.0, 1.0),
        ("load_fused", 0.0, 1.0),
    ):
        if name not in after:
            continue
        bound = max(sign * limit, sign * before[name])
        if sign * after[name] > bound + 1e-9:
            figure = FIGURES[name]
            unit = f" {figure.unit}" if figure.unit else ""
            word = "at most" if sign > 0 else "at least"
            return (
                f"breaks a margin: {figure.doc} {after[name]:.3g}{unit} ({word} "
                f"{sign * bound:.3g}{unit})"
            )
    return ""


def costs_of(before: Mapping[str, float], after: Mapping[str, float]) -> tuple[str, ...]:
    """What a change makes worse, in words."""
    out = []
    for name, least in COSTS.items():
        figure, old, new = FIGURES[name], before[name], after[name]
        worse = (new - old) if figure.less else (old - new)
        share = name in FORCES or name == "strain" or name.endswith("gap_px")
        if worse > (least * abs(old) if share else least):
            unit = f" {figure.unit}" if figure.unit else ""
            out.append(f"{figure.doc} {old:.3g} → {new:.3g}{unit}")
    return tuple(out)


def gain_words(goal: str, gain: float) -> str:
    """A gain, for a reader."""
    if goal in FORCES:
        return f"force {100.0 * gain:.1f} % finer"
    return f"{gain:+.0%} of the faults mended" if goal == FAULTS else f"gap {gain:+.2f} px"
