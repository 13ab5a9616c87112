"""Contact patches as nodal forces: any position, any radius, not only at nodes.

A patch is a disc of uniform pressure on the outer face. Every element is cut into small cells;
a cell carries its area times the share of it inside the disc (the edge is smoothed over one cell,
so that the load moves smoothly with the patch), and hands its force to the four corners through
the bilinear shape functions.
"""

from typing import Any

import numpy as np

from phytac_design.mechanics.element import R, S
from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import ShellMesh
from shapes import Surface
from shapes.arrays import FloatArray, IntArray
from shapes.errors import NumericalError

CELLS = 8
"""Cells along each side of an element."""
PAIRS = 20_000
"""(patch, element) pairs worked on at once, to bound the memory."""


def patch_loads(
    mesh: ShellMesh, surface: Surface, centres_uv: FloatArray, radii_mm: FloatArray | float
) -> Any:
    """Nodal loads of patches that each press inward with 1 N.

    The pressure acts along the local inward normal. It is scaled so that the resultant along the
    inward normal *at the centre* is exactly 1 N; by symmetry the resultant has (next to) no other
    component. Of a patch that reaches over a rim only the part on the shell carries, still 1 N in
    all. A patch smaller than the cells (an eighth of an element) is a point force, interpolated.
    Distances are chords between points of the outer face, as in :mod:`contact`.

    Parameters
    ----------
    mesh : ShellMesh
        Mesh of the middle face.
    surface : Surface
        The outer face.
    centres_uv : (m, 2) float
        Chart positions of the centres.
    radii_mm : float or (m,) float
        Radii, mm; 0 for a point force.

    Returns
    -------
    scipy.sparse.csc_matrix, (6N, m)
        Forces in N (the moments are zero), DOF order as in the solver.

    Raises
    ------
    NumericalError
        If a centre lies off the shell, or an input is not finite.
    """
    from scipy.sparse import coo_matrix

    centres = np.asarray(centres_uv, dtype=np.float64).reshape(-1, 2)
    radii = np.broadcast_to(np.asarray(radii_mm, dtype=np.float64), len(centres))
    if not (np.all(np.isfinite(radii)) and np.all(radii >= 0.0)):
        raise NumericalError("a patch radius is negative or not finite; give radii in mm, >= 0")
    nodes, weights = locate(mesh, centres, surface)  # also refuses centres off the shell
    inward = -surface.normal(centres)
    load, node, force, cell = _spread(mesh, surface, centres, radii)
    total = np.bincount(load, np.sum(force * inward[load], axis=1), minlength=len(centres))
    spread = (radii >= cell) & (total > 0.0)
    keep = spread[load]
    load, node = load[keep], node[keep]
    force = force[keep] / total[load][:, None]
    point = np.flatnonzero(~spread)
    load = np.concatenate([load, np.repeat(point, 4)])
    node = np.concatenate([node, nodes[point].ravel()])
    direct = weights[point][:, :, None] * inward[point][:, None]
    force = np.concatenate([force, direct.reshape(-1, 3)])
    rows = 6 * node[:, None] + np.arange(3)
    columns = np.broadcast_to(load[:, None], rows.shape)
    shape = (6 * len(mesh.nodes_mm), len(centres))
    matrix = coo_matrix((force.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsc()
    matrix.eliminate_zeros()
    return matrix


def _spread(
    mesh: ShellMesh, surface: Surface, centres: FloatArray, radii: FloatArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Unscaled nodal forces: patch (k,), node (k,), force (k, 3); and cell size per patch (m,)."""
    from scipy.spatial import cKDTree

    outer, middle, area = outer_elements(mesh)
    reach = np.linalg.norm(outer - middle[:, None], axis=2).max(axis=1)
    size = np.sqrt(area) / CELLS
    at, facing = surface.point(centres), surface.normal(centres)
    limit = float(radii.max(initial=0.0) + reach.max() + size.max())
    pairs = cKDTree(at).sparse_distance_matrix(cKDTree(middle), limit, output_type="ndarray")
    near = pairs["v"] <= radii[pairs["i"]] + reach[pairs["j"]] + size[pairs["j"]]
    patch, element = pairs["i"][near].astype(np.int64), pairs["j"][near].astype(np.int64)
    cell = np.zeros(len(centres))
    np.maximum.at(cell, patch, size[element])
    side = (np.arange(CELLS) + 0.5) * 2.0 / CELLS - 1.0
    r, s = (grid.ravel() for grid in np.meshgrid(side, side))
    h = 0.25 * (1.0 + np.multiply.outer(r, R)) * (1.0 + np.multiply.outer(s, S))  # (q, 4)
    used, slot = np.unique(element, return_inverse=True)
    points, normals = curved_points(outer[used], mesh.normals[mesh.quads[used]], h)
    push = -normals * _cell_area(outer[used], r, s)[:, :, None]
    force = np.zeros((len(patch), 4, 3))
    for first in range(0, len(patch), PAIRS):
        part = slice(first, first + PAIRS)
        i, k = patch[part], slot[part]
        distance = np.linalg.norm(points[k] - at[i][:, None], axis=2)
        inside = (radii[i][:, None] - distance) / size[used[k]][:, None] + 0.5
        inside = np.clip(inside, 0.0, 1.0)
        # A wall behind, within the radius of a thin sensor, faces away and is not touched.
        inside *= np.einsum("pqx,px->pq", push[k], facing[i]) < 0.0
        force[part] = np.einsum("pq,qi,pqx->pix", inside, h, push[k], optimize=True)
    return np.repeat(patch, 4), mesh.quads[element].ravel(), force.reshape(-1, 3), cell


def outer_elements(mesh: ShellMesh) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Corners (E, 4, 3) on the outer face, centres on it (E, 3), mm, and areas (E,), mm²."""
    normals = mesh.normals[mesh.quads]
    outer = mesh.nodes_mm[mesh.quads] + 0.5 * mesh.thickness_mm * normals
    centre = curved_points(outer, normals, np.full((1, 4), 0.25))[0][:, 0]
    across = np.cross(outer[:, 2] - outer[:, 0], outer[:, 3] - outer[:, 1])
    return outer, centre, np.linalg.norm(across, axis=1) / 2.0


def curved_points(
    corners: FloatArray, normals: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points and unit normals, (E, q, 3), of the curved face through element corners.

    Each bilinear point is moved halfway to the mean of its feet on the corners' tangent planes
    (Phong tessellation, Boubekeur and Alexa 2008, with α = 1/2): exact for faces of second order,
    and free of any chart.

    Parameters
    ----------
    corners, normals : (E, 4, 3) float
        Corners, mm, and unit normals there.
    weights : (q, 4) float
        Bilinear weights of the points.
    """
    flat = np.einsum("qi,eix->eqx", weights, corners, optimize=True)
    out = np.einsum("qi,eix->eqx", weights, normals, optimize=True)
    points = flat.copy()
    for i in range(4):
        normal = normals[:, None, i]
        above = np.sum((flat - corners[:, None, i]) * normal, axis=2) * weights[:, i]
        points -= 0.5 * above[:, :, None] * normal
    return points, out / np.linalg.norm(out, axis=2, keepdims=True)


def _cell_area(corner: FloatArray, r: FloatArray, s: FloatArray) -> FloatArray:
    """Jacobian of bilinear elements (E, 4, 3) at points (q,), up to a common factor, (E, q)."""
    x_r, x_s, x_d = (0.25 * np.einsum("i,eik->ek", c, corner)[:, None] for c in (R, S, R * S))
    normal = np.cross(x_r + s[:, None] * x_d, x_s + r[:, None] * x_d)
    return np.asarray(np.linalg.norm(normal, axis=2))
