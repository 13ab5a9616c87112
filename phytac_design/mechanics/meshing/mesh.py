"""Quadrilateral meshes of the middle face of the wall, aligned with the markers or not.

Three kinds of surface, distinguished by their chart alone: *tubes* close around v, *domes* close
around v and end in a pole, *sheets* are open both ways.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phytac_design.layout import Lattice, Markers
from phytac_design.mechanics.meshing import quad_grid
from phytac_design.mechanics.meshing.dome import dome_grid
from phytac_design.mechanics.meshing.lattice_mesh import MATCH_TOL, lattice_grid, shifted_grid
from phytac_design.mechanics.meshing.quad_grid import (
    EDGE_NAMES,
    QuadGrid,
    axis_lines,
    product_grid,
)
from phytac_design.mechanics.meshing.snap import scaled_jacobian, snap
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class MeshSettings:
    """What a mesh with a node on every marker must keep."""

    min_scaled_jacobian: float = 0.35
    """Of every element, when nodes move onto markers."""
    min_side_share: float = 0.05
    """Of its length, that a side of an element keeps when nodes move onto markers."""
    max_attempts: int = 6
    refinement: float = 0.8
    """Meshes tried for markers that are no lattice; element size of each over the one before."""
    min_elements_across: int = 8
    """Across a surface, taken as a square of its area."""
    max_turn_over_mean: float = 1.5
    """A tube bends unevenly where an element turns so much more than the mean element around."""


SETTINGS = MeshSettings()
R = np.array([-1.0, 1.0, 1.0, -1.0])
S = np.array([-1.0, -1.0, 1.0, 1.0])
"""Coordinates (r, s) of an element's corners, in the order of its nodes."""


@dataclass(frozen=True, kw_only=True)
class ShellMesh:
    """A quadrilateral mesh of the middle face of the wall.

    Attributes
    ----------
    nodes_mm : (N, 3) float
        Node positions on the middle face, mm, sensor frame.
    uv : (N, 2) float
        Chart coordinates of the nodes on the surface, v within one period.
    normals : (N, 3) float
        Outward unit normals, the directors of the shell.
    quads : (E, 4) int
        Corner nodes; seen from outside they run counter-clockwise (element normal = outward).
    marker_nodes : (n,) int
        Node of each marker in marker order; empty if the mesh is not aligned with markers.
    sets : mapping of str to (k,) int
        Node sets: ``BOTTOM`` (near rim, u0), ``TOP`` (far rim, u1), of sheets also ``LEFT`` (v0)
        and ``RIGHT`` (v1); empty where there is no such rim. ``CLAMPED``: all open edges;
        ``MARKERS``.
    thickness_mm : float
        Wall thickness that the middle face belongs to.
    period_v : float
        Chart period of v; inf where the chart does not close on itself or ends in a pole.
    surface : Surface or None
        The outer face; None only for meshes that are located through another one.
    around : int or None
        Nodes of each line around, where all nodes come in lines of as many, evenly spaced; only
        such a mesh can map onto itself when turned by a column.
    """

    nodes_mm: FloatArray
    uv: FloatArray
    normals: FloatArray
    quads: IntArray
    marker_nodes: IntArray
    sets: Mapping[str, IntArray]
    thickness_mm: float
    period_v: float
    surface: Surface | None = None
    around: int | None = None

    @property
    def clamped(self) -> IntArray:
        """Nodes of all open edges, (k,)."""
        rims = [self.sets[key] for key in EDGE_NAMES.values() if key in self.sets]
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *rims]))

    def scaled_jacobian(self) -> FloatArray:
        """Least sine of the corner angles of each element, (E,): 1 for rectangles."""
        return scaled_jacobian(self.nodes_mm, self.quads, self.normals)


def marker_mesh(
    surface: Surface, markers: Markers, *, thickness_mm: float, refine: int
) -> ShellMesh:
    """Mesh in which every marker is a node and the rims are lines of nodes.

    A lattice on a tube gives a structured mesh. Other markers, and other surfaces, start from a
    mesh without them; then the nearest nodes move onto the markers and the others follow. Where
    that distorts an element (scaled Jacobian below that of ``SETTINGS``) the mesh is made finer.

    Parameters
    ----------
    surface : Surface
        The outer face.
    markers : Markers
        Receptors on that surface.
    thickness_mm : float
        Wall thickness; nodes lie at half of it below the outer face.
    refine : int
        Elements per marker pitch: that around, for a lattice on a tube (along, the count that
        makes elements about square); else √(area / number of markers).

    Raises
    ------
    DesignError
        If the wall has no middle face, ``refine`` is too small, a marker is not on its node, or
        markers lie too close together or to a rim.
    """
    _check(surface, thickness_mm)
    lattice: Lattice | None = markers.lattice
    tube = surface.periodic[1] and not any(surface.poles)
    if tube and lattice is not None and len(lattice.rows_u) * lattice.columns == markers.count:
        grid, nodes = lattice_grid(surface, lattice, refine)
        if not _bends_unevenly(surface, grid):
            return _matching(_shell(surface, grid, thickness_mm, nodes), markers)
    if refine < 1 or markers.count < 1:
        raise DesignError(
            "mesh-refine-invalid",
            f"mesh: refine and the number of markers must be at least 1 (got {refine} and "
            f"{markers.count}); raise them",
        )
    mesh = node_mesh(
        surface,
        markers.uv,
        thickness_mm=thickness_mm,
        size_mm=marker_size_mm(surface, markers.count, refine),
    )
    return _matching(mesh, markers)


def marker_size_mm(surface: Surface, count: int, refine: int) -> float:
    """Element size, mm: ``refine`` elements per √(area / count), and a few across at least."""
    area = surface.area_mm2()
    return float(min(np.sqrt(area / count) / refine, np.sqrt(area) / SETTINGS.min_elements_across))


def node_mesh(
    surface: Surface, uv: FloatArray, *, thickness_mm: float, size_mm: float
) -> ShellMesh:
    """Mesh of any surface with a node, in ``marker_nodes``, at each chart position (n, 2).

    Elements are of ``size_mm`` as in :func:`plain_mesh`, or smaller where it takes that to keep
    them sound (:class:`MeshSettings`).

    Raises
    ------
    DesignError
        If positions lie too close together or to a rim.
    """
    _check(surface, thickness_mm)
    size, best, kept = size_mm, 0.0, 0.0
    for _ in range(SETTINGS.max_attempts):
        grid = _grid(surface, thickness_mm, size, through=_product_lines(uv))
        moved = snap(surface, grid, uv, offset_mm=-thickness_mm / 2.0)
        if moved is not None:
            before = _sides(surface.point(grid.uv, -thickness_mm / 2.0), grid.quads)
            grid = QuadGrid(uv=moved[0], quads=grid.quads, sets=grid.sets)
            mesh = _shell(surface, grid, thickness_mm, moved[1])
            minimum = float(mesh.scaled_jacobian().min())
            kept = float((_sides(mesh.nodes_mm, grid.quads) / before).min())
            if minimum >= SETTINGS.min_scaled_jacobian and kept >= SETTINGS.min_side_share:
                return mesh
            best = max(best, minimum)
        size *= SETTINGS.refinement
    i, j, gap = _closest(surface.point(uv))
    raise DesignError(
        "mesh-quality-too-low",
        f"mesh: no sound mesh has a node on every marker (best scaled Jacobian {best:.2f}, sides "
        f"kept to {kept:.2g}; needs {SETTINGS.min_scaled_jacobian} and {SETTINGS.min_side_share}; "
        f"elements down to {size / SETTINGS.refinement:.3g} mm); markers {i} and {j} are the "
        f"closest ({gap:.3g} mm apart): move markers apart and off the rims, or raise refine",
    )


def chart_mesh(surface: Surface, *, thickness_mm: float, n_along: int, n_around: int) -> ShellMesh:
    """Plain structured mesh, equally spaced in the chart, not aligned with markers.

    Parameters
    ----------
    surface : Surface
        The outer face of a tube or sheet; for others see :func:`plain_mesh`.
    thickness_mm : float
        Wall thickness; nodes lie at half of it below the outer face.
    n_along, n_around : int
        Elements along u and around v.
    """
    _check(surface, thickness_mm)
    if any(surface.poles):
        raise DesignError(
            "mesh-pole-unsupported",
            f"mesh: surface '{surface.name}' has a pole, where a structured mesh collapses; "
            "use plain_mesh",
        )
    closed = surface.periodic[1]
    if n_along < 1 or n_around < (3 if closed else 1):
        raise DesignError(
            "mesh-too-coarse",
            f"mesh: needs at least 1 element along and {'3 around' if closed else '1 across'} "
            f"(got {n_along} × {n_around})",
        )
    (u0, u1), (v0, v1) = surface.domain
    u = np.linspace(u0, u1, n_along + 1)
    if closed:
        grid = shifted_grid(surface, u, np.full_like(u, v0), n_around)
    else:
        grid = product_grid(surface, u, np.linspace(v0, v1, n_around + 1))
    return _shell(surface, grid, thickness_mm)


def plain_mesh(surface: Surface, *, thickness_mm: float, size_mm: float) -> ShellMesh:
    """Mesh of any surface with elements of about ``size_mm``, blind to the markers.

    Elements are smaller next to clamped edges, where the face bends, and towards the end of a
    dome that narrows.

    Parameters
    ----------
    surface : Surface
        The outer face.
    thickness_mm : float
        Wall thickness; nodes lie at half of it below the outer face.
    size_mm : float
        Element size.
    """
    _check(surface, thickness_mm)
    if not 0.0 < size_mm < np.inf:
        raise DesignError(
            "mesh-size-not-positive", f"mesh: the element size must be positive (got {size_mm} mm)"
        )
    return _shell(surface, _grid(surface, thickness_mm, size_mm), thickness_mm)


def _check(surface: Surface, thickness_mm: float) -> None:
    if surface.periodic[0]:
        raise DesignError(
            "mesh-closed-along-u",
            f"mesh: surface '{surface.name}' closes along u; meshes need it open along u, closed "
            "around v or open both ways: swap u and v",
        )
    if not 0.0 < thickness_mm < 2.0 * surface.inner_reach_mm():
        raise DesignError(
            "wall-exceeds-curvature",
            f"mesh: a wall of {thickness_mm} mm has no middle face on a surface that reaches "
            f"{surface.inner_reach_mm():.4g} mm inward; make the wall thinner",
        )


def _grid(
    surface: Surface,
    thickness_mm: float,
    size_mm: float,
    through: tuple[FloatArray, FloatArray] | None = None,
) -> QuadGrid:
    """Grid of any surface, with lines ``through`` given (u, v) where its lines are straight."""
    offset = -thickness_mm / 2.0
    if any(surface.poles):
        return dome_grid(surface, offset_mm=offset, size_mm=size_mm)
    lines = [
        axis_lines(
            surface, axis, offset_mm=offset, size_mm=size_mm, through=through and through[axis]
        )
        for axis in (0, 1)
    ]
    return product_grid(surface, lines[0], lines[1])


def _product_lines(uv: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Distinct u and v of markers that are all combinations of them; None otherwise."""
    scale = np.where(np.ptp(uv, axis=0) > 0.0, np.ptp(uv, axis=0), 1.0)
    u, v = (np.unique(np.round(uv[:, k] / scale[k], 9), return_index=True)[1] for k in (0, 1))
    return (uv[u, 0], uv[v, 1]) if len(u) * len(v) == len(uv) else None


def _bends_unevenly(surface: Surface, grid: QuadGrid) -> bool:
    """Whether equal steps around turn some corners too far for one element."""
    normal = surface.normal(grid.uv)
    ahead = normal[np.roll(grid.quads, -1, axis=1)[:, [0, 2]]]
    turn = np.linalg.norm(ahead - normal[grid.quads[:, [0, 2]]], axis=2)
    mean = 2.0 * np.pi / (grid.around or 1)
    return bool(
        turn.max() > max(1.5 * quad_grid.SETTINGS.max_turn_rad, SETTINGS.max_turn_over_mean * mean)
    )


def _sides(nodes_mm: FloatArray, quads: IntArray) -> FloatArray:
    """Lengths of the sides of every element, (E, 4)."""
    corner = nodes_mm[quads]
    return np.asarray(np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2))


def _closest(points: FloatArray) -> tuple[int, int, float]:
    from scipy.spatial import cKDTree

    if len(points) < 2:
        return 0, 0, float("inf")
    gap, near = cKDTree(points).query(points, k=2)
    i = int(np.argmin(gap[:, 1]))
    return i, int(near[i][near[i] != i][0]), float(gap[i, 1])


def _matching(mesh: ShellMesh, markers: Markers) -> ShellMesh:
    """Refuse a mesh whose marker nodes are not the markers."""
    gap = float(np.abs(mesh.nodes_mm[mesh.marker_nodes] - markers.mid_mm).max(initial=0.0))
    if gap > MATCH_TOL * float(_sides(mesh.nodes_mm, mesh.quads).min()):
        raise DesignError(
            "mesh-marker-off-node",
            f"mesh: a marker is {gap:.3g} mm off its node; the markers do not belong to this "
            f"surface and thickness ({mesh.thickness_mm} mm); make them from the same design",
        )
    return mesh


def _shell(
    surface: Surface, grid: QuadGrid, thickness_mm: float, marker_nodes: IntArray | None = None
) -> ShellMesh:
    """Put a grid onto the middle face, elements facing outward."""
    empty = np.zeros(0, dtype=np.int64)
    nodes, normals = surface.point(grid.uv, -thickness_mm / 2.0), surface.normal(grid.uv)
    quads, corner = grid.quads, nodes[grid.quads]
    facing = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    if np.sum(facing * normals[quads].sum(axis=1)) < 0.0:
        quads = quads[:, ::-1].copy()
    marked = empty if marker_nodes is None else marker_nodes
    rims = {"TOP": empty, "BOTTOM": empty} | dict(grid.sets)
    wraps = surface.periodic[1] and not any(surface.poles)
    return ShellMesh(
        nodes_mm=nodes,
        uv=grid.uv,
        normals=normals,
        quads=quads,
        marker_nodes=marked,
        sets=rims
        | {
            "CLAMPED": np.unique(np.concatenate([empty, *rims.values()])),
            "MARKERS": np.unique(marked),
        },
        thickness_mm=thickness_mm,
        period_v=float(surface.domain[1, 1] - surface.domain[1, 0]) if wraps else float("inf"),
        surface=surface,
        around=grid.around,
    )
