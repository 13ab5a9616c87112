"""All plates or trays of a design's switches, split into sets that fit the printer's bed."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.design.switch_table import MoldSection
from phytac_design.fabrication.molds.cavity import MoldSizes, make_sizes
from phytac_design.fabrication.molds.plate_grid import LEAST, PlateLayout, plan_sets
from phytac_design.fabrication.molds.plates import (
    cap_plate,
    check_troughs,
    core_plate,
    core_tray,
    dome_edge_mm,
    dome_plate,
    dome_tray,
    tray_edge_mm,
)
from phytac_design.fabrication.molds.strip_layout import KEY_LINES, Room, plan_strip_sets
from phytac_design.fabrication.molds.strip_plan import plan_strips
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.fabrication.switch_strips import StripSet, web_refusal
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import stl_triangles, to_manifold
from phytac_shapes.errors import DesignError

Maker = Callable[[PlateLayout, MoldSizes], TriangleMesh]
MAKERS: dict[str, dict[str, Maker]] = {
    "rigid": {"dome_plate": dome_plate, "core_plate": core_plate, "cap_plate": cap_plate},
    "silicone-master": {"dome_tray": dome_tray, "core_tray": core_tray},
}
TURNED = ("dome_plate", "core_tray")
"""Parts that are printed upside down: their cavities or pegs point up."""


@dataclass(frozen=True, kw_only=True)
class MoldSet:
    """Plates or trays that belong together.

    Attributes
    ----------
    plan : Plan
        What stands where.
    sizes : MoldSizes
        Outlines and thicknesses.
    parts : dict
        Name to mesh, in the frame of use (z towards the domes), before the print's shrinkage.
    """

    plan: PlateLayout
    sizes: MoldSizes
    parts: dict[str, TriangleMesh]

    @cached_property
    def solids(self) -> dict[str, Any]:
        """The parts as ``manifold3d.Manifold``."""
        return {name: to_manifold(mesh) for name, mesh in self.parts.items()}

    @cached_property
    def printed(self) -> dict[str, TriangleMesh]:
        """Parts as they are printed: on the bed, print (and silicone) shrinkage taken out."""
        out = {}
        for name, mesh in self.parts.items():
            points = self.sizes.print_scale * mesh.vertices_mm
            if name in TURNED:
                points = points * [1.0, -1.0, -1.0]
            points = points - [0.0, 0.0, points[:, 2].min()]
            out[name] = stl_triangles(TriangleMesh(vertices_mm=points, triangles=mesh.triangles))
        return out


def strips_of(
    sensor: Sensor, switches: SwitchSet, *, tolerance_mm: float = 0.01
) -> StripSet | None:
    """Strips of a sensor's switches; None where all are single.

    Raises
    ------
    DesignError
        If the design asks for strips and none fits, or no mold fits the bed.
    """
    design = sensor.design
    if design.strip.form == "single" or not switches.kinds:
        return None
    sizes = make_sizes(design.mold, design.print_rules, switches, tolerance_mm)
    room = _room(sizes, design.print_rules, strips=True)
    strips = plan_strips(sensor, switches, sizes, room)
    reason = web_refusal(design.strip, switches)
    if reason or not strips.webs:
        reason = reason or next(iter(strips.why_single.values()))
        raise DesignError(
            "no-strip-fits",
            f"no switches can be cast on strips: {reason}; change [strip], or set strip.form = "
            '"single"',
        )
    return strips


def plan_molds(
    section: MoldSection,
    rules: PrintSection,
    switches: SwitchSet,
    *,
    tolerance_mm: float = 0.01,
    strips: StripSet | None = None,
) -> tuple[MoldSizes, list[PlateLayout]]:
    """Sizes of the molds for all switches, and the grids of as few sets as the bed allows.

    Raises
    ------
    DesignError
        If no set fits the bed.
    """
    sizes = make_sizes(section, rules, switches, tolerance_mm)
    room = _room(sizes, rules, strips=strips is not None)
    if strips is not None:
        plans = plan_strip_sets(strips, switches, room, sizes.rubber_scale)
        spacing = min(plan.spacing_mm(sizes.pitch_mm) for plan in plans)
        sizes = replace(sizes, strips=strips, spacing_mm=spacing)
    else:
        counts = [(kind, len(switches.markers_of(kind))) for kind in switches.kinds]
        plans = plan_sets(counts, room.columns, room.lines)
    if section.way == "rigid":
        check_troughs(sizes)
    return sizes, plans


def _room(sizes: MoldSizes, rules: PrintSection, *, strips: bool) -> Room:
    """Largest grid of cells that fits the bed.

    Raises
    ------
    DesignError
        If it is too small.
    """
    edge = dome_edge_mm(sizes) if sizes.section.way == "rigid" else tray_edge_mm(sizes)
    wide, deep, _ = (side / sizes.print_scale for side in _bed(rules))
    columns, lines = (int((side - 2.0 * edge) / sizes.pitch_mm) for side in (wide, deep))
    least = (LEAST, LEAST + KEY_LINES if strips else LEAST)
    if columns < least[0] or lines < least[1]:
        sides = [sizes.print_scale * (cells * sizes.pitch_mm + 2.0 * edge) for cells in least]
        raise DesignError(
            "mold-exceeds-bed",
            f"the smallest mold ({sizes.section.way}) of these switches is {sides[0]:.0f} x "
            f"{sides[1]:.0f} mm, the printer's bed {rules.bed_mm[0]:g} x {rules.bed_mm[1]:g} mm, "
            "and a mold is not split further; lower [mold] wall_mm, moat_mm or channel_mm, or "
            "take a larger [print_rules] bed_mm",
        )
    return Room(columns=columns, lines=lines, pitch_mm=sizes.pitch_mm)


def make_molds(
    section: MoldSection,
    rules: PrintSection,
    switches: SwitchSet,
    *,
    tolerance_mm: float = 0.01,
    strips: StripSet | None = None,
) -> list[MoldSet]:
    """Molds for all switches of a design, in as few sets as the bed allows.

    Raises
    ------
    DesignError
        If no set fits the bed, or the printer cannot make a detail.
    """
    sizes, plans = plan_molds(section, rules, switches, tolerance_mm=tolerance_mm, strips=strips)
    made = [
        MoldSet(
            plan=plan,
            sizes=sizes,
            parts={name: make(plan, sizes) for name, make in MAKERS[section.way].items()},
        )
        for plan in plans
    ]
    tallest = max(float(np.ptp(mesh.vertices_mm[:, 2])) for mesh in made[0].parts.values())
    if tallest > rules.bed_mm[2] / sizes.print_scale:
        raise DesignError(
            "mold-exceeds-height",
            f"the mold's tallest part is {tallest * sizes.print_scale:.3g} mm, the printer's "
            f"height {rules.bed_mm[2]:g} mm; shorten the receptors or raise [print_rules] bed_mm",
        )
    return made


def _bed(rules: PrintSection) -> tuple[float, float, float]:
    """Bed with its long side first: long lines need fewer labels."""
    x, y, z = rules.bed_mm
    return max(x, y), min(x, y), z
