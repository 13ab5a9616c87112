"""Grippers: a palm that covers several receptors, and a jaw with three indenters and load cells.

In the frame of the middle region, as the indenters.
"""

from typing import Any

import numpy as np

from phytac_design.design.documents_table import KitSection
from phytac_design.design.spec import Design
from phytac_design.fabrication.calibration_rig.regions import (
    RADIUS_MIN_mm,
    Regions,
    clear_mm,
    follows,
    frames_at,
)
from phytac_design.fabrication.calibration_rig.tool_solids import (
    LIP_mm,
    OVER_mm,
    bolt_places,
    fitted_indenter,
    rig_places,
    rod,
    tool_height_mm,
)
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import box
from phytac_shapes.arrays import FloatArray


def middle_marker(sensor: Sensor) -> int:
    """Marker farthest from all rims, the nearest to the middle of the markers among equals."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    clear = np.minimum(clear_mm(design, surface, markers.uv), 1e6)
    points = surface.point(markers.uv)
    middle = surface.domain.mean(axis=1)
    off = np.linalg.norm(points - surface.point(middle[None]), axis=1)
    return int(np.lexsort((off, -np.round(clear, 6)))[0])


def palm_radius_mm(sensor: Sensor, marker: int) -> float:
    """Radius of the palm's face at a marker: as large as curvature, edges and rims let it be."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    curved_share = 0.6  # largest radius of the palm over the surface's radius of curvature
    palm_share = 2.0  # radius of the palm over that of the largest patch
    narrower = 0.9  # radii that would hang over an edge step down by this
    uv = markers.uv[[marker]]
    room = float(clear_mm(design, surface, uv)[0]) - design.kit.clearance_mm
    reach = float(surface.reach_mm(uv)[0])
    wanted = palm_share * design.training.patch_radius_max_mm
    radius = float(min(wanted, room, curved_share * reach))
    while radius >= RADIUS_MIN_mm and not follows(surface, uv, radius)[0]:
        radius *= narrower
    return radius


def palm(sensor: Sensor, tolerance_mm: float) -> Any:
    """Wide indenter over several receptors; None if rims or edges are too near for one."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    marker = middle_marker(sensor)
    radius = palm_radius_mm(sensor, marker)
    if radius < RADIUS_MIN_mm:
        return None
    return fitted_indenter(surface, markers.uv[marker], radius, design.kit, tolerance_mm)


def three_markers(sensor: Sensor, regions: Regions) -> tuple[int, ...]:
    """Three regions that one jaw can press at once, the middle one first; () if there are none.

    Their load cells must stand side by side and their normals within ``lean_max_deg``.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    lean_max_deg = 10.0  # normals of a jaw's regions may differ by this much from the middle one
    if not regions.faces:
        return ()
    points, normal = surface.point(markers.uv), markers.normal
    middle = middle_marker(sensor)
    room = 2.0 * post_mm(design.kit)
    wide = regions.faces[0].radius_mm + design.kit.clearance_mm
    fits = clear_mm(design, surface, markers.uv) >= wide
    away = points - points[middle]
    far = np.linalg.norm(away, axis=1)
    lean = normal @ normal[middle] >= np.cos(np.radians(lean_max_deg))
    least, most = _apart_mm(design, points, normal, middle)
    # Posts stand apart by what can be printed, or run into each other, but into no seat.
    apart = least >= room + design.print_rules.gap_min_mm
    apart |= (most <= room) & (least >= room - LIP_mm[0])
    near = np.flatnonzero(fits & lean & (far >= room) & apart)
    best: tuple[float, tuple[int, ...]] = (np.inf, ())
    for one in near[np.argsort(far[near], kind="stable")][:60].tolist():
        opposite = near[np.linalg.norm(away[near] + away[one], axis=1) < 0.3 * far[one]]
        for other in opposite[:8].tolist():
            length = float(far[one] + far[other])
            if length < best[0] - 1e-9:
                best = (length, (middle, one, other))
    return best[1]


def post_mm(kit: KitSection) -> float:
    """Outer radius of a load cell's seat and of the post that carries it."""
    return 0.5 * kit.cell_diameter_mm + kit.clearance_mm + LIP_mm[0]


def _apart_mm(
    design: Design, points: FloatArray, normal: FloatArray, middle: int
) -> tuple[FloatArray, FloatArray]:
    """Least and greatest distance of load cells' axes from the middle one, seat to slab, (n,)."""
    seat = tool_height_mm(design.kit) + design.kit.cell_height_mm
    levels = np.array([seat - LIP_mm[1], seat + design.kit.seat_mm])
    at = points + levels[:, None, None] * normal
    apart = np.linalg.norm(at - at[:, [middle]], axis=2)
    return np.asarray(apart.min(axis=0)), np.asarray(apart.max(axis=0))


def jaw(
    sensor: Sensor, regions: Regions, tolerance_mm: float
) -> tuple[Any, tuple[int, ...]] | None:
    """Jaw with seats for three load cells with fitted indenters; None if no three fit.

    Returns
    -------
    body : manifold3d.Manifold
        The jaw, in the frame of the middle region.
    markers : tuple of int
        Regions that its indenters press, the middle one first.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    chosen = three_markers(sensor, regions)
    if not chosen:
        return None
    kit = design.kit
    frame = frames_at(surface, markers.uv[[chosen[0]]])[0]
    ids = list(chosen)
    points = (surface.point(markers.uv[ids]) - surface.point(markers.uv[[chosen[0]]])) @ frame
    normal = markers.normal[ids] @ frame
    turns = np.einsum("ij,njk->nik", frame.T, frames_at(surface, markers.uv[ids]))
    seat = points + (tool_height_mm(kit) + kit.cell_height_mm) * normal
    slab = float(seat[:, 2].max()) + kit.seat_mm
    post = post_mm(kit)
    # Around the rig's screws too; the middle post is at the origin.
    reach = np.maximum(np.abs(seat[:, :2]).max(axis=0) + post, 0.5 * kit.rig_bolt_square_mm + 5.0)
    body = box(np.array([*-reach, slab]), np.array([*reach, slab + kit.seat_mm]))
    tall = (slab + 0.5 * kit.seat_mm - seat[:, 2]) / normal[:, 2]
    inner = post - LIP_mm[0]
    for k in range(len(ids)):
        start, up = seat[k], normal[k]
        lip = start - LIP_mm[1] * up
        ring = rod(lip, start + up, post, tolerance_mm)
        ring = ring - rod(lip - OVER_mm * up, start, inner, tolerance_mm)
        body = body + rod(start, start + tall[k] * up, post, tolerance_mm) + ring
    for k in range(len(ids)):
        places = np.column_stack([bolt_places(kit), np.zeros(kit.cell_bolts)])
        at = seat[k] + places @ turns[k].T
        through = (tall[k] + kit.seat_mm + 2.0 * OVER_mm) * normal[k]
        holes = rod(
            at - OVER_mm * normal[k], at + through, 0.5 * kit.cell_bolt_hole_mm, tolerance_mm
        )
        body = body - holes
    if not _rig_fits(design, seat):
        return None
    rig: FloatArray = np.column_stack([rig_places(kit), np.full(4, -OVER_mm)])
    rise = np.array([0.0, 0.0, slab + kit.seat_mm + 2.0 * OVER_mm])
    body = body - rod(rig, rig + rise, 0.5 * kit.rig_bolt_hole_mm, tolerance_mm)
    return body, chosen


def _rig_fits(design: Design, seat: FloatArray) -> bool:
    """Whether the rig's screws pass beside all load cells."""
    kit = design.kit
    gap = np.linalg.norm(rig_places(kit)[:, None] - seat[None, :, :2], axis=2)
    least = 0.5 * kit.cell_diameter_mm + kit.clearance_mm + 0.5 * kit.rig_bolt_hole_mm
    return bool(gap.min() > least)
