"""One surface of each kind, and places on it."""

import numpy as np

from phytac_shapes import Cone, Cuboid, Cylinder, Grip, Hemisphere, Patch, Plane, Surface
from phytac_shapes.arrays import FloatArray

WALL_MM = 0.8


def bowl() -> Patch:
    u, v = np.linspace(-20.0, 20.0, 4), np.linspace(-30.0, 30.0, 5)
    return Patch(
        points_mm=tuple(
            tuple((x, y, 40.0 - 0.008 * x * x - 0.006 * y * y + 0.004 * x * y) for x in v.tolist())
            for y in u.tolist()
        )
    )


FAMILIES: dict[str, Surface] = {
    "cylinder": Cylinder(diameter_outer_mm=60.0, length_mm=80.0),
    "cone": Cone(diameter_near_mm=60.0, diameter_far_mm=24.0, length_mm=60.0),
    "capped": Cone(diameter_near_mm=50.0, diameter_far_mm=24.0, length_mm=50.0, end="cap"),
    "hemisphere": Hemisphere(diameter_outer_mm=60.0),
    "finger": Hemisphere(diameter_outer_mm=40.0, skirt_mm=25.0),
    "plane": Plane(width_mm=80.0, height_mm=60.0, tilt_deg=20.0),
    "cuboid": Cuboid(width_mm=50.0, depth_mm=40.0, length_mm=60.0, edge_radius_mm=6.0),
    "sharp": Cuboid(width_mm=50.0, depth_mm=40.0, length_mm=60.0, edge_radius_mm=1.0),
    "grip": Grip(diameters_mm=(50.0, 40.0, 46.0, 36.0, 52.0), length_mm=100.0),
    "patch": bowl(),
}
DOMES = ("capped", "hemisphere", "finger")


def golden(surface: Surface, count: int, margin: float = 0.06) -> FloatArray:
    """``count`` places in no lattice, equal in area, off the open edges by a share ``margin``."""
    (u0, u1), (v0, v1) = surface.domain
    u = np.linspace(u0, u1, 2001)
    metric = surface.metric(np.column_stack([u, np.full_like(u, (v0 + v1) / 2.0)]))
    density = np.sqrt(np.maximum(np.linalg.det(metric), 0.0))
    area = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    near, far = (0.0 if pole else margin for pole in surface.poles)
    share = near + (1.0 - near - far) * (np.arange(count) + 0.5) / count
    turn = np.mod(np.arange(count) * (np.sqrt(5.0) - 1.0) / 2.0, 1.0)
    if not surface.periodic[1]:
        turn = margin + (1.0 - 2.0 * margin) * turn
    return np.column_stack([np.interp(share * area[-1], area, u), v0 + (v1 - v0) * turn])
