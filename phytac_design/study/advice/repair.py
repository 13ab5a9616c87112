"""Repair: changes that remove hidden, fused or disturbed markers, or satisfy a rule."""

from collections.abc import Callable, Sequence

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.loaded_visibility import FUSED_PX, WALL_SETBACK, scene_state
from phytac_design.optics.render_scene import build_scene
from phytac_design.optics.visibility import FRACTION_MIN
from phytac_design.rules.check import check_design
from phytac_design.study.advice.design_changes import FAULTS, RULES, Change
from phytac_design.study.advice.design_evaluation import LIMITS
from phytac_design.study.advice.design_variables import COUNT, ROW, DesignVariable
from phytac_design.study.advice.local_model import LocalModel
from phytac_shapes.errors import DesignError, PhytacError


def render_faults(model: LocalModel, design: Design, *, held: bool) -> dict[str, float]:
    """Faults of a design at rest and under the three worst presses of the base, every pixel.

    ``badness`` sums how far markers are from being wholly visible and separate: it falls before the
    counts do.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    """
    markers = check_design(design).markers
    view = model.view(design, markers=markers, held=held)
    load = model.base.load
    order = np.lexsort((load["press_gap_same_px"], -load["hidden"], -load["fused"]))
    hidden = fused = 0
    fraction, gap, badness, stray = 1.0, np.inf, 0.0, 0.0
    for number, camera in enumerate(view.cameras):
        own = np.asarray(view.camera_of == number)
        if not own.any():
            continue
        scene = build_scene(
            Sensor.of(design, design.surface(), markers), tolerance_mm=tolerance_mm(camera, markers)
        )
        poses = [scene_state(scene, camera).of(own)]
        rest = scene_state(scene, camera, wall_setback=WALL_SETBACK).of(own)
        for press in view.motion.press[order[:3]]:
            moved = scene.moved(press[:, :3], press[:, 3:], markers.mid_mm)
            poses.append(scene_state(moved, camera, wall_setback=WALL_SETBACK).of(own))
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
            found.append(Change(variable, amount, FAULTS, reached, gain))
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
    return [Change(variable, amount, RULES, {}, 1.0) for _, variable, amount in found]


def _passes(variable: DesignVariable, design: Design, amount: float) -> bool:
    try:
        check_design(variable.moved(design, amount))
    except DesignError:
        return False
    return True
