"""Changes that the stages recommend, collected for the verdict."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from phytac_design.engine.stage import Context

SHOWN = 6
"""Broken print rules that are listed, the most frequent first."""


def changes_of(context: Context, reasons: Sequence[str]) -> list[str]:
    """Sentences without a full stop, each a problem and its remedy.

    Parameters
    ----------
    reasons : list of str
        Why stages would stop a build that is not forced.
    """
    return [
        *reasons,
        *_under_load(context.facts("underload"), reasons),
        *_printing(context.facts("printing")),
        *_switches(context.facts("switch")),
    ]


def _under_load(load: Mapping[str, Any], reasons: Sequence[str]) -> list[str]:
    """Remedy for a marker that is lost under load, unless the design's demand names it already."""
    first = load["first_force_N"]
    if first is None or any("under load" in reason for reason in reasons):
        return []
    text = (
        f"from {first:.3g} N on a marker hides or fuses: space the markers wider, use more pixels "
        "or a thicker wall, or keep below that force (demands.clear_force_N makes a build insist)"
    )
    return [text]


def _printing(facts: Mapping[str, Any]) -> list[str]:
    """Print rules that are broken, those with the same remedy together."""
    found: Counter[tuple[str, str, str]] = Counter()
    first: dict[tuple[str, str, str], Mapping[str, Any]] = {}
    for file, part in facts["files"].items():
        for item in part["violations"]:
            # Figures differ from place to place, words do not.
            key = (file, item["rule"], re.sub(r"[-+.\d]*\d", "", item["fix"]))
            found[key] += 1
            first.setdefault(key, item)
    out = []
    for key, count in found.most_common(SHOWN):
        file, rule, _ = key
        item = first[key]
        where = f"1 place of {file} breaks" if count == 1 else f"{count} places of {file} break"
        out.append(
            f"{where} the print rule {rule} (such as {item['measured']:.3g} {item['unit']}, "
            f"required {item['asked']:.3g} {item['unit']}): {item['fix']}"
        )
    if len(found) > SHOWN:
        out.append(f"{len(found) - SHOWN} more kinds are in shell/print_report.json")
    return out


def _switches(facts: Mapping[str, Any]) -> list[str]:
    """Warnings before casting, each once; the page lists assumptions separately."""
    warnings = dict.fromkeys(
        text
        for item in facts.get("switches", ())
        for text in item.get("warnings", ())
        if not text.startswith("assumed")
    )
    return list(warnings)
