"""Figures as PNG, SVG and PDF. matplotlib is imported at first use, without its pyplot."""

from collections.abc import Sequence
from io import BytesIO, StringIO
from typing import Any


def png(figure: Any) -> bytes:
    """PNG of a figure, the same bytes for the same figure."""
    buffer = BytesIO()
    # Without a fixed date and program the same figure would not give the same bytes.
    style = {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": 1}}
    figure.savefig(buffer, format="png", dpi=130, **style)
    return buffer.getvalue()


def new_figure(size: tuple[float, float], *, constrained: bool = True) -> Any:
    """Figure without axes, of a size in inches; if constrained, its parts don't overlap."""
    from matplotlib.figure import Figure

    return Figure(figsize=size, layout="constrained" if constrained else None)


def svg(figure: Any) -> str:
    """SVG of a figure, text as text, the same for the same figure."""
    import matplotlib as mpl

    file = StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "phytac"}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    out = file.getvalue()
    return out[out.index("<svg") :]


def pdf(figures: Sequence[Any], *, title: str) -> bytes:
    """PDF with a page for each figure, without dates."""
    from matplotlib.backends.backend_pdf import PdfPages

    out, metadata = BytesIO(), {"Title": title, "CreationDate": None}
    with PdfPages(out, metadata=metadata) as pages:
        for figure in figures:
            pages.savefig(figure)
    return out.getvalue()
