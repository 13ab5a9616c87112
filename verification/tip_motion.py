"""Motion of the receptors' end faces on a solid: of true tubes, and of smeared ones by the wall."""

from typing import Any

import numpy as np

from phytac_design.layout import Markers
from phytac_design.mechanics.solid.load import cell_areas, cells, shape_triangle
from phytac_design.mechanics.solid.solid_mesh_tets import SolidMesh
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError
from verification.partial_solid import PartMesh

FIT_SIZES = 1.6
"""The wall's motion under a left-out receptor is fitted within this many far sizes."""
FIT_MIN_NODES = 24
"""Nodes needed for it."""


def tip_means(mesh: SolidMesh) -> Any:
    """Matrix (n, N) that takes nodal motions to the mean over each receptor's end face.

    The mean over a ring is the motion of its centre, the marker: rows sum to 1.

    Returns
    -------
    scipy.sparse.csr_matrix, (n, N)
        Apply to one component of the motion, or to (N, 3).
    """
    from scipy.sparse import csr_matrix

    if not mesh.tips:
        return csr_matrix((0, len(mesh.nodes_mm)))
    faces = np.concatenate(mesh.tips)
    tip = np.repeat(np.arange(len(mesh.tips)), [len(part) for part in mesh.tips])
    L = cells()
    nodes: IntArray = mesh.triangles[faces]
    area = cell_areas(mesh.nodes_mm[nodes], L)[1]
    weight = area @ shape_triangle(L)[0]
    weight /= np.bincount(tip, area.sum(axis=1))[tip, None]
    rows = np.broadcast_to(tip[:, None], nodes.shape)
    shape = (len(mesh.tips), len(mesh.nodes_mm))
    return csr_matrix((weight.ravel(), (rows.ravel(), nodes.ravel())), shape=shape)


def tips_motion(
    mesh: PartMesh, markers: Markers, motion_mm: FloatArray, *, far_mm: float
) -> FloatArray:
    """Displacement (n, 3) of the centre of every receptor's end face, mm.

    Of receptors that are modelled it is the mean over their end face. Where one is left out, the
    wall's motion around it is fitted by a polynomial (second order along the wall, first through
    it), and the tube is taken to stand rigidly on the middle face there.

    Parameters
    ----------
    mesh : PartMesh
        The mesh.
    markers : Markers
        All receptors.
    motion_mm : (N, 3) float
        Displacement of every node.
    far_mm : float
        Size of the smeared wall's elements.

    Raises
    ------
    NumericalError
        If too few nodes lie around a left-out receptor.
    """
    out = np.zeros((markers.count, 3))
    out[mesh.kept] = tip_means(mesh) @ motion_mm
    left = np.setdiff1d(np.arange(markers.count), mesh.kept)
    if len(left):
        out[left] = _on_wall(mesh, markers, left, motion_mm, FIT_SIZES * far_mm)
    return out


def _on_wall(
    mesh: PartMesh, markers: Markers, left: IntArray, motion: FloatArray, reach_mm: float
) -> FloatArray:
    from scipy.spatial import cKDTree

    normal, mid = markers.normal[left], markers.mid_mm[left]
    arm = markers.tip_mm[left] - mid
    members = cKDTree(mesh.nodes_mm).query_ball_point(mid, reach_mm)
    tubes = np.unique(np.concatenate([mesh.triangles[part].ravel() for part in mesh.tips]))
    out = np.zeros((len(left), 3))
    for k, found in enumerate(members):
        nodes = np.setdiff1d(found, tubes)
        if len(nodes) < FIT_MIN_NODES:
            raise NumericalError(
                "tip-nodes-too-few",
                f"only {len(nodes)} nodes of the solid lie within {reach_mm:.3g} mm of receptor "
                f"{left[k]}, {FIT_MIN_NODES} are needed; mesh the wall finer",
            )
        first, second = _tangents(normal[k])
        frame = np.stack([first, second, normal[k]])
        x, y, z = frame @ (mesh.nodes_mm[nodes] - mid[k]).T
        basis = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y, z, x * z, y * z])
        fit = np.linalg.lstsq(basis, motion[nodes], rcond=None)[0]
        moved = np.cross(first + fit[1], second + fit[2])
        # Deformed frame of the middle face: its normal, and the mean turn of its tangents.
        turn = _rotation(
            frame,
            np.stack([first + fit[1], second + fit[2], moved / np.linalg.norm(moved)]),
        )
        out[k] = fit[0] + turn @ arm[k] - arm[k]
    return out


def _tangents(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    axis = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first)
    return first, np.cross(normal, first)


def _rotation(before: FloatArray, after: FloatArray) -> FloatArray:
    """Rotation (3, 3) that turns row vectors ``before`` closest to ``after`` (Kabsch 1976)."""
    left, _, right = np.linalg.svd(after.T @ before)
    sign = np.sign(np.linalg.det(left @ right))
    return np.asarray(left @ np.diag([1.0, 1.0, sign]) @ right)


def tips_turn(mesh: PartMesh, motion_mm: FloatArray) -> FloatArray:
    """Rotation vectors (k, 3), rad, of the end faces of the receptors that are modelled."""
    out = np.zeros((len(mesh.kept), 3))
    for k in range(len(mesh.kept)):
        nodes = mesh.sets[f"TIP_{k}"]
        rest = mesh.nodes_mm[nodes]
        now = rest + motion_mm[nodes]
        out[k] = _vector(_rotation(rest - rest.mean(axis=0), now - now.mean(axis=0)))
    return out


def _vector(turn: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(turn).as_rotvec())
