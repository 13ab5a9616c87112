"""The switches of one sensor: one family for each threshold, all cast of one rubber."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.switch.family_spread import FamilyTolerance
from phytac_design.mechanics.switch.rubbers import Rubber
from phytac_design.mechanics.switch.switch_families import (
    Family,
    FamilyCandidate,
    compare_families,
)
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class ChosenSwitch:
    """The switch of one threshold.

    Attributes
    ----------
    threshold_N : float
        The threshold.
    candidate : FamilyCandidate
        The switch, which fits.
    tolerance : FamilyTolerance
        Behind its spread.
    reason : str
        Why it and no other.
    """

    threshold_N: float
    candidate: FamilyCandidate
    tolerance: FamilyTolerance
    reason: str


def choose_families(
    thresholds_N: Sequence[float],
    travels_mm: Sequence[FloatArray],
    rubbers: Sequence[Rubber],
    families: Sequence[Family],
    space: SwitchSpace,
    tolerance: FamilyTolerance,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> list[ChosenSwitch]:
    """Choose the family with the smallest spread for each threshold, and one rubber for all.

    Of several rubbers, the one is taken whose largest spread over the thresholds is smallest: all
    switches are cast at once.

    Parameters
    ----------
    thresholds_N : sequence of float
        Thresholds of the sensor.
    travels_mm : sequence of (n,) float
        For each, the travels at which the camera counts its tips as out, see
        :func:`~phytac_design.mechanics.switch.switch_families.compare_families`.
    rubbers, families : sequences
        What switches may be cast of, and their families.
    space, tolerance : SwitchSpace, FamilyTolerance
        What they must fit, and what varies.

    Raises
    ------
    DesignError
        If no rubber gives every threshold; it says why each one fails.
    """
    compared = [
        compare_families(
            force, rubbers, space, travel, families=families, tolerance=tolerance, progress=progress
        )
        for force, travel in zip(thresholds_N, travels_mm, strict=True)
    ]

    def best_of(rubber: Rubber) -> list[FamilyCandidate]:
        # Candidates are sorted by spread, those that do not fit last.
        return [next(one for one in found if one.rubber is rubber) for found in compared]

    def band(rubber: Rubber) -> float:
        return max(one.spread.band if one.spread else np.inf for one in best_of(rubber))

    chosen = min(rubbers, key=band)
    if not np.isfinite(band(chosen)):
        raise DesignError("switch-infeasible", _refusal(thresholds_N, compared, space))
    return [
        ChosenSwitch(
            threshold_N=force, candidate=one, tolerance=tolerance, reason=_reason(one, found)
        )
        for force, one, found in zip(thresholds_N, best_of(chosen), compared, strict=True)
    ]


def _reason(one: FamilyCandidate, found: Sequence[FamilyCandidate]) -> str:
    """Sentence on a choice, with the next best candidate and those that do not fit."""
    if one.spread is None or len(found) == 1:
        return ""
    others = [other for other in found if other is not one]
    parts = [f"± {one.spread.band:.0%}, the smallest spread that fits"]
    fitting = [other for other in others if other.spread]
    if fitting and fitting[0].spread:
        parts.append(f"next: {_name(fitting[0])}, ± {fitting[0].spread.band:.0%}")
    refused = [_name(other) for other in others if not other.spread]
    if refused:
        parts.append(f"do not fit: {', '.join(refused)}")
    return "; ".join(parts)


def _name(one: FamilyCandidate) -> str:
    return f"{one.family} of {one.rubber.name}"


def _refusal(
    thresholds_N: Sequence[float],
    compared: Sequence[Sequence[FamilyCandidate]],
    space: SwitchSpace,
) -> str:
    """Why no rubber gives every threshold."""
    reasons = {
        # Its own advice on what else to take is given once, below.
        f"{force:g} N, {_name(one)}: {one.reason.partition('; take another')[0]}": None
        for force, found in zip(thresholds_N, compared, strict=True)
        for one in found
        if one.reason
    }
    return (
        f"no switch fits {space.diameter_mm:.3g} mm with the families and rubbers that the design "
        f"allows ({'; '.join(reasons)}); take another switch.family or switch.material (`best` "
        "tries all), another threshold, or raise switch.footprint_diameter_mm"
    )
