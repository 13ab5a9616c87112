"""An evaluation as a table of contacts (CSV) and as Markdown tables."""

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from phytac_design.datasets.samples import Samples
from phytac_design.training.evaluation.decoded_contacts import DecodedContacts
from phytac_design.training.evaluation.groups import ContactPositions
from phytac_design.training.evaluation.interval_scores import intervals_text

COLUMNS = (
    "sample", "contact", "kind", "x_mm", "y_mm", "z_mm", "along", "around", "radius_mm", "tripped",
    "read", "force_N", "estimator", "decoded_N", "error_N", "relative_error",
)  # fmt: skip
COLUMNS_MD = (
    ("accuracy (%)", "accuracy", 100.0, 1),
    ("relative error (%)", "relative_error", 100.0, 1),
    ("median (%)", "relative_error_median", 100.0, 1),
    ("absolute error (N)", "absolute_error_mean_N", 1.0, 3),
    ("SD (N)", "absolute_error_sd_N", 1.0, 3),
    ("RMSE (N)", "rmse_N", 1.0, 3),
    ("bias (N)", "bias_N", 1.0, 3),
)
"""Title, measure, factor and digits."""
SECTIONS = {
    "contact": "Single contacts, several at once, grips",
    "small": "Below and from 5 N",
    "force": "By force",
    "height": "By height along the sensor",
    "along": "By height, in tenths of the length",
    "around": "By side, in eighths of the way around",
    "data": "By data set",
}


def contacts_csv(
    samples: Samples, decoded: DecodedContacts, where: ContactPositions | None, kind: Sequence[str]
) -> str:
    """Return one line for every contact and estimator; missing values are empty."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    touches = samples.touches
    for row, touch in enumerate(decoded.touch.tolist()):
        point = touches.point_mm[touch] if touches is not None else np.full(3, np.nan)
        radius = touches.radius_mm[touch] if touches is not None else np.nan
        share = (where.along[row], where.around[row]) if where is not None else (np.nan, np.nan)
        tripped, force = bool(decoded.tripped[row]), float(decoded.force_N[row])
        fixed = [
            int(decoded.sample[row]), touch, kind[row], *map(_short, (*point, *share, radius)),
            int(tripped), int(decoded.read[row]), _short(force),
        ]  # fmt: skip
        for name, estimate in decoded.decoded_N.items():
            value = float(estimate[row])
            found = (value, value - force, (value - force) / force) if tripped else (np.nan,) * 3
            writer.writerow([*fixed, name, *map(_short, found)])
    return buffer.getvalue()


def _short(value: float) -> str:
    return f"{value:.6g}" if np.isfinite(value) else ""


def tables_md(facts: Mapping[str, Any]) -> str:
    """Return the figures of ``evaluation.json`` as tables."""
    level = 100.0 * facts["bootstrap"]["level"]
    samples, contacts, switches = facts["samples"], facts["contacts"], facts["switches"]
    simulated = all(item["simulated"] for item in facts["data"])
    theories = ", ".join(f"{n} {name}" for name, n in facts["theories"].items() if n)
    lines = [
        f"# Forces of {facts['design']}, {'in simulation' if simulated else 'measured'}",
        "",
        *(f"- {item['what']}, {item['samples']} samples" for item in facts["data"]),
        (
            f"- {samples['judged']} samples evaluated ({samples['flagged']} of them flagged; "
            f"{theories}), {samples['failed']} that failed left out"
        ),
        (
            f"- {contacts['judged']} contacts evaluated ({contacts['all_switches_missed']} of them "
            f"with every switch missed), {_unseen(contacts)}"
        ),
    ]
    if switches is not None:
        lines.append(
            f"- switches: {switches['missed']} of {switches['on']} that were on were missed, "
            f"{switches['false']} of {switches['off']} that were off were read as on"
        )
    legend = (
        f"In brackets: {level:g} % intervals by the bootstrap over samples. Accuracy is 1 − mean "
        "of |error| / force. SD is that of the absolute error."
    )
    lines += ["", legend]
    lines += _table("All contacts", facts["estimators"], "all")
    for section, title in SECTIONS.items():
        lines += _table(title, facts["estimators"], section)
    lines += ["", "## Force decoded where no contact presses", ""]
    lines += ["| estimator | mean (N) | largest (N) |", "|---|---|---|"]
    lines += [
        f"| {name} | {item['elsewhere_N']['mean']:.3f} | {item['elsewhere_N']['largest']:.3f} |"
        for name, item in facts["estimators"].items()
    ]
    if facts["intervals"]:
        lines += ["", "## Standard deviations", "", f"{intervals_text(facts['intervals'])}."]
        lines += [_matched_text(facts["intervals"])]
    return "\n".join(lines) + "\n"


def _matched_text(scores: Mapping[str, Any]) -> str:
    share = scores["within_95"]["value"]
    return (
        f"95 % intervals hold {100.0 * share:.0f} %; the median standard deviation is "
        f"{scores['sd_N']:.3g} N. {scores['unmatched']} contacts with a switch that was read have "
        "no match: not found, found as two, or together with another."
    )


def _unseen(contacts: Mapping[str, Any]) -> str:
    count = contacts["tripped_none"]
    if not count:
        return "none that tripped no switch"
    median, largest = (contacts[f"tripped_none_force_N_{name}"] for name in ("median", "largest"))
    return (
        f"{count} that tripped no switch left out (median {median:.2f} N, largest {largest:.2f} N)"
    )


def _table(title: str, estimators: Mapping[str, Any], section: str) -> list[str]:
    """Return one table: groups by estimator."""
    groups = list(next(iter(estimators.values())).get(section, {}))
    if not groups:
        return []
    titles = ["group", "estimator", "contacts", *(title for title, *_ in COLUMNS_MD)]
    head = [f"| {' | '.join(titles)} |", "|---" * len(titles) + "|"]
    lines = ["", f"## {title}", "", *head]
    for group in groups:
        for name, sections in estimators.items():
            score = sections[section][group]
            cells = [
                _cell(score[measure], factor, digits) for _, measure, factor, digits in COLUMNS_MD
            ]
            lines.append(f"| {group} | {name} | {score['contacts']} | {' | '.join(cells)} |")
    return lines


def _cell(measure: Mapping[str, float | None], factor: float, digits: int) -> str:
    """Return a value with its interval."""
    value, low, high = (measure[key] for key in ("value", "low", "high"))
    if value is None:
        return "–"
    if low is None or high is None:
        return f"{factor * value:.{digits}f}"
    return f"{factor * value:.{digits}f} [{factor * low:.{digits}f}, {factor * high:.{digits}f}]"
