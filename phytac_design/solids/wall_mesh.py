r"""The wall with its rims as a closed mesh, made from the surface interface alone.

Square to an open edge the wall looks like this; a rim stands along every one::

      offset  +flange  4--3                          3--4     "extension" is measured from the
                       |  |         outer face       |  |     end of the sensing surface along
                    0  |  2--------------------------2  |     its conormal (tangent to the
                       |                                |     surface, square to the boundary)
            -thickness 5--6--------------------------6--5
                       rim           inner face      rim      u ->

Each number is a ring of points around a loop of open edges; strips of triangles join the rings.
At a pole the faces close in a fan.
"""

from itertools import pairwise

import numpy as np

from phytac_design.design.spec import WallSection
from phytac_design.geometry.boundary_loops import Loop, chart_loops
from phytac_design.geometry.triangles import TriangleMesh, grid_triangles, strip_triangles
from phytac_design.geometry.wall_sampling import chart_stations
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


def wall_mesh(
    surface: Surface, wall: WallSection, *, tolerance_mm: float, lift_mm: float = 0.0
) -> TriangleMesh:
    """Closed mesh of the wall and its rims, within ``tolerance_mm`` of the true faces.

    Corners are moved off the true face, by two thirds of the sag of the chords that meet there,
    which gives each cross-section the area of the true one (for a circle:
    r' = r·sqrt(θ / sin θ), θ = 2π/n, to fourth order; derived here). ``lift_mm`` moves all of it
    outwards.

    Raises
    ------
    DesignError
        If the surface is no tube, dome or sheet, or a rim folds on itself.
    """
    sampled = wall.model_copy(update={"rim_flange_mm": wall.rim_flange_mm + lift_mm})
    u, v = chart_stations(surface, sampled, tolerance_mm)
    loops = chart_loops(surface, u, v)
    ids = _grid_ids(surface, len(u), len(v))
    count = ids.size
    inner_ids = ids + count
    points = [_face(surface, u, v, lift_mm - depth) for depth in (0.0, wall.thickness_mm)]
    triangles = [
        grid_triangles(ids, closed=surface.periodic[1]),
        grid_triangles(inner_ids, closed=surface.periodic[1])[:, ::-1],
    ]
    used = 2 * count
    rings = _rings(wall)
    for loop in loops:
        own = [ids.ravel()[loop.index]]
        for offset, extension in rings:
            ring = _ring(surface, loop, lift_mm + offset, extension)
            # On the edge itself the stations of a mitre are one point.
            same = np.unique(loop.index, return_inverse=True)[1]
            place = np.arange(len(ring)) if extension > 0.0 else same
            block = np.zeros((int(place.max()) + 1, 3))
            block[place] = ring
            own.append(used + place)
            points.append(block)
            used += len(block)
        own.append(inner_ids.ravel()[loop.index])
        # The last strip faces the first two: on the same diagonals, twisted cells cancel.
        last = len(own) - 2
        triangles += [
            strip_triangles(a, b, mirrored=bool(rings) and k == last)
            for k, (a, b) in enumerate(pairwise(own))
        ]
    return _compact(np.concatenate(points), np.concatenate(triangles))


def _rings(wall: WallSection) -> list[tuple[float, float]]:
    """(offset, extension) of the rim's rings, from the outer face around to the inner one."""
    rim, flange = wall.rim_length_mm, wall.rim_flange_mm
    if rim == 0.0:
        return []
    step = [(flange, 0.0)] if flange > 0.0 else []
    return [*step, (flange, rim), (-wall.thickness_mm, rim)]


def _grid_ids(surface: Surface, rows: int, columns: int) -> IntArray:
    """Vertex ids of the grid, (rows, columns): one for all of a pole."""
    ids = np.arange(rows * columns).reshape(rows, columns)
    for end in (0, 1):
        if surface.poles[end]:
            ids[-end] = ids[-end, 0]
    return ids


def _compact(vertices: FloatArray, triangles: IntArray) -> TriangleMesh:
    used, renumbered = np.unique(triangles, return_inverse=True)
    return TriangleMesh(
        vertices_mm=vertices[used], triangles=renumbered.reshape(triangles.shape).astype(np.int64)
    )


def _face(surface: Surface, u: FloatArray, v: FloatArray, offset_mm: float) -> FloatArray:
    """Corners of one face with their lift, (rows · columns, 3)."""
    closed = surface.periodic[1]
    limits = np.append(v, surface.domain[1, 1]) if closed else v

    def at(u: FloatArray, v: FloatArray) -> FloatArray:
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)
        return surface.point(uv.reshape(-1, 2), offset_mm).reshape(*uv.shape[:2], 3)

    points = at(u, v)
    around, along = at(u, (limits[1:] + limits[:-1]) / 2.0), at((u[1:] + u[:-1]) / 2.0, v)
    lift = _lift(np.moveaxis(points, 1, 0), np.moveaxis(around, 1, 0), closed=closed)
    lift = np.moveaxis(lift, 0, 1) + _lift(points, along, closed=False)
    return np.asarray((points + lift).reshape(-1, 3))


def _lift(points: FloatArray, middles: FloatArray, *, closed: bool) -> FloatArray:
    """Movement of each corner of polylines that gives them the area of their curves, mm.

    Parameters
    ----------
    points : (n, ..., 3) float
        Corners, the first axis along the lines.
    middles : (n or n - 1, ..., 3) float
        Points of the curves half-way to the next corner; n where the lines close.

    Returns
    -------
    (n, ..., 3) float
        Zero at the ends of open lines.
    """
    after = np.roll(points, -1, axis=0) if closed else points[1:]
    here = points if closed else points[:-1]
    length, area = _slivers(here, middles, after)
    lift = np.zeros_like(points)
    if closed:
        whole = np.maximum(length + np.roll(length, 1, axis=0), 1e-300)
        lift[:] = (area + np.roll(area, 1, axis=0)) / whole
    else:
        whole = np.maximum(length[1:] + length[:-1], 1e-300)
        lift[1:-1] = (area[1:] + area[:-1]) / whole
    return lift


def _slivers(
    here: FloatArray, middle: FloatArray, after: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Length of each chord, (..., 1), and area between it and its curve as a vector, (..., 3)."""
    chord = after - here
    length = np.linalg.norm(chord, axis=-1, keepdims=True)
    along = chord / np.maximum(length, 1e-300)
    sag = middle - (here + after) / 2.0
    sag = sag - np.sum(sag * along, axis=-1, keepdims=True) * along
    return length, 2.0 / 3.0 * sag * length


def _ring(surface: Surface, loop: Loop, offset_mm: float, extension_mm: float) -> FloatArray:
    """Points of a rim's ring with their lift, (s, 3); corners of a sheet stay."""
    points = loop.points_mm(surface, offset_mm, extension_mm)
    after = np.roll(points, -1, axis=0)
    _refuse_fold(surface, loop, after - points, extension_mm)
    middles = loop.middles_mm(surface, offset_mm, extension_mm)
    length, area = _slivers(points, middles, after)
    both = (loop.along_edge & np.roll(loop.along_edge, 1))[:, None]
    whole = np.maximum(length + np.roll(length, 1, axis=0), 1e-300)
    return np.asarray(points + np.where(both, (area + np.roll(area, 1, axis=0)) / whole, 0.0))


def _refuse_fold(surface: Surface, loop: Loop, steps: FloatArray, extension_mm: float) -> None:
    base = surface.point(loop.uv)
    edge = np.roll(base, -1, axis=0) - base
    ahead = np.einsum("ni,ni->n", steps, edge) > 0.0
    if not ahead[loop.along_edge].all():
        raise DesignError(
            "rim-folds",
            f"the rim of the {surface.name} folds on itself: {extension_mm:g} mm beyond the end "
            "of the surface its sides have met; lower wall.rim_length_mm",
        )
