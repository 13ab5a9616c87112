r"""Open edges of a chart as closed loops of stations: where rims stand, for print and for picture.

A tube has two loops, a dome one, a sheet one that runs around its four edges. Each station has
the direction in which a rim extends: the conormal of its edge (tangent to the surface, square to
the edge). At the corner of a sheet both edges' rims meet in a mitre, a flat kite in the tangent
plane::

      corner p *-----* p + e·c1        e: extension
               |      \                c1, c2: conormals of the two edges
               |       \               mitre m = (c1 + c2) / (1 + c1·c2)
      p + e·c2 *--------* p + e·m
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class Loop:
    """Stations of a closed loop, the surface on its left seen from outside; s stations.

    Attributes
    ----------
    index : (s,) int
        Node ``row · columns + column`` of the chart's grid at each station.
    uv : (s, 2) float
        Chart coordinates.
    out : (s, 3) float
        Movement of a rim's point for each millimetre of extension; unit but on a mitre.
    middle_uv, middle_out : (s, 2), (s, 3) float
        The same half-way to the next station.
    along_edge : (s,) bool
        Whether the way to the next station follows the edge; else it is a side of a mitre.
    """

    index: IntArray
    uv: FloatArray
    out: FloatArray
    middle_uv: FloatArray
    middle_out: FloatArray
    along_edge: BoolArray

    def points_mm(self, surface: Surface, offset_mm: float, extension_mm: float) -> FloatArray:
        """Stations at an offset and an extension, (s, 3)."""
        return surface.point(self.uv, offset_mm) + extension_mm * self.out

    def middles_mm(self, surface: Surface, offset_mm: float, extension_mm: float) -> FloatArray:
        """Points half-way between stations, (s, 3), on the true edge."""
        return surface.point(self.middle_uv, offset_mm) + extension_mm * self.middle_out


def conormals(surface: Surface, uv: FloatArray, axis: int, end: int) -> FloatArray:
    """Unit vectors (n, 3) out of the chart's edge (axis, end): tangent, square to the edge."""
    tangents = surface.tangents(uv)
    own, along = tangents[:, axis], tangents[:, 1 - axis]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    out = own - np.einsum("ni,ni->n", own, along)[:, None] * along
    out = out / np.linalg.norm(out, axis=1, keepdims=True)
    return np.asarray(out if end == 1 else -out)


def edge_distance_mm(
    surface: Surface, uv: FloatArray, axis: int, end: int, *, within_mm: float = np.inf
) -> FloatArray:
    """Distance in space (n,) from points of the outer face to its edge (axis, end), mm.

    From the nearest of many stations, by Gauss-Newton along the edge. Distances beyond
    ``within_mm`` are those from the stations: a little too large.
    """
    # Points near the edge converge from few stations, and are not mistaken for another part of it.
    stations, iterations = 1025 if within_mm == np.inf else 257, 5
    low, high = surface.domain[1 - axis]
    points = surface.point(uv)
    foot = np.full((stations, 2), surface.domain[axis, end])
    foot[:, 1 - axis] = np.linspace(low, high, stations)
    edge = surface.point(foot)
    best, nearest = cKDTree(edge).query(points)
    spacing = float(np.linalg.norm(np.diff(edge, axis=0), axis=1).max())
    near = best <= within_mm + spacing
    points, foot = points[near], foot[nearest[near]]
    for _ in range(iterations if near.any() else 0):
        along, arm = surface.tangents(foot)[:, 1 - axis], points - surface.point(foot)
        foot[:, 1 - axis] += np.sum(arm * along, axis=1) / np.sum(along**2, axis=1)
        if not surface.periodic[1 - axis]:
            foot[:, 1 - axis] = np.clip(foot[:, 1 - axis], low, high)
    best[near] = np.minimum(best[near], np.linalg.norm(points - surface.point(foot), axis=1))
    return np.asarray(best)


def check_topology(surface: Surface) -> None:
    """Reject a surface that is no tube, dome or sheet.

    Raises
    ------
    DesignError
        If the surface closes along u, or has no open edge, or poles but open sides.
    """
    open_sides = not surface.periodic[1]
    if surface.periodic[0] or not surface.edges() or (open_sides and any(surface.poles)):
        raise DesignError(
            "surface-topology-unsupported",
            f"a shell on shape {surface.name!r} cannot be built: it must be a tube (closed around "
            "v, open along u), a dome (a tube with one pole) or a sheet (open both ways), got "
            f"periodic {surface.periodic} and poles {surface.poles}; choose such a shape",
        )


def chart_loops(surface: Surface, u: FloatArray, v: FloatArray) -> list[Loop]:
    """Loops around the grid of chart stations ``u`` by ``v``, nearest the camera first.

    Parameters
    ----------
    u, v : (rows,), (columns,) float
        Stations from end to end; where v is periodic its last station is not its first again.
    """
    check_topology(surface)
    if surface.periodic[1]:
        closing = surface.domain[1, 1]
        return [_ring(surface, u, v, end, closing) for _, end in surface.edges()]
    return [_frame(surface, u, v)]


def _ring(surface: Surface, u: FloatArray, v: FloatArray, end: int, closing: float) -> Loop:
    """Loop at one end of a tube."""
    rows, columns = len(u), len(v)
    column = np.arange(columns)
    limits = np.append(v, closing)
    middle = (limits[:-1] + limits[1:]) / 2.0
    if end == 1:
        # Backwards, so that the surface stays on the left.
        column, middle = column[::-1], np.roll(middle[::-1], -1)
    uv = np.column_stack([np.full(columns, u[-end]), v[column]])
    middle_uv = np.column_stack([np.full(columns, u[-end]), middle])
    return Loop(
        index=(rows - 1) * columns * end + column,
        uv=uv,
        out=conormals(surface, uv, 0, end),
        middle_uv=middle_uv,
        middle_out=conormals(surface, middle_uv, 0, end),
        along_edge=np.ones(columns, dtype=np.bool_),
    )


def _frame(surface: Surface, u: FloatArray, v: FloatArray) -> Loop:
    """Loop around the four edges of a sheet, with a mitre after each edge."""
    rows, columns = len(u), len(v)
    grid = np.arange(rows * columns).reshape(rows, columns)
    sides = (
        (grid[0], 0, 0),
        (grid[:, -1], 1, 1),
        (grid[-1, ::-1], 0, 1),
        (grid[::-1, 0], 1, 0),
    )
    index, uv, out, middle_uv, middle_out, along = [], [], [], [], [], []
    for nodes, axis, end in sides:
        at = np.column_stack([u[nodes // columns], v[nodes % columns]])
        middle = (at[:-1] + at[1:]) / 2.0
        direction = conormals(surface, at, axis, end)
        # The last station's way on is the mitre's first side, the mitre's own its second.
        index.append(np.append(nodes, nodes[-1]))
        uv.append(np.concatenate([at, at[-1:]]))
        out.append(direction)
        middle_uv.append(np.concatenate([middle, at[-1:], at[-1:]]))
        middle_out.append(conormals(surface, middle, axis, end))
        along.append(np.append(np.ones(len(middle), dtype=np.bool_), [False, False]))
    full_out, full_middle = [], []
    for k in range(4):
        first, second = out[k][-1], out[(k + 1) % 4][0]
        mitre = _mitre(first, second)[None]
        full_out += [out[k], mitre]
        full_middle += [middle_out[k], (first + mitre) / 2.0, (mitre + second) / 2.0]
    return Loop(
        index=np.concatenate(index),
        uv=np.concatenate(uv),
        out=np.concatenate(full_out),
        middle_uv=np.concatenate(middle_uv),
        middle_out=np.concatenate(full_middle),
        along_edge=np.concatenate(along),
    )


def _mitre(first: FloatArray, second: FloatArray) -> FloatArray:
    # Least cosine between the conormals at a corner: sharper corners have endless mitres.
    sharpest_cos = -0.9
    cosine = float(first @ second)
    if cosine < sharpest_cos:
        raise DesignError(
            "rim-corner-too-sharp",
            "the rim of the patch cannot be built: two of its edges meet at an angle of "
            f"{180.0 - np.degrees(np.arccos(cosine)):.0f}°, less than "
            f"{180.0 - np.degrees(np.arccos(sharpest_cos)):.0f}°; move its corner points "
            "(shape.points_mm) to a blunter corner",
        )
    return np.asarray((first + second) / (1.0 + cosine))
