"""Figures of an evaluation, after the paper's figures 3C to 3E."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from phytac_design.core.figures import new_figure, png
from phytac_design.training.evaluation.decoded_contacts import DecodedContacts

PAINT = ("#7a7a7a", "#1b6ca8", "#6fb1dd", "#e08a1e", "#b03060", "#2e8b57")
"""One colour for each estimator, distinct also in grey and for the colour-blind."""


def draw(facts: Mapping[str, Any], decoded: DecodedContacts) -> dict[str, bytes]:
    """Return all figures (PNG) by file name."""
    return {
        "accuracy.png": accuracy(facts),
        "decoded.png": decoded_against_true(decoded),
        "relative_error.png": relative_error(facts),
        "absolute_error.png": absolute_error(facts),
    }


def _label(name: str) -> str:
    return name.replace("_", " ")


def _axes(height: float) -> tuple[Any, Any]:
    figure = new_figure((6.4, height))
    axes = figure.add_subplot()
    axes.grid(axis="y", alpha=0.3)
    return figure, axes


def _finish(figure: Any, axes: Any, labels: Sequence[str], *, rotation: float = 0.0) -> bytes:
    axes.set_xticks(np.arange(len(labels)), labels, rotation=rotation)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    return png(figure)


def _with_interval(groups: Sequence[Any], measure: str, factor: float) -> tuple[Any, Any]:
    """Return values (g,) of a measure, NaN where missing, and the reach (2, g) of intervals."""
    rows = [[group[measure][key] for key in ("value", "low", "high")] for group in groups]
    value, low, high = factor * np.array(rows, dtype=np.float64).T
    return value, np.nan_to_num(np.maximum([value - low, high - value], 0.0))


def _needs_log_axis(values: list[float]) -> bool:
    """Return whether values span more than 1.3 decades."""
    some = [value for value in values if np.isfinite(value) and value > 0.0]
    return bool(some) and np.log10(max(some) / min(some)) > 1.3


def accuracy(facts: Mapping[str, Any]) -> bytes:
    """Draw the accuracy of each estimator over all contacts, and by kind (paper, fig. 3C)."""
    estimators = facts["estimators"]
    figure, axes = _axes(3.4)
    first = next(iter(estimators.values()))
    columns = [("all", "all")] + [("contact", name) for name in first["contact"]]
    width = 0.8 / len(columns)
    for number, (section, group) in enumerate(columns):
        scores = [item[section][group] for item in estimators.values()]
        value, reach = _with_interval(scores, "accuracy", 100.0)
        axes.bar(
            np.arange(len(estimators)) + (number - (len(columns) - 1) / 2.0) * width,
            value,
            0.92 * width,
            yerr=reach,
            label="all contacts" if section == "all" else group,
            color=("#2b2b2b", "#6b6b6b", "#a3a3a3", "#d2d2d2")[number],
            error_kw={"linewidth": 0.9, "capsize": 2, "ecolor": "#d00000"},
        )
    axes.set_ylabel("accuracy (%)")
    axes.axhline(0.0, color="black", linewidth=0.8)
    return _finish(figure, axes, [_label(name) for name in estimators])


def decoded_against_true(decoded: DecodedContacts) -> bytes:
    """Draw decoded against true force, a panel for each estimator; the line marks equality."""
    names = list(decoded.decoded_N)
    across = min(3, len(names))
    rows = -(-len(names) // across)
    figure = new_figure((2.9 * across + 0.3, 2.9 * rows + 0.2))
    on = decoded.tripped
    truth = decoded.force_N[on]
    top = 1.05 * float(truth.max())
    for number, name in enumerate(names):
        axes = figure.add_subplot(rows, across, number + 1)
        estimate = decoded.decoded_N[name][on]
        # Values outside are drawn at the edge and counted.
        inside = np.clip(estimate, -0.25 * top, 1.5 * top)
        outside = inside != estimate
        axes.plot([0.0, top], [0.0, top], color="black", linewidth=0.8, zorder=3)
        axes.scatter(truth, inside, s=5, color=PAINT[number % len(PAINT)], alpha=0.5, linewidths=0)
        edge = {"s": 12, "marker": "x", "color": "#d00000", "linewidths": 0.7}
        axes.scatter(truth[outside], inside[outside], **edge)
        count = f" ({int(outside.sum())} outside)" if outside.any() else ""
        axes.set_title(_label(name) + count, fontsize=10.0)
        axes.set(xlim=(0.0, top), ylim=(-0.3 * top, 1.55 * top))
        axes.grid(alpha=0.3)
        if number % across == 0:
            axes.set_ylabel("decoded force (N)")
        if number >= len(names) - across:
            axes.set_xlabel("true force (N)")
    return png(figure)


def relative_error(facts: Mapping[str, Any]) -> bytes:
    """Draw the mean relative error by range of force, with intervals (paper, fig. 3D)."""
    estimators = facts["estimators"]
    figure, axes = _axes(3.6)
    names = list(next(iter(estimators.values()))["force"])
    shown: list[float] = []
    for number, (name, item) in enumerate(estimators.items()):
        scores = [item["force"][group] for group in names]
        value, reach = _with_interval(scores, "relative_error", 100.0)
        shown += value.tolist()
        axes.errorbar(
            np.arange(len(names)) + 0.06 * (number - (len(estimators) - 1) / 2.0),
            value,
            yerr=reach,
            label=_label(name),
            color=PAINT[number % len(PAINT)],
            marker="o",
            markersize=4,
            linewidth=1.3,
            capsize=2,
        )
    if _needs_log_axis(shown):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set(xlabel="true force of the contact (N)", ylabel="mean relative error (%)")
    return _finish(figure, axes, [name.removesuffix(" N") for name in names], rotation=20)


def absolute_error(facts: Mapping[str, Any]) -> bytes:
    """Draw mean and standard deviation of the absolute error, by force (paper, fig. 3E)."""
    estimators = facts["estimators"]
    figure, axes = _axes(3.6)
    names = list(next(iter(estimators.values()))["force"])
    columns = [("all", "all"), *(("force", name) for name in names)]
    width = 0.8 / len(estimators)
    shown: list[float] = []
    for number, (name, item) in enumerate(estimators.items()):
        groups = [item[section][group] for section, group in columns]
        mean, _ = _with_interval(groups, "absolute_error_mean_N", 1.0)
        spread, _ = _with_interval(groups, "absolute_error_sd_N", 1.0)
        shown += mean.tolist()
        at = np.arange(len(columns)) + (number - (len(estimators) - 1) / 2.0) * width
        axes.bar(at, mean, 0.92 * width, color=PAINT[number % len(PAINT)], label=_label(name))
        # Only upwards: below the mean there is little room, and none on a logarithmic axis.
        bars = np.stack([np.zeros(len(mean)), spread])
        style = {"fmt": "none", "ecolor": "black", "elinewidth": 0.8, "capsize": 2}
        axes.errorbar(at, mean, yerr=bars, **style)
    if _needs_log_axis(shown):
        axes.set_yscale("log")
    axes.set(xlabel="true force of the contact (N)", ylabel="absolute error: mean, + SD (N)")
    labels = ["all", *(name.removesuffix(" N") for name in names)]
    return _finish(figure, axes, labels, rotation=20)
