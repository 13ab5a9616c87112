"""Points on the faces of a mesh, and regions of points and of triangles."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from phytac_design.geometry.ray_tree import RayTree
from phytac_design.geometry.triangles import TriangleMesh, proper_triangles
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

AREA_mm2 = 1e-10
"""Smaller triangles have no direction to speak of."""


@dataclass(frozen=True, kw_only=True)
class SurfaceSamples:
    """Points on faces: the middle of every triangle, and more on large ones.

    Attributes
    ----------
    point_mm, normal : (n, 3) float
        Points, and the outward normals of their triangles.
    triangle : (n,) int
        Their triangles.
    area_mm2 : (n,) float
        Area that each stands for.
    """

    point_mm: FloatArray
    normal: FloatArray
    triangle: IntArray
    area_mm2: FloatArray

    def some(self, which: BoolArray | IntArray) -> "SurfaceSamples":
        """Return those of an index."""
        return SurfaceSamples(
            point_mm=self.point_mm[which],
            normal=self.normal[which],
            triangle=self.triangle[which],
            area_mm2=self.area_mm2[which],
        )


def sample_faces(tree: RayTree, spacing_mm: float) -> SurfaceSamples:
    """Points about ``spacing_mm`` apart, at least one on each triangle."""
    # Steps of the evenest known sequence in the plane (Roberts' R2, of the plastic number).
    steps = np.array([0.7548776662466927, 0.5698402909980532])
    real = np.flatnonzero(tree.area_mm2 > AREA_mm2)
    area = tree.area_mm2[real]
    count = np.maximum(1, np.ceil(area / spacing_mm**2)).astype(np.int64)
    triangle = np.repeat(real, count)
    number = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    share = np.mod(0.5 + number[:, None] * steps, 1.0)
    share = np.where(share.sum(axis=1, keepdims=True) > 1.0, 1.0 - share, share)
    share[number == 0] = 1.0 / 3.0
    a, b, c = np.moveaxis(tree.corners[triangle], 1, 0)
    point = a + share[:, :1] * (b - a) + share[:, 1:] * (c - a)
    return SurfaceSamples(
        point_mm=point,
        normal=tree.normal[triangle],
        triangle=triangle,
        area_mm2=np.repeat(area / count, count),
    )


def regions(
    points_mm: FloatArray, width_mm: FloatArray, corners: IntArray, reach_mm: float
) -> IntArray:
    """Region of each point (n,): alike in width, and near or on triangles that share a corner.

    Parameters
    ----------
    points_mm : (n, 3) float
        Points.
    width_mm : (n,) float
        Width of the feature at each.
    corners : (n, 3) int
        Corner ids of their triangles.
    reach_mm : float
        How near.
    """
    alike = 1.4  # ratio of widths up to which places are of one feature
    count = len(points_mm)
    if count == 0:
        return np.zeros(0, dtype=np.int64)
    size = np.log(width_mm) / np.log(alike)
    pairs = cKDTree(points_mm).query_pairs(reach_mm, output_type="ndarray")
    pairs = pairs[np.abs(size[pairs[:, 0]] - size[pairs[:, 1]]) < 1.0]
    classes = np.floor(size).astype(np.int64)[:, None]
    key = corners * 1000 + (classes - classes.min())
    ids = count + np.unique(key, return_inverse=True)[1].reshape(-1)
    first = np.concatenate([pairs[:, 0], np.repeat(np.arange(count), 3)])
    label = _components(int(ids.max()) + 1, first, np.concatenate([pairs[:, 1], ids]))
    return np.asarray(np.unique(label[:count], return_inverse=True)[1], dtype=np.int64)


def patches(mesh: TriangleMesh, chosen: IntArray) -> IntArray:
    """Region (k,) of each chosen triangle (k,), by shared edges."""
    if chosen.size == 0:
        return np.zeros(0, dtype=np.int64)
    corners = mesh.triangles[chosen]
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]))
    key = edges[:, 0] * (int(mesh.triangles.max()) + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    owner = np.tile(np.arange(len(chosen)), 3)[order]
    same = key[order][1:] == key[order][:-1]
    return _components(len(chosen), owner[:-1][same], owner[1:][same])


def welded(mesh: TriangleMesh, grid_mm: float = 1e-6) -> TriangleMesh:
    """Return the mesh with equal corners made one, as an STL file does not have them."""
    _, first, renumbered = np.unique(
        np.round(mesh.vertices_mm / grid_mm).astype(np.int64),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    triangles = proper_triangles(renumbered.reshape(-1)[mesh.triangles])
    return TriangleMesh(vertices_mm=mesh.vertices_mm[first], triangles=triangles)


def bodies(mesh: TriangleMesh) -> IntArray:
    """Closed face (m,) that each triangle is of: triangles that share a corner share a face."""
    a, b, c = mesh.triangles.T
    count = len(mesh.vertices_mm)
    label = _components(count, np.concatenate([a, b]), np.concatenate([b, c]))
    return np.asarray(label[a])


def _components(count: int, first: IntArray, second: IntArray) -> IntArray:
    links = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)
