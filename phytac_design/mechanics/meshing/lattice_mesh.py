r"""Structured grids of a tube, aligned with a lattice of markers.

::

    line l+1   o-----o-----M-----o-----o      every line of nodes is equally spaced around (v);
                \     \     \     \     \     lines are shifted against each other so that
    line l       o-----o-----o-----o-----o    markers (M) are nodes and no element shears by
                  \     \     \     \     \   more than half its width
    line l-1       M-----o-----o-----M-----o
"""

import numpy as np

from phytac_design.layout import Lattice
from phytac_design.mechanics.meshing.quad_grid import QuadGrid
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError

MATCH_TOL = 1e-6
"""Rows closer than this, as a share of the domain, are one line."""


def lattice_grid(surface: Surface, lattice: Lattice, refine: int) -> tuple[QuadGrid, IntArray]:
    """Grid whose lines hold the markers of a lattice, and the node of each marker.

    Parameters
    ----------
    surface : Surface
        Open along u, closed around v.
    lattice : Lattice
        Rows and columns of the markers.
    refine : int
        Elements per marker pitch around; along, the count that makes elements about square.

    Raises
    ------
    DesignError
        If ``refine`` gives fewer than 3 elements around.
    """
    if refine < 1 or refine * lattice.columns < 3:
        raise DesignError(
            "mesh-too-coarse",
            f"mesh: refine = {refine} with {lattice.columns} columns gives fewer than 3 "
            f"elements around; raise refine to {-(-3 // lattice.columns)} or more",
        )
    around = lattice.columns * refine
    u, shift, line, start = _lines(surface, lattice, refine)
    ids = start[:, None] + refine * np.arange(lattice.columns)
    nodes = (line[:, None] * around + np.mod(ids, around)).ravel()
    return shifted_grid(surface, u, shift, around), nodes


def shifted_grid(surface: Surface, u: FloatArray, shift: FloatArray, around: int) -> QuadGrid:
    """Grid of lines at ``u``, each with ``around`` nodes equally spaced from ``shift`` on."""
    v0, v1 = surface.domain[1]
    v = shift[:, None] + (v1 - v0) / around * np.arange(around)
    here = np.arange(around)
    after = np.roll(here, -1)
    base = around * np.arange(len(u) - 1)[:, None]
    quads = np.stack([base + here, base + after, base + around + after, base + around + here], -1)
    return QuadGrid(
        uv=np.column_stack([np.repeat(u, around), v0 + np.mod(v - v0, v1 - v0).ravel()]),
        quads=quads.reshape(-1, 4),
        sets={"TOP": (len(u) - 1) * around + here, "BOTTOM": here},
        around=around,
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
    counts[[0, -1]] *= 2  # clamped edges bend sharply
    marks = np.concatenate([[0], np.cumsum(counts)])
    at = np.arange(marks[-1] + 1)
    u = np.interp(at, marks, stops)
    shift = np.interp(at, marks, stop_shift)
    return u, shift, marks[first_row : first_row + len(start)], start
