"""Plate, board, lens, cover and their screws: the same behind every mount.

Made in the frame of an end, along z; the camera looks towards +z::

      cover                plate
     |  back_room  board |front_room|wall|
     |..............|####|  boss    |    |
     |              |####|=========lens=======) - - - pupil - ▷ z
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.adapters import imu_seat
from phytac_design.fabrication.hardware.parts import HardwareAssembly, HardwarePart
from phytac_design.fabrication.hardware.screws import SCREWS, Joint, TOUCH_mm, through
from phytac_design.fabrication.hardware.solid_nodes import (
    Circle,
    Difference,
    Node,
    Point2,
    Point3,
    Prism,
    Rect,
    Union,
    block,
    disc,
    tube,
)
from phytac_shapes.errors import DesignError

SKIN_mm = 0.8
"""Material that a blind hole leaves, so that no light passes."""
BOSS_mm = 1.2
"""Wall of bosses and posts around a hole."""


@dataclass(frozen=True, kw_only=True)
class CameraUnit:
    """Positions of the camera's parts along z, and those parts that are the same for every mount.

    Attributes
    ----------
    front_mm, back_mm : float
        Faces of the mount's plate.
    lens_mm : float
        Front of the lens.
    plate : Rect
        Least outline of the plate: it carries the cover.
    added, removed : tuple of Node
        Bosses to add to the mount, and holes to cut.
    kit : HardwareAssembly
        Cover, board with lens, ring light if there is one, and the joint.
    """

    front_mm: float
    back_mm: float
    lens_mm: float
    plate: Rect
    added: tuple[Node, ...]
    removed: tuple[Node, ...]
    kit: HardwareAssembly


def camera_unit(
    design: Design, camera_mm: float, stop_mm: float, *, label: str, mount: str, ring: bool
) -> CameraUnit:
    """Parts behind the mount ``mount`` of a camera whose centre is at z = ``camera_mm``.

    Parameters
    ----------
    stop_mm : float
        Where the space for plate and lens ends: the rim's end.
    label : str
        Ends the parts' names: ``""``, ``"_near"`` or ``"_far"``.
    ring : bool
        Whether the plate carries a light ring.

    Raises
    ------
    DesignError
        If lens and plate have no room before the rim, or the screws do not fit.
    """
    boss_min_mm = 1.5  # least radius of a boss
    hardware, clearance = design.hardware, design.print_rules.clearance_mm
    wall = hardware.wall_mm
    lens = camera_mm + hardware.lens_pupil_mm
    board = lens - hardware.lens_length_mm
    back = board + hardware.front_room_mm
    front = back + wall
    if max(lens, front) > stop_mm - TOUCH_mm:
        raise DesignError(
            "camera-unit-too-long",
            f"the camera has no room before the rim: {'its lens' if lens > front else 'its mount'} "
            f"would reach {max(lens, front) - stop_mm:.1f} mm past the rim's end (camera "
            f"{-camera_mm:.1f} mm before the sensor, lens {hardware.lens_length_mm:g} mm, its "
            f"centre {hardware.lens_pupil_mm:g} mm behind its front); raise camera.stand_off_mm, "
            "or correct hardware.lens_length_mm and hardware.lens_pupil_mm",
        )
    if front > camera_mm:
        raise DesignError(
            "mount-before-lens",
            "the mount's plate would stand before the lens: the lens is "
            f"{hardware.lens_length_mm:g} mm long, plate and parts on the board take "
            f"{wall + hardware.front_room_mm:g} mm; lower hardware.wall_mm or "
            "hardware.front_room_mm",
        )
    joint, extra = _joint(design, board, back, label=label, mount=mount)
    floor = board - hardware.board_thickness_mm - hardware.back_room_mm - wall - extra
    boss = max(joint.screw.hole_mm(hardware.thread) / 2.0 + BOSS_mm, boss_min_mm)
    added = _rods(design, boss, board + TOUCH_mm, back + 0.5 * wall)
    kit = HardwareAssembly()
    bosses: tuple[Node, ...] = ()
    holes: tuple[Node, ...] = ()
    if hardware.imu == "seat" and label != "_far":
        kit, bosses, holes = imu_seat(design, floor, label=label)
    room, cover = _cover(design, joint, (floor, board, back), boss)
    cover = Difference(Union((cover, *bosses)), (*joint.passing(), *holes))
    lens_radius = hardware.lens_diameter_mm / 2.0
    opening = disc(lens_radius + clearance, back - 1.0, front + 1.0)
    camera = design.camera
    note = (
        f"camera board {hardware.board} with a lens of "
        f"{1e-3 * camera.focal_px * camera.pixel_um:.2f} mm focal length, "
        f"{camera.width_px} x {camera.height_px} px of {camera.pixel_um:g} um"
    )
    node = _camera(design, board, lens, joint)
    parts = [
        HardwarePart(f"cover{label}", cover, "resin", (0.0, 0.0, -45.0), "camera cover"),
        HardwarePart(f"camera{label}", node, "electronics", (0.0, 0.0, -25.0), note),
    ]
    removed: list[Node] = [opening, *joint.holding()]
    middle = 0.5 * (front + back)
    gaps = around_mm(lens_radius + 0.5 * clearance, middle)
    if ring:
        inner, outer = ring_radii_mm(design)
        gaps += ((0.0, -0.5 * (inner + outer), middle),)
        seat, wires, light = _ring(design, front)
        removed += [seat, wires]
        note = (
            f"ring of light, ø{2.0 * (inner + clearance):.1f} to "
            f"ø{2.0 * (outer - clearance):.1f} mm, {hardware.strip_thickness_mm:g} mm thick"
        )
        parts.append(HardwarePart(f"ring_light{label}", light, "light", (0.0, 0.0, 15.0), note))
    return CameraUnit(
        front_mm=front,
        back_mm=back,
        lens_mm=lens,
        plate=room,
        added=added,
        removed=tuple(removed),
        kit=kit
        + HardwareAssembly(
            parts=tuple(parts),
            joints=(joint,),
            openings_mm=gaps,
            clearances_mm={f"board in cover{label}": clearance, f"lens in {mount}": clearance},
        ),
    )


def _rods(design: Design, radius: float, low: float, high: float) -> tuple[Node, ...]:
    """Rods along z over all holes of the board."""
    return tuple(disc(radius, low, high, hole) for hole in design.hardware.board_holes_mm)


def _cover(
    design: Design, joint: Joint, levels_mm: tuple[float, float, float], boss_mm: float
) -> tuple[Rect, Node]:
    """Outline of the cover, and the cover without holes; levels: its back, the board, the plate."""
    hardware, clearance = design.hardware, design.print_rules.clearance_mm
    floor, board, back = levels_mm
    width, height = hardware.board_size_mm
    inside, outside = (
        Rect(size_mm=(width + 2.0 * by, height + 2.0 * by), centre_mm=hardware.board_offset_mm)
        for by in (clearance, clearance + hardware.wall_mm)
    )
    top = back - TOUCH_mm
    tools: list[Node] = [
        Prism(inside, floor + hardware.wall_mm, top + 1.0),
        _cable(design, inside, floor),
    ]
    # Thick bosses of the mount reach into the cover's wall.
    aside = np.abs(np.array(hardware.board_holes_mm) - np.array(inside.centre_mm))
    if float((aside + boss_mm + clearance - np.array(inside.size_mm) / 2.0).max()) > TOUCH_mm:
        tools += _rods(design, boss_mm + clearance, board - clearance, top + 1.0)
    post = joint.screw.clearance_mm / 2.0 + BOSS_mm
    levels = floor + 0.5 * hardware.wall_mm, board - hardware.board_thickness_mm - TOUCH_mm
    posts = *_rods(design, post, *levels), *_ribs(design, inside, post, levels)
    return outside, Union((Difference(Prism(outside, floor, top), tuple(tools)), *posts))


def _ribs(
    design: Design, inside: Rect, radius: float, levels_mm: tuple[float, float]
) -> tuple[Prism, ...]:
    """Blocks that join posts to the walls of the cover that they stand too near to print apart."""
    hardware = design.hardware
    middle, half = np.array(inside.centre_mm), np.array(inside.size_mm) / 2.0
    into = 0.5 * hardware.wall_mm  # how far they reach into a wall
    ribs = []
    for hole in np.array(hardware.board_holes_mm):
        side = np.where(hole < middle, -1.0, 1.0)
        wall = middle + side * half
        near = np.abs(wall - hole) - radius < design.print_rules.gap_min_mm
        outer = np.where(near, wall + into * side, hole + radius * side)
        for axis in np.flatnonzero(near):
            # From the post's axis to the wall, as wide as the post.
            inner = hole - radius * side
            inner[axis] = hole[axis]
            width, depth = np.abs(outer - inner).tolist()
            x, y = (0.5 * (outer + inner)).tolist()
            ribs.append(block((width, depth), *levels_mm, (x, y)))
    return tuple(ribs)


def _joint(
    design: Design, board: float, back: float, *, label: str, mount: str
) -> tuple[Joint, float]:
    """Screws through cover and board into the mount, and how much thicker the cover's back is."""
    hardware = design.hardware
    screw = SCREWS[hardware.screw_camera]
    gap = TOUCH_mm
    through_mm = hardware.board_thickness_mm + hardware.back_room_mm + hardware.wall_mm + gap
    depth = back - board - gap + hardware.wall_mm - SKIN_mm
    length, extra = through(
        screw,
        hardware.thread,
        grip_mm=through_mm,
        depth_mm=depth,
        what="the camera's cover",
    )
    grip = through_mm + extra
    seat = board + gap - grip
    return Joint(
        name=f"camera{label}",
        screw=screw,
        thread=hardware.thread,
        head_part=f"cover{label}",
        thread_part=mount,
        seats_mm=tuple((x, y, seat) for x, y in hardware.board_holes_mm),
        directions=tuple((0.0, 0.0, 1.0) for _ in hardware.board_holes_mm),
        grip_mm=grip,
        length_mm=length,
        depth_mm=depth,
    ), extra


def _cable(design: Design, inside: Rect, floor: float) -> Prism:
    """Opening for the cable in the cover's wall on the side of -y, behind the board."""
    hardware = design.hardware
    width, height = hardware.cable_mm
    height = min(height, 0.8 * hardware.back_room_mm)
    x, y = inside.centre_mm
    edge = y - inside.size_mm[1] / 2.0
    deep = 4.0 * hardware.wall_mm
    return block(
        (width, deep),
        floor + hardware.wall_mm,
        floor + hardware.wall_mm + height,
        (x, edge - deep / 2.0 + 0.1),
    )


def _camera(design: Design, board: float, lens: float, joint: Joint) -> Node:
    """Board with holes, and the lens on it."""
    hardware = design.hardware
    outline = Rect(size_mm=hardware.board_size_mm, centre_mm=hardware.board_offset_mm)
    low = board - hardware.board_thickness_mm
    return Difference(
        Union(
            (
                Prism(outline, low, board),
                disc(
                    hardware.lens_diameter_mm / 2.0, low + 0.5 * hardware.board_thickness_mm, lens
                ),
            )
        ),
        tuple(
            disc(joint.screw.clearance_mm / 2.0, low - 1.0, board + 1.0, hole)
            for hole in hardware.board_holes_mm
        ),
    )


def around_mm(radius_mm: float, z_mm: float, count: int = 16) -> tuple[Point3, ...]:
    """Points on a circle around the axis."""
    turn = 2.0 * np.pi * np.arange(count) / count
    return tuple(
        (float(radius_mm * np.cos(angle)), float(radius_mm * np.sin(angle)), z_mm) for angle in turn
    )


def ring_radii_mm(design: Design) -> tuple[float, float]:
    """Inner and outer radius of the light ring's seat: within the screws, or else around them."""
    ring_min_mm = 2.0  # narrowest light ring
    hardware, clearance = design.hardware, design.print_rules.clearance_mm
    hole = SCREWS[hardware.screw_camera].hole_mm(hardware.thread) / 2.0 + SKIN_mm
    places = np.linalg.norm(np.array(hardware.board_holes_mm), axis=1)
    inner = hardware.lens_diameter_mm / 2.0 + clearance + BOSS_mm
    room = float(places.min()) - hole - inner - 2.0 * clearance
    if room < min(hardware.ring_width_mm, ring_min_mm):
        inner, room = float(places.max()) + hole, np.inf
    return inner, inner + min(hardware.ring_width_mm, room) + 2.0 * clearance


def check_cavity(design: Design, half_mm: float, part: str, *, ring: bool) -> None:
    """Reject a mount or base whose inside, ``half_mm`` from the axis, holds no lens or light ring.

    Raises
    ------
    DesignError
        If one of them is wider.
    """
    lens = design.hardware.lens_diameter_mm
    sizes = [("lens", lens, lens / 2.0 + design.print_rules.clearance_mm, "lens_diameter_mm")]
    if ring:
        outer = ring_radii_mm(design)[1]
        sizes.append(("light ring", round(2.0 * outer, 1), outer, "ring_width_mm"))
    for what, diameter, radius, field in sizes:
        if radius > half_mm:
            raise DesignError(
                "hardware-part-too-wide",
                f"the {what} of ø{diameter:g} mm does not fit the {part}, which is "
                f"{2.0 * half_mm:.1f} mm wide inside; lower hardware.{field}",
            )


def _ring(design: Design, front: float) -> tuple[Node, Node, Node]:
    """Seat of the light ring in the plate's front, hole for its wires, and the ring."""
    hardware, clearance = design.hardware, design.print_rules.clearance_mm
    inner, outer = ring_radii_mm(design)
    deep = min(hardware.strip_thickness_mm, 0.5 * hardware.wall_mm)
    seat = tube(Circle(outer), Circle(inner), front - deep - TOUCH_mm, front + 0.5)
    middle: Point2 = (0.0, -0.5 * (inner + outer))
    wires = disc(min(1.0, 0.25 * (outer - inner)), front - hardware.wall_mm - 1.0, front, middle)
    light = tube(
        Circle(outer - clearance),
        Circle(inner + clearance),
        front - deep,
        front - deep + hardware.strip_thickness_mm,
    )
    return seat, wires, light
