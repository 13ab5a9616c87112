"""Rigid mold: a dome plate, a core plate with the stem holes right through, and a cap.

How it is cast: the dome plate lies with its cavities up and is filled with degassed rubber to the
rings around the bowls; its fence holds what runs over. The core plate goes in at a slant and is
pressed down until it meets the rings. Its cores push rubber up the stem holes, which are open at
their upper ends: air leaves at the highest points. The troughs behind the holes take a little more
rubber to draw down. The cap then closes the stems' ends but for a thin gap, the last vent.

How it opens: cap off (gap all around, nothing grips), the film on the stems' ends trimmed flush
with the troughs' floors, core plate pried up (a blade goes from the moat under its edge, the fence
is the fulcrum), the switches drawn off the cores as one sheet that hangs together by the film
between the rings. Stems leave by their wide ends, domes and cores by theirs: parting plane z = 0,
pulls along z, every wall drafted.

In the frame of use z points to the domes, as in a switch.
"""

import numpy as np

from phytac_design.fabrication.molds.cavity import KEY_SIDES, Cavity, EDGE_mm, MoldSizes
from phytac_design.fabrication.molds.mold_faces import CellGrid, core_face, dome_face
from phytac_design.fabrication.molds.plate_grid import PlateLayout, Run
from phytac_design.fabrication.molds.sheet import Sheet
from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


def draft_of(sizes: MoldSizes) -> float:
    """Tangent of the slope of a plate's outer walls."""
    return float(np.tan(np.radians(max(sizes.section.draft_deg, 1.0))))


def dome_away_mm(sizes: MoldSizes) -> float:
    """Distance of the dome plate's edge on its fence from the grid."""
    section = sizes.section
    flank = float(np.tan(np.radians(sizes.flank_deg)))
    moat = section.wall_mm + section.moat_mm
    return moat + (section.overflow_mm + section.fence_mm) * flank + section.wall_mm


def dome_edge_mm(sizes: MoldSizes) -> float:
    """Distance of the dome plate's widest edge from the grid."""
    return dome_away_mm(sizes) + (sizes.top_mm + sizes.section.fence_mm) * draft_of(sizes)


def dome_plate(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Plate above the domes' face, as thick as ``sizes.top_mm`` over the parting plane."""
    sheet, section = Sheet(), sizes.section
    sheet.up = False
    field, inner = dome_face(sheet, plan, sizes)
    away = dome_away_mm(sizes)
    edge = field.outline(away, -section.fence_mm)
    far = field.outline(dome_edge_mm(sizes), sizes.top_mm)
    sheet.strip(edge, inner)
    sheet.strip(far, edge)
    sheet.up = True
    sheet.disc(far[None], np.array([[0.0, 0.0, sizes.top_mm]]))
    return sheet.mesh()


def core_plate(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Plate below the cores' face; behind each run of stems a trough down to their ends."""
    sheet, depth = Sheet(), sizes.depth_mm
    field, edge, ends = core_face(sheet, plan, sizes, vent_level_mm=None)
    far = field.outline(sizes.section.wall_mm + depth * draft_of(sizes), -depth)
    sheet.strip(far, edge)
    sheet.up = False
    back = CellGrid(sheet, plan, sizes, -depth)
    sheet.strip(far, back.rim())
    for run in plan.runs:
        cavity = sizes.cavities[run.kind]
        mouth = _trough(back, run, cavity, -depth, 0.0)
        floor = _trough(back, run, cavity, -cavity.reach_mm, 0.0)
        sheet.strip(back.around(run), mouth)
        sheet.strip(mouth, floor)
        sheet.collar(_cells(floor, run.count), np.stack([ends[cell] for cell in run.cells]))
    back.round_cells(plan.keys, sizes.key(socket=True) + np.array([0.0, -depth]), KEY_SIDES)
    labels = [(run.start - 1, run.line) for run in plan.runs]
    sheet.squares(back.corners([plan.title, *labels, *plan.blank]))
    return sheet.mesh()


def cap_plate(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Cap behind the core plate: a boss in each trough, pads with keys, a gap everywhere else."""
    sheet, section = Sheet(), sizes.section
    level = -sizes.depth_mm - section.overflow_mm
    field = CellGrid(sheet, plan, sizes, level)
    for run in plan.runs:
        cavity = sizes.cavities[run.kind]
        gap = section.key_clearance_mm / np.cos(np.radians(sizes.trough_deg))
        foot = _trough(field, run, cavity, level, gap)
        top = _trough(field, run, cavity, -cavity.reach_mm - section.vent_gap_mm, gap)
        sheet.strip(field.around(run), foot)
        sheet.strip(foot, top)
        sheet.between_rows(top[: run.count + 1], top[: run.count : -1])
    flank = np.tan(np.radians(sizes.flank_deg))
    pad = np.array([[sizes.pad_mm + section.overflow_mm * flank, level], [sizes.pad_mm, 0.0]])
    pad[1, 1] = -sizes.depth_mm
    key = sizes.key(socket=False) + np.array([0.0, -sizes.depth_mm])
    field.round_cells(plan.keys, np.concatenate([pad, key]), KEY_SIDES)
    field.texts()
    away = section.wall_mm + sizes.depth_mm * draft_of(sizes)
    edge = field.outline(away, level)
    far = field.outline(away + section.backing_mm * draft_of(sizes), level - section.backing_mm)
    sheet.strip(edge, field.rim())
    sheet.strip(far, edge)
    sheet.up = False
    sheet.disc(far[None], np.array([[0.0, 0.0, level - section.backing_mm]]))
    return sheet.mesh()


def check_troughs(sizes: MoldSizes) -> None:
    """Reject troughs that leave no wall between them.

    Raises
    ------
    DesignError
        If they do not.
    """
    wall = sizes.trough_wall_mm
    if wall < EDGE_mm:
        raise DesignError(
            f"troughs behind the stems leave walls of {wall:.2g} mm; raise [mold] channel_mm by "
            f"{EDGE_mm - wall:.2g} mm or lower draft_deg"
        )


def _trough(field: CellGrid, run: Run, cavity: Cavity, z_mm: float, gap_mm: float) -> IntArray:
    """Ring of a run's trough at a height, or of the boss in it: a point for each of its cells'."""
    half = field.sizes.trough_mm(cavity, z_mm) - gap_mm
    centre = field.centres(run.cells)
    steps = 0.5 * (centre[:-1, 0] + centre[1:, 0])
    x: FloatArray = np.concatenate([[centre[0, 0] - half], steps, [centre[-1, 0] + half]])
    y = np.full(len(x), centre[0, 1])
    front = np.column_stack([x, y - half, np.full(len(x), z_mm)])
    back = np.column_stack([x, y + half, np.full(len(x), z_mm)])
    return field.sheet.points(np.concatenate([front, back[::-1]]))


def _cells(ring: IntArray, count: int) -> IntArray:
    """Corner points (count, 4) of the cells along a run's ring, the first to the right and back."""
    front, back = ring[: count + 1], ring[:count:-1]
    return np.stack([back[1:], back[:-1], front[:-1], front[1:]], axis=1)
