"""The light bar: a printed core with two flats for light strips, on a foot outside the connector.

The wires leave between foot and connector, around a corner that no light passes::

      strip  ____________
      core  |____________====|          z of the end's frame runs to the left
      strip  ____________  # | connector
                         ----  wires → groove in the foot
                         foot
"""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.camera_unit import SKIN_mm, around_mm
from phytac_design.fabrication.hardware.parts import HardwareAssembly, HardwarePart
from phytac_design.fabrication.hardware.screws import SCREWS, END_mm, Joint, TOUCH_mm
from phytac_design.fabrication.hardware.solid_nodes import (
    Difference,
    Intersection,
    Node,
    Prism,
    Rect,
    Union,
    block,
    disc,
)
from phytac_shapes.errors import DesignError

WITHIN_mm = 0.05
"""The bar stays this far within the cylinder that the camera's scene holds."""
CORE = 0.4
"""Half the core's thickness between its flats, as a share of the bar's radius."""
GROOVE_mm = (4.0, 1.5)
"""Width and depth of the groove for the wires."""


def foot_plate_mm(design: Design) -> float:
    """Thickness of a connector that holds the foot's screws."""
    hardware = design.hardware
    engaged = SCREWS[hardware.screw_bar].engaged_mm(hardware.thread)
    return max(hardware.wall_mm, engaged + END_mm + SKIN_mm)


def strip_mm(design: Design) -> tuple[float, float]:
    """Width and thickness of the light strips that fit on the bar's flats."""
    radius = design.light.bar_radius_mm - WITHIN_mm
    thick = min(design.hardware.strip_thickness_mm, 0.4 * radius)
    width = 2.0 * float(np.sqrt(radius**2 - (CORE * radius + thick) ** 2)) - 0.1
    return width, thick


def _radii_mm(design: Design) -> tuple[float, float]:
    """Radius of the circle of the foot's screws, and of the foot."""
    hardware = design.hardware
    screw = SCREWS[hardware.screw_bar]
    hole = screw.hole_mm(hardware.thread)
    ring = design.light.bar_radius_mm + design.print_rules.clearance_mm + hole / 2.0 + 1.5
    return ring, ring + screw.head_mm / 2.0 + 0.8


def _length_mm(design: Design, plate_mm: float) -> tuple[float, float]:
    """Length of the foot's screws, and the foot's thickness that they need."""
    hardware = design.hardware
    screw = SCREWS[hardware.screw_bar]
    least = max(hardware.wall_mm, GROOVE_mm[1] + SKIN_mm) + TOUCH_mm
    length = screw.length_mm(least + screw.engaged_mm(hardware.thread), "the light bar's foot")
    return length, max(least, length - (plate_mm - SKIN_mm - END_mm)) - TOUCH_mm


def foot_mm(design: Design, plate_mm: float) -> tuple[float, float]:
    """Radius of the foot, and its height with its screws' heads."""
    head = SCREWS[design.hardware.screw_bar].head_height_mm
    return _radii_mm(design)[1], _length_mm(design, plate_mm)[1] + head + 2.0 * TOUCH_mm


def bar(
    design: Design, low_mm: float, limit_mm: float, *, plate_mm: float, tip_mm: float
) -> tuple[HardwareAssembly, tuple[Node, ...]]:
    """Bar on a connector, and what is cut out of that.

    Parameters
    ----------
    low_mm : float
        Outside of the connector in the end's frame.
    limit_mm : float
        Half the connector's width.
    plate_mm : float
        Thickness of its plate.
    tip_mm : float
        Where the bar ends inside the sensor.

    Raises
    ------
    DesignError
        If the foot does not fit the connector.
    """
    hardware, clearance = design.hardware, design.print_rules.clearance_mm
    screw = SCREWS[hardware.screw_bar]
    radius = design.light.bar_radius_mm
    ring, foot = _radii_mm(design)
    if foot > limit_mm:
        raise DesignError(
            "bar-foot-too-wide",
            f"the light bar's foot of ø{2.0 * foot:.1f} mm does not fit the connector of "
            f"{2.0 * limit_mm:.1f} mm; lower light.bar_radius_mm or choose a smaller "
            "hardware.screw_bar",
        )
    length, thick = _length_mm(design, plate_mm)
    top = low_mm - TOUCH_mm
    turn = np.pi * np.array([0.0, 2.0, 4.0]) / 3.0
    places = (ring * np.column_stack([np.cos(turn), np.sin(turn)])).tolist()
    joint = Joint(
        name="bar",
        screw=screw,
        thread=hardware.thread,
        head_part="bar",
        thread_part="connector",
        seats_mm=tuple((x, y, top - thick) for x, y in places),
        directions=((0.0, 0.0, 1.0),) * len(places),
        grip_mm=thick + TOUCH_mm,
        length_mm=length,
        depth_mm=plate_mm - SKIN_mm,
    )
    inside = radius - WITHIN_mm
    flats = Rect(size_mm=(4.0 * inside, 2.0 * CORE * inside))
    core = Intersection(
        disc(inside, top - 0.5 * thick, tip_mm), Prism(flats, top - thick, tip_mm + 1.0)
    )
    width, deep = GROOVE_mm
    groove = block((width, 2.0 * foot), top - deep, top + 1.0, (0.0, -foot - CORE * inside))
    plate = disc(foot, top - thick, top)
    body = Union((Difference(plate, (groove, *joint.passing())), core))
    strip_width, strip = strip_mm(design)
    middle = CORE * inside + TOUCH_mm / 2.0 + strip / 2.0
    strips = tuple(
        block((strip_width, strip - TOUCH_mm), low_mm + plate_mm, tip_mm, (0.0, side * middle))
        for side in (-1.0, 1.0)
    )
    away = -0.6 * tip_mm - 40.0
    size = f"{strip_width:.1f} x {strip:.1f} mm"
    note = f"core of the light bar; flats for strips of {size}"
    parts = [HardwarePart("bar", body, "resin", (0.0, 0.0, away), note)]
    note = f"light strip {size} with polarising film"
    for number, node in enumerate(strips, start=1):
        step = (0.0, 40.0 * (2 * number - 3), away)
        parts.append(HardwarePart(f"light_strip_{number}", node, "light", step, note))
    opening = disc(radius + clearance, low_mm - 1.0, tip_mm)
    # Any line out crosses the hole half-way: beside the core, and where the wires pass.
    middle_z = low_mm + 0.5 * plate_mm
    gaps = around_mm(radius + 0.5 * clearance, middle_z)
    for share in (0.5, 0.75, 0.95):
        gaps += ((0.0, -share * radius, middle_z), (0.0, share * radius, middle_z))
    kit = HardwareAssembly(
        parts=tuple(parts),
        joints=(joint,),
        clearances_mm={"bar in connector": clearance},
        openings_mm=gaps,
    )
    return kit, (opening, *joint.holding())
