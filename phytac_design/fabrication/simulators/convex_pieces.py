"""Convex pieces that fill a sensor's outer hull, for the collisions of simulators.

A tube or dome is solid up to its axis; a sheet is solid from its outer face down to the ends of
its tallest receptors. Rims are pieces of their own. A piece is halved, along or around, until
it fills its part of the hull.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.geometry.boundary_loops import Loop, chart_loops
from phytac_design.geometry.triangles import TriangleMesh, grid_triangles, proper_triangles
from phytac_design.geometry.wall_sampling import chart_stations
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import hull, to_triangles
from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class PieceSettings:
    """How faithful the pieces are, chosen here.

    Attributes
    ----------
    tolerance_mm : float
        Largest distance between the stations' chords and the true faces.
    excess : float
        Largest volume of a piece beyond its part of the hull, as a share of that part.
    """

    tolerance_mm: float = 0.05
    excess: float = 0.03


SETTINGS = PieceSettings()


@dataclass(frozen=True, kw_only=True)
class Block:
    """A part of the hull: rows of a grid, and columns on its outer and on its inner side.

    Attributes
    ----------
    outer, inner : (rows, columns, 3) float
        Corners, mm. Inner columns may be equal: a wedge of a tube ends on its axis.
    """

    outer: FloatArray
    inner: FloatArray

    @property
    def points_mm(self) -> FloatArray:
        """All corners (n, 3)."""
        return np.concatenate([self.outer.reshape(-1, 3), self.inner.reshape(-1, 3)])

    def volume_mm3(self) -> float:
        """Volume between the faces; the sides follow the grid's lines."""
        around = np.concatenate([self.outer, self.inner[:, ::-1]], axis=1)
        rows, columns = around.shape[:2]
        ids = np.arange(rows * columns).reshape(rows, columns)
        # The ends are closed as strips from the outer to the inner side.
        half = columns // 2
        ends = [
            grid_triangles(np.stack([row[:half], row[half:][::-1]]), closed=False)
            for row in (ids[0], ids[-1])
        ]
        sides = grid_triangles(ids, closed=True)
        triangles = proper_triangles(np.concatenate([sides, ends[0][:, ::-1], ends[1]]))
        mesh = TriangleMesh(vertices_mm=around.reshape(-1, 3), triangles=triangles)
        return abs(mesh.volume_mm3)

    def halves(self) -> Iterator[tuple["Block", "Block"]]:
        """Both ways to cut the block in two, where it has more than one row or column."""
        for axis in (0, 1):
            middle = self.outer.shape[axis] // 2
            if self.outer.shape[axis] < 3:
                continue
            low, high = slice(None, middle + 1), slice(middle, None)
            yield self._part(axis, low), self._part(axis, high)

    def _part(self, axis: int, kept: slice) -> "Block":
        """Some rows (axis 0) or columns (1) of the block."""
        part = (kept, slice(None)) if axis == 0 else (slice(None), kept)
        return Block(outer=self.outer[part], inner=self.inner[part])


def convex_pieces(sensor: Sensor, settings: PieceSettings = SETTINGS) -> list[TriangleMesh]:
    """Convex solids that fill the outer hull, in a fixed order: the sensing part, then the rims.

    The sum of their volumes exceeds that of the hull by less than ``settings.excess``, unless
    single cells of the grid are less convex.
    """
    return [
        to_triangles(piece)
        for block in _blocks(sensor, settings.tolerance_mm)
        for piece in _pieces(block, settings.excess)
    ]


def _pieces(block: Block, excess: float) -> list[Any]:
    """Hulls of a block, or of its parts where one hull is too large."""
    whole = hull(block.points_mm)
    if whole.volume() <= (1.0 + excess) * block.volume_mm3():
        return [whole]
    ways = list(block.halves())
    if not ways:
        return [whole]
    # The cut that helps more at once; around first where neither does (a tube's cross-section).
    best = min(ways, key=lambda way: sum(hull(part.points_mm).volume() for part in way))
    return [piece for part in best for piece in _pieces(part, excess)]


def _blocks(sensor: Sensor, tolerance_mm: float) -> Iterator[Block]:
    """The sensing part, and the rim of every open edge."""
    design, surface = sensor.design, sensor.surface
    wall, closed = design.wall, surface.periodic[1]
    u, v = chart_stations(surface, wall, tolerance_mm)
    uu, vv = np.meshgrid(u, v, indexing="ij")
    uv = np.column_stack([uu.ravel(), vv.ravel()])

    def face(offset_mm: float) -> FloatArray:
        return surface.point(uv, offset_mm).reshape(len(u), len(v), 3)

    depth = wall.thickness_mm + float(sensor.markers.height_mm.max())
    yield _filled(face(0.0)) if closed else Block(outer=face(0.0), inner=face(-depth))
    if wall.rim_length_mm == 0.0:
        return
    extensions = (0.0, wall.rim_length_mm)
    for loop in chart_loops(surface, u, v):
        top = _loop_rows(sensor, loop, wall.rim_flange_mm, extensions)
        if closed:
            yield _filled(top)
            continue
        low = _loop_rows(sensor, loop, -wall.thickness_mm, extensions)
        # The rim of one edge of a sheet reaches from mitre to mitre.
        for stations in _sides(loop):
            yield Block(outer=top[:, stations], inner=low[:, stations])


def _loop_rows(
    sensor: Sensor, loop: Loop, offset_mm: float, extensions: tuple[float, ...]
) -> FloatArray:
    """Points of a rim's face, (extensions, stations, 3)."""
    return np.stack([loop.points_mm(sensor.surface, offset_mm, way) for way in extensions])


def _filled(rings: FloatArray) -> Block:
    """Rings (rows, columns, 3) around an axis, solid up to the middles of the rings."""
    closed = np.concatenate([rings, rings[:, :1]], axis=1)
    middle = rings.mean(axis=1, keepdims=True)
    return Block(outer=closed, inner=np.broadcast_to(middle, closed.shape))


def _sides(loop: Loop) -> Iterator[FloatArray]:
    """Stations of each edge of a sheet's loop, with the mitre before and after it."""
    # A mitre is the station between the two that do not lead along an edge.
    mitres = np.flatnonzero(~loop.along_edge & ~np.roll(loop.along_edge, 1))
    count = len(loop.along_edge)
    for start, end in zip(mitres, np.append(mitres[1:], mitres[0] + count), strict=True):
        yield np.arange(start, end + 1) % count
