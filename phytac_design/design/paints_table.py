"""The table ``[paints]`` of a design file: what paints and resin look like to the camera."""

from typing import Annotated

from pydantic import Field

from phytac_design.design.base_table import Section, assumed

Level = Annotated[int, Field(ge=0, le=255)]
Rgb = tuple[Level, Level, Level]


class PaintsSection(Section):
    """sRGB (red, green, blue; 0 to 255) of each paint in full light, not clipped.

    `phytac paints PHOTO` proposes these lines from a photo.
    """

    blue: Rgb = assumed((28, 72, 214))
    """Blue markers (marker pens; the paper names colours only)."""
    green: Rgb = assumed((24, 168, 62))
    """Green markers."""
    red: Rgb = assumed((214, 30, 34))
    """Tips of the switches."""
    yellow: Rgb = assumed((238, 206, 16))
    """Yellow markers."""
    magenta: Rgb = assumed((206, 36, 168))
    """Magenta markers."""
    cyan: Rgb = assumed((0, 182, 206))
    """Cyan markers."""
    white: Rgb = assumed((236, 236, 230))
    """White dots."""
    black: Rgb = assumed((26, 26, 28))
    """Black dots."""
    resin: Rgb = assumed((176, 170, 160))
    """The printed resin, a warm grey."""
    resin_dark: Rgb = assumed((34, 34, 36))
    """The black resin under white dots."""


NOMINAL_PAINTS = PaintsSection()
"""Paints of a design that does not say otherwise."""
