"""Plates of a rigid mold, and trays in which the halves of a silicone mold are cast.

Rigid mold: a dome plate, a core plate with the stem holes right through, and a cap.

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

Silicone mold: two printed trays, the masters. The dome tray carries the domes as bumps, the core
tray the undersides: stems that rise out of recesses as deep as the bowls. Silicone is poured over
both up to the lip in the frame. A switch's stem and its hollow bowl would lock into one block of
silicone; parted at z = 0 (the bowl's flat rim) both halves leave by straight pulls: domes widen
towards the parting plane, cores narrow away from it, stems and vents narrow towards the back. Pegs
above the stems reach through the silicone and leave a vent at the end of each, a step narrower
than the tip, so that one sees where to cut. The dome half is filled with rubber, the core half
pressed into it, stems up; the vents' rubber is cut at the step.

A tray is a block minus the silicone cast in it, which has the shape of the rigid plate. In the
frame of use z points to the domes, as in a switch. Cutters run past the faces that they open, so
that faces never coincide by accident.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.fabrication.molds.cavity import KEY_SIDES, EDGE_mm, MoldSizes
from phytac_design.fabrication.molds.labels import label
from phytac_design.fabrication.molds.plate_grid import PlateLayout, Run
from phytac_design.fabrication.switch_set import revolve
from phytac_design.fabrication.switch_strips import strip_label
from phytac_design.geometry.triangles import TriangleMesh, copies
from phytac_design.solids.solid_mesh import SLIVER_mm, hull, to_manifold, to_triangles, united
from phytac_shapes.errors import DesignError

OVER_mm = 0.1
"""How far cutters run past the faces that they open."""
FREEBOARD_mm = 1.5
"""Height of a tray's frame over the level of the silicone."""


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


def tray_edge_mm(sizes: MoldSizes) -> float:
    """Distance of a tray's widest edge from the grid."""
    section = sizes.section
    dome = (sizes.top_mm + section.fence_mm, sizes.top_mm + section.fence_mm + section.backing_mm)
    core = (sizes.depth_mm, sizes.depth_mm + sizes.core_mm + section.backing_mm)
    return max(
        away + section.wall_mm + (sum(span) + 2.0 * FREEBOARD_mm) * draft_of(sizes)
        for away, span in ((dome_away_mm(sizes), dome), (section.wall_mm, core))
    )


def label_sizes_mm(rules: PrintSection) -> tuple[float, float]:
    """Width and height of a label's strokes: raised on one face, sunken in the other."""
    label_mm = 0.4  # least height of labels: they must show in the rubber
    stroke = max(rules.engrave_min_mm, rules.emboss_min_mm)
    return stroke, max(stroke, label_mm)


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
            "mold-trough-wall-thin",
            f"troughs behind the stems leave walls of {wall:.2g} mm; raise [mold] channel_mm by "
            f"{EDGE_mm - wall:.2g} mm or lower draft_deg",
        )


def frustum(*ends: tuple[float, Any, Any]) -> Any:
    """Convex body between rectangles, each as (z, low corner, high corner)."""
    import manifold3d

    points = [(x, y, z) for z, (x0, y0), (x1, y1) in ends for x in (x0, x1) for y in (y0, y1)]
    return manifold3d.Manifold.hull_points(np.array(points))


def around_grid(plan: PlateLayout, sizes: MoldSizes, *ends: tuple[float, float]) -> Any:
    """Frustum between rectangles around the grid, each as (z, distance from the grid)."""
    half = 0.5 * sizes.pitch_mm * np.array([plan.columns, plan.lines])
    return frustum(*((z, -half - away, half + away) for z, away in ends))


class Cells:
    """Solids of revolution, labels and troughs over the cells of a plan."""

    def __init__(self, plan: PlateLayout, sizes: MoldSizes) -> None:
        self.plan, self.sizes = plan, sizes

    def turned(
        self,
        cells: Sequence[tuple[float, float]],
        profile: Sequence[Any],
        sides: int,
        z_mm: float = 0,
    ) -> Any:
        """Bodies of revolution over cells, of a half section from the axis on top around."""
        mesh = revolve(np.array(profile, dtype=np.float64), sides=sides)
        centre = self.plan.centre_mm(cells, self.sizes.pitch_mm)
        at = np.column_stack([centre, np.full(len(centre), z_mm)])
        return to_manifold(copies(mesh, at, np.tile(np.eye(3), (len(at), 1, 1))))

    def keys(self, z_mm: float, *, socket: bool) -> Any:
        """Keys that rise from a height, or their sockets' cutters, from a little below it."""
        (base, _), (top, high) = self.sizes.key(socket=socket).tolist()
        profile = [(0, high), (top, high), (base, 0), (base, -OVER_mm), (0, -OVER_mm)]
        return self.turned(self.plan.keys, profile, KEY_SIDES, z_mm)

    def labels(self, z_mm: float) -> Any:
        """Labels before each run and the set's number, standing on a height."""
        plan, sizes = self.plan, self.sizes
        texts = {
            cell: strip_label(name) if isinstance(name, int) else sizes.labels[name]
            for cell, name in plan.labels.items()
        }
        texts[plan.title] = f"{plan.number}/{plan.total}"
        stroke, height = label_sizes_mm(sizes.rules)
        return united(
            [
                label(text, sizes.pitch_mm, stroke, height).translate(
                    (*plan.centre_mm([cell], sizes.pitch_mm)[0], z_mm)
                )
                for cell, text in texts.items()
            ]
        )

    def troughs(self, run: Run, z_mm: tuple[float, float], gap_mm: float = 0.0) -> list[Any]:
        """Troughs behind a run's stems between two heights, or the bosses in them.

        One for a run on a line; one for each stem on strips.
        """
        centre = self.plan.centre_mm(run.cells, self.sizes.pitch_mm)
        halves = [self.sizes.trough_mm(self.sizes.cavities[run.kind], z) - gap_mm for z in z_mm]
        spans = [(at, at) for at in centre] if run.places else [(centre[0], centre[-1])]
        return [
            frustum(*((z, low - half, high + half) for z, half in zip(z_mm, halves, strict=True)))
            for low, high in spans
        ]

    def webs(self, z_mm: tuple[float, float], half_mm: tuple[float, float]) -> list[Any]:
        """Bars between the axes of joined switches, from a height and half width to another."""
        out = []
        for strip in self.plan.strips:
            at = self.plan.centre_mm(strip.cells, self.sizes.pitch_mm)
            for first, last in strip.bridges:
                way = at[last] - at[first]
                aside = np.array([-way[1], way[0]]) / np.hypot(*way)
                points = [
                    [*(end + side * half * aside), z]
                    for z, half in zip(z_mm, half_mm, strict=True)
                    for end in (at[first], at[last])
                    for side in (-1.0, 1.0)
                ]
                out.append(hull(np.array(points)))
        return out


def _dome_half(plan: PlateLayout, sizes: MoldSizes, body: Any) -> Any:
    """Body with the face on the domes' side: domes, pinching rings, channels, moat, fence.

    Around each bowl a flat ring lies in the parting plane; all else is ``overflow_mm`` higher, so
    that rubber runs off, plates touch on few places, and a blade goes between them.
    """
    section, cells = sizes.section, Cells(plan, sizes)
    relief, moat = section.overflow_mm, section.wall_mm + section.moat_mm
    flank = float(np.tan(np.radians(sizes.flank_deg)))
    low = -section.fence_mm - OVER_mm
    opening = around_grid(plan, sizes, (relief, moat), (low, moat + (relief - low) * flank))
    # Rings reach into the body, but not as far as their neighbours.
    high = relief + min(0.4 * section.channel_mm / flank, section.backing_mm)
    ring = [(0, high), (sizes.pad_mm + high * flank, high), (sizes.pad_mm, 0), (0, 0)]
    # On strips rings overlap: each is a solid of its own.
    rings = [
        cells.turned(part, ring, sizes.sides)
        for run in plan.runs
        for part in [[cell] for cell in run.places] or [list(run.cells)]
    ]
    rings.append(cells.turned(plan.keys, ring, KEY_SIDES))
    cutters = [cells.keys(0.0, socket=True), cells.labels(relief)]
    if sizes.strips is not None:
        thick, half = sizes.web_mm
        rings += cells.webs(
            (0.0, high), (half + section.land_mm, half + section.land_mm + high * flank)
        )
        cutters += cells.webs((-OVER_mm, thick), (half + OVER_mm * flank, half - thick * flank))
    for run in plan.runs:
        over = sizes.cavities[run.kind].over
        ends = [(over[0, 0], -OVER_mm), (0, -OVER_mm)]
        profile = [(0, over[-1, 1]), *over[::-1], *ends]
        cutters.append(cells.turned(run.cells, profile, sizes.sides))
    return united([body - opening, *rings]) - united(cutters)


def _core_half(
    plan: PlateLayout, sizes: MoldSizes, body: Any, *, vent_level_mm: float | None = None
) -> Any:
    """Body with the face on the cores' side: cores, stem holes, keys.

    ``vent_level_mm`` is the depth to which a vent continues below each stem.
    """
    cells = Cells(plan, sizes)
    added, stems = [cells.keys(0.0, socket=False), cells.labels(0.0)], []
    for run in plan.runs:
        cavity = sizes.cavities[run.kind]
        under = cavity.under
        top = int(under[:, 1].argmax())
        ridge = (0, under[top, 1])
        foot = [(under[0, 0], -OVER_mm), (0, -OVER_mm)]
        added.append(cells.turned(run.cells, [ridge, *under[top::-1], *foot], sizes.sides))
        stem = under[top:]
        if vent_level_mm is not None:
            stem = np.concatenate([stem, sizes.vent(cavity, vent_level_mm)])
        low = stem[-1, 1] - OVER_mm
        profile = [ridge, *stem, (stem[-1, 0], low), (0, low)]
        stems.append(cells.turned(run.cells, profile, sizes.sides))
    return united([body, *added]) - united(stems)


def _mesh(solid: Any) -> TriangleMesh:
    return to_triangles(solid.simplify(SLIVER_mm))


def dome_plate(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Plate above the domes' face, as thick as ``sizes.top_mm`` over the parting plane."""
    low = (-sizes.section.fence_mm, dome_away_mm(sizes))
    body = around_grid(plan, sizes, low, (sizes.top_mm, dome_edge_mm(sizes)))
    return _mesh(_dome_half(plan, sizes, body))


def core_plate(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Plate below the cores' face; behind each run of stems a trough down to their ends."""
    wall, depth, cells = sizes.section.wall_mm, sizes.depth_mm, Cells(plan, sizes)
    body = around_grid(plan, sizes, (0.0, wall), (-depth, wall + depth * draft_of(sizes)))
    cutters = [cells.keys(-depth, socket=True)]
    cutters += [
        trough
        for run in plan.runs
        for trough in cells.troughs(run, (-depth - OVER_mm, -sizes.cavities[run.kind].reach_mm))
    ]
    return _mesh(_core_half(plan, sizes, body) - united(cutters))


def cap_plate(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Cap behind the core plate: a boss in each trough, pads with keys, a gap everywhere else."""
    section, draft, cells = sizes.section, draft_of(sizes), Cells(plan, sizes)
    level = -sizes.depth_mm - section.overflow_mm
    away = section.wall_mm + sizes.depth_mm * draft
    low = (level - section.backing_mm, away + section.backing_mm * draft)
    flank = float(np.tan(np.radians(sizes.flank_deg)))
    high, wide = section.overflow_mm, sizes.pad_mm + section.overflow_mm * flank
    pad = [(0, high), (sizes.pad_mm, high), (wide, 0), (wide, -OVER_mm), (0, -OVER_mm)]
    gap = section.key_clearance_mm / np.cos(np.radians(sizes.trough_deg))
    bosses = [
        boss
        for run in plan.runs
        for boss in cells.troughs(
            run,
            (level - OVER_mm, -sizes.cavities[run.kind].reach_mm - section.vent_gap_mm),
            gap,
        )
    ]
    body = around_grid(plan, sizes, low, (level, away))
    pads = cells.turned(plan.keys, pad, KEY_SIDES, level)
    keys = cells.keys(-sizes.depth_mm, socket=False)
    return _mesh(united([body, *bosses, pads, keys, cells.labels(level)]))


def dome_tray(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Tray below the domes' face."""
    floor = -sizes.section.fence_mm
    inner, tray = _frame(plan, sizes, dome_away_mm(sizes), floor, sizes.top_mm)
    return _mesh(tray - _dome_half(plan, sizes, inner))


def core_tray(plan: PlateLayout, sizes: MoldSizes) -> TriangleMesh:
    """Tray above the cores' face, stems down as in use; it is printed stems up."""
    inner, tray = _frame(plan, sizes, sizes.section.wall_mm, 0.0, -sizes.depth_mm)
    vents = sizes.depth_mm + FREEBOARD_mm
    return _mesh(tray - _core_half(plan, sizes, inner, vent_level_mm=vents))


def _frame(
    plan: PlateLayout, sizes: MoldSizes, away: float, floor: float, level: float
) -> tuple[Any, Any]:
    """Inside of a tray's frame, and the tray as a block with a lip at which silicone runs over.

    ``away`` is the distance of the frame's foot from the grid, ``floor`` its height, ``level`` that
    of the silicone.
    """
    section, slope, sign = sizes.section, draft_of(sizes), float(np.sign(level - floor))
    back = sizes.core_mm if sign < 0.0 else 0.0
    bottom, top = floor - sign * (back + section.backing_mm), level + sign * FREEBOARD_mm
    edge = away + slope * abs(top - floor)
    inner = around_grid(plan, sizes, (floor, away), (top + sign * OVER_mm, edge + slope * OVER_mm))
    outer = edge + section.wall_mm
    block = around_grid(plan, sizes, (top, outer), (bottom, outer + slope * abs(top - bottom)))
    # The lip: cells in the middle of the front side; its ends rise over a cell.
    middle, wide = plan.columns // 2, max(0, plan.columns // 8)
    first, last = max(1, middle - wide), min(plan.columns - 1, middle + wide)
    pitch, half = sizes.pitch_mm, 0.5 * sizes.pitch_mm * np.array([plan.columns, plan.lines])
    x0, x1 = first * pitch - half[0], last * pitch - half[0]
    front, more = -half[1] - outer - 1.0, pitch * (1.0 + OVER_mm / FREEBOARD_mm)
    lip = frustum(
        (level, (x0, front), (x1, -half[1])),
        (top + sign * OVER_mm, (x0 - more, front), (x1 + more, -half[1])),
    )
    return inner, block - lip
