"""Parts on demand: a tray for an inertial sensor on the cover, a socket for a shaft."""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.parts import HardwareAssembly, HardwarePart
from phytac_design.fabrication.hardware.screws import SCREWS, END_mm, Joint, TOUCH_mm
from phytac_design.fabrication.hardware.solid_nodes import (
    Difference,
    Node,
    Point3,
    Union,
    block,
    disc,
    triples,
)
from phytac_shapes.errors import DesignError

BESIDE_mm = 1.0
"""Space beside screw heads."""


def imu_seat(
    design: Design, floor_mm: float, *, label: str
) -> tuple[HardwareAssembly, tuple[Node, ...], tuple[Node, ...]]:
    """Tray on the back of a cover whose outside is at z = ``floor_mm``; its bosses and holes."""
    ear_mm = 2.4  # thickness of the tray's ears under the screws' heads
    tray_mm = 1.5  # floor and wall of the tray
    hardware, clearance = design.hardware, design.print_rules.clearance_mm
    screw = SCREWS[hardware.screw_camera]
    width, height, deep = hardware.imu_size_mm
    x0, y0 = hardware.board_offset_mm
    top = floor_mm - TOUCH_mm
    engaged = screw.engaged_mm(hardware.thread)
    length = screw.length_mm(ear_mm + TOUCH_mm + engaged, "the inertial sensor's tray")
    depth = length - ear_mm - TOUCH_mm + END_mm
    ear = width / 2.0 + clearance + tray_mm + screw.head_mm / 2.0 + BESIDE_mm
    outside = (width + 2.0 * (clearance + tray_mm), height + 2.0 * (clearance + tray_mm))
    middle = (x0, y0)
    tray = block(outside, top - tray_mm - deep, top, middle)
    across = 2.0 * (ear + screw.head_mm / 2.0 + BESIDE_mm)
    ears = block((across, screw.head_mm + 2.0), top - ear_mm, top, middle)
    inside = (width + 2.0 * clearance, height + 2.0 * clearance)
    pocket = block(inside, top - tray_mm - deep - 1.0, top - tray_mm, middle)
    seats: tuple[Point3, ...] = ((x0 - ear, y0, top - ear_mm), (x0 + ear, y0, top - ear_mm))
    joint = Joint(
        name="imu",
        screw=screw,
        thread=hardware.thread,
        head_part="imu_seat",
        thread_part=f"cover{label}",
        seats_mm=seats,
        directions=((0.0, 0.0, 1.0),) * 2,
        grip_mm=ear_mm + TOUCH_mm,
        length_mm=length,
        depth_mm=depth,
    )
    radius = screw.hole_mm(hardware.thread) / 2.0 + tray_mm
    high = floor_mm + max(depth + 1.0, hardware.wall_mm)
    bosses = tuple(
        disc(radius, floor_mm + 0.5 * hardware.wall_mm, high, (x, y)) for x, y, _ in seats
    )
    seat = Difference(Union((tray, ears)), (pocket, *joint.passing()))
    imu = block((width, height), top - tray_mm - deep, top - tray_mm - TOUCH_mm, middle)
    parts = (
        HardwarePart("imu_seat", seat, "resin", (0.0, 0.0, -75.0), "tray for the inertial sensor"),
        HardwarePart("imu", imu, "electronics", (0.0, 0.0, -95.0), "inertial sensor, held by tape"),
    )
    kit = HardwareAssembly(
        parts=parts, joints=(joint,), clearances_mm={"inertial sensor in tray": clearance}
    )
    return kit, bosses, joint.holding()


def handle_plate_mm(design: Design) -> float:
    """Thickness of a connector that holds the socket's screws."""
    hardware = design.hardware
    return SCREWS[hardware.screw_clamp].engaged_mm(hardware.thread) + END_mm + 1.0


def handle(
    design: Design, low_mm: float, limit_mm: float, foot_mm: tuple[float, float]
) -> tuple[HardwareAssembly, tuple[Node, ...]]:
    """Socket for a shaft on a connector's outside at z = ``low_mm``, and its holes in that.

    Parameters
    ----------
    limit_mm : float
        Half the connector's width.
    foot_mm : (float, float)
        Radius and height of what stands on the connector: the light bar's foot with its screws.

    Raises
    ------
    DesignError
        If the shaft is too thick for the connector.
    """
    notch_mm = (5.0, 2.0)  # width and depth of the way for the bar's wires out of the socket
    hardware, clearance = design.hardware, design.print_rules.clearance_mm
    screw = SCREWS[hardware.screw_clamp]
    wall = max(hardware.wall_mm, screw.nominal_mm)
    bore = hardware.adapter_diameter_mm / 2.0 + clearance
    room, tall = (foot_mm[0] + clearance, foot_mm[1] + clearance) if foot_mm[0] else (0.0, 0.0)
    neck = max(bore, room) + wall
    ring = neck + screw.head_mm / 2.0 + BESIDE_mm
    edge = ring + screw.head_mm / 2.0 + BESIDE_mm
    if edge > limit_mm:
        raise DesignError(
            "adapter-too-wide",
            f"a socket for a shaft of ø{hardware.adapter_diameter_mm:g} mm does not fit the "
            f"connector: it needs ø{2.0 * edge:.1f} mm, the connector has {2.0 * limit_mm:.1f} mm; "
            "lower hardware.adapter_diameter_mm",
        )
    top = low_mm - TOUCH_mm
    depth = handle_plate_mm(design) - 1.0
    length = screw.length_mm(
        wall + TOUCH_mm + screw.engaged_mm(hardware.thread), "the shaft's socket"
    )
    thick = max(wall, length - TOUCH_mm - (depth - END_mm))
    bottom = top - max(tall, thick) - wall - hardware.adapter_depth_mm
    turn = np.pi * (0.25 + 0.5 * np.arange(4))
    level = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(4)])
    hold = Joint(
        name="adapter",
        screw=screw,
        thread=hardware.thread,
        head_part="adapter",
        thread_part="connector",
        seats_mm=triples(ring * level + np.array([0.0, 0.0, top - thick])),
        directions=((0.0, 0.0, 1.0),) * 4,
        grip_mm=thick + TOUCH_mm,
        length_mm=length,
        depth_mm=depth,
    )
    shaft = hardware.adapter_diameter_mm / 2.0 + TOUCH_mm
    middle = np.array([0.0, 0.0, bottom + 0.5 * hardware.adapter_depth_mm])
    sets = [size for size in screw.set_lengths_mm if size <= neck - shaft]
    grip = Joint(
        name="shaft",
        screw=screw,
        thread="set",
        head_part="shaft",
        thread_part="adapter",
        seats_mm=triples(shaft * level + middle),
        directions=triples(-level),
        grip_mm=bore - shaft,
        length_mm=sets[-1] if sets else screw.set_lengths_mm[0],
        depth_mm=neck - bore,
    )
    tools: list[Node] = [
        disc(bore, bottom - 1.0, bottom + hardware.adapter_depth_mm),
        *hold.passing(),
        *grip.holding(),
    ]
    if room > 0.0:
        across, deep = notch_mm
        tools += [
            disc(room, top - tall, top + 1.0),
            block((across, 2.0 * edge), top - deep, top + 1.0, (0.0, -edge)),
        ]
    body = Union((disc(edge, top - thick, top), disc(neck, bottom, top)))
    part = HardwarePart(
        "adapter",
        Difference(body, tuple(tools)),
        "resin",
        (0.0, 0.0, -150.0),
        f"socket for a shaft of {hardware.adapter_diameter_mm:g} mm",
    )
    kit = HardwareAssembly(
        parts=(part,), joints=(hold, grip), clearances_mm={"shaft in adapter": clearance}
    )
    return kit, hold.holding()
