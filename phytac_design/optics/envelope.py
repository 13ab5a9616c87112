"""The fixed parts around the receptors: inner face of the shell, rims, light bar."""

import numpy as np

from phytac_design.optics.mesh import Mesh, empty_mesh, grid_mesh, joined
from phytac_design.spec import Design
from shapes import Surface
from shapes.arrays import FloatArray

DIVISIONS_MAX = 4096


def edge_mm(surface: Surface, end: int, offset_mm: float, count: int = 256) -> FloatArray:
    """Points (count, 3) of the face at ``offset_mm`` along its edge u0 (end 0) or u1 (end 1)."""
    u, (v0, v1) = surface.domain[0, end], surface.domain[1]
    v = np.linspace(v0, v1, count, endpoint=not surface.periodic[1])
    return surface.point(np.column_stack([np.full(count, u), v]), offset_mm)


def divisions(surface: Surface, offset_mm: float, along: int, tolerance_mm: float) -> int:
    """Cells along chart axis ``along`` whose chords stay within ``tolerance_mm`` of the face."""
    limits = surface.domain
    other = np.linspace(limits[1 - along, 0], limits[1 - along, 1], 17)
    cells = 16
    while cells < DIVISIONS_MAX:
        steps = np.linspace(limits[along, 0], limits[along, 1], 2 * cells + 1)
        uv = np.zeros((len(other), len(steps), 2))
        uv[..., along], uv[..., 1 - along] = steps[None], other[:, None]
        p = surface.point(uv.reshape(-1, 2), offset_mm).reshape(*uv.shape[:2], 3)
        off = p[:, 1::2] - (p[:, :-1:2] + p[:, 2::2]) / 2.0
        if float(np.linalg.norm(off, axis=-1).max()) <= tolerance_mm:
            break
        cells *= 2
    return cells


def shell_mesh(design: Design, surface: Surface, *, tolerance_mm: float) -> Mesh:
    """Inner face over the whole domain, both rims flush with it, and the near rim's end.

    Only what a camera inside sees: the outer face is left out.
    """
    offset = -design.wall.thickness_mm
    (u0, u1), (v0, v1) = surface.domain
    rows = divisions(surface, offset, 0, tolerance_mm) + 1
    cells = divisions(surface, offset, 1, tolerance_mm)
    closed = surface.periodic[1]
    v = np.linspace(v0, v1, cells + (0 if closed else 1), endpoint=not closed)
    uu, vv = np.meshgrid(np.linspace(u0, u1, rows), v, indexing="ij")
    face = surface.point(np.column_stack([uu.ravel(), vv.ravel()]), offset)
    meshes = [grid_mesh(face.reshape(rows, len(v), 3), closed=closed)]
    if not surface.periodic[0] and design.wall.rim_length_mm > 0.0:
        meshes += [_rim(design, surface, v, end) for end in (0, 1)]
    return joined(meshes)


def _rim(design: Design, surface: Surface, v: FloatArray, end: int) -> Mesh:
    """Straight rim beyond one end along the conormal; the near one with its annular end."""
    wall = design.wall
    uv = np.column_stack([np.full_like(v, surface.domain[0, end]), v])
    edge = surface.point(uv, -wall.thickness_mm)
    normal, tangents = surface.normal(uv), surface.tangents(uv)
    along, around = tangents[:, 0], tangents[:, 1]
    length = np.sum(around**2, axis=1)
    if float(length.min()) <= 1e-18 * float(np.sum(along**2, axis=1).max()):
        return empty_mesh()  # A pole: the edge is a point and has no rim.
    along = along - (np.sum(along * around, axis=1) / length)[:, None] * around
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    outward = along if end == 1 else -along
    rim = edge + wall.rim_length_mm * outward
    curves = [edge, rim]
    if end == 0:
        curves.append(rim + (wall.thickness_mm + wall.rim_flange_mm) * normal)
    return grid_mesh(np.stack(curves), closed=surface.periodic[1])


def bar_span_mm(design: Design, surface: Surface) -> tuple[float, float]:
    """Z of the light bar's near and far end (at the far edge of the sensing surface)."""
    far = float(edge_mm(surface, 1, -design.wall.thickness_mm)[:, 2].max())
    return design.light.bar_start_mm, far


def bar_mesh(design: Design, surface: Surface, *, tolerance_mm: float) -> Mesh:
    """Light bar on the axis, a cylinder with its near cap; empty for radius 0."""
    radius = design.light.bar_radius_mm
    near, far = bar_span_mm(design, surface)
    if radius <= 0.0 or near >= far:
        return empty_mesh()
    ratio = min(max(tolerance_mm / radius, 1e-6), 0.1)
    sides = int(np.ceil(np.pi / np.arccos(1.0 - ratio)))
    turn = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(sides)]) * radius
    axis = np.array([0.0, 0.0, 1.0])
    curves = np.stack([np.zeros_like(ring) + near * axis, ring + near * axis, ring + far * axis])
    return grid_mesh(curves, closed=True)
