"""Plain SVG plots of switches, without a plotting library."""

from collections.abc import Mapping, Sequence
from html import escape
from math import floor, log10
from pathlib import Path

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import OutputError

SIZE = (720.0, 440.0)
FRAME = (70.0, 44.0, 700.0, 390.0)
"""Left, top, right and bottom of the axes, px."""
INKS = ("#1c48d6", "#c2189b", "#18a83e", "#c9a400", "#0fa3b1", "#d2452c", "#555555")


def _ticks(low: float, high: float) -> FloatArray:
    raw = (high - low) / 6.0
    unit = 10.0 ** floor(log10(raw))
    step = min(f * unit for f in (1.0, 2.0, 5.0, 10.0) if f * unit >= raw)
    return np.asarray(step * np.arange(np.ceil(low / step), np.floor(high / step + 1e-9) + 1))


def line_plot(
    lines: Mapping[str, tuple[FloatArray, FloatArray]],
    *,
    title: str,
    labels: tuple[str, str],
    marks: Sequence[tuple[float, float, str]] = (),
) -> str:
    """SVG of named lines (x, y), and marked points with a text; axes start at zero.

    Parameters
    ----------
    lines : mapping
        Name to x (m,) and y (m,).
    title : str
        Over the axes.
    labels : tuple of str
        Of x and y, with units.
    marks : sequence of (x, y, text)
        Points to name.
    """
    right, top = (max(float(np.max(line[k])) for line in lines.values()) for k in range(2))
    # Names stand in the upper right corner: lines end below them.
    right, top = 1.05 * right, (1.06 + 0.055 * len(lines)) * top
    x0, y0, x1, y1 = FRAME

    def at(x: float, y: float) -> tuple[float, float]:
        return x0 + (x1 - x0) * x / right, y1 - (y1 - y0) * y / top

    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE[0]:g}" height="{SIZE[1]:g}" '
        'font-family="sans-serif" font-size="13">'
    )
    heading = f'<text x="{SIZE[0] / 2:g}" y="24" text-anchor="middle" font-size="15">'
    out = [head, '<rect width="100%" height="100%" fill="white"/>']
    out.append(f"{heading}{escape(title)}</text>")
    for x in _ticks(0.0, right):
        px, _ = at(float(x), 0.0)
        out.append(f'<path d="M{px:.1f} {y0}V{y1}" stroke="#ddd"/>')
        out.append(f'<text x="{px:.1f}" y="{y1 + 17}" text-anchor="middle">{x:g}</text>')
    for y in _ticks(0.0, top):
        _, py = at(0.0, float(y))
        out.append(f'<path d="M{x0} {py:.1f}H{x1}" stroke="#ddd"/>')
        out.append(f'<text x="{x0 - 6}" y="{py + 4:.1f}" text-anchor="end">{y:.4g}</text>')
    out.append(f'<path d="M{x0} {y0}V{y1}H{x1}" fill="none" stroke="black"/>')
    out.append(
        f'<text x="{(x0 + x1) / 2}" y="{y1 + 38}" text-anchor="middle">{escape(labels[0])}</text>'
        f'<text transform="translate(18 {(y0 + y1) / 2}) rotate(-90)" text-anchor="middle">'
        f"{escape(labels[1])}</text>"
    )
    for number, (name, (xs, ys)) in enumerate(lines.items()):
        ink = INKS[number % len(INKS)]
        places = " ".join(
            "{:.1f},{:.1f}".format(*at(float(x), float(y))) for x, y in zip(xs, ys, strict=True)
        )
        out.append(f'<polyline points="{places}" fill="none" stroke="{ink}" stroke-width="2"/>')
        out.append(
            f'<text x="{x1 - 8}" y="{y0 + 16 + 17 * number}" text-anchor="end" '
            f'fill="{ink}">{escape(name)}</text>'
        )
    for x, y, text in marks:
        px, py = at(x, y)
        out.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="4"/>')
        out.append(f'<text x="{px + 7:.1f}" y="{py - 7:.1f}">{escape(text)}</text>')
    return "\n".join([*out, "</svg>"]) + "\n"


def check_svg(path: Path) -> None:
    """Refuse a file that is no SVG, before any work is done for it.

    Raises
    ------
    OutputError
        If its name does not end in .svg, or its folder does not exist.
    """
    if path.suffix != ".svg":
        raise OutputError(f"plots of switches are SVG (got {path.name}); name the file *.svg")
    if not path.parent.is_dir():
        raise OutputError(f"there is no folder {path.parent}; make it first")


def write_svg(path: Path, text: str) -> Path:
    """Write a plot.

    Raises
    ------
    OutputError
        If the file's name does not end in .svg, or it cannot be written.
    """
    check_svg(path)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write {path} ({error}); choose another place") from None
    return path
