"""Volume of a sensor's outer hull, from the printed solid and without its collision pieces."""

from collections.abc import Iterator
from typing import Any

import manifold3d
import numpy as np

from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import to_manifold
from phytac_design.solids.wall_mesh import wall_mesh


def outer_hull_mm3(sensor: Sensor) -> float:
    """Volume that the pieces should fill, by sections of the wall, or by Steiner's formula."""
    surface, wall = sensor.surface, sensor.design.wall
    solid = to_manifold(wall_mesh(surface, wall, tolerance_mm=0.02))
    if surface.periodic[1]:
        low, high = solid.bounding_box()[2], solid.bounding_box()[5]
        heights = low + (high - low) * (np.arange(400) + 0.5) / 400
        # The outer outline of each section, without the cavity.
        areas = [
            max(abs(section.area()) for section in _outlines(solid.slice(float(z))))
            for z in heights
        ]
        return float(np.mean(areas) * (high - low))

    def slab(depth: float) -> float:
        # The area is quadratic in the offset: Simpson's rule is exact.
        top, middle, low = (surface.area_mm2(-x * depth) for x in (0.0, 0.5, 1.0))
        return depth * (top + 4.0 * middle + low) / 6.0

    rims = solid.volume() - slab(wall.thickness_mm)
    return float(slab(wall.thickness_mm + sensor.markers.height_mm.max()) + rims)


def _outlines(section: Any) -> Iterator[Any]:
    for polygon in section.to_polygons():
        yield manifold3d.CrossSection([polygon], manifold3d.FillRule.EvenOdd)
