"""Mounts and connectors on the rims of tubes and domes, and the light bar between them.

A socket holds a rim on both sides, so that no light passes; set screws press on the flange::

        set screw →  |##|
        collar  ####### | flange
                #     # |        sensor ▷ z
        seat    #  ####.|_____________
                #  # spigot   (outside of the camera's view)
"""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.adapters import handle, handle_plate_mm
from phytac_design.fabrication.hardware.bar import bar, foot_mm, foot_plate_mm
from phytac_design.fabrication.hardware.camera_unit import camera_unit, check_cavity
from phytac_design.fabrication.hardware.parts import HardwareAssembly, HardwarePart
from phytac_design.fabrication.hardware.rim_ends import End, rim_places
from phytac_design.fabrication.hardware.screws import SCREWS, Joint, TOUCH_mm
from phytac_design.fabrication.hardware.solid_nodes import (
    Difference,
    Node,
    Outline,
    Point3,
    Prism,
    Union,
    grown,
    half_mm,
    span_mm,
    triples,
)
from phytac_shapes import Surface
from phytac_shapes.errors import DesignError

VIEW_mm = 0.3
"""Least distance between a spigot and the camera's lines of sight."""


def mount(
    design: Design, surface: Surface, end: End, camera_mm: float, *, label: str, ring: bool
) -> HardwareAssembly:
    """Socket, tube and plate before a camera whose centre is at z = ``camera_mm`` of the end.

    Raises
    ------
    DesignError
        If board, lens, ring or screws do not fit.
    """
    spigot_min_mm = 1.0  # a shorter spigot is left out
    clearance, wall = design.print_rules.clearance_mm, design.hardware.wall_mm
    name = f"mount{label}"
    unit = camera_unit(design, camera_mm, end.stop_mm, label=label, mount=name, ring=ring)
    inset = clearance + design.print_rules.wall_free_min_mm + 0.2
    top = camera_mm * (inset + VIEW_mm) / half_mm(end.edge)
    spigot = top - (end.stop_mm - TOUCH_mm) >= spigot_min_mm
    cavity = grown(end.inner, -inset) if spigot else end.inner
    check_cavity(design, half_mm(cavity), "mount", ring=ring)
    socket, cuts, joint = _socket(design, surface, end, name, top if spigot else None)
    gaps = _gaps(design, surface, end, top if spigot else None)
    hollow = Prism(cavity, unit.front_mm, 1.0)
    plate = Prism(unit.plate, unit.back_mm, unit.front_mm)
    # Behind the socket the tube needs no more than its wall.
    step = max(unit.back_mm, end.stop_mm - TOUCH_mm - wall)
    tube = Prism(grown(cavity, wall), unit.back_mm, step + 0.5 * wall)
    shaft = Difference(Union((Prism(socket, step, 0.0), tube)), (hollow, cuts))
    body = Difference(Union((shaft, plate, *unit.added)), (*unit.removed, *joint.holding()))
    check_bed(design, (span_mm(socket), span_mm(unit.plate)), -unit.back_mm, name)
    note = "camera mount" if surface.periodic[1] and not any(surface.poles) else "base"
    part = HardwarePart(name, body, "resin", (0.0, 0.0, -10.0), note)
    return unit.kit + HardwareAssembly(
        parts=(part,),
        joints=(joint,),
        openings_mm=gaps,
        clearances_mm={f"rim in {name}": clearance},
    )


def connector(
    design: Design, surface: Surface, end: End, *, bar_mm: float = 0.0
) -> HardwareAssembly:
    """Closed end of a tube without a camera; ``bar_mm`` is the length of the light bar on it.

    Raises
    ------
    DesignError
        If screws or bar do not fit.
    """
    hardware, clearance = design.hardware, design.print_rules.clearance_mm
    name = "connector"
    seat = end.stop_mm - TOUCH_mm
    plate = hardware.wall_mm
    if bar_mm > 0.0:
        plate = foot_plate_mm(design)
    if hardware.adapter == "handle":
        plate = max(plate, handle_plate_mm(design))
    low = seat - plate
    socket, cuts, clamp = _socket(design, surface, end, name, -VIEW_mm)
    tools: list[Node] = [cuts, *clamp.holding()]
    inset = clearance + hardware.wall_mm
    if half_mm(end.inner) > inset + hardware.wall_mm:
        tools.append(Prism(grown(end.inner, -inset), seat, 1.0))
    body: Node = Difference(Prism(socket, low, 0.0), tuple(tools))
    kit = HardwareAssembly(
        joints=(clamp,),
        openings_mm=_gaps(design, surface, end, -VIEW_mm),
        clearances_mm={f"rim in {name}": clearance},
    )
    if bar_mm > 0.0:
        own, removed = bar(design, low, half_mm(socket), plate_mm=plate, tip_mm=bar_mm)
        body = Difference(body, removed)
        kit = kit + own
    if hardware.adapter == "handle":
        foot = foot_mm(design, plate) if bar_mm > 0.0 else (0.0, 0.0)
        own, removed = handle(design, low, half_mm(socket), foot)
        body = Difference(body, removed)
        kit = kit + own
    check_bed(design, (span_mm(socket),), -low, name)
    part = HardwarePart(name, body, "resin", (0.0, 0.0, -20.0), "closes the end without a camera")
    return kit + HardwareAssembly(parts=(part,))


def _socket(
    design: Design, surface: Surface, end: End, name: str, spigot_mm: float | None
) -> tuple[Outline, Node, Joint]:
    """Outline of a socket, what is cut out of it for the rim, and its set screws."""
    hardware, clearance = design.hardware, design.print_rules.clearance_mm
    room = grown(end.outer, clearance)
    seat = end.stop_mm - TOUCH_mm
    cut: Node = Prism(room, seat, 1.0)
    if spigot_mm is not None:
        inside = Prism(grown(end.inner, -clearance), seat - 1.0, spigot_mm)
        cut = Difference(cut, (inside,))
    return grown(room, hardware.wall_mm), cut, _clamp(design, surface, end, name)


def _gaps(
    design: Design, surface: Surface, end: End, spigot_mm: float | None
) -> tuple[Point3, ...]:
    """Points in the gap between rim and spigot, or rim and seat, which any light path crosses."""
    gaps = 16  # places around a rim from which the light check starts
    gap = design.print_rules.clearance_mm
    if spigot_mm is None:
        offset, z = -0.5 * design.wall.thickness_mm, end.stop_mm - 0.5 * TOUCH_mm
    else:
        offset, z = -design.wall.thickness_mm - 0.5 * gap, 0.5 * (spigot_mm + end.stop_mm)
    share = z / end.stop_mm
    points, _ = rim_places(
        design, surface, end, count=gaps, offset_mm=offset, share=min(share, 1.0)
    )
    return triples(np.column_stack([points[:, :2], np.full(len(points), z)]))


def _clamp(design: Design, surface: Surface, end: End, name: str) -> Joint:
    """Set screws through the collar onto the flange."""
    hardware, wall = design.hardware, design.wall
    screw = SCREWS[hardware.screw_clamp]
    least = design.print_rules.wall_free_min_mm
    edge = -end.stop_mm / 2.0 - screw.tap_mm / 2.0
    if edge < least:
        raise DesignError(
            "set-screw-edge-distance",
            f"{screw.name} set screws do not fit the rim: their hole of {screw.tap_mm:g} mm in a "
            f"socket over {-end.stop_mm:.1f} mm of rim (flange {wall.rim_flange_mm:g} mm) leaves "
            f"{edge:.2f} mm beside it, the printer needs {least:g} mm; choose a smaller "
            "hardware.screw_clamp or raise wall.rim_length_mm",
        )
    bearing = wall.thickness_mm + wall.rim_flange_mm
    if bearing < 0.5 * screw.nominal_mm:
        raise DesignError(
            "set-screw-too-strong",
            f"{screw.name} set screws are too strong for the rim: wall and flange are "
            f"{bearing:g} mm thick, less than half the screw's diameter; raise "
            "wall.rim_flange_mm or choose a smaller hardware.screw_clamp",
        )
    room = hardware.wall_mm + design.print_rules.clearance_mm
    if hardware.wall_mm < screw.nominal_mm:
        raise DesignError(
            "set-screw-thread-short",
            f"{screw.name} set screws find too little thread in a wall of {hardware.wall_mm:g} mm: "
            f"they need {screw.nominal_mm:g} mm; raise hardware.wall_mm or choose a smaller "
            "hardware.screw_clamp",
        )
    fitting = [length for length in screw.set_lengths_mm if length <= room]
    length = fitting[-1] if fitting else screw.set_lengths_mm[0]
    points, normals = rim_places(
        design,
        surface,
        end,
        count=hardware.clamps,
        offset_mm=wall.rim_flange_mm,
        share=0.5,
    )
    across = np.linalg.norm(normals[:, :2], axis=1)
    level = np.column_stack([normals[:, :2] / across[:, None], np.zeros(len(normals))])
    # A flat point on a face that slopes along the axis touches it with its edge.
    gap = TOUCH_mm + screw.minor_mm / 2.0 * np.abs(normals[:, 2]) / across
    seats = points + gap[:, None] * level
    return Joint(
        name=f"clamp_{name}",
        screw=screw,
        thread="set",
        head_part="shell",
        thread_part=name,
        seats_mm=triples(seats),
        directions=triples(-level),
        grip_mm=design.print_rules.clearance_mm - TOUCH_mm,
        length_mm=length,
        depth_mm=hardware.wall_mm,
    )


def check_bed(
    design: Design, sizes: tuple[tuple[float, float], ...], tall: float, name: str
) -> None:
    """Reject a part that fits the bed in none of its upright positions."""
    width, height = (max(size[i] for size in sizes) for i in (0, 1))
    bed = sorted(design.print_rules.bed_mm)
    if any(a > b for a, b in zip(sorted((width, height, tall)), bed, strict=True)):
        raise DesignError(
            "hardware-exceeds-bed",
            f"the {name} is too large: {width:.0f} x {height:.0f} x {tall:.0f} mm, the printer "
            f"takes {' x '.join(f'{side:g}' for side in design.print_rules.bed_mm)} mm "
            "(print_rules.bed_mm); choose a smaller camera board (hardware.board_size_mm) or a "
            "larger printer",
        )
