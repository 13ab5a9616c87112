"""Flat drawings in millimetres, written as SVG; `pdf.py` writes the same items as PDF.

x runs to the right and y downwards from the top left corner of the paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Literal, TypeAlias

import numpy as np

from phytac_shapes.arrays import FloatArray

Anchor = Literal["start", "middle", "end"]
HAIR_mm = 0.1


@dataclass(frozen=True, kw_only=True)
class DrawnLine:
    """Polyline or polygon through points (k, 2); ``dash_mm`` 0 for a full line."""

    points: FloatArray
    closed: bool = False
    stroke: str = "#000000"
    fill: str = ""
    width_mm: float = HAIR_mm
    dash_mm: float = 0.0

    def moved(self, shift: FloatArray) -> "DrawnLine":
        """Return the same line elsewhere."""
        return replace(self, points=self.points + shift)

    @property
    def box(self) -> FloatArray:
        """Corners [[x0, y0], [x1, y1]]."""
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])


@dataclass(frozen=True, kw_only=True)
class Disc:
    """Circle around a centre (2,)."""

    centre: FloatArray
    radius_mm: float
    stroke: str = ""
    fill: str = ""
    width_mm: float = HAIR_mm
    dash_mm: float = 0.0

    def moved(self, shift: FloatArray) -> "Disc":
        """Return the same disc elsewhere."""
        return replace(self, centre=self.centre + shift)

    @property
    def box(self) -> FloatArray:
        """Corners [[x0, y0], [x1, y1]]."""
        return np.stack([self.centre - self.radius_mm, self.centre + self.radius_mm])


@dataclass(frozen=True, kw_only=True)
class Text:
    """A line of text on its baseline; ``turn_deg`` anticlockwise."""

    at: FloatArray
    text: str
    size_mm: float = 3.0
    anchor: Anchor = "start"
    colour: str = "#000000"
    turn_deg: float = 0.0

    def moved(self, shift: FloatArray) -> "Text":
        """Return the same text elsewhere."""
        return replace(self, at=self.at + shift)

    @property
    def box(self) -> FloatArray:
        """Generous corners [[x0, y0], [x1, y1]]."""
        reach = self.size_mm * max(len(self.text), 1)
        return np.stack([self.at - reach, self.at + reach])


Item: TypeAlias = DrawnLine | Disc | Text


@dataclass(frozen=True, kw_only=True)
class Layer:
    """Items drawn inside a window [[x0, y0], [x1, y1]] of a page only, or all over it."""

    items: Sequence[Item]
    window: FloatArray | None = None


@dataclass(frozen=True, kw_only=True)
class Page:
    """A sheet of paper."""

    width_mm: float
    height_mm: float
    layers: Sequence[Layer]


def _attributes(stroke: str, fill: str, width: float, dash: float) -> str:
    line = f' stroke="{stroke}" stroke-width="{width:g}"' if stroke else ""
    dashes = f' stroke-dasharray="{dash:g}"' if dash > 0.0 and stroke else ""
    return f' fill="{fill or "none"}"{line}{dashes}'


def svg_item(item: Item) -> str:
    """SVG element of an item."""
    if isinstance(item, DrawnLine):
        points = " ".join(f"{x:.3f},{y:.3f}" for x, y in item.points.tolist())
        kind = "polygon" if item.closed else "polyline"
        style = _attributes(item.stroke, item.fill, item.width_mm, item.dash_mm)
        return f'<{kind} points="{points}"{style}/>'
    if isinstance(item, Disc):
        style = _attributes(item.stroke, item.fill, item.width_mm, item.dash_mm)
        x, y = item.centre.tolist()
        return f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{item.radius_mm:.4f}"{style}/>'
    x, y = item.at.tolist()
    turn = f' transform="rotate({-item.turn_deg:g} {x:.3f} {y:.3f})"' if item.turn_deg else ""
    return (
        f'<text x="{x:.3f}" y="{y:.3f}" font-size="{item.size_mm:.3f}" '
        f'text-anchor="{item.anchor}" fill="{item.colour}"{turn}>{escape(item.text)}</text>'
    )


def svg_text(page: Page) -> str:
    """SVG of one page, true to scale: its width and height are in millimetres."""
    width, height = f"{page.width_mm:.3f}", f"{page.height_mm:.3f}"
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}" font-family="Helvetica, Arial, sans-serif">'
    )
    out = [head, f'<rect width="{width}" height="{height}" fill="#ffffff"/>']
    for number, layer in enumerate(page.layers):
        window = layer.window
        if window is not None:
            (x0, y0), (x1, y1) = window.tolist()
            out.append(
                f'<clipPath id="w{number}"><rect x="{x0:.4f}" y="{y0:.4f}" '
                f'width="{x1 - x0:.4f}" height="{y1 - y0:.4f}"/></clipPath>'
                f'<g clip-path="url(#w{number})">'
            )
        out += [svg_item(item) for item in layer.items]
        if window is not None:
            out.append("</g>")
    return "\n".join([*out, "</svg>"]) + "\n"
