"""Dents of the wall of a given depth, without mechanics, for line-of-sight heights under load.

A dent is a bell, ``w = depth · exp(-r² / 2 s²)`` along the inward normal, r the distance from its
middle and ``s = radius / 2``; the wall leans by its slope. The user gives depth and
radius; a press of the sensor shows them at a force.
"""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.markers import Markers
from phytac_design.layout.worst_places import press_places
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray


def dent_motions(
    design: Design, surface: Surface, markers: Markers, *, dents: int = 40
) -> FloatArray | None:
    """Translation (mm) and rotation (rad) under each marker (p, n, 6); None without a dent.

    At most ``dents`` are spread over the surface. Where rows are rings of equal markers dents in
    one sector represent all.
    """
    layout = design.layout
    if layout.sight_dent_mm <= 0.0:
        return None
    level = np.zeros(markers.count)
    uv = press_places(surface, markers, level, dents, repeats=_rings(markers))
    middle = surface.point(uv, -design.wall.thickness_mm / 2.0)
    away = markers.mid_mm[None] - middle[:, None]
    width = layout.sight_dent_radius_mm / 2.0
    depth = layout.sight_dent_mm * np.exp(-np.sum(away**2, axis=2) / (2.0 * width**2))
    slope = depth[..., None] / width**2 * away
    inward = np.broadcast_to(-markers.normal, away.shape)
    return np.concatenate([depth[..., None] * inward, np.cross(slope, markers.normal)], axis=2)


def _rings(markers: Markers) -> bool:
    """Whether each row of the lattice is a ring about the axis."""
    round_tol_mm = 1e-6
    if markers.lattice is None:
        return False
    columns = markers.lattice.columns
    place = np.column_stack([np.hypot(*markers.mid_mm[:, :2].T), markers.mid_mm[:, 2]])
    return bool(np.ptp(place.reshape(-1, columns, 2), axis=1).max() < round_tol_mm)
