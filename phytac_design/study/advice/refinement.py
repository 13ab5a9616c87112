r"""Polish a design: steps along the slopes, within margins and rules, until little is gained.

Sequential linear programming (Griffith and Stewart, 1961). With slopes of the logarithm of the
force over the middle heights, g, of the strain, s, and of the gaps, G, the step x of each knob
solves

    min g·x    with    gap + G x ≥ least gap,    ln strain + s·x ≤ ln limit,    |x| ≤ trust · reach

is rounded to whole steps of a workshop, and judged by the exact rungs. A step that gains and breaks
nothing is taken; else trust is halved. What was judged is kept in the cache, so that a run that was
stopped goes on where it was.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_design.study.advice.changes import broken_margin, stand_off_of
from phytac_design.study.advice.design_evaluation import (
    GAP_PX,
    STRAIN,
    EvaluatedDesign,
    evaluate_design,
)
from phytac_design.study.advice.design_variables import FREE, choose, variables_of
from phytac_design.study.advice.local_model import LocalModel
from phytac_design.study.advice.sensitivity import Sensitivity, sensitivities
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, PhytacError

GOAL = "force_middle_N"
GAPS = ("gap_px", "load_gap_px")
GAP_RESERVE_px = 0.5
"""What slopes may be wrong by in a step: kept free of the least gap."""
LEAST_GAIN = 0.01
"""A step that gains less than this ends it."""
HALVINGS = 3
"""Of trust, within one round."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """A step that was judged: what moved, gain foretold and achieved, and why it was not taken."""

    moved: dict[str, float]
    predicted: float
    gain: float
    figures: dict[str, float]
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class RefinedDesign:
    """Where polishing led: the design, its figures and those it began with, and every step."""

    design: Design
    before: dict[str, float]
    figures: dict[str, float]
    steps: list[Step]
    why: str


def refine(
    design: Design,
    accuracy: Accuracy,
    *,
    only: Sequence[str] = (),
    rounds: int = 6,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> RefinedDesign:
    """Make the force finer over the middle heights by what is free to move.

    Parameters
    ----------
    only : sequence of str
        Knobs or tables that may move; if empty all but the body's sizes, markers' numbers, and
        parts to buy.
    rounds : int
        Steps at most.

    Raises
    ------
    DesignError
        If the design breaks a rule, or its markers hide, fuse or disturb each other: first mend
        that.
    """
    start = here = evaluate_design(design, accuracy, seed=seed)
    if here.faults:
        raise DesignError(
            f"{design.name} has {here.faults} markers that hide, fuse or are disturbed; there is "
            "nothing to polish before that is mended: ask `phytac advise` without --polish"
        )
    steps: list[Step] = []
    why = f"{rounds} rounds are over"
    for number in range(1, rounds + 1):
        progress(f"polish: round {number}, {GOAL} {here.figures[GOAL]:.4g} N")
        taken = _round(here, accuracy, only, seed, steps, progress)
        if taken is None:
            why = f"no step gains {100.0 * LEAST_GAIN:g} % within the margins"
            break
        here = taken
    name = f"{design.name}-polished"[-64:].lstrip("_.-")
    done = parse_design(here.design.model_dump(mode="json") | {"name": name}, name)
    return RefinedDesign(
        design=done, before=start.figures, figures=here.figures, steps=steps, why=why
    )


def _round(
    here: EvaluatedDesign,
    accuracy: Accuracy,
    only: Sequence[str],
    seed: int,
    steps: list[Step],
    progress: Callable[[str], None],
) -> EvaluatedDesign | None:
    """One step; None if none gains."""
    every = variables_of(here.design, here.markers, stand_off_of(here))
    knobs = choose(every, list(only)) if only else [k for k in every if k.kind == FREE]
    # Heights that move together are moved one by one here.
    knobs = [knob for knob in knobs if "(all" not in knob.name or len(knobs) == 1]
    slopes = [
        slope
        for slope in sensitivities(LocalModel(here, accuracy), here, knobs, progress)
        if not slope.stuck and np.isfinite(list(slope.rate.values())).all()
    ]
    trust, tried = 1.0, set()
    for _ in range(HALVINGS + 1):
        amounts = step_of(here.figures, slopes, trust)
        trust /= 2.0
        key = tuple(np.round(amounts, 9))
        predicted = _gain(here.figures, slopes, amounts)
        if predicted < LEAST_GAIN or key in tried:
            continue
        tried.add(key)
        moved = {s.knob.name: float(a) for s, a in zip(slopes, amounts, strict=True) if a}
        progress(f"polish: trying {', '.join(f'{k} {v:+.3g}' for k, v in moved.items())}")
        try:
            after = evaluate_design(apply(here.design, slopes, amounts), accuracy, seed=seed)
        except PhytacError as error:
            steps.append(
                Step(moved=moved, predicted=predicted, gain=0.0, figures={}, reason=str(error))
            )
            continue
        gain = 1.0 - after.figures[GOAL] / here.figures[GOAL]
        reason = broken_margin(here.figures, after.figures)
        if not reason and gain < LEAST_GAIN:
            reason = "gains too little"
        steps.append(
            Step(moved=moved, predicted=predicted, gain=gain, figures=after.figures, reason=reason)
        )
        if not reason:
            return after
    return None


def apply(design: Design, slopes: Sequence[Sensitivity], amounts: FloatArray) -> Design:
    """Design with all knobs moved."""
    for slope, amount in zip(slopes, amounts, strict=True):
        if amount:
            design = slope.knob.moved(design, float(amount))
    return design


def step_of(figures: dict[str, float], slopes: Sequence[Sensitivity], trust: float) -> FloatArray:
    """Whole steps of each knob that gain most by the slopes and keep gaps and strain, (k,)."""
    if not slopes:
        return np.zeros(0)
    goal = np.array([slope.rate[GOAL] for slope in slopes])
    most = np.array([max(trust * s.knob.reach, s.knob.step) for s in slopes])
    room = [figures[gap] - min(figures[gap], GAP_PX + GAP_RESERVE_px) for gap in GAPS]
    room.append(float(np.log(max(STRAIN / figures["strain"], 1.0))))
    loss = np.array([[-slope.rate[gap] for slope in slopes] for gap in GAPS])
    loss = np.vstack([loss, [slope.rate["strain"] for slope in slopes]])
    found = linprog(
        goal, A_ub=loss, b_ub=room, bounds=list(zip(-most, most, strict=True)), method="highs"
    )
    if not found.success:
        return np.zeros(len(slopes))
    steps = np.array([slope.knob.step for slope in slopes])
    # Towards zero: what was feasible stays so, nearly.
    return np.asarray(np.trunc(found.x / steps + 1e-9 * np.sign(found.x)) * steps)


def _gain(figures: dict[str, float], slopes: Sequence[Sensitivity], amounts: FloatArray) -> float:
    """Gain that slopes foretell of a step."""
    ratio = 1.0
    for slope, amount in zip(slopes, amounts, strict=True):
        ratio *= slope.predict(figures, float(amount))[GOAL] / figures[GOAL]
    return 1.0 - ratio
