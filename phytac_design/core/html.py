"""Self-contained HTML pages: style, tables, figures; a page opens from disk and fetches nothing."""

import math
import re
from base64 import b64encode
from collections.abc import Sequence
from html import escape
from typing import Any

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 68rem; padding: 1rem;
       color: #1a1a1a; background: #fff; overflow-wrap: break-word; }
h1 { margin-bottom: 0; line-height: 1.2; }
h2 { margin-top: 2rem; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; margin: 0.5rem 0; display: block; overflow-x: auto; }
th, td { border: 1px solid #ccc; padding: 0.2rem 0.6rem; text-align: right; vertical-align: top; }
th { font-weight: 600; } tbody th { font-weight: 400; }
th:first-child, td:first-child, td.text, .facts td, .facts th { text-align: left; }
tr.weak th, tr.weak td { color: #595959; background: #f5f5f5; }
img, svg { max-width: 100%; height: auto; }
figure { margin: 0.5rem 0; min-width: 0; } figcaption { color: #555; font-size: 0.9em; }
.pair { display: grid; gap: 1rem; align-items: start;
        grid-template-columns: repeat(auto-fit, minmax(min(20rem, 100%), 1fr)); }
.verdict { font-size: 1.1rem; padding: 0.6rem 1rem; border-left: 6px solid #18863a;
           background: #eef8f0; }
.verdict p { margin: 0; } .verdict ul { margin: 0.4rem 0 0; padding: 0; list-style: none;
           font-size: 1rem; }
.verdict h2 { margin: 0; border: 0; font-size: 1.15rem; }
.verdict li { padding-left: 1.6rem; text-indent: -1.6rem; }
.verdict li::before { display: inline-block; width: 1.6rem; text-indent: 0; font-weight: 700; }
li.good::before { content: "✓"; color: #18863a; } li.odd::before { content: "!"; color: #9a6b00; }
li.bad::before { content: "✗"; color: #b3261e; }
.verdict.odd { border-color: #c08a00; background: #fff8e1; }
.verdict.bad { border-color: #b3261e; background: #fbeeed; }
.answers { display: grid; gap: 0.8rem; margin: 0.8rem 0;
           grid-template-columns: repeat(auto-fit, minmax(min(24rem, 100%), 1fr)); }
.answers .verdict { font-size: 1rem; }
.contents { font-size: 0.95em; } .contents a { margin-right: 0.9em; white-space: nowrap;
           display: inline-block; padding: 0.15rem 0; }
.foot { color: #555; font-size: 0.9em; margin-top: 0; }
.note { background: #f3f3f3; padding: 0.4rem 1rem; border-left: 6px solid #999; }
.bar { display: inline-block; height: 0.7em; background: #1b6ca8; }
pre { overflow: auto; max-height: 30rem; background: #f7f7f7; padding: 0.6rem; font-size: 0.85em; }
details { margin: 0.5rem 0; } summary { cursor: pointer; padding: 0.3rem 0; }
.press input { vertical-align: middle; width: min(20rem, 60%); }
.press img { display: none; } .press img.ends { display: block; }
.press.live img { display: none; } .press.live img.on { display: block; }
@media (max-width: 30rem) { body { padding: 0.6rem; } table { font-size: 0.85rem; }
  th, td { padding: 0.2rem 0.35rem; } }
@media print { body { max-width: none; font-size: 11px; padding: 0; }
  h2 { break-after: avoid; } figure, tr, .verdict { break-inside: avoid; }
  table { display: table; font-size: 9px; } .verdict, .answers .verdict, li { font-size: 11px; }
  .pair, .answers { grid-template-columns: 1fr 1fr; }
  .contents, .press .controls { display: none; }
  details::details-content { content-visibility: visible; display: block; }
  .press.live img.on { display: none; } .press.live img.ends { display: block; }
  pre { max-height: none; white-space: pre-wrap; font-size: 8px; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
"""
POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src {}"
"""Content security: a page fetches nothing."""
DASH = "–"
SHOWN = 12
"""Items of a list that are shown."""
SMALL = 1e-3
LARGE = 1e4


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
        if value != 0.0 and abs(value) < SMALL:
            return f"{value:.2g}"
        return f"{value:.0f}" if abs(value) >= LARGE else f"{value:.4g}"
    if isinstance(value, list | tuple):
        inner = any(isinstance(item, list | tuple) for item in value)
        more = f" … ({len(value)})" if len(value) > SHOWN else ""
        return (("; " if inner else ", ").join(map(number, value[:SHOWN])) or "none") + more
    return escape(str(value))


def cell(value: Any) -> str:
    """One cell of a table; words to the left, figures to the right."""
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


def drawing(svg: str, caption: str) -> str:
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
    policy = POLICY.format("'unsafe-inline'" if tail else "'none'")
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
