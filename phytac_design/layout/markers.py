"""The markers of one sensor, and the lattice that most of them come from."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray

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
    """All receptors of one sensor; arrays run over markers, near rows first.

    On a full lattice id = row · columns + column. Towards a pole rows hold fewer markers than
    ``columns``; layouts without rows number their markers along u: there ``row`` is the marker's
    id and ``column`` 0.

    Attributes
    ----------
    uv : (n, 2) float
        Chart coordinates on the surface.
    row, column, colour : (n,) int
        Place in the lattice (row 0 nearest the camera) and index into the design's colour list.
    height_mm : (n,) float
        Receptor height, from the inner face of the wall to the end face.
    base_mm, tip_mm : (n, 3) float
        Axis of the receptor on the inner face, and in the plane of its end face.
    mid_mm : (n, 3) float
        Point of the middle face of the wall under the marker, on the axis: the mesh node.
    normal : (n, 3) float
        Outward unit normal.
    direction : (n, 3) float
        Unit vector from base to tip; minus the normal unless the design leans its receptors.
    neighbours : (n, 8) int
        Ids in the order of ``NEIGHBOUR_STEPS``; -1 beyond a rim. Off a lattice: the nearest
        marker in each of eight sectors around.
    lattice : Lattice or None
        The full lattice the markers came from; None if they are on none, or some are dropped.
    """

    uv: FloatArray
    row: IntArray
    column: IntArray
    colour: IntArray
    height_mm: FloatArray
    base_mm: FloatArray
    tip_mm: FloatArray
    mid_mm: FloatArray
    normal: FloatArray
    direction: FloatArray
    neighbours: IntArray
    lattice: Lattice | None

    @property
    def count(self) -> int:
        """Number of markers."""
        return len(self.row)

    @cached_property
    def in_rows(self) -> bool:
        """Whether rows and columns say where a marker is."""
        return self.lattice is not None or len(np.unique(self.row)) < self.count

    def name(self, marker: int) -> str:
        """Name of a marker in messages: ``(row 3, column 4)`` or its number."""
        if self.in_rows:
            return f"(row {self.row[marker]}, column {self.column[marker]})"
        return f"number {marker}"

    def place(self, marker: int) -> str:
        """Where a marker is, for messages that hold for its whole row: ``row 3`` or its number."""
        return f"row {self.row[marker]}" if self.in_rows else f"marker {marker}"
