"""Drawings and tables as plain HTML, for notebooks: numbers and inline SVG, nothing to load."""

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from phytac_shapes.arrays import FloatArray

SIZE_px = 420
"""Longer side of a drawing."""
MARGIN = 0.04
"""Empty border, as a share of the longer side."""


def map_svg(
    edges: Sequence[FloatArray],
    label: str,
    *,
    faint: Sequence[FloatArray] = (),
    points: FloatArray | None = None,
    colours: Sequence[str] = (),
    names: Sequence[str] = (),
    radius_mm: float = 1.0,
    y_down: bool = False,
) -> str:
    """Inline SVG of lines (n, 2) and, on top, of one disc for each point (m, 2), mm.

    Parameters
    ----------
    edges, faint : sequence of (n, 2) float
        Lines, drawn firmly and faintly.
    label : str
        What the drawing shows, for screen readers.
    points : (m, 2) float, optional
        Centres of discs of ``radius_mm``.
    colours, names : sequence of str
        Fill of each disc, and what it is called when pointed at; fewer are repeated.
    y_down : bool
        Whether the second coordinate grows downwards; upwards if not.
    """
    sign = np.array([1.0, 1.0 if y_down else -1.0])
    whole = np.concatenate([*edges, *([] if points is None else [points])]) * sign
    low, high = whole.min(axis=0), whole.max(axis=0)
    side = float(max((high - low).max(), 1e-9))
    low, size = low - MARGIN * side, high - low + 2.0 * MARGIN * side
    scale = SIZE_px / float(size.max())
    parts = [_line(line * sign, 0.5 if k < len(faint) else 1.2, faded=k < len(faint))
             for k, line in enumerate([*faint, *edges])]  # fmt: skip
    if points is not None:
        # A disc that is too small to be seen on the screen is drawn larger.
        radius = max(radius_mm, 1.5 / scale)
        for k, (x, y) in enumerate((points * sign).tolist()):
            fill = escape(colours[k % len(colours)]) if colours else "currentColor"
            name = f"<title>{escape(names[k % len(names)])}</title>" if names else ""
            parts.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{radius:.2f}" fill="{fill}">')
            parts.append(f"{name}</circle>")
    box = f"{low[0]:.2f} {low[1]:.2f} {size[0]:.2f} {size[1]:.2f}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" width="{scale * size[0]:.0f}" '
        f'height="{scale * size[1]:.0f}" role="img" aria-label="{escape(label)}" '
        'style="max-width:100%;height:auto">' + "".join(parts) + "</svg>"
    )


def _line(points: FloatArray, width_px: float, *, faded: bool) -> str:
    path = " ".join(f"{x:.2f},{y:.2f}" for x, y in points.tolist())
    return (
        f'<polyline points="{path}" fill="none" stroke="currentColor" '
        f'stroke-opacity="{0.25 if faded else 0.9}" stroke-width="{width_px}" '
        'vector-effect="non-scaling-stroke"/>'
    )


def card(title: str, rows: Mapping[str, str], *blocks: str) -> str:
    """Title, a table of names and values (escaped here), and blocks of HTML (as they are)."""
    cells = "".join(
        f'<tr><th scope="row" style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows.items()
    )
    table = f"<table>{cells}</table>" if cells else ""
    return f"<div><p><b>{escape(title)}</b></p>{table}{''.join(blocks)}</div>"


def figure(value: float) -> str:
    """Four digits of a number, thousands written out."""
    number = float(value)
    return f"{number:.0f}" if 1e4 <= abs(number) < 1e9 else f"{number:.4g}"
