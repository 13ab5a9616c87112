"""Line plots of switches as SVG."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from phytac_design.core.figures import new_figure, svg
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import OutputError


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
    colours = ("#1c48d6", "#c2189b", "#18a83e", "#c9a400", "#0fa3b1", "#d2452c", "#555555")
    figure = new_figure((7.2, 4.4))
    axes = figure.subplots()
    for (name, (x, y)), colour in zip(lines.items(), colours, strict=False):
        axes.plot(x, y, color=colour, label=name)
    for *place, text in marks:
        axes.plot(*place, "ko")
        axes.annotate(text, (place[0], place[1]), (7, 7), textcoords="offset points")
    top = max(float(np.max(y)) for _, y in lines.values())
    axes.set(xlabel=labels[0], ylabel=labels[1], title=title)
    # The names are in the upper right corner: lines end below them.
    axes.set_xlim(0.0)
    axes.set_ylim(0.0, (1.06 + 0.055 * len(lines)) * top)
    axes.grid(visible=True, color="#ddd")
    axes.legend(loc="upper right", labelcolor="linecolor", frameon=False, handlelength=0.0)
    return svg(figure)


def check_svg(path: Path) -> None:
    """Refuse a file that is no SVG, before any work is done for it.

    Raises
    ------
    OutputError
        If its name does not end in .svg, or its folder does not exist.
    """
    if path.suffix != ".svg":
        raise OutputError(
            "plot-format-unknown",
            f"plots of switches are SVG (got {path.name}); name the file *.svg",
        )
    if not path.parent.is_dir():
        raise OutputError("output-not-writable", f"there is no folder {path.parent}; make it first")


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
        raise OutputError(
            "output-not-writable", f"cannot write {path} ({error}); choose another place"
        ) from None
    return path
