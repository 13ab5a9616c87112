"""A plain triangle mesh: what crosses the borders between manifold3d, STL, 3MF and checks."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class TriangleMesh:
    """An indexed triangle mesh in the sensor's frame.

    Attributes
    ----------
    vertices_mm : (n, 3) float
        Corner points.
    triangles : (m, 3) int
        Corner ids, counter-clockwise seen from outside.
    """

    vertices_mm: FloatArray
    triangles: IntArray

    @property
    def corners_mm(self) -> FloatArray:
        """Corner points of each triangle, (m, 3, 3)."""
        return self.vertices_mm[self.triangles]

    @property
    def volume_mm3(self) -> float:
        """Enclosed volume by the divergence theorem, positive when triangles face outward."""
        a, b, c = np.moveaxis(self.corners_mm, 1, 0)
        return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0)

    def moved(self, shift_mm: FloatArray) -> "TriangleMesh":
        """Return the same mesh, shifted by (3,)."""
        return TriangleMesh(vertices_mm=self.vertices_mm + shift_mm, triangles=self.triangles)

    def flipped(self) -> "TriangleMesh":
        """Return the same surface seen from the other side."""
        return TriangleMesh(vertices_mm=self.vertices_mm, triangles=self.triangles[:, ::-1])


def merged(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    """Several meshes as one, of separate components."""
    starts = np.cumsum([0, *(len(mesh.vertices_mm) for mesh in meshes)])
    return TriangleMesh(
        vertices_mm=np.concatenate([mesh.vertices_mm for mesh in meshes]),
        triangles=np.concatenate(
            [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=False)]
        ),
    )


def copies(mesh: TriangleMesh, origin_mm: FloatArray, rotation: FloatArray) -> TriangleMesh:
    """Copies of a mesh at origins (n, 3), turned by rotations (n, 3, 3), as one mesh."""
    points = np.einsum("nij,vj->nvi", rotation, mesh.vertices_mm) + origin_mm[:, None]
    starts = len(mesh.vertices_mm) * np.arange(len(origin_mm))
    return TriangleMesh(
        vertices_mm=points.reshape(-1, 3),
        triangles=(mesh.triangles[None] + starts[:, None, None]).reshape(-1, 3),
    )


def frames_along(axis: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) whose third column is the unit vector ``axis`` (n, 3)."""
    helper = np.where(np.abs(axis[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, axis)
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axis, first), axis], axis=2)


def grid_triangles(ids: IntArray, *, closed: bool) -> IntArray:
    """Triangles of a grid of vertex ids (rows, columns).

    ``closed`` joins the last column to the first. Counter-clockwise where columns run to the right
    and rows upward. Triangles with a vertex twice (at a pole) are left out.
    """
    onward = np.roll(ids, -1, axis=1) if closed else ids[:, 1:]
    here = ids if closed else ids[:, :-1]
    a, b, c, d = (part.ravel() for part in (here[:-1], onward[:-1], onward[1:], here[1:]))
    return proper_triangles(
        np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    )


def strip_triangles(first: IntArray, second: IntArray, *, mirrored: bool = False) -> IntArray:
    """Triangles of a closed strip between two rings of vertex ids (s,), the first on the left.

    Vertices may repeat; triangles with a vertex twice are left out. ``mirrored`` cuts the cells
    along their other diagonal.
    """
    a, b = np.roll(first, -1), np.roll(second, -1)
    if mirrored:
        return proper_triangles(
            np.concatenate([np.column_stack([a, first, b]), np.column_stack([first, second, b])])
        )
    return proper_triangles(
        np.concatenate([np.column_stack([a, first, second]), np.column_stack([a, second, b])])
    )


def distinct_points(points: NDArray[Any]) -> tuple[NDArray[Any], IntArray]:
    """Distinct points, by x, y and z, and the number of that of each point (n, 3).

    As ``np.unique`` of rows gives them, in a third of the time.
    """
    order = np.lexsort(points.T[::-1])
    ordered = points[order]
    new = np.ones(len(points), dtype=np.bool_)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    number = np.empty(len(points), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    return ordered[new], number


def proper_triangles(triangles: IntArray) -> IntArray:
    """Triangles without those that name a vertex twice."""
    a, b, c = triangles.T
    return np.asarray(triangles[(a != b) & (b != c) & (c != a)])


def widening(sides: int) -> float:
    """Circumradius of a regular polygon over the radius of the circle of the same area."""
    angle = 2.0 * np.pi / sides
    return float(np.sqrt(angle / np.sin(angle)))


def sides_for(radius_mm: float, tolerance_mm: float, *, minimum: int = 12) -> int:
    """Sides, a multiple of 4, of the equal-area polygon within ``tolerance_mm`` of a circle.

    The corners stand out by about r·θ²/12 (θ = 2π/sides), more than the sides fall short (θ²/24).
    """
    sides = np.pi * np.sqrt(radius_mm / (3.0 * tolerance_mm))
    return max(minimum, 4 * int(np.ceil(sides / 4.0)))


def prisms(start_mm: FloatArray, end_mm: FloatArray, radius_mm: float, sides: int) -> TriangleMesh:
    """Closed prisms that approximate round rods, all in one mesh of separate components.

    Parameters
    ----------
    start_mm, end_mm : (n, 3) float
        Ends of each axis.
    radius_mm : float
        Radius of the rod; the polygon has the area of its circle.
    sides : int
        Sides of the polygon.
    """
    axis = end_mm - start_mm
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    # The frame depends on the axis alone: rods on one axis have corners on the same lines.
    first, second, _ = np.moveaxis(frames_along(axis), 2, 0)
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = first[:, None] * np.cos(angle)[:, None] + second[:, None] * np.sin(angle)[:, None]
    ring = ring * (radius_mm * widening(sides))
    vertices = np.concatenate([start_mm[:, None] + ring, end_mm[:, None] + ring], axis=1)
    triangles = _prism_triangles(sides)
    offset = 2 * sides * np.arange(len(axis))
    return TriangleMesh(
        vertices_mm=vertices.reshape(-1, 3),
        triangles=(triangles[None] + offset[:, None, None]).reshape(-1, 3),
    )


def _prism_triangles(sides: int) -> IntArray:
    """Triangles of one prism: ids 0…sides-1 around the start, sides…2·sides-1 around the end."""
    near = np.arange(sides)
    onward = (near + 1) % sides
    side = [[near, onward, onward + sides], [near, onward + sides, near + sides]]
    fan = np.arange(1, sides - 1)
    zero = np.zeros_like(fan)
    caps = [[zero, fan + 1, fan], [zero + sides, fan + sides, fan + 1 + sides]]
    return np.concatenate([np.column_stack(part) for part in side + caps])


def grid_mesh(
    points: FloatArray, *, closed: bool, poles: tuple[bool, bool] = (False, False)
) -> TriangleMesh:
    """Two triangles per cell of a grid of points (rows, columns, 3).

    ``closed`` joins the last column to the first. ``poles`` says whether the first, and the last,
    row is a single point: there one triangle per cell.
    """
    rows, columns = points.shape[:2]
    cells = columns if closed else columns - 1
    row, column = np.divmod(np.arange((rows - 1) * cells), cells)
    after = (column + 1) % columns
    a, b = row * columns + column, row * columns + after
    c, d = a + columns, b + columns
    first = np.column_stack([a, b, c])[row > 0 if poles[0] else slice(None)]
    second = np.column_stack([b, d, c])[row < rows - 2 if poles[1] else slice(None)]
    triangles = np.concatenate([first, second])
    return TriangleMesh(vertices_mm=points.reshape(-1, 3).copy(), triangles=triangles)


def empty_mesh() -> TriangleMesh:
    """Mesh without any vertex."""
    return TriangleMesh(vertices_mm=np.zeros((0, 3)), triangles=np.zeros((0, 3), dtype=np.int64))


def cylinder_mesh(
    start_mm: FloatArray,
    end_mm: FloatArray,
    radius_mm: float,
    *,
    tolerance_mm: float,
    caps: tuple[bool, bool] = (True, True),
) -> TriangleMesh:
    """Cylinder between two points (3,), with caps at its start and end as wanted.

    Its polygon stays within ``tolerance_mm`` of the circle.
    """
    # Cosine to the y axis from which a cylinder's polygon starts along another one.
    most_along = 0.9
    axis = (end_mm - start_mm) / np.linalg.norm(end_mm - start_mm)
    # For an axis along z these are x and y.
    first = np.cross(np.eye(3)[1 if abs(axis[1]) < most_along else 0], axis)
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    ratio = min(max(tolerance_mm / radius_mm, 1e-6), 0.1)
    sides = int(np.ceil(np.pi / np.arccos(1.0 - ratio)))
    turn = 2.0 * np.pi * np.arange(sides) / sides
    ring = radius_mm * (np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second)
    curves = [start_mm + ring, end_mm + ring]
    if caps[0]:
        curves.insert(0, start_mm + 0.0 * ring)
    if caps[1]:
        curves.append(end_mm + 0.0 * ring)
    return grid_mesh(np.stack(curves), closed=True, poles=caps)
