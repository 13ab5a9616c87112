"""Pictures of fronts: seconds across, error up, both logarithmic."""

from collections.abc import Mapping, Sequence
from typing import Any

from phytac_design.report.figures import new_figure, png
from phytac_design.study.tradeoff.front import Measured, pareto
from phytac_design.study.tradeoff.settings import QUANTITIES, Knob

PAINT = ("#1b6ca8", "#b03060", "#2e8b57", "#e08a1e", "#7a7a7a", "#6fb1dd")
LEAST = 1e-5
"""Smaller errors are drawn there: a logarithm of zero is nowhere."""
ACROSS = 3


def whole_front(name: str, points: Sequence[Measured], presets: Mapping[str, Measured]) -> bytes:
    """Every joint setting, the front of each quantity, and the presets on it."""
    figure = new_figure((10.0, 7.2))
    for k, quantity in enumerate(QUANTITIES):
        axes = figure.add_subplot(2, 2, k + 1)
        _logarithmic(axes, quantity)
        x = [p.seconds for p in points]
        y = [max(p.errors[quantity], LEAST) for p in points]
        axes.plot(x, y, ".", color="#c4c4c4", markersize=3)
        front = pareto(points, quantity)
        x = [p.seconds for p in front]
        y = [max(p.errors[quantity], LEAST) for p in front]
        axes.plot(x, y, "o-", color=PAINT[0], markersize=4, linewidth=1.2)
        for preset, point in presets.items():
            at = (point.seconds, max(point.errors[quantity], LEAST))
            axes.plot(*at, "s", color=PAINT[1], markersize=6)
            axes.annotate(preset, at, xytext=(5, 4), textcoords="offset points", fontsize=8)
    figure.suptitle(f"{name}: the whole build, seconds against error", fontsize=11)
    return png(figure)


def knob_fronts(name: str, rows: Mapping[str, tuple[Knob, Sequence[Measured]]]) -> bytes:
    """A panel for each knob: its values, cheapest to finest."""
    down = -(-len(rows) // ACROSS)
    figure = new_figure((10.0, 2.6 * down))
    for k, (knob, points) in enumerate(rows.values()):
        axes = figure.add_subplot(down, ACROSS, k + 1)
        _logarithmic(axes, f"{knob.quantity}, {knob.unit}")
        x = [max(p.seconds, LEAST) for p in points]
        y = [max(p.errors[knob.quantity], LEAST) for p in points]
        axes.plot(x, y, "o-", color=PAINT[k % len(PAINT)], markersize=4, linewidth=1.2)
        for point, a, b in zip(points, x, y, strict=True):
            value = str(next(iter(point.settings.values())))
            axes.annotate(value, (a, b), xytext=(3, 3), textcoords="offset points", fontsize=7)
        axes.set_title(knob.name, fontsize=9)
    figure.suptitle(f"{name}: one knob at a time", fontsize=11)
    return png(figure)


def _logarithmic(axes: Any, label: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("s", fontsize=8)
    axes.set_ylabel(label, fontsize=8)
    axes.tick_params(labelsize=7, which="both")
    axes.grid(visible=True, alpha=0.3)
