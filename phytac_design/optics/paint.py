"""Paints of the parts, and the light they reflect: one table for pictures and frames."""

from collections.abc import Iterable

import numpy as np

from phytac_design.design.paints_table import NOMINAL_PAINTS, PaintsSection, Rgb
from phytac_shapes.arrays import FloatArray

PAINTS: dict[str, Rgb] = {
    name: rgb for name, rgb in NOMINAL_PAINTS if name not in {"resin", "resin_dark"}
}
"""sRGB of each paint, 8 bits, unless the design measured its own; ``red`` is the switches' tip."""
RESIN = NOMINAL_PAINTS.resin
"""sRGB of the printed resin."""
BAR = (255, 252, 240)
"""sRGB of the light bar, which shines."""
FIXTURE = (84, 86, 90)
"""sRGB of fixtures, a dark grey."""
BACKGROUND = (6, 6, 7)
"""sRGB where there is nothing to see."""


def paints_of(names: Iterable[str], table: PaintsSection = NOMINAL_PAINTS) -> dict[str, Rgb]:
    """Return the paints that a sensor shows: its markers' (each once, in order), then red."""
    return {name: getattr(table, name) for name in dict.fromkeys((*names, "red"))}


def resin_of(names: Iterable[str], table: PaintsSection = NOMINAL_PAINTS) -> Rgb:
    """SRGB of the wall under these paints: dark under white dots."""
    return table.resin_dark if "white" in names else table.resin


def to_linear(srgb: FloatArray) -> FloatArray:
    """Linear light in [0, 1] of sRGB values in [0, 255], any shape (IEC 61966-2-1)."""
    c = np.asarray(srgb, dtype=np.float64) / 255.0
    return np.asarray(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4))


def to_srgb(linear: FloatArray) -> FloatArray:
    """SRGB values in [0, 255] (not rounded) of linear light, clipped to [0, 1], any shape."""
    c = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.asarray(255.0 * np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055))
