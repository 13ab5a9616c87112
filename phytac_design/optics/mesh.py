"""Triangle meshes as plain arrays, and strips between curves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Vertices (V, 3) mm, sensor frame, and triangles (T, 3) int32."""

    vertices: FloatArray
    triangles: NDArray[np.int32]


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several; vertices keep their order."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])[:-1]
    parts = [m.triangles + np.int32(s) for m, s in zip(meshes, starts, strict=True)]
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        triangles=np.concatenate(parts).astype(np.int32),
    )


def grid_mesh(
    points: FloatArray, *, closed: bool, poles: tuple[bool, bool] = (False, False)
) -> Mesh:
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
    return Mesh(vertices=points.reshape(-1, 3).copy(), triangles=triangles.astype(np.int32))


def empty_mesh() -> Mesh:
    """Mesh without any vertex."""
    return Mesh(vertices=np.zeros((0, 3)), triangles=np.zeros((0, 3), dtype=np.int32))
