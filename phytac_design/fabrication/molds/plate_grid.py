"""Places of cavities in a mold: lines of a square grid, one label before each run of a kind."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phytac_shapes.arrays import FloatArray

SwitchKind = tuple[int, int]
LEAST = 3
"""Cells that a grid needs each way: its keys stand in the corners, one of them out of line."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """Cavities of one kind side by side on a line; the cell before them holds their label.

    Attributes
    ----------
    kind : (int, int)
        As in ``SwitchSet.kinds``.
    line, start, count : int
        Line, first cell and cells.
    places : tuple of (float, float)
        On strips: where the cavities are instead, as (column, line), between cells too.
    """

    kind: SwitchKind
    line: int
    start: int
    count: int
    places: tuple[tuple[float, float], ...] = ()

    @property
    def cells(self) -> Sequence[tuple[float, float]]:
        """Cells as (column, line)."""
        return self.places or [(self.start + k, self.line) for k in range(self.count)]


@dataclass(frozen=True, kw_only=True)
class PlacedStrip:
    """Cavity of a strip.

    Attributes
    ----------
    number : int
        As in ``SwitchStrip.number``.
    cells : tuple of (float, float)
        Places of its switches as (column, line), between cells too.
    bridges : tuple of (int, int)
        Pairs of them that a web joins.
    label_cell : (float, float)
        Place of its label.
    """

    number: int
    cells: tuple[tuple[float, float], ...]
    bridges: tuple[tuple[int, int], ...]
    label_cell: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class PlateLayout:
    """Grid of one set of plates.

    Attributes
    ----------
    columns, lines : int
        Cells each way.
    runs : tuple of Run
        The cavities.
    number, total : int
        This set, from 1, and how many there are.
    strips : tuple of PlacedStrip
        The strips that its cavities belong to; none where switches are cast one by one.
    castings : int
        How often the set is cast.
    """

    columns: int
    lines: int
    runs: tuple[Run, ...]
    number: int = 1
    total: int = 1
    strips: tuple[PlacedStrip, ...] = ()
    castings: int = 1

    @property
    def keys(self) -> list[tuple[int, int]]:
        """Cells of the registration keys; no turn of the plate brings them onto themselves."""
        right, back = self.columns - 1, self.lines - 1
        # Strips fill all lines but the first and the last.
        last = (right - 1, back) if self.strips else (right, back - 1)
        return [(0, 0), (right, 0), (0, back), last]

    @property
    def title(self) -> tuple[int, int]:
        """Cell of the set's number."""
        return (1, 0)

    @property
    def labels(self) -> dict[tuple[float, float], SwitchKind | int]:
        """Cells of labels, with the kind of switch or the number of the strip that they name."""
        if self.strips:
            return {strip.label_cell: strip.number for strip in self.strips}
        return {(run.start - 1, run.line): run.kind for run in self.runs}

    @property
    def cavities(self) -> int:
        """Number of cavities."""
        return sum(run.count for run in self.runs)

    @property
    def blank(self) -> list[tuple[int, int]]:
        """Cells that hold nothing."""
        taken: set[tuple[float, float]] = {*self.keys, self.title}
        for run in self.runs:
            taken |= {(run.start - 1, run.line), *run.cells}
        return [
            (x, y) for y in range(self.lines) for x in range(self.columns) if (x, y) not in taken
        ]

    def spacing_mm(self, pitch_mm: float) -> float:
        """Least distance of two cavities along x or y, whichever is larger for them, mm."""
        if not self.strips:
            return pitch_mm
        at = self.centre_mm([cell for run in self.runs for cell in run.cells], pitch_mm)
        away = np.abs(at[:, None] - at[None]).max(axis=2)
        np.fill_diagonal(away, np.inf)
        return float(away.min())

    def centre_mm(self, cells: Sequence[tuple[float, float]], pitch_mm: float) -> FloatArray:
        """Middles of cells (m, 2); the grid's own middle is the origin."""
        middle = 0.5 * np.array([self.columns - 1.0, self.lines - 1.0])
        return pitch_mm * (np.asarray(cells, dtype=np.float64).reshape(-1, 2) - middle)


def _span(columns: int, lines: int, line: int) -> tuple[int, int]:
    """First cell of a line for labels and cavities, and the one behind the last."""
    first = {0: 2, lines - 1: 1}.get(line, 0)
    last = columns - 1 if line in {0, lines - 2} else columns
    return first, last


def _fill(columns: int, lines: int, left: list[tuple[SwitchKind, int]]) -> tuple[list[Run], int]:
    """Runs that fit one grid, taken off the list's front; and the lines that they use."""
    runs: list[Run] = []
    line = 0
    x, end = _span(columns, lines, 0)
    while left:
        room = end - x - 1
        if room < 1:
            line += 1
            if line == lines:
                break
            x, end = _span(columns, lines, line)
            continue
        kind, count = left.pop(0)
        taken = min(room, count)
        runs.append(Run(kind=kind, line=line, start=x + 1, count=taken))
        x += taken + 1
        if taken < count:
            left.insert(0, (kind, count - taken))
    return runs, line


def _sets(columns: int, lines: int, counts: Sequence[tuple[SwitchKind, int]]) -> list[list[Run]]:
    """All sets of a grid size."""
    left = list(counts)
    made = []
    while left:
        runs, _ = _fill(columns, lines, left)
        if not runs:
            return []
        made.append(runs)
    return made


def plan_sets(
    counts: Sequence[tuple[SwitchKind, int]], columns_max: int, lines_max: int
) -> list[PlateLayout]:
    """Fewest sets that hold all cavities, then the least and squarest grid for them.

    Parameters
    ----------
    counts : sequence of (kind, int)
        Switches to make of each kind, in order.
    columns_max, lines_max : int
        Largest grid that fits the bed, at least ``LEAST``.
    """
    made = _sets(columns_max, lines_max, counts)
    best = ((columns_max * lines_max + 1, 0, 0), made, columns_max, lines_max)
    fewest = len(made)
    cells = sum(count for _, count in counts) + 5
    for columns in range(LEAST, columns_max + 1):
        for lines in range(max(LEAST, -(-cells // (columns * fewest))), lines_max + 1):
            area = (columns * lines, abs(columns - lines), columns)
            if area >= best[0]:
                break
            made = _sets(columns, lines, counts)
            if made and len(made) <= fewest:
                best = (area, made, columns, lines)
                break
    _, made, columns, lines = best
    return [
        PlateLayout(columns=columns, lines=lines, runs=tuple(runs), number=k + 1, total=len(made))
        for k, runs in enumerate(made)
    ]
