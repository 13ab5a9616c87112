"""Raised labels in a font of straight strokes."""

from typing import Any

import numpy as np

from phytac_design.solids.solid_mesh import united
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

GLYPHS = {
    "0": ("00 20 24 04 00",),
    "1": ("00 20", "10 14 03"),
    "2": ("04 24 22 02 00 20",),
    "3": ("04 24 20 00", "02 22"),
    "4": ("04 02 22", "24 20"),
    "5": ("24 04 02 22 20 00",),
    "6": ("24 04 00 20 22 02",),
    "7": ("04 24 10",),
    "8": ("00 20 24 04 00", "02 22"),
    "9": ("22 02 04 24 20 00",),
    "A": ("00 03 14 23 20", "02 22"),
    "B": ("00 04 14 23 12 21 10 00", "02 12"),
    "C": ("24 04 00 20",),
    "D": ("00 04 14 23 21 10 00",),
    "E": ("24 04 00 20", "02 12"),
    "F": ("24 04 00", "02 12"),
    "G": ("24 04 00 20 22 12",),
    "H": ("00 04", "20 24", "02 22"),
    "I": ("00 20", "04 24", "10 14"),
    "J": ("24 20 00 01",),
    "K": ("00 04", "24 02 20"),
    "L": ("04 00 20",),
    "M": ("00 04 12 24 20",),
    "N": ("00 04 20 24",),
    "O": ("01 03 14 23 21 10 01",),
    "P": ("00 04 24 22 02",),
    "Q": ("01 03 14 23 21 10 01", "11 20"),
    "R": ("00 04 24 22 02", "12 20"),
    "S": ("24 14 03 21 10 00",),
    "T": ("04 24", "14 10"),
    "U": ("04 00 20 24",),
    "V": ("04 10 24",),
    "W": ("04 00 12 20 24",),
    "X": ("00 24", "04 20"),
    "Y": ("04 12 24", "12 10"),
    "Z": ("04 24 00 20",),
    "/": ("00 24",),
}
"""Strokes of each letter through points xy of a grid of 2 by 4."""
ADVANCE = 0.82
"""From one letter to the next, over the height of letters."""


def strokes(text: str) -> FloatArray:
    """Strokes (s, 2, 2) of a text whose letters are 1 high, its middle at the origin.

    Raises
    ------
    DesignError
        If a letter is not known.
    """
    unknown = sorted(set(text) - set(GLYPHS))
    if unknown or not text:
        raise DesignError(
            "label-character-unknown",
            f"no letters for the label {text!r}; use capitals, digits and '/'",
        )
    found = []
    for place, letter in enumerate(text):
        for line in GLYPHS[letter]:
            way = np.array([[float(pair[0]), float(pair[1])] for pair in line.split()]) / 4.0
            way[:, 0] += place * ADVANCE
            found.append(np.stack([way[:-1], way[1:]], axis=1))
    width = (len(text) - 1) * ADVANCE + 0.5
    return np.concatenate(found) - [0.5 * width, 0.5]


def label(
    text: str, side_mm: float, stroke_mm: float, height_mm: float, *, slope_deg: float = 5.0
) -> Any:
    """Text as large as fits a square of ``side_mm``, from below z = 0 to ``height_mm``.

    Its middle is the origin; sides of letters fall off by ``slope_deg`` against the pull.

    Raises
    ------
    DesignError
        If strokes of that width leave nothing between them.
    """
    import manifold3d

    drawn = strokes(text)
    free = 0.84 * side_mm - stroke_mm
    tall = min(free / ((len(text) - 1) * ADVANCE + 0.5), 0.5 * free)
    if 0.25 * tall < 0.6 * stroke_mm:
        raise DesignError(
            "label-does-not-fit",
            f"the mold has no room for its label {text!r}: letters of {tall:.2g} mm with strokes "
            f"of {stroke_mm:g} mm; raise [mold] channel_mm or lower [print_rules] engrave_min_mm",
        )
    slope = np.tan(np.radians(slope_deg))
    bars = []
    for start, end in tall * drawn:
        along = (end - start) / np.hypot(*(end - start))
        across = np.array([-along[1], along[0]])
        points = [
            [*(point + (0.5 * stroke_mm - z * slope) * (sign * along + side * across)), z]
            for z in (-0.5 * height_mm, height_mm)
            for point, sign in ((start, -1.0), (end, 1.0))
            for side in (-1.0, 1.0)
        ]
        bars.append(manifold3d.Manifold.hull_points(np.array(points)))
    return united(bars)
