"""The scripts and the style of the viewer, as text to go into a page."""

import json
from collections.abc import Mapping
from importlib import resources
from typing import Any

SCRIPTS = ("three.bundle.min.js", "colours.js", "viewer.js", "map.js", "explorer.js")
"""In the order that they need each other."""


def text_of(name: str) -> str:
    """One file of this folder."""
    folder = resources.files("phytac_design") / "report" / "viewer"
    return (folder / name).read_text(encoding="utf-8")


def script_tags() -> str:
    """The scripts of a report, inline; the last one starts the others."""
    return "".join(f"<script>{text_of(name)}</script>" for name in (*SCRIPTS, "page.js"))


def style() -> str:
    """CSS of the viewer's parts."""
    return text_of("viewer.css")


def data_tag(name: str, data: Mapping[str, Any]) -> str:
    """Data as JSON that no browser takes for markup; scripts find it by its id."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    text = text.replace("<", "\\u003c")
    return f'<script type="application/json" id="{name}">{text}</script>'
