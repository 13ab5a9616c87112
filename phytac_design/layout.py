"""Where the markers sit: a lattice of receptors on a surface, the single source for every stage."""

from dataclasses import dataclass

import numpy as np

from phytac_design.spec import Design
from shapes import Surface
from shapes.arrays import FloatArray, IntArray

NEIGHBOUR_STEPS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""(row, column) steps of the eight neighbours, in the order of every neighbour array."""


@dataclass(frozen=True, kw_only=True)
class Lattice:
    """A lattice of rows along u, each row equally spaced around v.

    Attributes
    ----------
    rows_u : (rows,) float
        Chart coordinate u of each row, row 0 nearest the camera.
    phase_v : (rows,) float
        Chart coordinate v of column 0 in each row (unwrapped, it keeps growing along a spiral).
    columns : int
        Markers in each row.
    pitch_v : float
        Chart distance between neighbours of one row.
    """

    rows_u: FloatArray
    phase_v: FloatArray
    columns: int
    pitch_v: float


@dataclass(frozen=True, kw_only=True)
class Markers:
    """All receptors of one sensor; arrays run over markers, id = row · columns + column.

    Attributes
    ----------
    uv : (n, 2) float
        Chart coordinates on the surface.
    row, column, colour : (n,) int
        Lattice indices (row 0 nearest the camera) and index into the design's colour list.
    height_mm : (n,) float
        Receptor height, from the inner face of the wall to the end face.
    foot_mm, tip_mm : (n, 3) float
        Axis of the receptor on the inner face, and in the plane of its end face.
    mid_mm : (n, 3) float
        Point of the middle face of the wall under the marker: the mesh node.
    normal : (n, 3) float
        Outward unit normal; receptors point along minus the normal.
    neighbours : (n, 8) int
        Ids in the order of ``NEIGHBOUR_STEPS``; -1 beyond a rim.
    lattice : Lattice
        The lattice the markers came from.
    """

    uv: FloatArray
    row: IntArray
    column: IntArray
    colour: IntArray
    height_mm: FloatArray
    foot_mm: FloatArray
    tip_mm: FloatArray
    mid_mm: FloatArray
    normal: FloatArray
    neighbours: IntArray
    lattice: Lattice

    @property
    def count(self) -> int:
        """Number of markers."""
        return len(self.row)


def make_lattice(design: Design, surface: Surface) -> Lattice:
    """Rows in the middle of equal bands along u; the spiral turns each row by pitch · tan α.

    α is measured from the sensor axis, in the surface's own metric, so that the shift of one row
    against the row before is ``pitch · tan α`` millimetres whatever the shape. (The paper states
    α = 50.5° but not from what; measured from the circumference the published markers fuse.)
    """
    layout = design.layout
    (u0, u1), (v0, v1) = surface.domain
    edges = np.linspace(u0, u1, layout.rows + 1)
    rows_u = (edges[:-1] + edges[1:]) / 2.0
    pitch_v = (v1 - v0) / layout.columns
    phase = np.full(layout.rows, v0)
    if layout.kind == "spiral" and layout.rows > 1:
        between = (rows_u[:-1] + rows_u[1:]) / 2.0
        metric = surface.metric(np.column_stack([between, np.full_like(between, v0)]))
        step_mm = np.diff(rows_u) * np.sqrt(metric[:, 0, 0])
        turn = step_mm * np.tan(np.radians(layout.spiral_angle_deg)) / np.sqrt(metric[:, 1, 1])
        phase = v0 + np.concatenate([[0.0], np.cumsum(turn)])
    return Lattice(rows_u=rows_u, phase_v=phase, columns=layout.columns, pitch_v=float(pitch_v))


def lattice_neighbours(lattice: Lattice, *, periodic: bool) -> IntArray:
    """Eight neighbours of each marker, (n, 8), -1 where there is none.

    In the next row the middle neighbour is the marker *nearest around the surface*, not the one
    of the same column: a spiral shifts rows by more than half a pitch, and the eight neighbours
    are meant to surround the marker (paper, Fig. 3B).
    """
    rows, columns = len(lattice.rows_u), lattice.columns
    row, column = np.divmod(np.arange(rows * columns), columns)
    out = np.full((rows * columns, 8), -1, dtype=np.int64)
    for slot, (step_row, step_column) in enumerate(NEIGHBOUR_STEPS):
        other = row + step_row
        inside = (other >= 0) & (other < rows)
        safe = np.clip(other, 0, rows - 1)
        shift = np.rint((lattice.phase_v[row] - lattice.phase_v[safe]) / lattice.pitch_v)
        target = column + shift.astype(np.int64) + step_column
        if periodic:
            target = np.mod(target, columns)
        inside &= (target >= 0) & (target < columns)
        out[:, slot] = np.where(inside, safe * columns + target, -1)
    own = np.arange(rows * columns)[:, None]
    # With one or two columns a step around meets the marker itself: that is no neighbour.
    return np.where(out == own, -1, out)


def make_markers(design: Design, surface: Surface) -> Markers:
    """Place every receptor of a design on its surface."""
    layout, thickness = design.layout, design.wall.thickness_mm
    lattice = make_lattice(design, surface)
    row, column = np.divmod(np.arange(layout.rows * layout.columns), layout.columns)
    angle = lattice.phase_v[row] + column * lattice.pitch_v
    if surface.periodic[1]:
        (v0, v1) = surface.domain[1]
        angle = v0 + np.mod(angle - v0, v1 - v0)
    uv = np.column_stack([lattice.rows_u[row], angle])
    heights = np.linspace(layout.height_near_mm, layout.height_far_mm, layout.rows)[row]
    return Markers(
        uv=uv,
        row=row,
        column=column,
        colour=column % len(layout.colours),
        height_mm=heights,
        foot_mm=surface.point(uv, -thickness),
        tip_mm=surface.point(uv, -thickness - heights),
        mid_mm=surface.point(uv, -thickness / 2.0),
        normal=surface.normal(uv),
        neighbours=lattice_neighbours(lattice, periodic=surface.periodic[1]),
        lattice=lattice,
    )
