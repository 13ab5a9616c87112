"""Wall of any sheet (open both ways) as CAD: spline faces, ruled rims and flat mitres, sewn."""

from itertools import pairwise
from typing import Any

import numpy as np

from phytac_design.design.spec import WallSection
from phytac_design.geometry.boundary_loops import chart_loops, conormals
from phytac_design.solids.cad_kernel import cadquery
from phytac_design.solids.cad_spline import cells_for, flat_face, spline_face
from phytac_design.solids.wall_mesh import wall_mesh
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import NumericalError


def sheet_wall(surface: Surface, wall: WallSection) -> Any:
    """Wall and rims of a sheet as a CadQuery solid, within ``cad_spline.FIT_mm``.

    Raises
    ------
    DesignError
        If a rim folds on itself.
    NumericalError
        If the faces do not close to one solid.
    """
    coarse_mm = 0.5
    sewing_mm = 1e-5  # gap that sewing closes: faces share their edges exactly, up to rounding
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeSolid, BRepBuilderAPI_Sewing
    from OCP.BRepLib import BRepLib
    from OCP.TopAbs import TopAbs_SHELL
    from OCP.TopoDS import TopoDS

    cq = cadquery()
    wall_mesh(surface, wall, tolerance_mm=coarse_mm)  # raises if a rim folds
    sewing = BRepBuilderAPI_Sewing(sewing_mm)
    for face in sheet_faces(surface, wall):
        sewing.Add(face)
    sewing.Perform()
    shell = sewing.SewedShape()
    if shell.ShapeType() != TopAbs_SHELL or sewing.NbFreeEdges() > 0:
        raise NumericalError(
            "cad-faces-open",
            f"the CAD faces of the {surface.name} do not close ({sewing.NbFreeEdges()} free "
            "edges); please report this design",
        )
    solid = BRepBuilderAPI_MakeSolid(TopoDS.Shell_s(shell)).Solid()
    BRepLib.OrientClosedSolid_s(solid)
    return cq.Solid(solid)


def stations(surface: Surface, wall: WallSection, axis: int) -> FloatArray:
    """Chart stations along ``axis`` whose splines keep to the wall's faces and rims."""
    low, high = surface.domain[axis]
    first, last = surface.domain[1 - axis]
    across = np.linspace(first, last, 9)  # lines of each face by which the samples are chosen

    def lines(t: FloatArray) -> FloatArray:
        along = low + t * (high - low)
        out = []
        for other in across:
            uv = np.full((len(t), 2), other)
            uv[:, axis] = along
            out += [surface.point(uv), surface.point(uv, -wall.thickness_mm)]
        for end in (0, 1):
            uv = np.full((len(t), 2), surface.domain[1 - axis, end])
            uv[:, axis] = along
            rim = wall.rim_length_mm * conormals(surface, uv, 1 - axis, end)
            for offset in (-wall.thickness_mm, wall.rim_flange_mm):
                out.append(surface.point(uv, offset) + rim)
        return np.stack(out, axis=1)

    # Where the chart counts the points of a spline its pieces are one unit long.
    span = high - low
    knots = int(span) if float(span).is_integer() and span <= 64.0 else 1
    return np.linspace(low, high, cells_for(lines, knots) + 1)


def sheet_faces(surface: Surface, wall: WallSection) -> list[Any]:
    """Faces of the whole boundary, each once."""
    u, v = stations(surface, wall, 0), stations(surface, wall, 1)
    inner, rim, flange = -wall.thickness_mm, wall.rim_length_mm, wall.rim_flange_mm
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)
    faces = [
        spline_face(surface.point(uv.reshape(-1, 2), offset).reshape(*uv.shape[:2], 3))
        for offset in (0.0, inner)
    ]
    if rim == 0.0:
        section = [(0.0, 0.0), (inner, 0.0)]
    elif flange > 0.0:
        section = [(0.0, 0.0), (flange, 0.0), (flange, rim), (inner, rim), (inner, 0.0)]
    else:
        section = [(0.0, 0.0), (0.0, rim), (inner, rim), (inner, 0.0)]
    (loop,) = chart_loops(surface, u, v)
    curves = [loop.points_mm(surface, *corner) for corner in section]
    for start, stop in _edges_of(loop.along_edge):
        strips = (np.stack(pair)[:, start : stop + 1] for pair in pairwise(curves))
        faces += [spline_face(strip) for strip in strips]
    if rim > 0.0:
        # Stations at a corner: last of an edge, mitre, first of the next edge.
        for mitre in np.flatnonzero(~loop.along_edge & ~np.roll(loop.along_edge, 1)):
            three = [mitre - 1, mitre, (mitre + 1) % len(loop.index)]
            faces += _mitre_faces([curve[three] for curve in curves], section)
    return faces


def _edges_of(along_edge: BoolArray) -> list[tuple[int, int]]:
    """First and last station of each edge."""
    starts = np.flatnonzero(along_edge & ~np.roll(along_edge, 1))
    stops = np.flatnonzero(~along_edge & np.roll(along_edge, 1))
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


def _mitre_faces(curves: list[FloatArray], section: list[tuple[float, float]]) -> list[Any]:
    """Flat faces of one corner: two kites and two ends."""
    faces = []
    for k in range(len(section) - 1):
        (_, before), (_, after) = section[k], section[k + 1]
        first, second = curves[k], curves[k + 1]
        if before == 0.0 and after > 0.0:
            faces.append(flat_face(np.concatenate([first[:1], second])))
        elif before > 0.0 and after == 0.0:
            faces.append(flat_face(np.concatenate([first, second[:1]])))
        elif before > 0.0:
            faces += [
                flat_face(np.stack([first[a], first[b], second[b], second[a]]))
                for a, b in ((0, 1), (1, 2))
            ]
    return faces
