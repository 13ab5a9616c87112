"""Contact patches as nodal forces: any position, any size, not only at nodes.

A patch is a pressure on the outer face. Every element is cut into small cells; a cell carries its
area times the pressure (averaged over one cell, so that the load moves smoothly with the patch),
and hands its force to the four corners through the bilinear shape functions.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import R, S, ShellMesh
from phytac_design.mechanics.shell.pressure_sharing import near_pairs
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError


class Pressure(Protocol):
    """Pressure of m patches over a face."""

    def __call__(
        self, patch: IntArray, arm_mm: FloatArray, mean_mm: FloatArray, longest_mm: FloatArray
    ) -> FloatArray:
        """Pressure in any unit, (p, q), averaged over a cell.

        Parameters
        ----------
        patch : (p,) int
            Patch of each row.
        arm_mm : (p, q, 3) float
            From the patch's centre to the middle of each cell, on the outer face.
        mean_mm, longest_mm : (p,) float
            Root of the area, and longest side, of a cell.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class PressurePatches:
    """Patches that press on the outer face with 1 N each; arrays run over m patches.

    Attributes
    ----------
    uv : (m, 2) float
        Chart positions of the centres.
    reach_mm : (m,) float
        Distance from the centre beyond which nothing presses.
    pressure : Pressure
        How each presses.
    drag : (m, 3) float, optional
        Tangential force (N) that comes with the 1 N, in the tangent plane at the centre; spread
        as the pressure is.
    """

    uv: FloatArray
    reach_mm: FloatArray
    pressure: Pressure
    drag: FloatArray | None = None


@dataclass(frozen=True, kw_only=True)
class _Spread:
    """Unscaled nodal forces and moments; k rows of (patch, node), and each patch's cell size."""

    patch: IntArray
    node: IntArray
    push: FloatArray
    drag: FloatArray | None
    """(k, 6): tangential forces and their moments about the middle face."""
    cell: FloatArray


@dataclass(frozen=True, kw_only=True)
class UniformDiscs:
    """Even pressure over discs of the given radii (m,), mm."""

    radii_mm: FloatArray

    def __call__(
        self, patch: IntArray, arm_mm: FloatArray, mean_mm: FloatArray, longest_mm: FloatArray
    ) -> FloatArray:
        """See :class:`Pressure`; 1 inside, the edge averaged over the mean side of a cell."""
        del longest_mm
        distance = np.linalg.norm(arm_mm, axis=2)
        inside = (self.radii_mm[patch][:, None] - distance) / mean_mm[:, None] + 0.5
        return np.asarray(np.clip(inside, 0.0, 1.0))


def patch_loads(
    mesh: ShellMesh, surface: Surface, centres_uv: FloatArray, radii_mm: FloatArray | float
) -> Any:
    """Nodal loads of discs of even pressure that each press inward with 1 N.

    See :func:`spread_loads`. Distances are chords between points of the outer face, as in
    :mod:`contact`.

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
    centres = np.asarray(centres_uv, dtype=np.float64).reshape(-1, 2)
    radii = np.broadcast_to(np.asarray(radii_mm, dtype=np.float64), len(centres))
    if not (np.all(np.isfinite(radii)) and np.all(radii >= 0.0)):
        raise NumericalError(
            "load-radius-invalid",
            "a patch radius is negative or not finite; give radii in mm, >= 0",
        )
    pressure = UniformDiscs(radii_mm=radii)
    return spread_loads(
        mesh, surface, PressurePatches(uv=centres, reach_mm=radii, pressure=pressure)
    )


def spread_loads(mesh: ShellMesh, surface: Surface, patches: PressurePatches) -> Any:
    """Nodal loads of patches that each press inward with 1 N, and drag along the face.

    The pressure acts along the local inward normal. It is scaled so that the resultant along the
    inward normal *at the centre* is exactly 1 N; by symmetry the resultant has (next to) no other
    component. Of a patch that reaches over a rim only the part on the shell carries, still 1 N in
    all; nothing presses where the face is turned more than 90° from the centre's. A patch smaller
    than the cells (an eighth of an element) is a point force, interpolated.

    The drag is spread as the pressure is. Its direction goes with the face by the least turn that
    carries the centre's normal to the local one; its resultant along its own direction is exactly
    the given one. Where a rim or an edge makes a patch one-sided, drag presses or lifts too;
    the pressure makes up for that, so that the 1 N is that of both. Drag acts on the outer face,
    half a thickness off the nodes, and so brings the moment (t/2) n × f.

    Returns
    -------
    scipy.sparse.csc_matrix, (6N, m)
        Forces in N and moments in N mm, DOF order as in the solver.

    Raises
    ------
    NumericalError
        If a centre lies off the shell, or drag alone presses with more than 1 N.
    """
    from scipy.sparse import coo_matrix

    centres = patches.uv
    nodes, weights = locate(mesh, centres, surface)  # also refuses centres off the shell
    inward = -surface.normal(centres)
    all_of = _spread(mesh, surface, patches)
    load, node = all_of.patch, all_of.node
    total = np.bincount(load, np.sum(all_of.push * inward[load], axis=1), minlength=len(centres))
    spread = (patches.reach_mm >= all_of.cell) & (total > 0.0)
    keep = spread[load]
    load, node = load[keep], node[keep]
    force = all_of.push[keep] / total[load][:, None]
    point = np.flatnonzero(~spread)
    direct = weights[point][:, :, None] * inward[point][:, None]
    if patches.drag is not None and all_of.drag is not None:
        pull = _scaled_drag(all_of.drag[keep], load, patches.drag)
        pressed = np.sum(pull[:, :3] * inward[load], axis=1)
        left = np.asarray(1.0 - np.bincount(load, pressed, minlength=len(centres)))
        _refuse_pulling(left, centres)
        force = np.column_stack([force * left[load][:, None], np.zeros_like(force)]) + pull
        aside = patches.drag[point]
        lever = -0.5 * mesh.thickness_mm * np.cross(inward[point], aside)
        both = np.column_stack([inward[point] + aside, lever])
        direct = weights[point][:, :, None] * both[:, None]
    load = np.concatenate([load, np.repeat(point, 4)])
    node = np.concatenate([node, nodes[point].ravel()])
    force = np.concatenate([force, direct.reshape(-1, force.shape[1])])
    rows = 6 * node[:, None] + np.arange(force.shape[1])
    columns = np.broadcast_to(load[:, None], rows.shape)
    shape = (6 * len(mesh.nodes_mm), len(centres))
    matrix = coo_matrix((force.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsc()
    matrix.eliminate_zeros()
    return matrix


def _spread(mesh: ShellMesh, surface: Surface, patches: PressurePatches) -> _Spread:
    cells = 8  # along each side of an element
    outer, middle, area = outer_elements(mesh)
    reach = np.linalg.norm(outer - middle[:, None], axis=2).max(axis=1)
    size = np.sqrt(area) / cells
    longest = np.linalg.norm(outer - np.roll(outer, 1, axis=1), axis=2).max(axis=1) / cells
    at, facing = surface.point(patches.uv), surface.normal(patches.uv)
    patch, element, _ = near_pairs(at, patches.reach_mm, middle, reach + size)
    cell = np.zeros(len(patches.uv))
    np.maximum.at(cell, patch, size[element])
    side = (np.arange(cells) + 0.5) * 2.0 / cells - 1.0
    r, s = (grid.ravel() for grid in np.meshgrid(side, side))
    h = 0.25 * (1.0 + np.multiply.outer(r, R)) * (1.0 + np.multiply.outer(s, S))  # (q, 4)
    used, slot = np.unique(element, return_inverse=True)
    points, normals = curved_points(outer[used], mesh.normals[mesh.quads[used]], h)
    push = -normals * _cell_area(outer[used], r, s)[:, :, None]
    force = np.zeros((len(patch), 4, 3))
    drag = None if patches.drag is None else np.zeros((len(patch), 4, 6))
    at_once = 20_000  # pairs, to bound the memory
    for first in range(0, len(patch), at_once):
        part = slice(first, first + at_once)
        i, k = patch[part], slot[part]
        arm = points[k] - at[i][:, None]
        inside = patches.pressure(i, arm, size[used[k]], longest[used[k]])
        # A wall behind, within the reach on a thin sensor, faces away and is not touched.
        inside = inside * (dot(push[k], facing[i]) < 0.0)
        # Products per patch and element: sums do not depend on the other patches.
        force[part] = h.T @ (inside[:, :, None] * push[k])
        if drag is not None and patches.drag is not None:
            hit = np.flatnonzero(inside.any(axis=1))
            i, k = i[hit], k[hit]
            weight = inside[hit] * np.linalg.norm(push[k], axis=2)
            pull = _carried(patches.drag[i], facing[i], normals[k])
            lever = 0.5 * mesh.thickness_mm * np.cross(normals[k], pull)
            both = np.concatenate([pull, lever], axis=2)
            drag[first + hit] = h.T @ (weight[:, :, None] * both)
    return _Spread(
        patch=np.repeat(patch, 4),
        node=mesh.quads[element].ravel(),
        push=force.reshape(-1, 3),
        drag=None if drag is None else drag.reshape(-1, 6),
        cell=cell,
    )


def _scaled_drag(drag: FloatArray, load: IntArray, wanted: FloatArray) -> FloatArray:
    """Rows (k, 6) of loads (k,), each load's resultant along ``wanted`` (m, 3) as long as that."""
    along = np.bincount(load, np.sum(drag[:, :3] * wanted[load], axis=1), minlength=len(wanted))
    length = np.sum(wanted**2, axis=1)
    scale = length / np.where(along > 0.0, along, 1.0)
    return np.asarray(drag * scale[load][:, None])


def _refuse_pulling(left: FloatArray, centres: FloatArray) -> None:
    if np.any(left <= 0.0):
        where = int(np.argmin(left))
        u, v = centres[where]
        raise NumericalError(
            "patch-beyond-edge",
            f"patch {where} at (u, v) = ({u:.6g}, {v:.6g}) reaches around an edge so far that its "
            f"friction alone presses with {1.0 - left[where]:.3g} times the normal force; lower "
            "its friction or make it smaller",
        )


def _carried(vector: FloatArray, normal: FloatArray, normals: FloatArray) -> FloatArray:
    """Tangent vectors (p, 3) at ``normal`` (p, 3), turned with it to ``normals`` (p, q, 3)."""
    # Where the face looks backwards nothing presses; the bound only keeps that finite.
    lean = dot(normals, vector) / np.maximum(1.0 + dot(normals, normal), 1.0)
    return np.asarray(vector[:, None] - lean[:, :, None] * (normal[:, None] + normals))


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products (p, q) of vectors (p, q, 3) with vectors (p, 3), each summed in the same order."""
    return np.asarray(sum(a[:, :, k] * b[:, None, k] for k in range(3)))


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

    Each bilinear point is moved halfway to the mean of its projections onto the corners'
    tangent planes (Phong tessellation, Boubekeur and Alexa 2008, with α = 1/2): exact for faces of
    second order, and free of any chart.

    Parameters
    ----------
    corners, normals : (E, 4, 3) float
        Corners, mm, and unit normals there.
    weights : (q, 4) float
        Bilinear weights of the points.
    """
    flat, out = weights @ corners, weights @ normals
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
