"""PDF of drawings at 1:1, by matplotlib: no dates, so the same drawing gives the same bytes.

Text is set in Helvetica, one of the fonts that every viewer and printer has.
"""

import io
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from phytac_design.fabrication.documents.sheet_drawing import Disc, Item, Page, Text

POINTS = 72.0 / 25.4
"""Points per millimetre."""
SETTINGS = {
    "pdf.use14corefonts": True,
    "lines.scale_dashes": False,
    "axes.unicode_minus": False,
}
ALIGNMENT: dict[str, Any] = {"start": "left", "middle": "center", "end": "right"}


def pdf_bytes(pages: Sequence[Page], *, title: str) -> bytes:
    """PDF of pages of drawings, true to scale."""
    import matplotlib as mpl
    from matplotlib.backends.backend_pdf import PdfPages

    out = io.BytesIO()
    with (
        mpl.rc_context(SETTINGS),
        PdfPages(out, metadata={"Title": title, "CreationDate": None}) as pdf,
    ):
        for page in pages:
            pdf.savefig(_figure(page))
    return out.getvalue()


def _figure(page: Page) -> Any:
    """Figure of the size of a page, its axes in millimetres with y downwards."""
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox, TransformedBbox

    figure = Figure(figsize=(page.width_mm / 25.4, page.height_mm / 25.4))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, page.width_mm), ylim=(page.height_mm, 0.0))
    axes.set_axis_off()
    order = itertools.count()
    for layer in page.layers:
        clip = None if layer.window is None else TransformedBbox(Bbox(layer.window), axes.transData)
        for item in layer.items:
            low, high = item.box
            if layer.window is not None and (
                np.any(high < layer.window[0]) or np.any(low > layer.window[1])
            ):
                continue
            artist = axes.add_artist(_artist(item))
            artist.set_clip_box(clip)
            artist.set_clip_on(clip is not None)
            artist.set_zorder(next(order))
    return figure


def _artist(item: Item) -> Any:
    """Matplotlib's artist for an item."""
    from matplotlib import patches, text

    if isinstance(item, Text):
        x, y = item.at.tolist()
        return text.Text(
            x,
            y,
            item.text,
            color=item.colour,
            fontsize=item.size_mm * POINTS,
            horizontalalignment=ALIGNMENT[item.anchor],
            rotation=item.turn_deg,
            family="Helvetica",
            weight="medium",
            parse_math=False,
        )
    style = {
        "edgecolor": item.stroke or "none",
        "facecolor": item.fill or "none",
        "linewidth": item.width_mm * POINTS if item.stroke else 0.0,
        "linestyle": (0, (item.dash_mm * POINTS,) * 2) if item.dash_mm else "solid",
    }
    if isinstance(item, Disc):
        return patches.Circle(tuple(item.centre), item.radius_mm, **style)
    return patches.Polygon(item.points, closed=item.closed, **style)
