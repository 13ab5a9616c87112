"""Section of the threshold switches: the bowls that the build designed."""

from collections.abc import Mapping
from html import escape
from typing import Any

from phytac_design.engine.stage import EXPORT, Context
from phytac_design.report import page
from phytac_design.report.verdict import sentence

ROWS = {
    "threshold_N": "threshold asked (N)",
    "limit_N": "threshold of the bowl (N)",
    "spread.low_N": "least of a batch (N)",
    "spread.high_N": "greatest of a batch (N)",
    "valley_N": "force once it has snapped (N)",
    "travel_mm": "travel of the snap (mm)",
    "visible_mm": "tip shows, when out (mm)",
    "strain": "greatest strain",
    "bowl.diameter_mm": "bowl: diameter (mm)",
    "bowl.depth_mm": "bowl: depth (mm)",
    "bowl.thickness_mm": "bowl: wall (mm)",
    "bowl.stem_diameter_mm": "bowl: stem diameter (mm)",
    "rubber.name": "rubber",
    "rubber.modulus_MPa": "its Young's modulus (MPa)",
}
"""Shown of each switch; report.json and the files of the folder ``switch`` hold the rest."""


def switch_section(context: Context, report: Mapping[str, Any]) -> str:
    """Bowls side by side, their force curves, what to mind, and what is seen of the tips."""
    made = [page.flatten(item) for item in report["switch"]["switches"]]
    keys = [key for key in ROWS if any(key in item for item in made)]
    head = ("switch", *(f"{page.number(item['threshold_N'])} N" for item in made))
    rows = [(ROWS[key], *(item.get(key) for item in made)) for key in keys]
    minded = dict.fromkeys(text for item in made for text in item.get("warnings", ()))
    curves = sorted((context.folders["switch"] / EXPORT / "switch").glob("*.svg"))
    left_out = {"switches", "refused"}  # shown above, and in the verdict
    red = {key: value for key, value in report["switch"].items() if key not in left_out}
    return (
        page.table(head, rows)
        + "".join(f'<p class="foot">{escape(sentence(text))}</p>' for text in minded)
        + page.side_by_side(
            *(
                page.svg_figure(path.read_text(encoding="utf-8"), f"Force over stroke: {path.stem}")
                for path in curves
            )
        )
        + page.facts(red, "switch")
    )
