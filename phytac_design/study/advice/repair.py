"""Least moves that mend a fault: markers that hide, fuse or disturb, or a rule that is broken."""

from collections.abc import Callable, Sequence

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.optics.incremental_renderer import Watch
from phytac_design.optics.loaded_visibility import FUSED_PX, WALL_BACK, Sight, sight_of
from phytac_design.optics.scene import build_scene
from phytac_design.optics.visibility import FRACTION_MIN
from phytac_design.rules.check import check_design
from phytac_design.study.advice.design_evaluation import CROSSTALK_PX
from phytac_design.study.advice.design_variables import COUNT, ROW, DesignVariable
from phytac_design.study.advice.local_model import LocalModel
from phytac_shapes.errors import DesignError, PhytacError

TIMES = (1, 2, 4, 8)
"""Steps that are looked at, either way."""
FAR = 5
"""Doublings of a step until a rule that is broken must let a design pass."""
PRESSES = 3
"""Presses that are looked at: the worst of the judged design's."""
PROMISING = 8
"""Knobs that are looked at beyond a step."""

Mend = tuple[DesignVariable, float, dict[str, float], float]
"""Knob, amount, figures seen, share of the faults that it mends."""


def glance(probe: LocalModel, design: Design, *, held: bool) -> dict[str, float]:
    """Faults of a design at rest and under the worst presses, every pixel, no frames.

    ``badness`` adds up how far markers are from being whole and apart: it falls before the
    counts do.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    """
    _, markers = check_design(design)
    view = probe.view(design, markers=markers, held=held)
    load = probe.base.load
    order = np.lexsort((load["press_gap_same_px"], -load["hidden"], -load["fused"]))
    hidden = fused = 0
    fraction, gap, badness, stray = 1.0, np.inf, 0.0, 0.0
    for number, camera in enumerate(view.cameras):
        own = np.asarray(view.reads == number)
        if not own.any():
            continue
        scene = build_scene(
            design, design.surface(), markers, tolerance_mm=tolerance_mm(camera, markers)
        )
        rest = sight_of(Watch(scene, camera).look(scene), scene).of(own)
        watch = Watch(scene, camera, wall_back=WALL_BACK)
        still = sight_of(watch.look(scene), scene).of(own)
        poses: list[Sight] = [rest]
        for press in view.moved.press[order[:PRESSES]]:
            moved = scene.moved(press[:, :3], press[:, 3:], markers.mid_mm)
            poses.append(sight_of(watch.look(moved), moved).of(own))
            stray = max(stray, float(poses[-1].crosstalk_px(still).max()))
        hidden += max(int(pose.hidden.sum()) for pose in poses)
        fused += max(int(pose.fused.sum()) for pose in poses)
        for pose in poses:
            fraction = min(fraction, float(pose.fraction.min()))
            gap = min(gap, float(pose.gap_same_px.min()))
            badness += float(np.maximum(FRACTION_MIN + 0.1 - pose.fraction, 0.0).sum())
            badness += float(np.maximum(FUSED_PX + 1.0 - pose.gap_same_px, 0.0).sum()) / FUSED_PX
    return {
        "hidden": hidden,
        "fused": fused,
        "crosstalk_px": stray,
        "visible_least": fraction,
        "gap_px": gap,
        "badness": badness + max(stray - CROSSTALK_PX, 0.0),
        "faults": hidden + fused + int(stray > CROSSTALK_PX),
    }


def mends_of(
    probe: LocalModel, knobs: Sequence[DesignVariable], progress: Callable[[str], None]
) -> list[Mend]:
    """Least moves that mend most, the best first."""
    base = glance(probe, probe.base.design, held=False)
    begun = []
    for number, knob in enumerate(knobs, start=1):
        progress(f"mending: {number} of {len(knobs)}, {knob.name}")
        looks = [(sign, _look(probe, knob, sign * knob.step)) for sign in (1.0, -1.0)]
        better = min(
            ((look["badness"], sign, look) for sign, look in looks if look),
            default=None,
            key=lambda item: item[0],
        )
        if better and better[0] < base["badness"]:
            begun.append((better[0], knob, better[1], better[2]))
    begun.sort(key=lambda item: item[0])
    found: list[Mend] = []
    for _, knob, sign, first in begun[:PROMISING]:
        progress(f"mending: {knob.name}, farther")
        best, amount = first, sign * knob.step
        for times in TIMES[1:]:
            if not best["faults"]:
                break
            look = _look(probe, knob, sign * knob.step * times)
            if look and look["badness"] < best["badness"]:
                best, amount = look, sign * knob.step * times
        share = 1.0 - best["faults"] / max(base["faults"], 1)
        if share > 0.0:
            found.append((knob, amount, best, share))
    # Of what mends as much, a row alone changes least, then fewer steps; fewer markers last.
    return sorted(
        found,
        key=lambda mend: (
            -mend[3],
            mend[0].kind == COUNT,
            mend[0].kind != ROW,
            abs(mend[1] / mend[0].step),
        ),
    )


def _look(probe: LocalModel, knob: DesignVariable, amount: float) -> dict[str, float]:
    """A glance at a moved design; empty if a rule refuses it."""
    try:
        return glance(probe, knob.moved(probe.base.design, amount), held=knob.kind == ROW)
    except PhytacError:
        return {}


def passes_of(
    design: Design, knobs: Sequence[DesignVariable]
) -> list[tuple[DesignVariable, float]]:
    """Knobs that make every rule pass, with their least amount; those of fewest steps first."""
    found = []
    for knob in knobs:
        for times in (2**k for k in range(FAR + 1)):
            amount = _passing(design, knob, times)
            if amount:
                found.append((times, knob, amount))
                break
    found.sort(key=lambda item: (item[0], item[1].kind == COUNT))
    return [(knob, amount) for _, knob, amount in found]


def _passing(design: Design, knob: DesignVariable, times: int) -> float:
    """The amount of so many steps, either way, that passes; 0 if none does."""
    for sign in (1.0, -1.0):
        amount = sign * times * knob.step
        try:
            check_design(knob.moved(design, amount))
        except DesignError:
            continue
        return amount
    return 0.0
