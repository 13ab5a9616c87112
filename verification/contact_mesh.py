"""Structured meshes that are fine under one contact and coarse elsewhere."""

from dataclasses import replace

import numpy as np

from phytac_design.mechanics.meshing.mesh import ShellMesh, _shell
from phytac_design.mechanics.meshing.quad_grid import product_grid
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

SAMPLES = 4001
"""Points at which the wanted element size is integrated."""
MIN_ELEMENTS = 2
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
        raise DesignError(
            "contact-mesh-surface",
            f"mesh: surface '{surface.name}' is not open along u and closed around v",
        )
    if not min(thickness_mm, core_mm, size_mm) > 0.0 or not growth >= 0.0:
        raise DesignError(
            "contact-mesh-size",
            f"mesh: thickness, core and size must be positive, growth not negative (got "
            f"{thickness_mm}, {core_mm}, {size_mm} mm, {growth})",
        )
    (u0, u1), (v0, v1) = surface.domain
    if not u0 < centre[0] < u1:
        raise DesignError(
            "contact-mesh-position",
            f"mesh: the contact's u = {centre[0]:.6g} is not between {u0} and {u1}",
        )
    metric = surface.metric(centre[None])[0]
    along, around = np.sqrt(metric[0, 0]), np.sqrt(metric[1, 1])
    size = (core_mm, size_mm, growth)
    below = _steps((centre[0] - u0) * along, *size) / along
    above = _steps((u1 - centre[0]) * along, *size) / along
    u = np.concatenate([centre[0] - below[::-1], centre[0] + above[1:]])
    u[[0, -1]] = u0, u1
    half = _steps(0.5 * (v1 - v0) * around, *size) / around
    v = centre[1] + np.concatenate([-half[:0:-1], half[:-1]])
    v = v0 + np.mod(v - v0, v1 - v0)
    grid = product_grid(surface, u, np.append(v, v[0]))
    return _shell(surface, replace(grid, around=None), thickness_mm)


def _steps(length: float, core: float, size: float, growth: float) -> FloatArray:
    """Distances from 0 to ``length`` with spacing size + growth·(x − core)."""
    x = np.linspace(0.0, length, SAMPLES)
    density = 1.0 / (size + growth * np.maximum(x - core, 0.0))
    count = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * x[1])])
    steps = max(MIN_ELEMENTS, int(np.ceil(count[-1])))
    return np.interp(np.linspace(0.0, count[-1], steps + 1), count, x)
