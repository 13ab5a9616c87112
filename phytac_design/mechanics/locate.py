"""Where a chart position lies on a mesh: the element and its bilinear weights."""

import numpy as np

from phytac_design.mechanics.element import R, S
from phytac_design.mechanics.mesh import ShellMesh
from shapes.arrays import FloatArray, IntArray
from shapes.errors import NumericalError

CANDIDATES = 9
"""Elements tried for each position, nearest centre first."""
EDGE_TOL = 1e-6
"""How far outside an element, in its own coordinates (-1 … 1), a position may lie."""
STEPS = 12
"""Newton steps of the inverse bilinear map."""


def element_uv(mesh: ShellMesh) -> FloatArray:
    """Chart corners of every element, (E, 4, 2), unwrapped: no element jumps over the seam."""
    uv = mesh.uv[mesh.quads]
    if np.isfinite(mesh.period_v):
        turn = (uv[:, :, 1] - uv[:, :1, 1]) / mesh.period_v
        uv[:, :, 1] -= mesh.period_v * np.rint(turn)
    return np.asarray(uv)


def locate(mesh: ShellMesh, uv: FloatArray) -> tuple[IntArray, FloatArray]:
    """Nodes (n, 4) and bilinear weights (n, 4) of chart positions ``uv`` (n, 2).

    Bilinear in the chart, as the elements are; positions are taken modulo the period of v.

    Raises
    ------
    NumericalError
        If a position lies on no element.
    """
    from scipy.spatial import cKDTree

    uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
    if not np.all(np.isfinite(uv)):
        raise NumericalError("a chart position is not finite (NaN or inf); check the contacts")
    corners = element_uv(mesh)
    centre = corners.mean(axis=1)
    scale = np.abs(corners - centre[:, None]).mean(axis=(0, 1))
    points, seeds, owner = uv / scale, centre / scale, np.arange(len(centre))
    if np.isfinite(mesh.period_v):
        period = mesh.period_v / scale[1]
        low = float(mesh.uv[:, 1].min() / scale[1])
        points[:, 1] = low + np.mod(points[:, 1] - low, period)
        seeds = np.concatenate([seeds + np.array([0.0, k * period]) for k in (-1, 0, 1)])
        owner = np.tile(owner, 3)
    count = min(CANDIDATES, len(seeds))
    near = cKDTree(seeds).query(points, k=count)[1].reshape(len(points), count)
    # The positions relative to each candidate's own (possibly wrapped) copy.
    element = owner[near]
    local = (points[:, None] - seeds[near]) * scale
    rs = _inverse_bilinear(corners[element] - centre[element][:, :, None], local)
    outside = np.abs(rs).max(axis=2)
    best = np.argmin(outside, axis=1)
    here = np.arange(len(uv))
    lost = ~(outside[here, best] <= 1.0 + EDGE_TOL)
    if np.any(lost):
        where = uv[np.argmax(lost)]
        raise NumericalError(
            f"position (u, v) = ({where[0]:.6g}, {where[1]:.6g}) lies on no element "
            f"({int(lost.sum())} in all); the mesh spans u from {mesh.uv[:, 0].min():.6g} to "
            f"{mesh.uv[:, 0].max():.6g}"
        )
    r, s = rs[here, best].T
    weights = 0.25 * (1.0 + np.multiply.outer(r, R)) * (1.0 + np.multiply.outer(s, S))
    return mesh.quads[element[here, best]], weights


def _inverse_bilinear(corners: FloatArray, target: FloatArray) -> FloatArray:
    """(r, s) with Σ h_i(r, s) corner_i = target; corners (..., 4, 2), target (..., 2)."""
    x0, x_r, x_s, x_d = (
        0.25 * np.einsum("i,...ik->...k", c, corners) for c in (np.ones(4), R, S, R * S)
    )
    rs = np.zeros_like(target)
    for _ in range(STEPS):
        r, s = rs[..., :1], rs[..., 1:]
        gap = target - (x0 + r * x_r + s * x_s + r * s * x_d)
        a, b = x_r + s * x_d, x_s + r * x_d
        det = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        det = np.where(np.abs(det) > 1e-30, det, 1e-30)
        move_r = (gap[..., 0] * b[..., 1] - gap[..., 1] * b[..., 0]) / det
        move_s = (a[..., 0] * gap[..., 1] - a[..., 1] * gap[..., 0]) / det
        rs = np.clip(rs + np.stack([move_r, move_s], axis=-1), -4.0, 4.0)
    return rs
