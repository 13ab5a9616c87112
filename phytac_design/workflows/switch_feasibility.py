"""Whether switches can have a design's thresholds, for ``phytac check`` and ``phytac new``.

Outcomes are cached by space and rubber: the next check of the same switches solves nothing, nor
one of the same rubber in another mix, whose thresholds are in proportion to its modulus.
"""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.engine.cache import lookup, record, solved_once, stage_key
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.mechanics.switch.feasible_range import (
    FeasibleRange,
    feasible_range,
    fit_words,
    misfit,
    moduli_MPa,
)
from phytac_design.mechanics.switch.rubbers import RUBBERS, Rubber
from phytac_design.mechanics.switch.switch_inputs import rubber_of, space_of
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_design.mechanics.switch.threshold_bound import far_too_high
from phytac_design.simulation.switch_law import chosen_switches
from phytac_shapes.errors import DesignError


def check_thresholds(design: Design, *, progress: Callable[[str], None] = lambda _: None) -> None:
    """Check that a bowl, or the design's family of switches, can have each threshold of a design.

    Of bowls, buckling and tolerances are not evaluated; a build does that.

    Raises
    ------
    DesignError
        If a threshold does not fit, with those that do; if no bowl fits at all, or the markers
        cannot be placed.
    """
    if not design.has_switches:
        return
    if design.switch.family != "bowl":
        chosen_switches(design, progress)
        return
    rubber, space = rubber_of(design), space_of(design)
    solved = _solved_range(design, rubber, space)
    faults = []
    for threshold_N in map(float, np.unique(thresholds_N(design, Sensor(design).markers))):
        if solved is not None and solved.min_N <= threshold_N <= solved.max_N:
            continue

        def solve(wanted_N: float = threshold_N) -> dict[str, Any]:
            progress(f"pressing bowls for a threshold of {wanted_N:g} N (some seconds)")
            far = far_too_high(wanted_N, rubber, space)
            return {"far": far, "misfit": "" if far else misfit(wanted_N, rubber, space)}

        inputs = [design.switch.material, design.switch.modulus_MPa, asdict(space), threshold_N]
        known = solved_once("threshold_fit", inputs, solve)
        why, far = str(known["misfit"]), str(known["far"])
        if far:
            faults.append(f"{_fault_start(threshold_N, rubber, space)}: no wall gives it, {far}")
        if not why:
            continue
        found = threshold_range(design, progress=progress)
        # Solved in full: walls near the thickest pass here that the power law misses.
        if found is None or not found.min_N <= threshold_N <= found.max_N:
            faults.append(_fault(threshold_N, rubber, space, why, found))
    if faults:
        raise DesignError("switch-infeasible", "; ".join(faults))


def threshold_range(
    design: Design, *, progress: Callable[[str], None] = lambda _: None
) -> FeasibleRange | None:
    """Thresholds that fit the switches' space and rubber; None if no wall does.

    Raises
    ------
    DesignError
        If no bowl fits, or the rubber is not known.
    """
    rubber, space = rubber_of(design), space_of(design)

    def solve() -> dict[str, Any]:
        progress(
            "finding the thresholds that bowls of this size and rubber can have (once, up to a "
            "minute)"
        )
        found = feasible_range(rubber.of_modulus(1.0), space)
        return {"range": found and asdict(found)}

    found = solved_once("threshold_range", _range_inputs(design, space), solve)["range"]
    return None if found is None else FeasibleRange(**found).of_modulus(_modulus_MPa(rubber))


def _solved_range(design: Design, rubber: Rubber, space: SwitchSpace) -> FeasibleRange | None:
    """Thresholds that fit, if they were solved for before."""
    name = "threshold_range"
    done = lookup(name, stage_key(name, _range_inputs(design, space)))
    found = record(done)["range"] if done else None
    return None if found is None else FeasibleRange(**found).of_modulus(_modulus_MPa(rubber))


def _range_inputs(design: Design, space: SwitchSpace) -> list[Any]:
    """What the thresholds that fit depend on, for a modulus of 1 MPa."""
    return [design.switch.material, asdict(space)]


def known_rubbers(design: Design, found: FeasibleRange) -> list[dict[str, Any]]:
    """Fields of the rubbers with data whose bowls snap at a design's threshold, or a little below.

    They are estimates by the modulus alone: laws differ. The nearest threshold comes first; none
    is below half of the design's.
    """
    switch, least_share = design.switch, 0.5
    fitting = []
    for name, known in RUBBERS.items():
        own = found.of_modulus(_modulus_MPa(known))
        # Design files hold two digits: not at the very ends of the range.
        share = min(1.0, 0.95 * own.max_N / switch.threshold_N)
        if share < least_share or share * switch.threshold_N < 1.05 * own.min_N:
            continue
        fields: dict[str, Any] = {"switch.material": name, "switch.modulus_MPa": 0.0}
        if share < 1.0:
            fields |= threshold_fields(design, share)
        fitting.append((-share, name, fields))
    return [fields for _, name, fields in sorted(fitting, key=lambda one: one[:2])]


def threshold_fields(design: Design, factor: float) -> dict[str, float]:
    """Fields of threshold and release, a factor times those of the design, to two digits."""
    return {
        f"switch.{name}": float(f"{factor * getattr(design.switch, name):.2g}")
        for name in ("threshold_N", "release_N")
    }


def modulus_for(threshold_N: float, found: FeasibleRange) -> float:
    """Modulus, MPa to two digits, at which a threshold lies amid those that fit."""
    return float(f"{np.sqrt(np.prod(moduli_MPa(threshold_N, found))):.2g}")


def _fault(
    threshold_N: float, rubber: Rubber, space: SwitchSpace, why: str, found: FeasibleRange | None
) -> str:
    fits = (
        "No wall fits: raise switch.footprint_diameter_mm, or lower switch.stroke_mm"
        if found is None
        else f"{fit_words(threshold_N, found)}: change switch.threshold_N or switch.modulus_MPa"
    )
    return f"{_fault_start(threshold_N, rubber, space)}: {why}. {fits}"


def _fault_start(threshold_N: float, rubber: Rubber, space: SwitchSpace) -> str:
    return (
        f"a switch of {threshold_N:g} N does not fit a bowl {space.diameter_mm:.3g} mm wide of "
        f"{rubber.name} at {rubber.material.modulus_MPa:.3g} MPa"
    )


def _modulus_MPa(rubber: Rubber) -> float:
    return float(rubber.material.modulus_MPa)
