"""Volumes of a mold's plates, silicone and rubber from its sizes alone: no solid is made.

Bodies are frustums around the grid and solids of revolution over its cells. Left out are labels,
keys and the pouring lip; troughs and the cap's bosses in them cancel but for their gap.
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.fabrication.molds.audit import vent_mm3
from phytac_design.fabrication.molds.cavity import Cavity, MoldSizes
from phytac_design.fabrication.molds.plate_grid import PlateLayout
from phytac_design.fabrication.molds.plates import FREEBOARD_mm, dome_away_mm, draft_of
from phytac_design.fabrication.switch_set import revolved_volume_mm3


@dataclass(frozen=True, kw_only=True)
class MoldVolumes:
    """Volumes of one mold set, mm³.

    Attributes
    ----------
    printed_mm3 : float
        All plates or trays.
    silicone_mm3 : float
        Both halves; 0 for a rigid mold.
    rubber_mm3 : float
        All rubber of one casting, with what runs over.
    """

    printed_mm3: float
    silicone_mm3: float
    rubber_mm3: float


def mold_volumes(plan: PlateLayout, sizes: MoldSizes) -> MoldVolumes:
    """Estimate the volumes of one mold set."""
    section, slope = sizes.section, draft_of(sizes)
    flank = float(np.tan(np.radians(sizes.flank_deg)))
    wall, backing, relief = section.wall_mm, section.backing_mm, section.overflow_mm
    moat, away = wall + section.moat_mm, dome_away_mm(sizes)

    def body(near: float, height: float, tangent: float) -> float:
        """Frustum around the grid, from a distance outwards."""
        return _frustum_mm3(plan, sizes.pitch_mm, near, near + height * tangent, height)

    cavities = [(run.count, sizes.cavities[run.kind]) for run in plan.runs]
    domes = sum(count * _dome_mm3(cavity) for count, cavity in cavities)
    cores = sum(count * _core_mm3(cavity) for count, cavity in cavities)
    stems = sum(count * _stem_mm3(cavity) for count, cavity in cavities)
    vents = sum(count * vent_mm3(sizes, cavity) for count, cavity in cavities)
    # What lies between the parting plane and the relief around the rings, filled with rubber.
    pads = (plan.cavities + len(plan.keys)) * _cone_mm3(sizes.pad_mm, relief, flank)
    web = 0.0
    if sizes.strips is not None:
        pads = _pads_mm3(plan, sizes)
        web = sum(sizes.strips.web_of_mm3(strip.number) for strip in plan.strips)
        web *= sizes.rubber_scale**3
    domes += web
    channels = body(moat, relief, flank) - pads
    # Below the parting plane the moat's fence stands around the core half.
    opening = body(moat, relief + section.fence_mm, flank) - pads
    grown = sizes.print_scale**3
    rubber = channels + domes + max(0.0, stems - cores + vents)
    deep, high = sizes.depth_mm, sizes.top_mm + section.fence_mm
    dome = body(away, high, slope) - opening - domes
    core = body(wall, deep, slope) + cores - stems
    if section.way == "rigid":
        cap = body(wall + deep * slope, backing, slope)
        return MoldVolumes(
            printed_mm3=grown * (dome + core + cap), silicone_mm3=0.0, rubber_mm3=rubber
        )

    def tray(near: float, height: float, back: float) -> float:
        """Frame with its floor, without what stands in it."""
        rise = height + FREEBOARD_mm
        edge = near + slope * rise + wall
        return body(edge, rise + back, slope) - body(near, rise, slope)

    trays = tray(away, high, backing) + opening + domes
    trays += tray(wall, deep, sizes.core_mm + backing) - cores + stems + vents
    grown_silicone = 1.0 / (1.0 - section.shrink_silicone) ** 3
    return MoldVolumes(
        printed_mm3=grown * trays,
        silicone_mm3=grown_silicone * (dome + core - vents),
        rubber_mm3=rubber,
    )


def _frustum_mm3(
    plan: PlateLayout, pitch_mm: float, low_mm: float, high_mm: float, height_mm: float
) -> float:
    """Volume between rectangles at two distances from the grid (Simpson's rule, exact)."""
    areas = [
        float(np.prod(pitch_mm * np.array([plan.columns, plan.lines]) + 2.0 * away))
        for away in (low_mm, 0.5 * (low_mm + high_mm), high_mm)
    ]
    return height_mm / 6.0 * (areas[0] + 4.0 * areas[1] + areas[2])


def _cone_mm3(radius_mm: float, height_mm: float, tangent: float) -> float:
    wide = radius_mm + height_mm * tangent
    return float(np.pi / 3.0 * height_mm * (radius_mm**2 + radius_mm * wide + wide**2))


def _pads_mm3(plan: PlateLayout, sizes: MoldSizes) -> float:
    """Rings and lands of webs, which overlap, up to the relief: areas at three heights."""
    from manifold3d import CrossSection, OpType

    flank, areas = float(np.tan(np.radians(sizes.flank_deg))), []
    cells = [*plan.keys, *(cell for run in plan.runs for cell in run.cells)]
    for height in (0.0, 0.5 * sizes.section.overflow_mm, sizes.section.overflow_mm):
        disc = CrossSection.circle(sizes.pad_mm + height * flank, 64)
        parts = [disc.translate(tuple(at)) for at in plan.centre_mm(cells, sizes.pitch_mm)]
        half = sizes.web_mm[1] + sizes.section.land_mm + height * flank
        for strip in plan.strips:
            at = plan.centre_mm(strip.cells, sizes.pitch_mm)
            for first, last in strip.bridges:
                way = at[last] - at[first]
                aside = half * np.array([-way[1], way[0]]) / np.hypot(*way)
                corners = [at[first] - aside, at[last] - aside, at[last] + aside, at[first] + aside]
                parts.append(CrossSection([np.array(corners)]))
        areas.append(float(CrossSection.batch_boolean(parts, OpType.Add).area()))
    return sizes.section.overflow_mm / 6.0 * (areas[0] + 4.0 * areas[1] + areas[2])


def _dome_mm3(cavity: Cavity) -> float:
    """What the dome half has above the parting plane: the outer face filled."""
    over = cavity.over[::-1]
    return revolved_volume_mm3(np.array([[0.0, over[0, 1]], *over, [0.0, over[-1, 1]]]))


def _core_mm3(cavity: Cavity) -> float:
    """Core above the parting plane, its ridge's hollow for the stem filled."""
    under = cavity.under[: int(cavity.under[:, 1].argmax()) + 1][::-1]
    return revolved_volume_mm3(np.array([[0.0, under[0, 1]], *under, [0.0, under[-1, 1]]]))


def _stem_mm3(cavity: Cavity) -> float:
    """Stem from the core's ridge down to the tip."""
    stem = cavity.under[int(cavity.under[:, 1].argmax()) :]
    return revolved_volume_mm3(np.array([[0.0, stem[0, 1]], *stem, [0.0, stem[-1, 1]]]))
