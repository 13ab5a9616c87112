"""Paints of the parts, and the light they reflect: one table for pictures and frames."""

from collections.abc import Iterable

import numpy as np

from phytac_shapes.arrays import FloatArray

PAINTS: dict[str, tuple[int, int, int]] = {
    "blue": (28, 72, 214),
    "green": (24, 168, 62),
    "red": (214, 30, 34),
    "yellow": (238, 206, 16),
    "magenta": (206, 36, 168),
    "cyan": (0, 182, 206),
    "white": (236, 236, 230),
    "black": (26, 26, 28),
}
"""sRGB of each paint, 8 bits (chosen here as marker pens; the paper names the colours only).

``red`` is the switches' tip. See :func:`paints_of` for those of one design.
"""
RESIN = (176, 170, 160)
"""sRGB of the printed resin, a warm grey."""
RESIN_DARK = (34, 34, 36)
"""sRGB of the black resin under white dots."""
BAR = (255, 252, 240)
"""sRGB of the light bar, which shines."""
FIXTURE = (84, 86, 90)
"""sRGB of fixtures, a dark grey."""
BACKGROUND = (6, 6, 7)
"""sRGB where there is nothing to see."""


def paints_of(names: Iterable[str]) -> dict[str, tuple[int, int, int]]:
    """Return the paints that a sensor shows: its markers' (each once, in order), then red."""
    return {name: PAINTS[name] for name in dict.fromkeys((*names, "red"))}


def resin_of(names: Iterable[str]) -> tuple[int, int, int]:
    """SRGB of the wall under these paints: dark under white dots."""
    return RESIN_DARK if "white" in names else RESIN


def to_linear(srgb: FloatArray) -> FloatArray:
    """Linear light in [0, 1] of sRGB values in [0, 255], any shape (IEC 61966-2-1)."""
    c = np.asarray(srgb, dtype=np.float64) / 255.0
    return np.asarray(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4))


def to_srgb(linear: FloatArray) -> FloatArray:
    """SRGB values in [0, 255] (not rounded) of linear light, clipped to [0, 1], any shape."""
    c = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.asarray(255.0 * np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055))
