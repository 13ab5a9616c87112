"""Jigs that hold the sensor where the program expects it: a collar for tubes, plates for others."""

from typing import Any

import numpy as np

from phytac_design.design.spec import Design, WallSection
from phytac_design.fabrication.calibration_rig.regions import Regions
from phytac_design.fabrication.calibration_rig.tool_solids import OVER_mm, rod
from phytac_design.geometry.boundary_loops import conormals
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import extruded_manifold, to_manifold
from phytac_design.solids.wall_mesh import wall_mesh
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray

NOTCH_mm, FIRST_mm = 1.0, 1.6
"""Radius of the notches; column 0 has the wider one."""
PLATE_mm = 3.0
"""Thickness of a hole plate."""


def is_tube(surface: Surface) -> bool:
    """Whether a surface closes around and is open at both ends."""
    return surface.periodic[1] and not any(surface.poles)


def has_rims(design: Design) -> bool:
    """Whether rims stand out of the outer face, for the jig to hold."""
    return design.wall.rim_length_mm > 0.0 and design.wall.rim_flange_mm > 0.0


def _outline(surface: Surface, offset_mm: float, extensions: tuple[float, ...]) -> FloatArray:
    """Largest section (around, 2) of the near rim square to the axis, at an offset."""
    around = 360
    (u0, _), (v0, v1) = surface.domain
    v = np.linspace(v0, v1, 4 * around, endpoint=False)
    uv = np.column_stack([np.full(len(v), u0), v])
    out, base = conormals(surface, uv, 0, 0), surface.point(uv, offset_mm)
    angle = 2.0 * np.pi * np.arange(around) / around
    reach = np.zeros(around)
    for extension in extensions:
        x, y, _ = (base + extension * out).T
        own = np.argsort(np.arctan2(y, x))
        turn, radius = np.arctan2(y, x)[own], np.hypot(x, y)[own]
        reach = np.maximum(reach, np.interp(angle, turn, radius, period=2.0 * np.pi))
    return np.asarray(reach[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def _ring(inner: FloatArray, outer: FloatArray, low: float, high: float) -> Any:
    """Solid between two outlines (k, 2) and two heights."""
    hole = extruded_manifold(inner, low - OVER_mm, high + OVER_mm)
    return extruded_manifold(outer, low, high) - hole


def collar(sensor: Sensor, tolerance_mm: float) -> Any:
    """Ring around the near rim of a tube, with a notch for each column of its first row.

    The rim stands on a ledge; column 0 has the wider notch. In the sensor's frame.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    stop_mm = 2.0  # thickness of the ledge that the rim stands on
    collar_mm = 8.0  # width of the collar around the rim
    wall, gap = design.wall, design.kit.clearance_mm
    ends = (0.0, wall.rim_length_mm)
    inner = _outline(surface, wall.rim_flange_mm + gap, ends)
    ledge = _outline(surface, -0.5 * wall.thickness_mm, ends)
    radius = float(np.linalg.norm(inner, axis=1).max()) + collar_mm
    outer = inner / np.linalg.norm(inner, axis=1, keepdims=True) * radius
    (u0, _), (v0, _) = surface.domain
    corner = np.array([[u0, v0]])
    way = wall.rim_length_mm * conormals(surface, corner, 0, 0)
    sides = [surface.point(corner, at)[0, 2] for at in (-wall.thickness_mm, wall.rim_flange_mm)]
    foot, top = float(min(sides) + way[0, 2]), float(sides[1])
    body = _ring(inner, outer, foot - stop_mm, top) + _ring(ledge, outer, foot - stop_mm, foot)
    first = np.flatnonzero(markers.row == markers.row.min())
    points = surface.point(markers.uv[first])
    angle = np.arctan2(points[:, 1], points[:, 0])
    at = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    start = np.column_stack([at, np.full(len(at), foot - stop_mm - OVER_mm)])
    up = np.array([0.0, 0.0, top - foot + stop_mm + 2.0 * OVER_mm])
    wide = markers.column[first] == markers.column[first].min()
    for own, size in ((~wide, NOTCH_mm), (wide, FIRST_mm)):
        if own.any():
            body = body - rod(start[own], start[own] + up, size, tolerance_mm)
    return body


def plate_sets(
    surface: Surface, markers: Markers, regions: Regions, gap_mm: float
) -> list[IntArray]:
    """Regions (indices) that share a hole plate: as few plates as keep holes apart."""
    bridge_mm = 1.2  # least material between two holes of a plate
    if len(regions.marker) == 0:
        return []
    points = surface.point(markers.uv[regions.marker])
    radius = np.array([face.radius_mm for face in regions.faces])[regions.face] + gap_mm
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    close = apart < radius[:, None] + radius[None] + bridge_mm
    np.fill_diagonal(close, False)
    colour = np.full(len(points), -1)
    for k in np.argsort(-close.sum(axis=1), kind="stable"):
        taken = set(colour[close[k]].tolist())
        colour[k] = next(c for c in range(len(points)) if c not in taken)
    return [np.flatnonzero(colour == c) for c in range(int(colour.max()) + 1)]


def hole_plates(
    sensor: Sensor, regions: Regions, bowl_mm: float, tolerance_mm: float
) -> list[tuple[Any, IntArray]]:
    """Plates that lie over a sheet or dome, each with holes along the normals of its regions.

    A sheet's plate rests on the rims and grips them from outside; a dome's is a cap that stands
    beside the sensor on the same plane. In the sensor's frame.

    Parameters
    ----------
    bowl_mm : float
        How far the bowls of the switches stand out of the outer face.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    blank = _blank(design, surface, bowl_mm, tolerance_mm)
    gap = design.kit.clearance_mm
    lift = _lift_mm(design, bowl_mm)
    out = []
    for own in plate_sets(surface, markers, regions, gap):
        body = blank
        for face in np.unique(regions.face[own]):
            uv = markers.uv[regions.marker[own[regions.face[own] == face]]]
            size = regions.faces[face].radius_mm + gap
            deep, high = surface.point(uv), surface.point(uv, lift + PLATE_mm + 2.0 * OVER_mm)
            body = body - rod(deep, high, size, tolerance_mm)
        out.append((body, own))
    return out


def _lift_mm(design: Design, bowl_mm: float) -> float:
    above_mm = 0.4  # gap between a plate and the bowls below it
    return max(bowl_mm, design.wall.rim_flange_mm) + above_mm


def _blank(design: Design, surface: Surface, bowl_mm: float, tolerance_mm: float) -> Any:
    past_mm = 0.15  # how far room for the bowls reaches past the ends of the sensing surface
    rest_mm = 0.05  # play of a plate on the rims
    lip_mm = 2.0
    wall, gap = design.wall, design.kit.clearance_mm
    lift = _lift_mm(design, bowl_mm)
    flange = wall.rim_flange_mm if has_rims(design) else 0.0
    rim = wall.rim_length_mm

    def slab(low: float, high: float, extension: float) -> Any:
        section = WallSection(thickness_mm=high - low, rim_length_mm=extension, rim_flange_mm=0.0)
        mesh = wall_mesh(surface, section, tolerance_mm=tolerance_mm, lift_mm=high)
        return to_manifold(mesh)

    # A little beyond the ends: sides on lines of the other solids would leave slivers.
    over = slab(-OVER_mm - wall.thickness_mm, lift, past_mm)
    if any(surface.poles):
        whole = slab(0.0, lift + PLATE_mm, rim)
        return whole - over - slab(-OVER_mm - wall.thickness_mm, flange + gap, rim + OVER_mm)
    whole = slab(-wall.thickness_mm, lift + PLATE_mm, rim + gap + lip_mm)
    return whole - over - slab(-OVER_mm - wall.thickness_mm, flange + rest_mm, rim + gap)
