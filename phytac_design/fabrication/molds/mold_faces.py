"""The two faces that meet the rubber: the domes' side and the cores' side of the parting plane."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.fabrication.molds.cavity import KEY_SIDES, MoldSizes
from phytac_design.fabrication.molds.labels import label
from phytac_design.fabrication.molds.plate_grid import PlateLayout, Run
from phytac_design.fabrication.molds.sheet import Sheet
from phytac_shapes.arrays import FloatArray, IntArray


def label_sizes_mm(rules: PrintSection) -> tuple[float, float]:
    """Width and height of a label's strokes: raised on one face, sunken in the other."""
    label_mm = 0.4  # least height of labels: they must show in the rubber
    stroke = max(rules.engrave_min_mm, rules.emboss_min_mm)
    return stroke, max(stroke, label_mm)


class CellGrid:
    """The grid of a plan on a sheet: its corner points at one height, and cells between them."""

    def __init__(self, sheet: Sheet, plan: PlateLayout, sizes: MoldSizes, z_mm: float) -> None:
        self.sheet, self.plan, self.sizes, self.z_mm = sheet, plan, sizes, z_mm
        pitch = sizes.pitch_mm
        x = pitch * (np.arange(plan.columns + 1) - 0.5 * plan.columns)
        y = pitch * (np.arange(plan.lines + 1) - 0.5 * plan.lines)
        grid = np.stack(np.meshgrid(x, y, indexing="xy"), axis=-1)
        flat = np.concatenate([grid, np.full((*grid.shape[:2], 1), z_mm)], axis=-1)
        self.nodes = sheet.points(flat)

    def corners(self, cells: Sequence[tuple[int, int]]) -> IntArray:
        """Corner points (m, 4) of cells, the first to the right and back."""
        x, y = np.asarray(cells, dtype=np.int64).reshape(-1, 2).T
        nodes = self.nodes
        return np.stack(
            [nodes[y + 1, x + 1], nodes[y + 1, x], nodes[y, x], nodes[y, x + 1]], axis=1
        )

    def around(self, run: Run) -> IntArray:
        """Points around a run's cells, from its left front corner."""
        first, last = run.start, run.start + run.count
        front = self.nodes[run.line, first : last + 1]
        back = self.nodes[run.line + 1, first : last + 1]
        return np.concatenate([front, back[::-1]])

    def rim(self) -> IntArray:
        """Points around the whole grid, from its left front corner."""
        nodes = self.nodes
        return np.concatenate([nodes[0, :-1], nodes[:-1, -1], nodes[-1, :0:-1], nodes[:0:-1, 0]])

    def centres(self, cells: Sequence[tuple[int, int]]) -> FloatArray:
        """Middles (m, 2) of cells."""
        return self.plan.centre_mm(cells, self.sizes.pitch_mm)

    def round_cells(
        self,
        cells: Sequence[tuple[int, int]],
        profile: FloatArray,
        sides: int,
        *,
        closed: bool = True,
    ) -> IntArray:
        """Surfaces of revolution in cells; the last ring of each, (m, sides)."""
        centre = self.centres(cells)
        rings = self.sheet.turned(centre, profile, sides)
        self.sheet.collar(self.corners(cells), rings[:, 0])
        last = rings[:, -1]
        if closed:
            height = np.full((len(centre), 1), profile[-1, 1])
            self.sheet.disc(last, np.concatenate([centre, height], axis=1))
        return last

    def texts(self) -> None:
        """Labels before each run, the set's number in its cell; blank cells flat."""
        plan, rules = self.plan, self.sizes.rules
        texts = {(run.start - 1, run.line): self.sizes.labels[run.kind] for run in plan.runs}
        texts[plan.title] = f"{plan.number}/{plan.total}"
        stroke, height = label_sizes_mm(rules)
        for cell, text in texts.items():
            patch = label(text, self.sizes.pitch_mm, stroke, height)
            middle = np.array([*self.centres([cell])[0], self.z_mm])
            ids = np.full(len(patch.mesh.vertices_mm), -1)
            ids[patch.corners] = self.corners([cell])[0]
            ids[patch.inner] = self.sheet.points(patch.mesh.vertices_mm[patch.inner] + middle)
            self.sheet.faces(ids[patch.mesh.triangles])
        if plan.blank:
            self.sheet.squares(self.corners(plan.blank))

    def outline(self, away_mm: FloatArray | float, z_mm: FloatArray | float) -> IntArray:
        """Ring of the grid's rim moved outward, at a height; each may differ from point to point.

        Points stay on straight sides: corners move both ways, others square to their side.
        """
        plan, pitch = self.plan, self.sizes.pitch_mm
        half = 0.5 * pitch * np.array([plan.columns, plan.lines])
        x = np.arange(plan.columns) * pitch - half[0]
        y = np.arange(plan.lines) * pitch - half[1]
        ring = np.concatenate(
            [
                np.column_stack([x, np.full(len(x), -half[1])]),
                np.column_stack([np.full(len(y), half[0]), y]),
                np.column_stack([-x, np.full(len(x), half[1])]),
                np.column_stack([np.full(len(y), -half[0]), -y]),
            ]
        )
        edge = np.abs(np.abs(ring) - half) < 1e-9
        away = np.broadcast_to(np.asarray(away_mm, dtype=np.float64), (len(ring),))
        height = np.broadcast_to(np.asarray(z_mm, dtype=np.float64), (len(ring),))
        moved = ring + np.where(edge, np.sign(ring) * away[:, None], 0.0)
        return self.sheet.points(np.column_stack([moved, height]))


def dome_face(sheet: Sheet, plan: PlateLayout, sizes: MoldSizes) -> tuple[CellGrid, IntArray]:
    """Face on the domes' side, seen from below: domes, pinching rings, channels, moat, fence.

    Around each bowl a flat ring lies in the parting plane; all else is ``overflow_mm`` higher, so
    that rubber runs off, plates touch on few places, and a blade goes between them.

    Returns
    -------
    field : Field
    outline : (n,) int
        Outer edge of the moat's wall, ``fence_mm`` below the parting plane.
    """
    section = sizes.section
    relief, wide = section.overflow_mm, np.tan(np.radians(sizes.flank_deg))
    field = CellGrid(sheet, plan, sizes, relief)
    pad = np.array([[sizes.pad_mm + relief * wide, relief], [sizes.pad_mm, 0.0]])
    for run in plan.runs:
        over = sizes.cavities[run.kind].over
        field.round_cells(run.cells, np.concatenate([pad, over]), sizes.sides)
    field.round_cells(plan.keys, np.concatenate([pad, sizes.key(socket=True)]), KEY_SIDES)
    field.texts()
    moat = section.wall_mm + section.moat_mm
    rings = [field.rim(), field.outline(moat, relief), field.outline(moat + relief * wide, 0.0)]
    foot = moat + (relief + section.fence_mm) * wide
    rings.append(field.outline(foot, -section.fence_mm))
    for inner, outer in pairwise(rings):
        sheet.strip(outer, inner)
    return field, rings[-1]


def core_face(
    sheet: Sheet, plan: PlateLayout, sizes: MoldSizes, *, vent_level_mm: float | None
) -> tuple[CellGrid, IntArray, dict[tuple[int, int], IntArray]]:
    """Face on the cores' side, seen from above: cores, stem holes, keys.

    Parameters
    ----------
    vent_level_mm : float or None
        Depth to which a vent continues below each stem; None leaves stems open.

    Returns
    -------
    field : Field
    outline : (n,) int
        Edge of the face, in the parting plane.
    ends : dict
        For open stems the ring of each cell's tip.
    """
    field = CellGrid(sheet, plan, sizes, 0.0)
    ends: dict[tuple[int, int], IntArray] = {}
    for run in plan.runs:
        cavity = sizes.cavities[run.kind]
        if vent_level_mm is None:
            rings = field.round_cells(run.cells, cavity.under, sizes.sides, closed=False)
            ends |= dict(zip(run.cells, rings, strict=True))
        else:
            vent = sizes.vent(cavity, vent_level_mm)
            field.round_cells(run.cells, np.concatenate([cavity.under, vent]), sizes.sides)
    field.round_cells(plan.keys, sizes.key(socket=False), KEY_SIDES)
    field.texts()
    outline = field.outline(sizes.section.wall_mm, 0.0)
    sheet.strip(outline, field.rim())
    return field, outline, ends
