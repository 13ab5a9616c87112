"""Moving the nodes of a mesh onto markers, with the nodes around following smoothly."""

from typing import Any

import numpy as np

from phytac_design.mechanics.meshing.quad_grid import EDGE_NAMES, QuadGrid
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


def snap(
    surface: Surface, grid: QuadGrid, marker_uv: FloatArray, *, offset_mm: float
) -> tuple[FloatArray, IntArray] | None:
    """Chart coordinates (N, 2) with a node on every marker, and that node (n,).

    Each marker takes one node; together they take those that move least (an assignment problem).
    The displacement of the other nodes is the one of least squared Laplacian on the mesh's graph,
    with open edges held, put back onto the face along its normals; nodes of the edges
    slide along with their inner neighbours. ``None`` where the mesh has
    too few nodes for the markers.
    """
    node_mm = surface.point(grid.uv, offset_mm)
    marker_mm = surface.point(marker_uv, offset_mm)
    edges = [(*edge, grid.sets[EDGE_NAMES[edge]]) for edge in surface.edges()]
    taken = _match(surface, node_mm, marker_mm, marker_uv, edges)
    if taken is None:
        return None
    held = np.zeros(len(node_mm), dtype=np.bool_)
    for *_, nodes in edges:
        held[nodes] = True
    held[taken] = True
    move = np.zeros_like(node_mm)
    move[taken] = marker_mm - node_mm[taken]
    move[~held] = _follow(grid.quads, held, move)
    _slide(grid.quads, edges, move)
    uv = grid.uv.copy()
    moved = np.abs(move).max(axis=1) > 0.0
    foot = surface.chart(node_mm[moved] + move[moved])
    uv[moved] = np.clip(foot, *surface.domain.T)
    for axis, end, nodes in edges:
        uv[nodes, axis] = surface.domain[axis, end]
    uv[taken] = marker_uv
    return uv, taken


def _slide(quads: IntArray, edges: list[tuple[int, int, IntArray]], move: FloatArray) -> None:
    """Let nodes of open edges go along with their inner neighbours, in place; corners stay."""
    rim = np.zeros(len(move), dtype=np.bool_)
    for *_, nodes in edges:
        rim[nodes] = True
    start, end = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    start, end = np.concatenate([start, end]), np.concatenate([end, start])
    spoke = rim[start] & ~rim[end]
    total, count = np.zeros_like(move), np.bincount(start[spoke], minlength=len(move))
    np.add.at(total, start[spoke], move[end[spoke]])
    free = (count > 0) & (np.abs(move).max(axis=1) == 0.0)
    move[free] = total[free] / count[free][:, None]


def scaled_jacobian(nodes_mm: FloatArray, quads: IntArray, normals: FloatArray) -> FloatArray:
    """Least sine of the corner angles of each element, seen along the normals, (E,); 1 is best."""
    corner, normal = nodes_mm[quads], normals[quads]
    ahead = np.roll(corner, -1, axis=1) - corner
    back = np.roll(corner, 1, axis=1) - corner
    area = np.sum(np.cross(ahead, back) * normal, axis=2)
    size = np.linalg.norm(ahead, axis=2) * np.linalg.norm(back, axis=2)
    return np.asarray(np.min(area / np.maximum(size, 1e-300), axis=1))


def _match(
    surface: Surface,
    node_mm: FloatArray,
    marker_mm: FloatArray,
    marker_uv: FloatArray,
    edges: list[tuple[int, int, IntArray]],
) -> IntArray | None:
    """Node of each marker; markers on an open edge take nodes there, all others inner nodes."""
    group = np.zeros(len(marker_uv), dtype=np.int64)
    inner: BoolArray = np.ones(len(node_mm), dtype=np.bool_)
    pools: list[IntArray] = []
    for k, (axis, end, nodes) in enumerate(edges, start=1):
        limit = surface.domain[axis]
        on = np.abs(marker_uv[:, axis] - limit[end]) <= 1e-9 * (limit[1] - limit[0])
        group[on & (group == 0)] = k
        inner[nodes] = False
        pools.append(nodes)
    pools.insert(0, np.flatnonzero(inner))
    taken = np.full(len(marker_uv), -1, dtype=np.int64)
    for k, pool in enumerate(pools):
        mine = np.flatnonzero(group == k)
        if len(mine) == 0:
            continue
        found = _assign(node_mm[pool], marker_mm[mine])
        if found is None:
            return None
        taken[mine] = pool[found]
    return taken if len(np.unique(taken)) == len(taken) else None


def _assign(points: FloatArray, wanted: FloatArray) -> IntArray | None:
    """Distinct point for each wanted place with the least sum of squared distances."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching
    from scipy.spatial import cKDTree

    count = min(12, len(points))  # nodes that a marker may take, nearest first
    if len(points) < len(wanted):
        return None
    distance, near = cKDTree(points).query(wanted, k=count)
    distance, near = distance.reshape(len(wanted), -1), near.reshape(len(wanted), -1)
    # A weight of zero would be no edge at all.
    cost = distance**2 + 1e-6 * float(np.mean(distance**2)) + 1e-300
    row = np.repeat(np.arange(len(wanted)), count)
    graph = csr_matrix((cost.ravel(), (row, near.ravel())), shape=(len(wanted), len(points)))
    try:
        mine, found = min_weight_full_bipartite_matching(graph)
    except ValueError:  # no way to give every marker a node of its own
        return None
    return np.asarray(found[np.argsort(mine)])


def _follow(quads: IntArray, held: BoolArray, move: FloatArray) -> FloatArray:
    """Displacements (k, 3) of the nodes that are not held."""
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import splu

    count = len(held)
    start, end = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    link: Any = coo_matrix((np.ones(len(start)), (start, end)), shape=(count, count))
    link = ((link + link.T) > 0).astype(np.float64)
    degree = np.asarray(link.sum(axis=1)).ravel()
    laplace = diags(np.ones(count)) - diags(1.0 / degree) @ link
    bend = (laplace.T @ laplace).tocsc()
    free = np.flatnonzero(~held)
    if len(free) == 0:
        return np.zeros((0, 3))
    right = -(bend[free][:, np.flatnonzero(held)] @ move[held])
    return np.asarray(splu(bend[free][:, free]).solve(right))
