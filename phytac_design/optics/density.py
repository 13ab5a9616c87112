"""How densely markers sense, and on what kind of surface: densities compare within a kind only."""

from dataclasses import dataclass

import numpy as np

from phytac_design.layout import Markers
from shapes import Surface

ALIGNED = 0.05
"""Sine of the angle (about 3 degrees) within which a surface counts as parallel."""


@dataclass(frozen=True, kw_only=True)
class Density:
    """Markers per area of the outer face, what the hand touches.

    Attributes
    ----------
    count : int
        Markers.
    area_cm2 : float
        Area of the outer face between the rims.
    per_cm2 : float
        Their ratio.
    surface_class : str
        ``parallel``, ``perpendicular`` or ``oblique`` to the optical axis (+z).
    """

    count: int
    area_cm2: float
    per_cm2: float
    surface_class: str


def density_of(surface: Surface, markers: Markers) -> Density:
    """Marker density of the outer face (paper: 368 on ø60 x 120, 1.63 per cm²)."""
    area = surface.area_mm2(0.0) / 100.0
    lean = np.abs(markers.normal[:, 2])
    if bool(np.all(lean <= ALIGNED)):
        kind = "parallel"
    elif bool(np.all(lean >= np.sqrt(1.0 - ALIGNED**2))):
        kind = "perpendicular"
    else:
        kind = "oblique"
    return Density(
        count=markers.count, area_cm2=area, per_cm2=markers.count / area, surface_class=kind
    )
