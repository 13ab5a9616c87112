"""The fixed parts around the receptors: inner face of the shell, rims, light bar."""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.geometry.boundary_loops import Loop, chart_loops
from phytac_design.geometry.triangles import (
    TriangleMesh,
    cylinder_mesh,
    empty_mesh,
    grid_mesh,
    merged,
)
from phytac_design.geometry.wall_sampling import untwisted
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray


def edge_mm(
    surface: Surface, end: int, offset_mm: float, count: int = 256, *, axis: int = 0
) -> FloatArray:
    """Points (count, 3) of the face at ``offset_mm`` along an edge of the chart.

    The edge is that at the low (``end`` 0) or high (1) end of chart direction ``axis``: u0 or u1
    for axis 0, v0 or v1 for axis 1.
    """
    low, high = surface.domain[1 - axis]
    uv = np.full((count, 2), surface.domain[axis, end])
    uv[:, 1 - axis] = np.linspace(low, high, count, endpoint=not surface.periodic[1 - axis])
    return surface.point(uv, offset_mm)


def boundary_mm(surface: Surface, offset_mm: float, count: int = 256) -> FloatArray:
    """Points (edges · count, 3) of the face at ``offset_mm`` along all of its open edges."""
    return np.concatenate(
        [edge_mm(surface, end, offset_mm, count, axis=axis) for axis, end in surface.edges()]
    )


def divisions(
    surface: Surface,
    offset_mm: float,
    along: int,
    tolerance_mm: float,
    longest_mm: float = np.inf,
) -> int:
    """Cells along chart axis ``along`` whose chords stay within ``tolerance_mm`` of the face.

    No chord is longer than ``longest_mm``.
    """
    divisions_max = 4096
    limits = surface.domain
    other = np.linspace(limits[1 - along, 0], limits[1 - along, 1], 17)
    cells = 16
    while cells < divisions_max:
        steps = np.linspace(limits[along, 0], limits[along, 1], 2 * cells + 1)
        uv = np.zeros((len(other), len(steps), 2))
        uv[..., along], uv[..., 1 - along] = steps[None], other[:, None]
        p = surface.point(uv.reshape(-1, 2), offset_mm).reshape(*uv.shape[:2], 3)
        off = p[:, 1::2] - (p[:, :-1:2] + p[:, 2::2]) / 2.0
        chord = np.linalg.norm(p[:, 2::2] - p[:, :-1:2], axis=-1)
        near = float(np.linalg.norm(off, axis=-1).max()) <= tolerance_mm
        if near and float(chord.max()) <= longest_mm:
            break
        cells *= 2
    return cells


def shell_mesh(
    design: Design, surface: Surface, *, tolerance_mm: float, longest_mm: float = np.inf
) -> TriangleMesh:
    """Inner face over the whole domain, a rim flush with it along every open edge, rims' ends.

    Only what the cameras see: the outer face, and the end of a tube without a camera before it, are
    left out. Sides of the inner face's cells are at most ``longest_mm`` long.
    """
    closed = surface.periodic[1]
    u, v, face = _inner_face(design, surface, tolerance_mm, longest_mm)
    meshes = [grid_mesh(face, closed=closed, poles=surface.poles)]
    if design.wall.rim_length_mm > 0.0:
        ends = surface.edges()
        visible_ends = {(0, end) for end in design.camera.end_numbers}
        for number, loop in enumerate(chart_loops(surface, u, v)):
            hidden = closed and ends[number] not in visible_ends
            meshes.append(_rim(design, surface, loop, ended=not hidden))
    return merged(meshes)


def _inner_face(
    design: Design, surface: Surface, tolerance_mm: float, longest_mm: float = np.inf
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stations of the chart and the inner face there, (rows, columns, 3) mm."""
    offset = -design.wall.thickness_mm
    u, v = (
        np.linspace(low, high, divisions(surface, offset, axis, tolerance_mm, longest_mm) + 1)
        for axis, (low, high) in enumerate(surface.domain)
    )
    u, v = untwisted(surface, u, v, tolerance_mm)
    if surface.periodic[1]:
        v = v[:-1]
    uu, vv = np.meshgrid(u, v, indexing="ij")
    face = surface.point(np.column_stack([uu.ravel(), vv.ravel()]), offset)
    return u, v, face.reshape(len(u), len(v), 3)


def _rim(design: Design, surface: Surface, loop: Loop, *, ended: bool) -> TriangleMesh:
    """Rim around one loop of edges along their conormals; ``ended`` with its outer end face."""
    wall = design.wall
    edge = loop.points_mm(surface, -wall.thickness_mm, 0.0)
    rim = loop.points_mm(surface, -wall.thickness_mm, wall.rim_length_mm)
    curves = [edge, rim]
    if ended:
        curves.append(loop.points_mm(surface, wall.rim_flange_mm, wall.rim_length_mm))
    strip = grid_mesh(np.stack(curves), closed=True)
    # The stations of a mitre are one point on the edge itself.
    a, b, c = np.moveaxis(strip.vertices_mm[strip.triangles], 1, 0)
    real = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0.0
    return TriangleMesh(vertices_mm=strip.vertices_mm, triangles=strip.triangles[real])


def open_far(surface: Surface) -> bool:
    """Whether the surface is a tube with an open far end."""
    return (0, 1) in surface.edges() and surface.periodic[1]


def bar_span_mm(design: Design, surface: Surface) -> tuple[float, float]:
    """Z of the light bar's near and far end.

    In a tube the bar begins ``light.bar_start_mm`` inside the rim of each camera and ends at the
    rim of an end without one; in a dome, or before a sheet, a little in front of the inner face.
    """
    # Gap, as a share of the wall's thickness, between the bar's far end and the face.
    bar_step = 0.1
    # Rays along the light bar's side, besides its axis, that find the face at its end.
    bar_rays = 12
    offset, near = -design.wall.thickness_mm, design.light.bar_start_mm
    if open_far(surface):
        low = float(edge_mm(surface, 0, offset)[:, 2].min())
        high = float(edge_mm(surface, 1, offset)[:, 2].max())
        ends = design.camera.end_numbers
        return near if 0 in ends else low, high - near if 1 in ends else high
    clearance = bar_step * design.wall.thickness_mm
    face = grid_mesh(
        _inner_face(design, surface, clearance / 2.0)[2],
        closed=surface.periodic[1],
        poles=surface.poles,
    )
    turn = 2.0 * np.pi * np.arange(bar_rays) / bar_rays
    around = design.light.bar_radius_mm * np.column_stack([np.cos(turn), np.sin(turn)])
    heights = _heights_mm(face, np.concatenate([np.zeros((1, 2)), around]))
    far = float(heights.min(initial=np.inf))
    if not np.isfinite(far):
        far = float(boundary_mm(surface, offset)[:, 2].max())
    return near, far - clearance


def _heights_mm(mesh: TriangleMesh, places_mm: FloatArray) -> FloatArray:
    """Z of every crossing of the mesh with lines along z at ``places_mm`` (n, 2), flat."""
    slack = 1e-9  # how far outside a triangle, in its own coordinates, a line still meets it
    a, b, c = np.moveaxis(mesh.vertices_mm[mesh.triangles], 1, 0)
    first, second = b - a, c - a
    twice = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    flat = twice != 0.0
    a, first, second, twice = a[flat], first[flat], second[flat], twice[flat]
    arm = places_mm[:, None] - a[None, :, :2]
    s = (arm[..., 0] * second[:, 1] - arm[..., 1] * second[:, 0]) / twice
    t = (first[:, 0] * arm[..., 1] - first[:, 1] * arm[..., 0]) / twice
    inside = (s >= -slack) & (t >= -slack) & (s + t <= 1.0 + slack)
    height = a[:, 2] + s * first[:, 2] + t * second[:, 2]
    return np.asarray(height[inside])


def bar_mesh(design: Design, surface: Surface, *, tolerance_mm: float) -> TriangleMesh:
    """Light bar on the axis, a cylinder with a cap towards each camera; empty for radius 0."""
    radius = design.light.bar_radius_mm
    if radius <= 0.0:
        return empty_mesh()
    near, far = bar_span_mm(design, surface)
    if near >= far:
        return empty_mesh()
    ends = design.camera.end_numbers
    axis = np.array([0.0, 0.0, 1.0])
    return cylinder_mesh(
        near * axis, far * axis, radius, tolerance_mm=tolerance_mm, caps=(0 in ends, 1 in ends)
    )
