"""report.html: one self-contained page that opens from disk."""

import re
from base64 import b64decode
from collections.abc import Mapping, Sequence
from html import escape, unescape
from typing import Any

from phytac_design.core.html import (
    DASH,
    STYLE,
    Html,
    cell,
    figure,
    image,
    missing,
    number,
    page,
    slug,
    svg_figure,
    table,
)
from phytac_design.report.figure_names import absent_why, name_of, place_of

__all__ = [
    "DASH",
    "STYLE",
    "Html",
    "cell",
    "details",
    "facts",
    "figure",
    "flatten",
    "image",
    "images_of",
    "missing",
    "number",
    "page",
    "side_by_side",
    "slug",
    "svg_figure",
    "table",
]


def facts(values: Mapping[str, Any], section: str = "") -> str:
    """Two-column table of names and figures of one section of ``report.json``.

    Missing figures are a dash, with the reason if it is known. The path in ``report.json`` is the
    name's tooltip. Lists of records follow as separate tables.
    """
    rows, records = [], []
    flat = flatten(values, f"{section}." if section else "")
    for path in sorted(flat, key=place_of):
        value = flat[path]
        if isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
            records.append(_records(path, value))
            continue
        why = absent_why(path) if missing(value) else ""
        shown = f'<td class="text">{DASH} ({escape(why)})</td>' if why else cell(value)
        name = f'<th scope="row" title="{escape(path)}">{escape(name_of(path))}</th>'
        rows.append(f"<tr>{name}{shown}</tr>")
    head = '<tr><th scope="col">figure</th><th scope="col">value</th></tr>'
    return (
        f'<table class="facts"><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table>'
        + "".join(records)
    )


def _records(path: str, items: Sequence[Mapping[str, Any]]) -> str:
    """Table of records, a column for each of their keys."""
    flat = [flatten(item) for item in items]
    found = dict.fromkeys(key for item in flat for key in item)
    keys = sorted(found, key=lambda key: place_of(f"{path}.{key}"))
    head = [name_of(f"{path}.{key}").removeprefix(f"{path}.") for key in keys]
    body = table(head, [[item.get(key) for key in keys] for item in flat])
    name = name_of(path)
    return f"<p>{escape(name[:1].upper() + name[1:])}:</p>{body}"


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one with dotted keys."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            out |= flatten(value, f"{name}.")
        else:
            out[name] = value
    return out


def images_of(html: str) -> dict[str, bytes]:
    """Return the named images of a page, by file name."""
    found = re.findall(r'<img [^>]*?data-file="([^"]+)"[^>]*? src="data:[^,]+,([^"]*)"', html)
    return {unescape(name): b64decode(source) for name, source in found}


def side_by_side(*parts: str) -> str:
    """Figures side by side where there is room."""
    return f'<div class="pair">{"".join(parts)}</div>'


def details(summary: str, html: str) -> str:
    """HTML that is shown when its summary is clicked, and in print."""
    return f"<details><summary>{escape(summary)}</summary>{html}</details>"
