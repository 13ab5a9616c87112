"""Figures as PNG bytes. matplotlib is imported at first use, without its pyplot."""

from io import BytesIO
from typing import Any


def png(figure: Any) -> bytes:
    """PNG of a figure, the same bytes for the same figure."""
    buffer = BytesIO()
    # Without a fixed date and program the same figure would not give the same bytes.
    figure.savefig(buffer, format="png", dpi=130, metadata={"Software": None})
    return buffer.getvalue()


def new_figure(size: tuple[float, float], *, layout: str | None = "constrained") -> Any:
    """Figure without axes, of a size in inches; with the default layout its parts don't overlap."""
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout=layout)
