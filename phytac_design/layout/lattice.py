"""Rows and columns: spirals and straight grids through the surface's own metric."""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.arc import along_u
from phytac_design.layout.markers import NEIGHBOUR_STEPS, Lattice
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


def row_shares(rows: int, exponent: float) -> FloatArray:
    """Where rows lie along the surface, (rows,) in (0, 1).

    The first and the last row keep half of a uniform pitch from the ends; between them the
    distance from the first row grows as (row number) ** exponent.
    """
    margin = 0.5 / rows
    if rows == 1:
        return np.array([0.5])
    if exponent == 1.0:
        edges = np.linspace(0.0, 1.0, rows + 1)
        return np.asarray((edges[:-1] + edges[1:]) / 2.0)
    steps = (np.arange(rows) / (rows - 1)) ** exponent
    return np.asarray(margin + (1.0 - 2.0 * margin) * steps)


def make_lattice(design: Design, surface: Surface) -> Lattice:
    """Rows along the surface; a spiral turns each row by pitch · tan α.

    Row pitch is arc length along the middle of the chart. α is measured from the sensor axis (or,
    with ``spiral_from``, from the circumference) in the surface's own metric, so that the shift of
    one row against the row before is ``pitch · tan α`` (or ``pitch / tan α``) millimetres whatever
    the shape. (The paper states α = 50.5° but not from what; from the circumference the published
    markers fuse.) Sheets, which do not close around, carry columns in the middle of equal bands.

    Raises
    ------
    DesignError
        For a spiral on a sheet, or one whose angle from the circumference is too small.
    """
    layout = design.layout
    (v0, v1) = surface.domain[1]
    rows_u = along_u(surface, row_shares(layout.rows, layout.row_pitch_exponent))
    pitch_v = (v1 - v0) / layout.columns
    start = v0 if surface.periodic[1] else v0 + pitch_v / 2.0
    phase = np.full(layout.rows, start)
    if layout.kind == "spiral":
        if not surface.periodic[1]:
            raise DesignError(
                "spiral-on-open-surface",
                f"a spiral needs a surface that closes around, the {surface.name} does not (got "
                "layout.kind = 'spiral'); set layout.kind to 'straight' or 'phyllotaxis'",
            )
        turn = np.cumsum(_row_shifts(design, surface, rows_u))
        phase = start + np.concatenate([[0.0], turn])
    return Lattice(rows_u=rows_u, phase_v=phase, columns=layout.columns, pitch_v=float(pitch_v))


def _row_shifts(design: Design, surface: Surface, rows_u: FloatArray) -> FloatArray:
    """Turn of each row against the row before, (rows - 1,), in units of v."""
    layout = design.layout
    between = (rows_u[:-1] + rows_u[1:]) / 2.0
    metric = surface.metric(np.column_stack([between, np.full_like(between, surface.domain[1, 0])]))
    step_mm = np.diff(rows_u) * np.sqrt(metric[:, 0, 0])
    tangent = np.tan(np.radians(layout.spiral_angle_deg))
    if layout.spiral_from == "circumference":
        if abs(layout.spiral_angle_deg) < 1.0:
            raise DesignError(
                "spiral-angle-too-small",
                "a spiral along the circumference never leaves its row (got "
                f"layout.spiral_angle_deg = {layout.spiral_angle_deg:g}); raise it to 1 or more",
            )
        tangent = 1.0 / tangent
    return np.asarray(step_mm * tangent / np.sqrt(metric[:, 1, 1]))


def row_counts(design: Design, surface: Surface, lattice: Lattice) -> IntArray:
    """Markers in each row, (rows,): ``columns``, on a surface with a pole fewer towards it.

    There a row holds markers in proportion to its length around, in whole sets of colours so that
    they still alternate around, at least one set; the widest row holds ``columns``.
    """
    rows = len(lattice.rows_u)
    if not any(surface.poles):
        return np.full(rows, lattice.columns)
    at = np.column_stack([lattice.rows_u, np.full(rows, surface.domain[1, 0])])
    around = np.sqrt(surface.metric(at)[:, 1, 1])
    fitting = lattice.columns * around / float(around.max())
    whole = len(design.layout.colours)
    sets = np.maximum(np.rint(fitting / whole), 1.0).astype(np.int64)
    return np.minimum(sets * whole, lattice.columns)


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
