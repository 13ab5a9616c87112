"""Figures as PNG bytes. matplotlib is imported at first use."""

from io import BytesIO
from typing import Any

DPI = 130


def png(figure: Any) -> bytes:
    """PNG of a figure, the same bytes for the same figure; the figure is closed."""
    import matplotlib.pyplot as plt

    buffer = BytesIO()
    # Without a fixed date and program the same figure would not give the same bytes.
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    plt.close(figure)
    return buffer.getvalue()


def new_figure(size: tuple[float, float]) -> Any:
    """Figure without axes, of a size in inches, drawn off screen; its parts don't overlap."""
    figure = blank_figure(size)
    figure.set_layout_engine("constrained")
    return figure


def blank_figure(size: tuple[float, float]) -> Any:
    """Figure without axes or layout, of a size in inches, drawn off screen."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    return plt.figure(figsize=size)
