"""Where a position of the surface lies on a mesh: the element and its bilinear weights.

The search is made in space, along the normal of the surface, so that seams and poles of the chart
are places like any other.
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.meshing.mesh import R, S, ShellMesh
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class LocateSettings:
    """The search for the element under a position."""

    candidates: int = 8
    """Elements tried first for each position, nearest centre first; four times as many each
    round."""
    edge_tolerance: float = 1e-6
    """How far outside the chart, as a share of its span, a position may lie; and how far outside an
    element, in its own coordinates (-1 … 1), at first."""
    rim_tolerance: float = 0.1
    """The same next to a rim that is curved, where chords of the rim leave a sliver uncovered."""
    newton_steps: int = 12
    """Newton steps of the inverse bilinear map."""
    pairs_at_once: int = 200_000
    """(position, element) pairs worked on at once, to bound the memory."""


SETTINGS = LocateSettings()


def locate(
    mesh: ShellMesh, uv: FloatArray, surface: Surface | None = None
) -> tuple[IntArray, FloatArray]:
    """Nodes (n, 4) and bilinear weights (n, 4) of chart positions ``uv`` (n, 2).

    The element is the one that the surface's normal through the position pierces, the weights are
    those of the point where it does. Positions are taken modulo the period of v.

    Parameters
    ----------
    mesh : ShellMesh
        Mesh of the middle face.
    uv : (n, 2) float
        Chart positions.
    surface : Surface, optional
        The outer face; that of the mesh if not given.

    Raises
    ------
    NumericalError
        If a position lies on no element, or the mesh has no surface and none is given.
    """
    uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
    surface = mesh.surface if surface is None else surface
    if surface is None:
        raise NumericalError(
            "mesh-without-surface",
            "this mesh does not know its surface; hand the surface to locate too",
        )
    if not np.all(np.isfinite(uv)):
        raise NumericalError(
            "position-not-finite", "a chart position is not finite (NaN or inf); check the contacts"
        )
    lost = outside(surface, uv)
    element, rs = np.zeros(len(uv), dtype=np.int64), np.full((len(uv), 2), np.inf)
    todo = np.flatnonzero(~lost)
    element[todo], rs[todo] = _search(
        mesh, surface.point(uv[todo], -mesh.thickness_mm / 2.0), surface.normal(uv[todo])
    )
    lost |= ~(np.abs(rs).max(axis=1, initial=0.0) <= 1.0 + SETTINGS.rim_tolerance)
    if np.any(lost):
        where = uv[np.argmax(lost)]
        (u0, u1), (v0, v1) = surface.domain
        raise NumericalError(
            "position-outside-mesh",
            f"position (u, v) = ({where[0]:.6g}, {where[1]:.6g}) lies on no element "
            f"({int(lost.sum())} in all); the surface spans u from {u0:.6g} to {u1:.6g}, v from "
            f"{v0:.6g} to {v1:.6g}{' and around' if surface.periodic[1] else ''}",
        )
    r, s = np.clip(rs, -1.0, 1.0).T
    weights = 0.25 * (1.0 + np.multiply.outer(r, R)) * (1.0 + np.multiply.outer(s, S))
    return mesh.quads[element], weights


def outside(surface: Surface, uv: FloatArray) -> BoolArray:
    """Whether chart positions (n, 2) lie beyond an open edge or a pole, (n,)."""
    out = np.zeros(len(uv), dtype=np.bool_)
    for axis in (0, 1):
        if not surface.periodic[axis]:
            low, high = surface.domain[axis]
            slack = SETTINGS.edge_tolerance * (high - low)
            out |= (uv[:, axis] < low - slack) | (uv[:, axis] > high + slack)
    return out


def _search(
    mesh: ShellMesh, points: FloatArray, normals: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Element (n,) and its coordinates (n, 2) where the normal through each point pierces it."""
    from scipy.spatial import cKDTree

    corners = mesh.nodes_mm[mesh.quads]
    tree = cKDTree(corners.mean(axis=1))
    element, rs = np.zeros(len(points), dtype=np.int64), np.full((len(points), 2), np.inf)
    todo, count = np.arange(len(points)), min(SETTINGS.candidates, len(corners))
    while len(todo):
        step = max(1, SETTINGS.pairs_at_once // count)
        for first in range(0, len(todo), step):
            part = todo[first : first + step]
            near = tree.query(points[part], k=count)[1].reshape(len(part), count)
            found = _pierce(corners[near], points[part], normals[part])
            size = np.abs(found).max(axis=2)
            best = np.argmin(size, axis=1)
            here = np.arange(len(part))
            better = size[here, best] < np.abs(rs[part]).max(axis=1)
            element[part[better]] = near[here, best][better]
            rs[part[better]] = found[here, best][better]
        todo = todo[np.abs(rs[todo]).max(axis=1) > 1.0 + SETTINGS.edge_tolerance]
        if count == len(corners):
            break
        # Nearly all are found at once; the rest lie in long elements or next to a curved rim.
        count = min(4 * count, len(corners)) if count < 4**3 * SETTINGS.candidates else len(corners)
    return element, rs


def _pierce(corners: FloatArray, points: FloatArray, normals: FloatArray) -> FloatArray:
    """Coordinates (n, c, 2) where lines meet elements, ``corners`` (n, c, 4, 3); else inf."""
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    smallest_axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(normals, smallest_axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frame = np.stack([first, np.cross(normals, first)], axis=1)
    flat = np.einsum("nkx,ncix->ncik", frame, corners - points[:, None, None])
    across, over = flat[..., 2, :] - flat[..., 0, :], flat[..., 3, :] - flat[..., 1, :]
    facing = across[..., 0] * over[..., 1] - across[..., 1] * over[..., 0]
    size = np.linalg.norm(across, axis=-1) + np.linalg.norm(over, axis=-1)
    rs = _inverse_bilinear(flat, np.zeros((*flat.shape[:2], 2)))
    h = 0.25 * (1.0 + rs[..., :1] * R) * (1.0 + rs[..., 1:] * S)
    miss = np.linalg.norm(np.einsum("nci,ncik->nck", h, flat), axis=-1)
    # Newton may end nowhere in an element far off; and the line continues to the wall behind, which
    # faces away. Neither is a candidate.
    rs[(miss > SETTINGS.edge_tolerance * size) | (facing <= 0.0)] = np.inf
    return rs


def _inverse_bilinear(corners: FloatArray, target: FloatArray) -> FloatArray:
    """(r, s) with Σ h_i(r, s) corner_i = target; corners (..., 4, 2), target (..., 2)."""
    x0, x_r, x_s, x_d = (
        0.25 * np.einsum("i,...ik->...k", c, corners) for c in (np.ones(4), R, S, R * S)
    )
    rs = np.zeros_like(target)
    for _ in range(SETTINGS.newton_steps):
        r, s = rs[..., :1], rs[..., 1:]
        gap = target - (x0 + r * x_r + s * x_s + r * s * x_d)
        a, b = x_r + s * x_d, x_s + r * x_d
        det = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        det = np.where(np.abs(det) > 1e-30, det, 1e-30)
        move_r = (gap[..., 0] * b[..., 1] - gap[..., 1] * b[..., 0]) / det
        move_s = (a[..., 0] * gap[..., 1] - a[..., 1] * gap[..., 0]) / det
        rs = np.clip(rs + np.stack([move_r, move_s], axis=-1), -4.0, 4.0)
    return rs
