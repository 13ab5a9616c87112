"""Pictures of an evaluation, after the paper's figures 3C to 3E."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.report.figures import new_figure, png
from phytac_design.training.evaluation.decoded_contacts import DecodedContacts

PAINT = ("#7a7a7a", "#1b6ca8", "#6fb1dd", "#e08a1e", "#b03060", "#2e8b57")
"""One colour for each estimator, told apart also in grey and by the colour-blind."""
GREYS = ("#2b2b2b", "#6b6b6b", "#a3a3a3", "#d2d2d2")
RANGE_DECADES = 1.3
"""Errors that span more than this are drawn on a logarithmic axis."""
ACROSS = 3


def draw(facts: Mapping[str, Any], decoded: DecodedContacts) -> dict[str, bytes]:
    """All pictures (PNG) by file name."""
    return {
        "accuracy.png": accuracy(facts),
        "decoded.png": decoded_against_true(decoded),
        "relative_error.png": relative_error(facts),
        "absolute_error.png": absolute_error(facts),
    }


def _label(name: str) -> str:
    return name.replace("_", " ")


def _axes(size: tuple[float, float]) -> tuple[Any, Any]:
    figure = new_figure(size)
    axes = figure.add_subplot()
    axes.grid(axis="y", alpha=0.3)
    return figure, axes


def _reach(measure: Mapping[str, float | None], factor: float) -> tuple[float, float, float]:
    """A value, and how far its interval reaches below and above it; NaN if there is none."""
    value = measure["value"]
    at = np.nan if value is None else factor * value
    low, high = measure["low"], measure["high"]
    if low is None or high is None:
        return at, 0.0, 0.0
    return at, max(at - factor * low, 0.0), max(factor * high - at, 0.0)


def _reaches(
    groups: Mapping[str, Any], names: list[str], measure: str, factor: float
) -> tuple[Any, Any]:
    """Values (g,) and reaches (2, g) of a measure in some groups."""
    rows = np.array([_reach(groups[name][measure], factor) for name in names])
    return rows[:, 0], rows[:, 1:].T


def _wide(values: list[float]) -> bool:
    """Whether values are spread so far that only a logarithmic axis shows them all."""
    some = [value for value in values if np.isfinite(value) and value > 0.0]
    return bool(some) and np.log10(max(some) / min(some)) > RANGE_DECADES


def accuracy(facts: Mapping[str, Any]) -> bytes:
    """Accuracy of each estimator over all contacts, and by kind of contact (paper, fig. 3C)."""
    estimators = facts["estimators"]
    figure, axes = _axes((6.4, 3.4))
    place = np.arange(len(estimators))
    first = next(iter(estimators.values()))
    columns = [("all", "all")] + [("contact", name) for name in first["contact"]]
    width = 0.8 / len(columns)
    for number, (section, group) in enumerate(columns):
        rows = np.array(
            [_reach(item[section][group]["accuracy"], 100.0) for item in estimators.values()]
        )
        shift = (number - (len(columns) - 1) / 2.0) * width
        label = "all contacts" if section == "all" else group
        axes.bar(
            place + shift,
            rows[:, 0],
            0.92 * width,
            yerr=rows[:, 1:].T,
            label=label,
            color=GREYS[number],
            error_kw={"linewidth": 0.9, "capsize": 2, "ecolor": "#d00000"},
        )
    axes.set_xticks(place, [_label(name) for name in estimators])
    axes.set_ylabel("accuracy (%)")
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    return png(figure)


def decoded_against_true(decoded: DecodedContacts) -> bytes:
    """A dot for each contact, a panel for each estimator; the line is where both are equal."""
    names = list(decoded.decoded_N)
    across = min(ACROSS, len(names))
    rows = -(-len(names) // across)
    figure = new_figure((2.9 * across + 0.3, 2.9 * rows + 0.2))
    on = decoded.tripped
    truth = decoded.force_N[on]
    top = 1.05 * float(truth.max())
    for number, name in enumerate(names):
        axes = figure.add_subplot(rows, across, number + 1)
        estimate = decoded.decoded_N[name][on]
        # What lies outside is drawn at the edge and counted, so that the rest can be seen.
        inside = np.clip(estimate, -0.25 * top, 1.5 * top)
        outside = inside != estimate
        axes.plot([0.0, top], [0.0, top], color="black", linewidth=0.8, zorder=3)
        axes.scatter(truth, inside, s=5, color=PAINT[number % len(PAINT)], alpha=0.5, linewidths=0)
        edge = {"s": 12, "marker": "x", "color": "#d00000", "linewidths": 0.7}
        axes.scatter(truth[outside], inside[outside], **edge)
        said = f" ({int(outside.sum())} outside)" if outside.any() else ""
        axes.set_title(_label(name) + said, fontsize=10.0)
        axes.set(xlim=(0.0, top), ylim=(-0.3 * top, 1.55 * top))
        axes.grid(alpha=0.3)
        if number % across == 0:
            axes.set_ylabel("decoded force (N)")
        if number >= len(names) - across:
            axes.set_xlabel("true force (N)")
    return png(figure)


def relative_error(facts: Mapping[str, Any]) -> bytes:
    """Mean relative error by range of force, with intervals (paper, fig. 3D)."""
    estimators = facts["estimators"]
    figure, axes = _axes((6.4, 3.6))
    names = list(next(iter(estimators.values()))["force"])
    place = np.arange(len(names))
    shown: list[float] = []
    for number, (name, item) in enumerate(estimators.items()):
        value, reach = _reaches(item["force"], names, "relative_error", 100.0)
        shown += value.tolist()
        axes.errorbar(
            place + 0.06 * (number - (len(estimators) - 1) / 2.0),
            value,
            yerr=reach,
            label=_label(name),
            color=PAINT[number % len(PAINT)],
            marker="o",
            markersize=4,
            linewidth=1.3,
            capsize=2,
        )
    if _wide(shown):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set_xticks(place, [name.removesuffix(" N") for name in names], rotation=20)
    axes.set(xlabel="true force of the contact (N)", ylabel="mean relative error (%)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    return png(figure)


def absolute_error(facts: Mapping[str, Any]) -> bytes:
    """Mean and standard deviation of the absolute error, by force (paper, fig. 3E)."""
    estimators = facts["estimators"]
    figure, axes = _axes((6.4, 3.6))
    names = list(next(iter(estimators.values()))["force"])
    columns = [("all", "all"), *(("force", name) for name in names)]
    place = np.arange(len(columns))
    width = 0.8 / len(estimators)
    shown: list[float] = []
    for number, (name, item) in enumerate(estimators.items()):
        groups = [item[section][group] for section, group in columns]
        mean = np.array([group["absolute_error_mean_N"]["value"] for group in groups])
        spread = np.array([group["absolute_error_sd_N"]["value"] for group in groups])
        shown += mean.tolist()
        at = place + (number - (len(estimators) - 1) / 2.0) * width
        axes.bar(at, mean, 0.92 * width, color=PAINT[number % len(PAINT)], label=_label(name))
        # Only upwards: below the mean of a size there is little room, and none on a log axis.
        axes.errorbar(
            at,
            mean,
            yerr=np.stack([np.zeros(len(mean)), spread]),
            fmt="none",
            ecolor="black",
            elinewidth=0.8,
            capsize=2,
        )
    if _wide(shown):
        axes.set_yscale("log")
    labels = ["all", *(name.removesuffix(" N") for name in names)]
    axes.set_xticks(place, labels, rotation=20)
    axes.set(xlabel="true force of the contact (N)", ylabel="absolute error: mean, + SD (N)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    return png(figure)
