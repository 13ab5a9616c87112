"""report.html: one self-contained page that opens from disk."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 60rem; padding: 1rem;
       color: #1a1a1a; background: #fff; }
h1 { margin-bottom: 0; } h2 { margin-top: 2rem; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; margin: 0.5rem 0; display: block; overflow-x: auto; }
th, td { border: 1px solid #ccc; padding: 0.2rem 0.6rem; text-align: right; }
th:first-child, td:first-child { text-align: left; }
img { max-width: 100%; height: auto; }
figure { margin: 0.5rem 0; } figcaption { color: #555; font-size: 0.9rem; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(20rem, 1fr)); gap: 1rem; }
.verdict { font-size: 1.15rem; padding: 0.6rem 1rem; border-left: 6px solid #18863a;
           background: #eef8f0; }
.bad { border-color: #b3261e; background: #fbeeed; }
.note { background: #fff8e1; padding: 0.4rem 1rem; border-left: 6px solid #c08a00; }
@media print { body { max-width: none; } h2 { break-after: avoid; } }
"""


def number(value: Any) -> str:
    """Figure as people write it: four significant digits, integers whole."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    return escape(str(value))


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """HTML table; the first cell of each row is its heading."""
    top = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    body = "".join(
        f'<tr><th scope="row">{escape(str(row[0]))}</th>'
        + "".join(f"<td>{number(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def facts(values: Mapping[str, Any]) -> str:
    """Two-column table of names and figures; nested tables are flattened with dots."""
    return table(("figure", "value"), list(flatten(values).items()))


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


def figure(data: bytes, caption: str, kind: str = "png") -> str:
    """Inline image with a caption that is also its alternative text."""
    source = b64encode(data).decode()
    text = escape(caption)
    return (
        f'<figure><img alt="{text}" src="data:image/{kind};base64,{source}">'
        f"<figcaption>{text}</figcaption></figure>"
    )


def page(title: str, sections: Sequence[tuple[str, str]], lead: str) -> str:
    """Whole page from sections (heading, HTML)."""
    body = "".join(f"<section><h2>{escape(head)}</h2>{html}</section>" for head, html in sections)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>"
        f"<body><h1>{escape(title)}</h1>{lead}{body}</body></html>\n"
    )


def score_table(scores: Mapping[str, Mapping[str, Any]]) -> str:
    """Estimators side by side."""
    head = (
        "estimator",
        "relative error %",
        "MAE N",
        "SD N",
        "below 5 N %",
        "from 5 N %",
        "single %",
        "multi %",
        "middle %",
        "near rims %",
        "contacts",
    )
    groups = ("below_5N", "from_5N", "single", "multi", "middle", "near_rims")
    rows = [
        (
            name,
            100.0 * item["relative_error"],
            item["mae_N"],
            item["sd_N"],
            *(100.0 * item[group]["relative_error"] for group in groups),
            item["samples"],
        )
        for name, item in scores.items()
    ]
    return table(head, rows)
