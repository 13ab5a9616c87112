r"""Local refinement of a design by sequential linear programming (Griffith and Stewart, 1961).

With the sensitivities of the logarithm of the force bound over the middle heights, g, of the
strain, s, and of the gaps, G, the step x of the variables solves

    min g·x    with    gap + G x ≥ least gap,    ln strain + s·x ≤ ln limit,    |x| ≤ trust · reach

It is rounded to whole steps and evaluated exactly. A step that gains and breaks no margin is
accepted; otherwise the trust region is halved. Evaluations are cached: a stopped run resumes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_design.study.advice.design_changes import broken_margin
from phytac_design.study.advice.design_evaluation import LIMITS, EvaluatedDesign, evaluate_design
from phytac_design.study.advice.design_variables import FREE, choose, variables_of
from phytac_design.study.advice.local_model import GAPS, LocalModel, Sensitivity, sensitivities
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, PhytacError

GOAL = "force_middle_N"


@dataclass(frozen=True)
class Step:
    """An evaluated step: amounts, predicted and achieved gain, and why it was not accepted."""

    moved: dict[str, float]
    predicted: float
    gain: float
    figures: dict[str, float]
    reason: str = ""


@dataclass(frozen=True)
class RefinedDesign:
    """Result: the design, its figures and those before, every step, and why it ended."""

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
    least_gain: float = 0.01,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> RefinedDesign:
    """Lower the force bound over the middle heights by the free variables.

    Parameters
    ----------
    only : sequence of str
        Variables or tables that may change; if empty all but the body's sizes, numbers of markers,
        and parts to buy.
    rounds : int
        Accepted steps at most.
    least_gain : float
        A step that gains a smaller share ends the refinement.

    Raises
    ------
    DesignError
        If the design breaks a rule, or its markers are hidden, fused or disturbed.
    """
    start = here = evaluate_design(design, accuracy, seed=seed)
    if here.faults:
        raise DesignError(
            "design-not-repaired",
            f"{design.name} has {here.faults} markers that are hidden, fused or disturbed; repair "
            "them before --polish: run `phytac advise` without --polish",
        )
    steps: list[Step] = []
    why = f"{rounds} rounds are over"
    for number in range(1, rounds + 1):
        progress(f"polish: round {number}, {GOAL} {here.figures[GOAL]:.4g} N")
        slopes = _slopes(here, accuracy, only, progress)
        tried: set[tuple[float, ...]] = set()
        for trust in (1.0, 0.5, 0.25, 0.125):
            amounts = step_of(here.figures, slopes, trust)
            predicted = _predicted_gain(here.figures, slopes, amounts)
            if predicted < least_gain or tuple(amounts) in tried:
                continue
            tried.add(tuple(amounts))
            moved = {s.variable.name: float(a) for s, a in zip(slopes, amounts, strict=True) if a}
            progress(f"polish: trying {', '.join(f'{k} {v:+.3g}' for k, v in moved.items())}")
            gain, figures = 0.0, {}
            try:
                after = evaluate_design(_apply(here.design, slopes, moved), accuracy, seed=seed)
            except PhytacError as error:
                reason = str(error)
            else:
                figures = after.figures
                gain = 1.0 - figures[GOAL] / here.figures[GOAL]
                reason = broken_margin(here.figures, figures)
                if not reason and gain < least_gain:
                    reason = "gains too little"
            steps.append(Step(moved, predicted, gain, figures, reason))
            if not reason:
                here = after
                break
        else:
            why = f"no step gains {100.0 * least_gain:g} % within the margins"
            break
    name = f"{design.name}-polished"[-64:].lstrip("_.-")
    done = parse_design(here.design.model_dump(mode="json") | {"name": name}, name)
    return RefinedDesign(done, start.figures, here.figures, steps, why)


def _slopes(
    here: EvaluatedDesign,
    accuracy: Accuracy,
    only: Sequence[str],
    progress: Callable[[str], None],
) -> list[Sensitivity]:
    """Sensitivities to the variables that may change."""
    variables = choose(variables_of(here.sensor), only)
    variables = [one for one in variables if only or one.kind == FREE]
    # Heights that change together are here changed one by one.
    variables = [one for one in variables if "(all" not in one.name or len(variables) == 1]
    slopes = sensitivities(LocalModel(here, accuracy), variables, progress)
    return [s for s in slopes if not s.stuck and np.isfinite(list(s.rate.values())).all()]


def _apply(design: Design, slopes: Sequence[Sensitivity], moved: dict[str, float]) -> Design:
    """Design with all variables changed."""
    for slope in slopes:
        if slope.variable.name in moved:
            design = slope.variable.moved(design, moved[slope.variable.name])
    return design


def step_of(
    figures: dict[str, float],
    slopes: Sequence[Sensitivity],
    trust: float,
    *,
    gap_reserve_px: float = 0.5,
) -> FloatArray:
    """Whole steps (k,) of the variables that gain most and keep gaps and strain, as predicted.

    ``gap_reserve_px`` is the error of predicted gaps in a step, added to the least gap.
    """
    if not slopes:
        return np.zeros(0)
    goal = np.array([slope.rate[GOAL] for slope in slopes])
    most = np.array([max(trust * s.variable.reach, s.variable.step) for s in slopes])
    least_gap = LIMITS["gap_px"] + gap_reserve_px
    slack = [figures[gap] - min(figures[gap], least_gap) for gap in GAPS]
    slack.append(float(np.log(max(LIMITS["strain"] / figures["strain"], 1.0))))
    loss = np.array([[-slope.rate[gap] for slope in slopes] for gap in GAPS])
    loss = np.vstack([loss, [slope.rate["strain"] for slope in slopes]])
    bounds = list(zip(-most, most, strict=True))
    found = linprog(goal, A_ub=loss, b_ub=slack, bounds=bounds, method="highs")
    if not found.success:
        return np.zeros(len(slopes))
    steps = np.array([slope.variable.step for slope in slopes])
    # Rounding towards zero keeps a feasible step nearly feasible.
    return np.asarray(np.trunc(found.x / steps + 1e-9 * np.sign(found.x)) * steps)


def _predicted_gain(
    figures: dict[str, float], slopes: Sequence[Sensitivity], amounts: FloatArray
) -> float:
    ratio = 1.0
    for slope, amount in zip(slopes, amounts, strict=True):
        ratio *= slope.predict(figures, float(amount))[GOAL] / figures[GOAL]
    return 1.0 - ratio
