"""Masters for a silicone mold: two printed trays, a half of the mold is cast in each.

The dome tray carries the domes as bumps, the core tray the undersides: stems that rise out of
recesses as deep as the bowls. Silicone is poured over both up to the lip in the frame. A switch's
stem and its hollow bowl would lock into one block of silicone; parted at z = 0 (the bowl's flat
rim) both halves leave by straight pulls: domes widen towards the parting plane, cores narrow away
from it, stems and vents narrow towards the back. Pegs above the stems reach through the silicone
and leave a vent at the end of each, a step narrower than the tip, so that one sees where to cut.

How it is cast: the dome half lies with its cavities up and is filled with degassed rubber; the
core half is pressed into it, stems up. Air leaves through the vents at the highest points, rubber
runs over into channels and moat. The vents' rubber is cut at the step.

The trays have the same two faces as the plates of the rigid mold, seen from the other side.
"""

import numpy as np

from phytac_design.fabrication.molds.cavity import MoldSizes
from phytac_design.fabrication.molds.mold_faces import CellGrid, core_face, dome_face
from phytac_design.fabrication.molds.plate_grid import PlateLayout
from phytac_design.fabrication.molds.plates import dome_away_mm, draft_of
from phytac_design.fabrication.molds.sheet import Sheet
from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import FloatArray, IntArray

FREEBOARD_mm = 1.5
"""Height of the frame over the level of the silicone."""


def tray_edge_mm(sizes: MoldSizes) -> float:
    """Distance of a tray's widest edge from the grid."""
    section = sizes.section
    dome = (sizes.top_mm + section.fence_mm, sizes.top_mm + section.fence_mm + section.backing_mm)
    core = (sizes.depth_mm, sizes.depth_mm + sizes.core_mm + section.backing_mm)
    return max(
        away + section.wall_mm + (sum(span) + 2.0 * FREEBOARD_mm) * draft_of(sizes)
        for away, span in ((dome_away_mm(sizes), dome), (section.wall_mm, core))
    )


def dome_tray(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Tray below the domes' face."""
    sheet, section = Sheet(), sizes.section
    field, inner = dome_face(sheet, plan, sizes)
    away = dome_away_mm(sizes)
    foot = field.outline(away, -section.fence_mm)
    sheet.strip(foot, inner)
    bottom = -section.fence_mm - section.backing_mm
    _frame(field, foot, away, (-section.fence_mm, sizes.top_mm, bottom))
    return sheet.mesh()


def core_tray(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Tray above the cores' face, stems down as in use; it is printed stems up."""
    sheet, section = Sheet(), sizes.section
    sheet.up = False
    field, edge, _ = core_face(sheet, plan, sizes, vent_level_mm=sizes.depth_mm + FREEBOARD_mm)
    bottom = sizes.core_mm + section.backing_mm
    _frame(field, edge, section.wall_mm, (0.0, -sizes.depth_mm, bottom))
    return sheet.mesh()


def _frame(
    field: CellGrid, foot: IntArray, away: float, levels_mm: tuple[float, float, float]
) -> None:
    """Frame on a tray's floor, its lip, outer wall and underside.

    ``levels_mm`` are the floor's at the frame's foot, the silicone's, and the underside's.
    """
    sheet, sizes = field.sheet, field.sizes
    floor, level, bottom = levels_mm
    sign, slope, wall = np.sign(level - floor), draft_of(sizes), sizes.section.wall_mm
    height = np.full(len(foot), level + sign * FREEBOARD_mm)
    height[_lip(field)] = level
    inner: FloatArray = away + slope * np.abs(height - floor)
    top = field.outline(inner, height)
    outer = field.outline(inner + wall, height)
    widest = away + wall + slope * (abs(level - floor) + FREEBOARD_mm)
    under = field.outline(widest + slope * (abs(level - bottom) + FREEBOARD_mm), bottom)
    for inside, outside in ((foot, top), (top, outer), (outer, under)):
        sheet.strip(outside, inside)
    sheet.up = not sheet.up
    sheet.disc(under[None], np.array([[0.0, 0.0, bottom]]))


def _lip(field: CellGrid) -> IntArray:
    """Points of the frame's front side at which silicone runs over."""
    columns = field.plan.columns
    middle = columns // 2
    wide = max(0, columns // 8)
    return np.arange(max(1, middle - wide), min(columns - 1, middle + wide) + 1)
