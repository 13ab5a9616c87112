"""Figures of the report, as PNG bytes. matplotlib is imported only here."""

from collections.abc import Mapping
from io import BytesIO
from typing import Any

import cv2
import numpy as np

from shapes.arrays import FloatArray, ImageArray

INK = {
    "blue": "#1c48d6",
    "green": "#18a83e",
    "yellow": "#c9a400",
    "magenta": "#c2189b",
    "cyan": "#0fa3b1",
}
DPI = 110


def _png(figure: Any) -> bytes:
    import matplotlib.pyplot as plt

    buffer = BytesIO()
    # Without a fixed date and program the same figure would not give the same bytes.
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    plt.close(figure)
    return buffer.getvalue()


def _axes(size: tuple[float, float]) -> tuple[Any, Any]:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=size, layout="constrained")
    return figure, axes


def unrolled_map(
    flat_mm: FloatArray, values: FloatArray, *, title: str, label: str, colours: list[str]
) -> bytes:
    """Markers on the unrolled surface, filled by a value, edged by their paint.

    Parameters
    ----------
    flat_mm : (n, 2) float
        Around and along, mm.
    values : (n,) float
        What the fill shows.
    title, label : str
        Of the figure and of its colour bar.
    colours : list of str
        Paint of each marker.
    """
    figure, axes = _axes((8.6, 5.2))
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if high - low <= 1e-9 * max(abs(high), 1e-300):  # one value all over: a range that says so
        low, high = (0.0, high) if high > 0.0 else (0.0, 1.0)
    dots = axes.scatter(
        flat_mm[:, 0],
        flat_mm[:, 1],
        c=values,
        vmin=low,
        vmax=high,
        s=46,
        cmap="viridis",
        edgecolors=[INK.get(name, "black") for name in colours],
        linewidths=1.4,
    )
    figure.colorbar(dots, ax=axes, label=label)
    axes.set(xlabel="around the sensor (mm)", ylabel="along, away from the camera (mm)")
    axes.set_title(title)
    axes.set_aspect("equal")
    return _png(figure)


def error_bars(table: Mapping[str, Mapping[str, Any]], *, title: str) -> bytes:
    """Relative error of each estimator below and from 5 N, in per cent."""
    figure, axes = _axes((7.2, 3.4))
    names = list(table)
    place = np.arange(len(names))
    for shift, (group, label) in enumerate(
        (("below_5N", "contacts below 5 N"), ("from_5N", "contacts from 5 N"))
    ):
        values = [100.0 * table[name][group]["relative_error"] for name in names]
        axes.bar(place + 0.4 * shift - 0.2, values, 0.38, label=label)
    axes.set_xticks(place, [name.replace("_", " ") for name in names])
    axes.set_ylabel("mean relative error (%)")
    axes.set_title(title)
    axes.legend()
    axes.grid(axis="y", alpha=0.3)
    return _png(figure)


def thumbnail(image: ImageArray, width_px: int) -> bytes:
    """JPEG of an image (BGR) scaled to a width, for the page."""
    height = round(image.shape[0] * width_px / image.shape[1])
    small = cv2.resize(image, (width_px, height), interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 85])[1])
