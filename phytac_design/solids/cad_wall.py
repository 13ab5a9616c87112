"""Wall and rims of every family as an exact CAD solid, without receptors.

Surfaces of revolution turn their exact profile (lines, arcs, or a spline), boxes are extruded,
pads are blocks; any other sheet is sewn from spline faces.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from phytac_design.design.spec import WallSection
from phytac_design.geometry.boundary_loops import conormals
from phytac_design.solids.cad_kernel import cadquery
from phytac_design.solids.cad_sheet import sheet_wall
from phytac_design.solids.cad_spline import cells_for, spline_edge
from phytac_shapes import Cone, Cuboid, Cylinder, Grip, Hemisphere, Patch, Plane, Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, NumericalError
from phytac_shapes.plane_curves import Arc
from phytac_shapes.revolved import PathRevolved, Revolved

AXIS_TOL_mm = 1e-9
Builder = Callable[[Surface, WallSection], Any]


def wall_cad(surface: Surface, wall: WallSection) -> Any:
    """Wall and rims as a CadQuery solid, by the builder of the surface's family or its base.

    Raises
    ------
    DesignError
        If neither has a builder, or a rim folds.
    NumericalError
        If OpenCASCADE does not return one solid.
    """
    for kind in type(surface).__mro__:
        if kind in WALLS:
            solids = WALLS[kind](surface, wall).Solids()
            if len(solids) != 1:
                raise NumericalError(
                    "cad-wall-disconnected",
                    f"the CAD wall of the {surface.name} falls into {len(solids)} solids; please "
                    "report this design",
                )
            return solids[0]
    known = ", ".join(sorted(kind.name for kind in WALLS if hasattr(kind, "name")))
    raise DesignError(
        "cad-wall-unsupported",
        f"shape {surface.name!r} has no CAD wall (known: {known}); register one in "
        "phytac_design.solids.cad_wall.WALLS, or build without STEP",
    )


def revolved_wall(surface: Surface, wall: WallSection) -> Any:
    """Wall and rims of a surface of revolution, as a CadQuery solid."""
    cq = cadquery()
    rim, flange, inner = wall.rim_length_mm, wall.rim_flange_mm, -wall.thickness_mm
    outer = _face_edges(surface, 0.0)
    back = [_reversed(edge) for edge in reversed(_face_edges(surface, inner))]
    # Rims at the far end, then (after the inner face) at the near one.
    rims: list[list[FloatArray]] = [[], []]
    for end in (0, 1):
        if surface.poles[end] or rim == 0.0:
            continue
        step = [(flange, 0.0)] if flange > 0.0 else []
        corners = [*step, (flange, rim), (inner, rim)]
        rims[end] = [_corner(surface, end, *corner) for corner in corners]
    loop = [*outer, *rims[1], *back, *reversed(rims[0])]
    wire = cq.Wire.assembleEdges(_edges(cq, loop))
    solid = cq.Solid.revolve(wire, [], 360.0, cq.Vector(0, 0, 0), cq.Vector(0, 0, 1))
    if all(len(piece) <= 3 for piece in outer):
        return solid
    # Receptors are fused with a spline face several times faster than with a revolved spline.
    from OCP.BRepBuilderAPI import BRepBuilderAPI_NurbsConvert

    return cq.Solid(BRepBuilderAPI_NurbsConvert(solid.wrapped).Shape())


def _face_edges(surface: Surface, offset_mm: float) -> list[FloatArray]:
    """Pieces of the meridian at an offset, each a (2, 2), (3, 2) or (n > 3, 2) array of (r, z).

    Two points stand for a line, three for an arc through them, more for a spline.
    """
    u0, u1 = surface.domain[0]

    def at(u: FloatArray) -> FloatArray:
        points = surface.point(np.column_stack([u, np.zeros_like(u)]), offset_mm)
        return np.column_stack([points[:, 0], points[:, 2]])

    if isinstance(surface, PathRevolved):
        path = surface.profile
        return [
            at(np.linspace(start, stop, 3 if isinstance(part, Arc) else 2))
            for part, (start, stop) in zip(path.parts, pairwise(path.marks), strict=True)
        ]

    def curve(t: FloatArray) -> FloatArray:
        rz = at(u0 + t * (u1 - u0))
        return np.column_stack([rz, np.zeros(len(rz))])

    knots = len(surface.diameters_mm) - 1 if isinstance(surface, Grip) else 1
    cells = cells_for(curve, knots)
    return [at(np.linspace(u0, u1, cells + 1))]


def _reversed(edge: FloatArray) -> FloatArray:
    return edge[::-1]


def _corner(surface: Surface, end: int, offset_mm: float, extension_mm: float) -> FloatArray:
    """Point (1, 2) of the rim's cross-section in (r, z)."""
    uv = np.array([[surface.domain[0, end], 0.0]])
    p = surface.point(uv, offset_mm) + extension_mm * conormals(surface, uv, 0, end)
    if p[0, 0] <= AXIS_TOL_mm:
        raise DesignError(
            "rim-folds",
            f"the rim of the {surface.name} folds on itself: {extension_mm:g} mm beyond the end "
            "of the surface its sides have met; lower wall.rim_length_mm",
        )
    return np.asarray(p[:, [0, 2]])


def _edges(cq: Any, loop: list[FloatArray]) -> list[Any]:
    """Edges of a closed loop of pieces and points, joined by lines where they do not meet."""

    def vector(rz: FloatArray) -> Any:
        radius = 0.0 if abs(rz[0]) < AXIS_TOL_mm else float(rz[0])
        return cq.Vector(radius, 0.0, float(rz[1]))

    edges = []
    for k, piece in enumerate(loop):
        if len(piece) == 2:
            edges.append(cq.Edge.makeLine(vector(piece[0]), vector(piece[1])))
        elif len(piece) == 3:
            edges.append(cq.Edge.makeThreePointArc(*(vector(point) for point in piece)))
        elif len(piece) > 3:
            points = np.column_stack([piece[:, 0], np.zeros(len(piece)), piece[:, 1]])
            edges.append(cq.Edge(spline_edge(points)))
        following = loop[(k + 1) % len(loop)][0]
        if np.linalg.norm(following - piece[-1]) > AXIS_TOL_mm:
            edges.append(cq.Edge.makeLine(vector(piece[-1]), vector(following)))
    return edges


def cuboid_wall(surface: Surface, wall: WallSection) -> Any:
    """Rounded box, open at both ends, with its rims."""
    assert isinstance(surface, Cuboid)  # noqa: S101 - by the registry below
    cq = cadquery()

    def block(offset: float, low: float, high: float) -> Any:
        width, depth = surface.width_mm + 2.0 * offset, surface.depth_mm + 2.0 * offset
        return (
            cq.Workplane("XY", origin=(0.0, 0.0, low))
            .rect(width, depth)
            .extrude(high - low)
            .edges("|Z")
            .fillet(surface.edge_radius_mm + offset)
            .val()
        )

    length, rim = surface.length_mm, wall.rim_length_mm
    body = block(0.0, 0.0, length)
    if rim > 0.0:
        near, far = (block(wall.rim_flange_mm, z, z + rim) for z in (-rim, length))
        body = body.fuse(near, far).clean()
    # A cutter beyond both ends leaves no face in common.
    return body.cut(block(-wall.thickness_mm, -rim - 1.0, length + rim + 1.0))


def plane_wall(surface: Surface, wall: WallSection) -> Any:
    """Flat pad with its frame."""
    assert isinstance(surface, Plane)  # noqa: S101 - by the registry below
    cq = cadquery()
    rim = wall.rim_length_mm

    def block(extension: float, low: float, high: float) -> Any:
        width, height = surface.width_mm + 2.0 * extension, surface.height_mm + 2.0 * extension
        corner = cq.Vector(-width / 2.0, -height / 2.0, low)
        return cq.Solid.makeBox(width, height, high - low, corner)

    if rim > 0.0 and wall.rim_flange_mm > 0.0:
        body = block(rim, -wall.thickness_mm, wall.rim_flange_mm)
        body = body.cut(block(0.0, 0.0, wall.rim_flange_mm + 1.0))
    else:
        body = block(rim, -wall.thickness_mm, 0.0)
    return body.rotate(cq.Vector(0, 0, 0), cq.Vector(1, 0, 0), surface.tilt_deg)


WALLS: dict[type[Any], Builder] = {
    Cylinder: revolved_wall,
    Cone: revolved_wall,
    Hemisphere: revolved_wall,
    Grip: revolved_wall,
    Revolved: revolved_wall,
    Cuboid: cuboid_wall,
    Plane: plane_wall,
    Patch: sheet_wall,
}
"""CAD of the wall for each surface family; a new family adds its builder, or has its base's."""
