"""Tables of estimators, with footnotes from the limits of the sensor."""

from collections.abc import Mapping, Sequence
from typing import Any

from phytac_design.core import html as page

STIFFNESS = ("fem", "fem_nn", "fem_nn_identity")
"""Estimators that use K·u."""
GROUPS = ("below_5N", "from_5N", "single", "multi", "middle", "near_rims")


def marks_of(limits: Mapping[str, Any], names: Sequence[str]) -> dict[str, str]:
    """Footnote signs of estimators: † where K·u is noise, ‡ where no force can be read."""
    out = {}
    for name in names:
        noisy = name in STIFFNESS and limits["fem_unusable_count"]
        out[name] = ("†" if noisy else "") + ("‡" if limits["force_unreadable"] else "")
    return out


def score_table(
    scores: Mapping[str, Mapping[str, Any]], limits: Mapping[str, Any], count: int
) -> str:
    """Estimators side by side, with footnotes.

    Parameters
    ----------
    scores : mapping
        ``decoder``, ``decoder_anywhere`` or ``decoder_frames`` of the report.
    limits : mapping
        ``limit_figures`` of the report.
    count : int
        Markers of the sensor.
    """
    weak_share = 0.1  # rows are greyed where an estimator is of no use at so many of the markers
    head = (
        "estimator",
        "relative error (%)",
        "absolute error (N)",
        "SD (N)",
        "below 5 N (%)",
        "from 5 N (%)",
        "single (%)",
        "multi (%)",
        "middle (%)",
        "near rims (%)",
        "contacts",
    )
    marks = marks_of(limits, list(scores))
    rows = [
        (
            name + marks[name],
            _percent(item),
            item["mae_N"],
            item["sd_N"],
            *(_percent(item[group]) for group in GROUPS),
            item["samples"],
        )
        for name, item in scores.items()
    ]
    faint, unread = limits["fem_unusable_count"], len(limits["force_unreadable"])
    weak = [
        unread >= weak_share * count or (name in STIFFNESS and faint >= weak_share * count)
        for name in scores
    ]
    notes = []
    if faint:
        notes.append(
            f"† At {faint} of {count} markers K·u cannot separate a force from noise (median over "
            f"all markers: {page.number(limits['fem_noise_N_median'])} N): use koi_inverse."
        )
    if unread:
        notes.append(f"‡ Forces on {unread} of {count} markers cannot be read by any estimator.")
    if any(page.missing(value) for row in rows for value in row):
        notes.append(f"{page.DASH}: no such contacts among these.")
    return page.table(head, rows, weak) + "".join(f'<p class="foot">{note}</p>' for note in notes)


def _percent(score: Mapping[str, Any]) -> float | None:
    error = score["relative_error"]
    return None if page.missing(error) else 100.0 * float(error)
