"""Changes with which bowls have a design's thresholds, and the camera reads its switches."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.design.switch_table import BEST
from phytac_design.study.advice.design_changes import SWITCHES, THRESHOLDS, Change
from phytac_design.study.advice.design_variables import together, with_fields
from phytac_design.study.advice.quick_repair import READABLE_SHARE, readable_switches
from phytac_design.workflows.switch_feasibility import (
    check_thresholds,
    known_rubbers,
    modulus_for,
    threshold_fields,
    threshold_range,
)
from phytac_shapes.errors import PhytacError


def readable_changes(
    design: Design,
    unreadable: int,
    count: int,
    *,
    seed: int = 0,
    castable: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Change]:
    """Changes that were tried so that the camera reads more switches, the best first.

    Parameters
    ----------
    unreadable, count : int
        Switches that it cannot read, and all of them; nothing is tried if it reads most.
    castable : bool
        Whether bowls have the design's thresholds; they must then have them after the change too.
    """
    if unreadable <= (1.0 - READABLE_SHARE) * count:
        return []
    fits: Callable[[Design], None] = check_thresholds if castable else lambda _: None
    tried = readable_switches(design, fits=fits, seed=seed, seconds=90.0, progress=progress)
    return [
        Change(
            together(one.fields, one.words),
            1.0,
            SWITCHES,
            {"switch_unreadable": one.after},
            1.0 - one.after / max(one.before, 1),
            reason=one.reason,
            design=one.design,
        )
        for one in tried
    ]


def threshold_changes(
    design: Design,
    figures: dict[str, float],
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Change]:
    """Rubbers and thresholds that fit a design whose thresholds no bowl has, each one checked.

    They move no marker: its ``figures`` stay as they are.
    """
    out = []
    for fields in _threshold_fields(design, progress):
        changed, reason = with_fields(design, fields), ""
        words = ", ".join(
            f"{name} {_shown(old)} → {_shown(new)}"
            for name, new in fields.items()
            if (old := getattr(design.switch, name.removeprefix("switch."))) != new
        )
        progress(f"trying {words}")
        try:
            check_thresholds(changed, progress=progress)
        except PhytacError as error:
            reason = f"breaks a rule: {error}"
        out.append(
            Change(
                together(fields, words),
                1.0,
                THRESHOLDS,
                {},
                1.0,
                gain=0.0 if reason else 1.0,
                achieved=figures,
                reason=reason,
                design=changed,
            )
        )
    return out


def _threshold_fields(design: Design, progress: Callable[[str], None]) -> Iterator[dict[str, Any]]:
    """A rubber with data, the modulus for the threshold, then the rubber's nearest threshold.

    Of families that are compared, the best one of all rubbers.
    """
    if design.switch.family != "bowl":
        yield {"switch.family": BEST, "switch.material": BEST, "switch.modulus_MPa": 0.0}
        return
    threshold_N, found = design.switch.threshold_N, threshold_range(design, progress=progress)
    if found is None:
        return
    yield from known_rubbers(design, found)[:1]
    yield {"switch.modulus_MPa": modulus_for(threshold_N, found)}
    # Design files hold two digits: not at the very ends of the range.
    nearest_N = float(np.clip(threshold_N, 1.05 * found.min_N, 0.95 * found.max_N))
    yield threshold_fields(design, nearest_N / threshold_N)


def _shown(value: Any) -> str:
    """Value of a field in words."""
    return value if isinstance(value, str) else f"{value:g}"
