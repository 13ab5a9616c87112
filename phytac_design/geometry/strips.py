"""Triangle meshes of grids and strips between curves."""

import numpy as np

from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import FloatArray


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
