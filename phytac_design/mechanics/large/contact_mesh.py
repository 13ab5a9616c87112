"""Structured meshes that are fine under one contact and coarse elsewhere."""

import numpy as np

from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

SAMPLES = 4001
"""Points at which the wanted element size is integrated."""
LEAST_SIDE = 2
"""Elements on each side of the contact at least."""


def contact_mesh(
    surface: Surface,
    *,
    thickness_mm: float,
    centre_uv: FloatArray,
    core_mm: float,
    size_mm: float,
    growth: float = 0.25,
) -> ShellMesh:
    """Mesh with elements of ``size_mm`` within ``core_mm`` of a contact, growing away from it.

    Lines of nodes run along u and v (a product mesh); the contact's centre is a node.

    Parameters
    ----------
    surface : Surface
        The outer face; open along u, closed around v.
    thickness_mm : float
        Wall thickness.
    centre_uv : (2,) float
        Chart position of the contact, between the rims.
    core_mm : float
        Half-width of the fine part: the patch's radius and the dimple around it, about √(R·t) wide.
    size_mm : float
        Element size in the fine part.
    growth : float
        Element size gained per mm of distance from the fine part, mm/mm.

    Raises
    ------
    DesignError
        If the chart is not of that kind, a size is not positive or the centre is off the shell.
    """
    centre = np.asarray(centre_uv, dtype=np.float64).reshape(2)
    if surface.periodic != (False, True):
        raise DesignError(f"mesh: surface '{surface.name}' is not open along u and closed around v")
    if not min(thickness_mm, core_mm, size_mm) > 0.0 or not growth >= 0.0:
        raise DesignError(
            f"mesh: thickness, core and size must be positive, growth not negative (got "
            f"{thickness_mm}, {core_mm}, {size_mm} mm, {growth})"
        )
    (u0, u1), (v0, v1) = surface.domain
    if not u0 < centre[0] < u1:
        raise DesignError(f"mesh: the contact's u = {centre[0]:.6g} is not between {u0} and {u1}")
    metric = surface.metric(centre[None])[0]
    along, around = np.sqrt(metric[0, 0]), np.sqrt(metric[1, 1])
    size = (core_mm, size_mm, growth)
    below = _steps((centre[0] - u0) * along, *size) / along
    above = _steps((u1 - centre[0]) * along, *size) / along
    u = np.concatenate([centre[0] - below[::-1], centre[0] + above[1:]])
    u[[0, -1]] = u0, u1
    half = _steps(0.5 * (v1 - v0) * around, *size) / around
    v = centre[1] + np.concatenate([-half[:0:-1], half[:-1]])
    return _product(surface, u, v0 + np.mod(v - v0, v1 - v0), thickness_mm)


def _steps(length: float, core: float, size: float, growth: float) -> FloatArray:
    """Distances from 0 to ``length`` with spacing size + growth·(x − core)."""
    x = np.linspace(0.0, length, SAMPLES)
    density = 1.0 / (size + growth * np.maximum(x - core, 0.0))
    count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * x[1])])
    steps = max(LEAST_SIDE, int(np.ceil(count[-1])))
    return np.interp(np.linspace(0.0, count[-1], steps + 1), count, x)


def _product(surface: Surface, u: FloatArray, v: FloatArray, thickness_mm: float) -> ShellMesh:
    uv = np.column_stack([np.repeat(u, len(v)), np.tile(v, len(u))])
    ids = np.arange(len(uv)).reshape(len(u), len(v))
    after = np.roll(ids, -1, axis=1)
    quads = np.stack([ids[:-1], after[:-1], after[1:], ids[1:]], axis=-1).reshape(-1, 4)
    nodes, normals = surface.point(uv, -thickness_mm / 2.0), surface.normal(uv)
    corner = nodes[quads]
    facing = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    if np.sum(facing * normals[quads].sum(axis=1)) < 0.0:
        quads = quads[:, ::-1].copy()
    empty = np.zeros(0, dtype=np.int64)
    return ShellMesh(
        nodes_mm=nodes,
        uv=uv,
        normals=normals,
        quads=quads,
        marker_nodes=empty,
        sets={
            "TOP": ids[-1],
            "BOTTOM": ids[0],
            "CLAMPED": np.concatenate([ids[0], ids[-1]]),
            "MARKERS": empty,
        },
        thickness_mm=thickness_mm,
        period_v=float(surface.domain[1, 1] - surface.domain[1, 0]),
        surface=surface,
    )
