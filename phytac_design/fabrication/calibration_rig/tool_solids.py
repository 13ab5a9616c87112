"""Small solids that the kit is made of, as ``manifold3d`` bodies.

Tools stand in their own frame: z along the outward normal of the pressed region, z = 0 on the
outer face, the face of the tool at the bottom.
"""

from typing import Any

import numpy as np

from phytac_design.design.documents_table import KitSection
from phytac_design.fabrication.calibration_rig.regions import disc_places, heights_mm
from phytac_design.fabrication.switch_set import revolve
from phytac_design.geometry.triangles import (
    TriangleMesh,
    grid_triangles,
    prisms,
    sides_for,
    strip_triangles,
)
from phytac_design.solids.solid_mesh import box, to_manifold
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

FACE_RINGS, FACE_SECTORS = 12, 72
OVER_mm = 1.0
"""How far cutters run past what they cut."""


def rod(start: FloatArray, end: FloatArray, radius_mm: float, tolerance_mm: float) -> Any:
    """Round rods between points (n, 3)."""
    sides = sides_for(radius_mm, tolerance_mm)
    return to_manifold(prisms(np.atleast_2d(start), np.atleast_2d(end), radius_mm, sides))


def bolt_places(kit: KitSection) -> FloatArray:
    """Screws of the load cell, (n, 2) mm around its axis, clear of the notch on x."""
    if kit.cell_bolts == 1:
        return np.zeros((1, 2))
    angle = 2.0 * np.pi * (np.arange(kit.cell_bolts) + 0.5) / kit.cell_bolts
    return 0.5 * kit.cell_bolt_circle_mm * np.column_stack([np.cos(angle), np.sin(angle)])


def bolt_cutters(kit: KitSection, low: float, high: float, tolerance_mm: float) -> Any:
    """Holes for the load cell's screws between two heights."""
    places = bolt_places(kit)
    start = np.column_stack([places, np.full(len(places), low)])
    end = np.column_stack([places, np.full(len(places), high)])
    return rod(start, end, 0.5 * kit.cell_bolt_hole_mm, tolerance_mm)


def neck_mm(kit: KitSection) -> float:
    """Greatest radius of a shaft that leaves room for the screws' heads."""
    head_share = 1.0  # radius of a screw's head over the diameter of its hole
    if kit.cell_bolts == 1:
        return 0.5 * kit.cell_diameter_mm
    return 0.5 * kit.cell_bolt_circle_mm - head_share * kit.cell_bolt_hole_mm


def tool_height_mm(kit: KitSection) -> float:
    """From the pressed face to the flange's back, where the load cell sits."""
    return kit.shaft_mm + kit.seat_mm


def fitted_face(surface: Surface, uv: FloatArray, radius_mm: float, top_mm: float) -> Any:
    """Rod of a radius whose lower end is the outer face itself around ``uv`` (2,)."""
    places = disc_places(radius_mm, rings=FACE_RINGS, sectors=FACE_SECTORS)
    height = heights_mm(surface, uv[None], places)[0]
    if not np.isfinite(height).all():
        raise NumericalError(
            "indenter-off-face",
            f"an indenter of radius {radius_mm:.3g} mm cannot follow the outer face at (u, v) = "
            f"({uv[0]:.4g}, {uv[1]:.4g}), which is too steep there; lower "
            "training.patch_radius_min_mm",
        )
    face = np.column_stack([places, height])
    ids = np.arange(FACE_RINGS * FACE_SECTORS).reshape(FACE_RINGS, FACE_SECTORS)
    centre = FACE_RINGS * FACE_SECTORS
    rim = face[ids[-1]].copy()
    rim[:, 2] = top_mm
    top = centre + 1 + np.arange(FACE_SECTORS)
    last = centre + 1 + FACE_SECTORS
    points = np.concatenate([face, rim, [[0.0, 0.0, top_mm]]])
    grid = np.concatenate([np.full((1, FACE_SECTORS), centre), ids])
    bottom = grid_triangles(grid, closed=True)
    side = strip_triangles(top, ids[-1])
    lid = strip_triangles(np.full(FACE_SECTORS, last), top)
    mesh = TriangleMesh(vertices_mm=points, triangles=np.concatenate([bottom, side, lid]))
    return to_manifold(mesh if mesh.volume_mm3 > 0.0 else mesh.flipped())


def with_flange(body: Any, kit: KitSection, radius_mm: float, tolerance_mm: float) -> Any:
    """Add neck, flange, screw holes and the notch to a tool's end of a radius.

    The end reaches up past the middle of the shaft; wider ends are drawn in to the neck there.
    """
    key_mm = 1.0  # radius of the notch that shows where u grows
    high, middle = kit.shaft_mm, 0.5 * kit.shaft_mm
    neck = min(radius_mm, neck_mm(kit))
    outer = max(0.5 * kit.cell_diameter_mm, neck + 1.0)
    profile = [[0.0, high + kit.seat_mm], [outer, high + kit.seat_mm], [outer, high]]
    profile += [[neck, high], [neck, middle], [0.0, middle]]
    body = body + to_manifold(revolve(np.array(profile), tolerance_mm))
    body = body - bolt_cutters(
        kit, high - OVER_mm * (kit.cell_bolts > 1), high + kit.seat_mm + OVER_mm, tolerance_mm
    )
    key = np.array([outer, 0.0, high - OVER_mm])
    return body - rod(
        key, key + np.array([0.0, 0.0, kit.seat_mm + 2.0 * OVER_mm]), key_mm, tolerance_mm
    )


def fitted_indenter(
    surface: Surface, uv: FloatArray, radius_mm: float, kit: KitSection, tolerance_mm: float
) -> Any:
    """Indenter whose face is the negative of the outer face around ``uv`` (2,)."""
    places = disc_places(radius_mm)
    least = float(heights_mm(surface, uv[None], places).max())
    top = max(0.5 * kit.shaft_mm + 0.5, least + OVER_mm)
    return with_flange(fitted_face(surface, uv, radius_mm, top), kit, radius_mm, tolerance_mm)


def flat_indenter(radius_mm: float, kit: KitSection, tolerance_mm: float) -> Any:
    """Indenter with a flat face."""
    top = 0.5 * kit.shaft_mm + 0.5
    profile = np.array([[0.0, top], [radius_mm, top], [radius_mm, 0.0], [0.0, 0.0]])
    end = to_manifold(revolve(profile, tolerance_mm))
    return with_flange(end, kit, radius_mm, tolerance_mm)


def ball_indenter(radius_mm: float, kit: KitSection, tolerance_mm: float) -> Any:
    """Indenter with a round face: half a ball on its shaft."""
    steps = max(8, sides_for(radius_mm, tolerance_mm) // 4)
    angle = np.linspace(0.0, np.pi / 2.0, steps + 1)
    ball = np.column_stack([np.cos(angle), 1.0 - np.sin(angle)]) * radius_mm
    ball[-1, 0] = 0.0
    top = max(0.5 * kit.shaft_mm, radius_mm) + 0.5
    profile = np.concatenate([[[0.0, top], [radius_mm, top]], ball])
    end = to_manifold(revolve(profile, tolerance_mm))
    return with_flange(end, kit, radius_mm, tolerance_mm)


def rig_places(kit: KitSection) -> FloatArray:
    """Screws of the rig's carriage, (4, 2) mm around the load cell's axis."""
    return 0.5 * kit.rig_bolt_square_mm * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])


LIP_mm = (1.2, 1.5)
"""Width and height of the ring that centres a load cell on its seat."""


def cell_seat(kit: KitSection, tolerance_mm: float) -> Any:
    """Plate between the rig's carriage and the load cell, which a ring centres."""
    reach = 0.5 * kit.rig_bolt_square_mm + 1.5 * kit.rig_bolt_hole_mm
    inner = 0.5 * kit.cell_diameter_mm + kit.clearance_mm
    reach = max(reach, inner + LIP_mm[0])
    plate = box(np.array([-reach, -reach, 0.0]), np.array([reach, reach, kit.seat_mm]))
    low, high = (
        np.array([0.0, 0.0, 0.5 * kit.seat_mm]),
        np.array([0.0, 0.0, kit.seat_mm + LIP_mm[1]]),
    )
    ring = rod(low, high, inner + LIP_mm[0], tolerance_mm)
    over = np.array([0.0, 0.0, OVER_mm])
    ring = ring - rod(np.array([0.0, 0.0, kit.seat_mm]), high + over, inner, tolerance_mm)
    body = plate + ring
    body = body - bolt_cutters(kit, -OVER_mm, kit.seat_mm + OVER_mm, tolerance_mm)
    rig = np.column_stack([rig_places(kit), np.full(4, -OVER_mm)])
    up = np.array([0.0, 0.0, kit.seat_mm + LIP_mm[1] + 2.0 * OVER_mm])
    return body - rod(rig, rig + up, 0.5 * kit.rig_bolt_hole_mm, tolerance_mm)
