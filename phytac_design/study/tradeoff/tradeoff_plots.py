"""Pictures of fronts: error over seconds, both logarithmic."""

from collections.abc import Mapping, Sequence
from typing import Any

from phytac_design.core.figures import new_figure, png
from phytac_design.study.tradeoff.front import MeasuredSetting, pareto
from phytac_design.study.tradeoff.settings import QUANTITIES, Setting

BLUE, RED = "#1b6ca8", "#b03060"


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
