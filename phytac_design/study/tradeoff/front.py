"""Pareto fronts of settings in time and error, dominated settings, and pictures of both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log
from typing import Any

from phytac_design.core.figures import new_figure, png
from phytac_design.study.tradeoff.settings import QUANTITIES, Setting

BLUE, RED = "#1b6ca8", "#b03060"


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
    """Whether no error of ``one`` is larger than the other's, and no check or file left out.

    What a check (``tools``) does not find, and files (``step``), are in none of the errors.
    """
    left_out = any(
        bool(other.settings.get(name, True)) and not one.settings.get(name, True)
        for name in ("tools", "step")
    )
    return not left_out and all(one.errors[name] <= error for name, error in other.errors.items())


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


def joint_fronts(
    name: str, points: Sequence[MeasuredSetting], presets: Mapping[str, MeasuredSetting]
) -> bytes:
    """Every joint setting, the front of each quantity, and the presets."""
    figure = new_figure((10.0, 7.2))
    for k, quantity in enumerate(QUANTITIES):
        axes = _axes(figure, 2, 2, k, quantity)
        axes.plot(*_curve(points, quantity), ".", color="#c4c4c4", markersize=3)
        front = _curve(pareto(points, quantity), quantity)
        axes.plot(*front, "o-", color=BLUE, markersize=4, linewidth=1.2)
        for preset, point in presets.items():
            [x], [y] = _curve([point], quantity)
            axes.plot(x, y, "s", color=RED, markersize=6)
            axes.annotate(preset, (x, y), xytext=(5, 4), textcoords="offset points", fontsize=8)
    figure.suptitle(f"{name}: the whole build, seconds against error", fontsize=11)
    return png(figure)


def setting_fronts(name: str, rows: Sequence[tuple[Setting, Sequence[MeasuredSetting]]]) -> bytes:
    """A panel for each setting: its values, cheapest to finest."""
    columns = 3
    down = -(-len(rows) // columns)
    figure = new_figure((10.0, 2.6 * down))
    for k, (setting, points) in enumerate(rows):
        axes = _axes(figure, down, columns, k, f"{setting.quantity}, {setting.unit}")
        x, y = _curve(points, setting.quantity)
        axes.plot(x, y, "o-", color=BLUE, markersize=4, linewidth=1.2)
        for point, a, b in zip(points, x, y, strict=True):
            value = str(next(iter(point.settings.values())))
            axes.annotate(value, (a, b), xytext=(3, 3), textcoords="offset points", fontsize=7)
        axes.set_title(setting.name, fontsize=9)
    figure.suptitle(f"{name}: one setting at a time", fontsize=11)
    return png(figure)


def _curve(points: Sequence[MeasuredSetting], quantity: str) -> tuple[list[float], list[float]]:
    least = 1e-5  # the axes are logarithmic
    seconds = [max(p.seconds, least) for p in points]
    return seconds, [max(p.errors[quantity], least) for p in points]


def _axes(figure: Any, rows: int, columns: int, number: int, label: str) -> Any:
    axes = figure.add_subplot(rows, columns, number + 1, xscale="log", yscale="log")
    axes.set_xlabel("s", fontsize=8)
    axes.set_ylabel(label, fontsize=8)
    axes.tick_params(labelsize=7, which="both")
    axes.grid(visible=True, alpha=0.3)
    return axes
