"""Contact patches on solid meshes."""

import numpy as np

from phytac_design.mechanics.solid.solid_mesh_tets import SolidMesh
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError


def shape_triangle(L: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Quadratic shape functions (q, 6) at barycentric ``L`` (q, 3), derivatives (2, q, 6)."""
    edge, after = [0, 1, 2], [1, 2, 0]
    h = np.concatenate([L * (2.0 * L - 1.0), 4.0 * L[:, edge] * L[:, after]], axis=1)
    d = np.zeros((3, len(L), 6))
    for k in range(3):
        d[k, :, k] = 4.0 * L[:, k] - 1.0
        d[edge[k], :, 3 + k] = 4.0 * L[:, after[k]]
        d[after[k], :, 3 + k] = 4.0 * L[:, edge[k]]
    return h, d[1:] - d[0]


def cells(count: int = 6) -> FloatArray:
    """Barycentric centres (count², 3) of the equal cells that a boundary triangle is cut into."""
    up = [(i, j) for i in range(count) for j in range(count - i)]
    down = [(i, j) for i in range(count - 1) for j in range(count - 1 - i)]
    a = np.array([(i + 1.0 / 3.0, j + 1.0 / 3.0) for i, j in up])
    b = np.array([(i + 2.0 / 3.0, j + 2.0 / 3.0) for i, j in down]).reshape(-1, 2)
    ij = np.concatenate([a, b]) / count
    return np.column_stack([1.0 - ij.sum(axis=1), ij])


def cell_areas(corner: FloatArray, L: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (F, q, 3) and areas (F, q) of the cells of curved triangles (F, 6, 3)."""
    h, d = shape_triangle(L)
    tangent = np.einsum("aqi,fik->afqk", d, corner)
    area = np.linalg.norm(np.cross(tangent[0], tangent[1]), axis=2) / (2.0 * len(L))
    return np.einsum("qi,fik->fqk", h, corner), area


def solid_patch_load(
    mesh: SolidMesh, surface: Surface, centre_uv: FloatArray, radius_mm: float
) -> FloatArray:
    """Consistent nodal forces (N, 3) of a disc of pressure that presses inward with 1 N.

    The pressure acts along the local inward normal on the wall's material (holes carry none), its
    resultant along the inward normal at the centre is 1 N, as in :func:`loads.patch_loads`. The
    edge of the disc is smoothed over one cell (a sixth of a triangle).

    Parameters
    ----------
    mesh : SolidMesh
        Solid mesh of the shell.
    surface : Surface
        The outer face.
    centre_uv : (2,) float
        Chart position of the centre.
    radius_mm : float
        Radius > 0; no smaller than the cells.

    Raises
    ------
    NumericalError
        If the disc meets no cell of the outer face.
    """
    centre = np.asarray(centre_uv, dtype=np.float64).reshape(1, 2)
    at, inward = surface.point(centre)[0], -surface.normal(centre)[0]
    L = cells()
    corner = mesh.nodes_mm[mesh.triangles[mesh.outer]]
    # Triangles farther away than the disc and their own size carry nothing.
    size = np.linalg.norm(corner - corner.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    gap = np.linalg.norm(corner.mean(axis=1) - at, axis=1)
    near = np.flatnonzero(gap < radius_mm + 2.0 * size)
    points, area = cell_areas(corner[near], L)
    edge = np.sqrt(area)
    distance = np.linalg.norm(points - at, axis=2)
    covered = np.clip((radius_mm - distance) / np.maximum(edge, 1e-300) + 0.5, 0.0, 1.0)
    normal = surface.normal(surface.chart(points.reshape(-1, 3))).reshape(points.shape)
    force = -(area * covered)[:, :, None] * normal
    total = float(np.sum(force @ inward))
    if not (np.isfinite(total) and total > 0.0):
        raise NumericalError(
            "solid-contact-off-mesh",
            f"a contact of radius {radius_mm!r} mm at (u, v) = ({centre[0, 0]:.6g}, "
            f"{centre[0, 1]:.6g}) meets no cell of the solid mesh; move it onto the shell, make "
            "it larger, or mesh finer under it",
        )
    nodal = np.einsum("fqk,qi->fik", force / total, shape_triangle(L)[0])
    load = np.zeros_like(mesh.nodes_mm)
    np.add.at(load, mesh.triangles[mesh.outer[near]], nodal)
    return load
