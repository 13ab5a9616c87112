"""Pareto fronts of settings in time and error, and dominated settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log
from typing import Any


@dataclass(frozen=True, kw_only=True)
class MeasuredSetting:
    """A setting with its cost and errors.

    Attributes
    ----------
    settings : dict
        Names and values.
    seconds, cpu_s, peak_MB : float
        Wall and processor time, and the largest memory of its processes.
    errors : dict
        By quantity.
    """

    settings: Mapping[str, Any]
    seconds: float
    cpu_s: float
    peak_MB: float
    errors: Mapping[str, float]


def pareto(points: Sequence[MeasuredSetting], quantity: str) -> list[MeasuredSetting]:
    """Front in (seconds, error of a quantity), cheapest first."""
    out: list[MeasuredSetting] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.errors[quantity])):
        if not out or point.errors[quantity] < out[-1].errors[quantity]:
            out.append(point)
    return out


def no_worse(one: MeasuredSetting, other: MeasuredSetting) -> bool:
    """Whether no error of ``one`` is larger than the other's, and no check of it left out.

    What a check (``print_tools``) does not find is in none of the errors.
    """
    checks = [bool(point.settings.get("print_tools", True)) for point in (one, other)]
    return checks[0] >= checks[1] and all(
        one.errors[name] <= error for name, error in other.errors.items()
    )


def beaten_by(point: MeasuredSetting, points: Sequence[MeasuredSetting]) -> float:
    """Share of a setting's seconds that another saves without a larger error; 0 if none does."""
    rivals = [other.seconds for other in points if no_worse(other, point)]
    return max(0.0, 1.0 - min(rivals, default=point.seconds) / point.seconds)


def knee(points: Sequence[MeasuredSetting], quantity: str) -> MeasuredSetting:
    """Point of a front farthest below the line between its ends, in logarithms of both."""
    whole = pareto(points, quantity)
    front = [p for p in whole if p.errors[quantity] > 0.0]
    x = [log(p.seconds) for p in front]
    y = [log(p.errors[quantity]) for p in front]
    if len(front) < 3:
        return (front or whole)[-1]
    dx, dy = x[-1] - x[0], y[-1] - y[0]
    below = [dx * (y[0] - b) - dy * (x[0] - a) for a, b in zip(x, y, strict=True)]
    return front[max(range(len(front)), key=below.__getitem__)]
