"""Self-contained HTML pages: style, tables, figures; a page opens from disk and fetches nothing."""

import math
import re
from base64 import b64decode, b64encode
from collections.abc import Mapping, Sequence
from html import escape, unescape
from importlib import resources
from typing import Any

STYLE = (resources.files("phytac_design.core") / "page.css").read_text(encoding="utf-8")
DASH = "–"


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def missing(value: Any) -> bool:
    """Whether a figure does not exist: None, NaN, infinite, or an empty text."""
    if isinstance(value, float):
        return not math.isfinite(value)
    return value is None or value == ""


def number(value: Any) -> str:
    """Figure as people write it: four significant digits, integers whole, a dash for none."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if missing(value):
        return DASH
    if isinstance(value, float):
        if value != 0.0 and abs(value) < 1e-3:
            return f"{value:.2g}"
        return f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
    if isinstance(value, list | tuple):
        shown = 12
        inner = any(isinstance(item, list | tuple) for item in value)
        more = f" … ({len(value)})" if len(value) > shown else ""
        return (("; " if inner else ", ").join(map(number, value[:shown])) or "none") + more
    return escape(str(value))


def cell(value: Any) -> str:
    """One cell of a table; words to the left, figures to the right."""
    if isinstance(value, Html):
        return f"<td>{value}</td>"
    words = isinstance(value, str) and not missing(value)
    return f'<td class="text">{number(value)}</td>' if words else f"<td>{number(value)}</td>"


def table(head: Sequence[str], rows: Sequence[Sequence[Any]], weak: Sequence[bool] = ()) -> str:
    """HTML table; the first cell of each row is its heading. ``weak`` rows are greyed."""
    grey = [*weak, *[False] * (len(rows) - len(weak))]
    top = "".join(f'<th scope="col">{escape(item)}</th>' for item in head)
    body = "".join(
        f'<tr{" class=weak" if faint else ""}><th scope="row">{number(row[0])}</th>'
        + "".join(cell(item) for item in row[1:])
        + "</tr>"
        for row, faint in zip(rows, grey, strict=True)
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def figure(data: bytes, caption: str, kind: str = "png", *, name: str = "") -> str:
    """Inline image with a caption that is also its alternative text; ``name``: :func:`image`."""
    shown = image(data, caption, kind, name=name)
    return f"<figure>{shown}<figcaption>{escape(caption)}</figcaption></figure>"


def image(data: bytes, text: str, kind: str = "png", *, name: str = "", extra: str = "") -> str:
    """Inline image with its alternative text.

    ``name`` is that of the file which :func:`images_of` makes of it, "" for none; ``extra`` are
    further attributes.
    """
    file = f' data-file="{escape(name)}"' if name else ""
    source = f"data:image/{kind};base64,{b64encode(data).decode()}"
    return f'<img alt="{escape(text)}"{file}{extra} src="{source}">'


def svg_figure(svg: str, caption: str) -> str:
    """Inline SVG that shrinks with the page, and its caption."""
    size = re.search(r'<svg [^>]*?width="([\d.]+)" height="([\d.]+)"', svg)
    if size and "viewBox" not in svg:
        svg = svg.replace("<svg ", f'<svg viewBox="0 0 {size[1]} {size[2]}" ', 1)
    return f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>"


def page(
    title: str, sections: Sequence[tuple[str, str]], lead: str, *, style: str = "", tail: str = ""
) -> str:
    """Whole page from sections (heading, HTML).

    Parameters
    ----------
    style : str
        CSS beside the page's own.
    tail : str
        Data and scripts at its end; pages without any run none. With them come links to the
        sections, as such pages are long.
    """
    body = "".join(
        f'<section id="{slug(head)}"><h2>{escape(head)}</h2>{html}</section>'
        for head, html in sections
    )
    links = "".join(f'<a href="#{slug(head)}">{escape(head)}</a>' for head, _ in sections)
    contents = f'<nav class="contents" aria-label="Sections">{links}</nav>' if tail else ""
    # It fetches nothing.
    policy = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src " + (
        "'unsafe-inline'" if tail else "'none'"
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}{style}</style></head>"
        f"<body><header><h1>{escape(title)}</h1></header><main>{lead}{contents}{body}</main>"
        f"{tail}</body></html>\n"
    )


def slug(head: str) -> str:
    """Heading as a name for links."""
    return re.sub(r"[^a-z0-9]+", "-", head.lower()).strip("-")


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
