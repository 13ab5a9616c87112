"""Changes of a design: by sensitivities, to repair faults, to satisfy a rule; gains and margins."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from phytac_design.design.shell_materials import material_of
from phytac_design.design.spec import Design
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.optics.loaded_visibility import FUSED_PX, scene_state
from phytac_design.optics.render_scene import build_scene
from phytac_design.optics.visibility import FRACTION_MIN
from phytac_design.rules.check import check_design
from phytac_design.study.advice.design_evaluation import (
    FIGURES,
    FORCES,
    LIMITS,
    EvaluatedDesign,
    faults_of,
)
from phytac_design.study.advice.design_variables import COUNT, ROW, SIZE, DesignVariable
from phytac_design.study.advice.local_model import LocalModel, Sensitivity
from phytac_design.study.search.surrogate import strain_of
from phytac_shapes.errors import DesignError, PhytacError

GOALS = ("force_middle_N", "force_worst_N", "gap_px", "load_gap_px")
"""Goals of a design without faults; gaps only while they are below ``WANTED_GAP_px``. Others are
``faults`` (hidden, fused or disturbed markers) and ``rules`` (a rule rejects the design)."""
WANTED_GAP_px = 8.0
SWITCHES, THRESHOLDS, STIFFNESS = "switches", "thresholds", "stiffness"
"""Other goals: the camera reads more switches; bowls have their thresholds; the shell is soft
enough for the largest force."""
REPAIRS = {"faults", "rules", SWITCHES, THRESHOLDS, STIFFNESS}
"""Goals that repair a design; they come before all others."""


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
    if goal in REPAIRS:
        return 10.0 + gain
    return gain if goal in FORCES else gain / WANTED_GAP_px


def least_gain(goal: str) -> float:
    """Least gain of a goal that is reported: a share, or px of gaps."""
    return 0.01 if goal in {*FORCES, *REPAIRS} else 0.5


def gain_of(goal: str, before: Mapping[str, float], after: Mapping[str, float]) -> float:
    """Gain of a goal: share of force or faults, px of gaps."""
    if goal == "faults":
        return 1.0 - faults_of(after) / max(faults_of(before), 1)
    if goal == SWITCHES:
        return 1.0 - after["switch_unreadable"] / max(before["switch_unreadable"], 1)
    if goal in {*FORCES, STIFFNESS}:
        name = "force_middle_N" if goal == STIFFNESS else goal
        return 1.0 - after[name] / before[name]
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
    found: Change | None = None
    for amount in slope.variable.amounts(sign):
        change = change_by(base.figures, slope, goal, amount)
        if change.predicted_gain < least_gain(goal):
            # What a larger change broke does not say what this one would.
            return found or change
        why = broken_margin(base.figures, change.predicted)
        if not why:
            try:
                design = slope.variable.moved(base.design, amount)
                strain = strain_of(check_design(design))
                why = broken_margin(base.figures, {"strain": strain}, limits_of(design))
            except PhytacError as error:
                why = str(error)
        found = replace(change, reason=why)
        if not why:
            break
    return found or change


def limits_of(design: Design) -> dict[str, float]:
    """Margins of a design: known materials bear a strain of their own."""
    material = material_of(design.material.modulus_MPa)
    return LIMITS | ({"strain": material.strain_max} if material else {})


def broken_margin(
    before: Mapping[str, float],
    after: Mapping[str, float],
    limits: Mapping[str, float] = LIMITS,
) -> str:
    """A margin that a change breaks, in words; what was outside before may stay as it was."""
    for name, limit in limits.items():
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
    if goal in {*FORCES, STIFFNESS}:
        return f"force {100.0 * gain:.1f} % finer"
    if goal == SWITCHES:
        return f"{gain:+.0%} of the unreadable switches read"
    return f"{gain:+.0%} of the faults repaired" if goal == "faults" else f"gap {gain:+.2f} px"


def render_faults(model: LocalModel, design: Design, *, held: bool) -> dict[str, float]:
    """Faults of a design at rest and under the three worst presses of the base, every pixel.

    ``badness`` sums how far markers are from being wholly visible and separate: it falls before the
    counts do.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    """
    sensor = check_design(design)
    markers = sensor.markers
    view = model.view(design, markers=markers, held=held)
    load = model.base.load
    order = np.lexsort((load["press_gap_same_px"], -load["hidden"], -load["fused"]))
    hidden = fused = 0
    fraction, gap, badness, stray = 1.0, np.inf, 0.0, 0.0
    for number, camera in enumerate(view.sensor.cameras):
        own = np.asarray(view.camera_of == number)
        if not own.any():
            continue
        scene = build_scene(sensor, tolerance_mm=tolerance_mm(camera, markers))
        poses = [scene_state(scene, camera).of(own)]
        rest = scene_state(scene, camera, wall_follows=True).of(own)
        for press in view.motion.press[order[:3]]:
            moved = scene.moved(press[:, :3], press[:, 3:], markers.mid_mm)
            poses.append(scene_state(moved, camera, wall_follows=True).of(own))
            stray = max(stray, float(poses[-1].crosstalk_px(rest).max()))
        hidden += max(int(pose.hidden.sum()) for pose in poses)
        fused += max(int(pose.fused.sum()) for pose in poses)
        for pose in poses:
            fraction = min(fraction, float(pose.fraction.min()))
            gap = min(gap, float(pose.gap_same_px.min()))
            badness += float(np.maximum(FRACTION_MIN + 0.1 - pose.fraction, 0.0).sum())
            badness += float(np.maximum(FUSED_PX + 1.0 - pose.gap_same_px, 0.0).sum()) / FUSED_PX
    excess = stray - LIMITS["crosstalk_px"]
    return {
        "hidden": hidden,
        "fused": fused,
        "crosstalk_px": stray,
        "visible_least": fraction,
        "gap_px": gap,
        "badness": badness + max(excess, 0.0),
        "faults": hidden + fused + int(excess > 0.0),
    }


def repairs(
    model: LocalModel, variables: Sequence[DesignVariable], progress: Callable[[str], None]
) -> list[Change]:
    """Smallest changes that repair most faults, the best first."""

    def faults(variable: DesignVariable, amount: float) -> dict[str, float]:
        try:
            design = variable.moved(model.base.design, amount)
            return render_faults(model, design, held=variable.kind == ROW)
        except PhytacError:
            return {"badness": np.inf}

    base = render_faults(model, model.base.design, held=False)
    begun = []
    for number, variable in enumerate(variables, start=1):
        progress(f"repair: {number} of {len(variables)}, {variable.name}")
        sides = [(faults(variable, amount), amount) for amount in (variable.step, -variable.step)]
        best, amount = min(sides, key=lambda side: side[0]["badness"])
        if best["badness"] < base["badness"]:
            begun.append((best, variable, amount))
    begun.sort(key=lambda item: item[0]["badness"])
    found = []
    for best, variable, step in begun[:8]:
        progress(f"repair: {variable.name}, larger steps")
        reached, amount = best, step
        for times in (2, 4, 8):
            if not reached["faults"]:
                break
            look = faults(variable, step * times)
            if look["badness"] < reached["badness"]:
                reached, amount = look, step * times
        gain = 1.0 - reached["faults"] / max(base["faults"], 1)
        if gain > 0.0:
            found.append(Change(variable, amount, "faults", reached, gain))
    # Of equal repairs, a row alone changes least, then fewer steps; fewer markers come last.
    return sorted(
        found,
        key=lambda one: (
            -one.predicted_gain,
            one.variable.kind == COUNT,
            one.variable.kind != ROW,
            abs(one.amount / one.variable.step),
        ),
    )


def rule_repairs(design: Design, variables: Sequence[DesignVariable]) -> list[Change]:
    """Smallest changes that satisfy every rule; those of fewest steps first."""
    found = []
    for variable in variables:
        for times in (1, 2, 4, 8, 16, 32):
            passing = [
                s for s in (1.0, -1.0) if _passes(variable, design, s * times * variable.step)
            ]
            if passing:
                found.append((times, variable, passing[0] * times * variable.step))
                break
    found.sort(key=lambda item: (item[0], item[1].kind == COUNT))
    return [Change(variable, amount, "rules", {}, 1.0) for _, variable, amount in found]


def _passes(variable: DesignVariable, design: Design, amount: float) -> bool:
    try:
        check_design(variable.moved(design, amount))
    except DesignError:
        return False
    return True
