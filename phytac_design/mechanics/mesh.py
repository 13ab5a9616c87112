r"""Structured quadrilateral meshes of the middle face, aligned with the markers or not.

::

    line l+1   o-----o-----M-----o-----o      every line of nodes is equally spaced around (v);
                \     \     \     \     \     lines are shifted against each other so that
    line l       o-----o-----o-----o-----o    markers (M) are nodes and no element shears by
                  \     \     \     \     \   more than half its width
    line l-1       M-----o-----o-----M-----o
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from phytac_design.layout import Lattice, Markers
from shapes import Surface
from shapes.arrays import FloatArray, IntArray
from shapes.errors import DesignError

MATCH_TOL = 1e-6
"""Largest distance (in units of the element size) between a marker and its node."""
RIM_REFINE = 2
"""Elements along are this much shorter next to the rims, where clamped edges bend sharply."""


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
        Node sets: ``TOP`` (far rim), ``BOTTOM`` (near rim), ``MARKERS``.
    thickness_mm : float
        Wall thickness that the middle face belongs to.
    period_v : float
        Chart period of v; inf where the chart does not close on itself.
    """

    nodes_mm: FloatArray
    uv: FloatArray
    normals: FloatArray
    quads: IntArray
    marker_nodes: IntArray
    sets: Mapping[str, IntArray]
    thickness_mm: float
    period_v: float


def marker_mesh(
    surface: Surface, markers: Markers, *, thickness_mm: float, refine: int
) -> ShellMesh:
    """Mesh in which every marker is a node and the rims are lines of nodes.

    Parameters
    ----------
    surface : Surface
        The outer face; v must be periodic (so far).
    markers : Markers
        Receptors on that surface; their lattice defines the lines of nodes.
    thickness_mm : float
        Wall thickness; nodes lie at half of it below the outer face.
    refine : int
        Elements per marker pitch around; along, the count that makes elements about square.

    Raises
    ------
    DesignError
        If the chart is not periodic around, if ``refine`` gives fewer than 3 elements around,
        or if a marker is not on its node.
    """
    _check(surface, thickness_mm)
    if refine < 1 or refine * markers.lattice.columns < 3:
        raise DesignError(
            f"mesh: refine = {refine} with {markers.lattice.columns} columns gives fewer than 3 "
            f"elements around; raise refine to {-(-3 // markers.lattice.columns)} or more"
        )
    lattice = markers.lattice
    around = lattice.columns * refine
    u, shift, marker_line, marker_start = _lines(surface, lattice, refine)
    ids = marker_start[:, None] + refine * np.arange(lattice.columns)
    marker_nodes = (marker_line[:, None] * around + np.mod(ids, around)).ravel()
    mesh = _structured(
        surface, u, shift, around, thickness_mm=thickness_mm, marker_nodes=marker_nodes
    )
    gap = float(np.abs(mesh.nodes_mm[marker_nodes] - markers.mid_mm).max(initial=0.0))
    size = float(np.linalg.norm(np.diff(mesh.nodes_mm[mesh.quads[0, :2]], axis=0)))
    if gap > MATCH_TOL * size:
        raise DesignError(
            f"mesh: a marker is {gap:.3g} mm off its node; the markers do not belong to this "
            f"surface and thickness ({thickness_mm} mm); make them from the same design"
        )
    return mesh


def chart_mesh(surface: Surface, *, thickness_mm: float, n_along: int, n_around: int) -> ShellMesh:
    """Plain structured mesh, equally spaced in the chart, not aligned with markers.

    Parameters
    ----------
    surface : Surface
        The outer face; v must be periodic (so far).
    thickness_mm : float
        Wall thickness; nodes lie at half of it below the outer face.
    n_along, n_around : int
        Elements along u and around v.
    """
    _check(surface, thickness_mm)
    if n_along < 1 or n_around < 3:
        raise DesignError(
            f"mesh: needs at least 1 element along and 3 around (got {n_along} × {n_around})"
        )
    u0, u1 = surface.domain[0]
    u = np.linspace(u0, u1, n_along + 1)
    shift = np.full_like(u, surface.domain[1, 0])
    empty = np.zeros(0, dtype=np.int64)
    return _structured(surface, u, shift, n_around, thickness_mm=thickness_mm, marker_nodes=empty)


def _check(surface: Surface, thickness_mm: float) -> None:
    if surface.periodic != (False, True):
        raise DesignError(
            f"mesh: surface '{surface.name}' is not open along u and closed around v; "
            "only such charts can be meshed so far"
        )
    if not 0.0 < thickness_mm < 2.0 * surface.inner_reach_mm():
        raise DesignError(
            f"mesh: a wall of {thickness_mm} mm has no middle face on a surface that reaches "
            f"{surface.inner_reach_mm():.4g} mm inward; make the wall thinner"
        )


def _lines(
    surface: Surface, lattice: Lattice, refine: int
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Chart u and v-shift of every line of nodes; line and first node of every marker row."""
    (u0, u1), (v0, _) = surface.domain
    pitch = lattice.pitch_v / refine
    # Row by row the shift changes by the remainder of the turn modulo one element.
    start = np.zeros(len(lattice.rows_u), dtype=np.int64)
    row_shift = np.zeros(len(lattice.rows_u))
    previous = v0
    for k, phase in enumerate(lattice.phase_v):
        start[k] = round((phase - previous) / pitch)
        row_shift[k] = previous = phase - start[k] * pitch
    stops = np.concatenate([[u0], lattice.rows_u, [u1]])
    stop_shift = np.concatenate([row_shift[:1], row_shift, row_shift[-1:]])
    # A first or last row on the rim needs no strip between itself and the rim.
    keep = np.concatenate([[True], np.diff(stops) > MATCH_TOL * (u1 - u0)])
    if not keep[-1]:
        keep[-1], keep[-2] = True, False
    first_row = 1 if keep[1] else 0
    stops, stop_shift = stops[keep], stop_shift[keep]
    mid = np.column_stack([(stops[:-1] + stops[1:]) / 2.0, np.full(len(stops) - 1, v0)])
    metric = surface.metric(mid)
    length = np.diff(stops) * np.sqrt(metric[:, 0, 0])
    width = pitch * np.sqrt(metric[:, 1, 1])
    counts = np.maximum(1, np.rint(length / width)).astype(np.int64)
    counts[[0, -1]] *= RIM_REFINE
    marks = np.concatenate([[0], np.cumsum(counts)])
    at = np.arange(marks[-1] + 1)
    u = np.interp(at, marks, stops)
    shift = np.interp(at, marks, stop_shift)
    return u, shift, marks[first_row : first_row + len(start)], start


def _structured(
    surface: Surface,
    u: FloatArray,
    shift: FloatArray,
    around: int,
    *,
    thickness_mm: float,
    marker_nodes: IntArray,
) -> ShellMesh:
    """Nodes and quads of lines at ``u``, each with ``around`` nodes starting at ``shift``."""
    v0, v1 = surface.domain[1]
    v = shift[:, None] + (v1 - v0) / around * np.arange(around)
    uv = np.column_stack([np.repeat(u, around), v0 + np.mod(v - v0, v1 - v0).ravel()])
    here = np.arange(around)
    after = np.roll(here, -1)
    base = around * np.arange(len(u) - 1)[:, None]
    quads = np.stack([base + here, base + after, base + around + after, base + around + here], -1)
    quads = quads.reshape(-1, 4)
    nodes, normals = surface.point(uv, -thickness_mm / 2.0), surface.normal(uv)
    corner = nodes[quads]
    facing = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    if np.sum(facing * normals[quads].sum(axis=1)) < 0.0:
        quads = quads[:, ::-1].copy()
    last = (len(u) - 1) * around
    sets = {"TOP": last + here, "BOTTOM": here, "MARKERS": np.unique(marker_nodes)}
    return ShellMesh(
        nodes_mm=nodes,
        uv=uv,
        normals=normals,
        quads=quads,
        marker_nodes=marker_nodes,
        sets=sets,
        thickness_mm=thickness_mm,
        period_v=float(v1 - v0),
    )
