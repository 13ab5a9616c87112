"""Base and frame of a sheet: its rim lies on the base's shelf, the frame is screwed down on it.

Both follow the curved rim: what is cut out of them is the design's own wall, a little thicker::

          frame  ______
                |  ____|  screw beside the rim
      pad ______|_|flange|#
      ___________________|#   base, around the rim's end
                  # shelf #
                  #  wall #    ... down to the camera's plate
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.design.safe_rounding import at_least
from phytac_design.design.spec import Design, WallSection
from phytac_design.fabrication.hardware.camera_unit import camera_unit, check_cavity
from phytac_design.fabrication.hardware.parts import HardwareAssembly, HardwarePart
from phytac_design.fabrication.hardware.screws import SCREWS, END_mm, Joint, TOUCH_mm
from phytac_design.fabrication.hardware.solid_nodes import (
    Difference,
    Node,
    Outline,
    Point2,
    Prism,
    Rect,
    Slab,
    Union,
    grown,
    half_mm,
    polygon,
    span_mm,
)
from phytac_design.fabrication.hardware.tube_parts import check_bed
from phytac_design.geometry.boundary_loops import Loop, chart_loops
from phytac_design.geometry.wall_sampling import chart_stations
from phytac_shapes import Surface
from phytac_shapes.errors import DesignError

GRIP_mm = 0.3
"""Gap between frame and base beside the rim: the frame presses on the rim."""


@dataclass(frozen=True, kw_only=True)
class _Rim:
    """The rim of a sheet: heights of its faces, and outlines in the projection along z."""

    surface: Surface
    loop: Loop

    def points(self, offset_mm: float, extension_mm: float) -> np.ndarray:
        return self.loop.points_mm(self.surface, offset_mm, extension_mm)

    def outline(self, extension_mm: float, offset_mm: float) -> Outline:
        return _simple(self.points(offset_mm, extension_mm)[:, :2])


def base_and_frame(
    design: Design, surface: Surface, camera_mm: float, *, ring: bool
) -> HardwareAssembly:
    """Base with the camera's plate, and frame, of a sheet before a camera at z = ``camera_mm``.

    Raises
    ------
    DesignError
        If the rim leans too much, or screws, board or lens do not fit.
    """
    shelf_mm = 0.5  # how far shelf and frame stay behind the rim's inner edge
    hardware, wall, clearance = design.hardware, design.wall, design.print_rules.clearance_mm
    if min(wall.rim_length_mm, wall.rim_flange_mm) <= 0.0:
        raise DesignError(
            "hardware-needs-rim",
            "no frame holds a sheet without rim and flange (wall.rim_length_mm = "
            f"{wall.rim_length_mm:g}, wall.rim_flange_mm = {wall.rim_flange_mm:g}); give it both, "
            'or set hardware.parts = "none"',
        )
    coarse_mm = 0.02  # outlines of base and frame follow the rim within this
    (loop,) = chart_loops(surface, *chart_stations(surface, wall, coarse_mm))
    rim = _Rim(surface=surface, loop=loop)
    lean = _lean(rim)
    length, flange, inner = wall.rim_length_mm, wall.rim_flange_mm, -wall.thickness_mm
    tops = np.concatenate([rim.points(flange, way)[:, 2] for way in (0.0, length)])
    high = float(tops.max()) + TOUCH_mm
    low = float(min(rim.points(inner, way)[:, 2].min() for way in (0.0, length)))
    # Cutters lean with the rim's normals: shelf and tongue keep off by as much.
    reach = 1.1 * (high - float(tops.min())) + 0.5
    aside = lean * (flange + reach)
    shelf = shelf_mm + aside
    if length < shelf + clearance + shelf_mm:
        raise DesignError(
            "rim-too-short",
            f"a rim of {length:g} mm gives base and frame no hold: here they need "
            f"{at_least(shelf + clearance + shelf_mm)} mm; raise wall.rim_length_mm",
        )
    unit = camera_unit(design, camera_mm, low, label="", mount="base", ring=ring)
    screw = SCREWS[hardware.screw_clamp]
    # Beside the rim there is room for a screw's head, and for the rim's lean.
    offsets = (inner, flange, flange + reach)
    holes = [rim.outline(length + clearance, offset) for offset in offsets]
    size = np.max([span_mm(hole) for hole in holes], axis=0)
    beside = max(screw.head_mm, screw.hole_mm(hardware.thread) + 3.0) + 0.6
    centre = _middle(holes[0])
    outer = Rect(size_mm=_pair(size + 2.0 * beside), centre_mm=centre)
    cavity = rim.outline(shelf, inner)
    check_cavity(design, half_mm(cavity), "base", ring=ring)
    joint = _joint(design, outer, beside, high)
    above = Slab(_thick(wall, under=TOUCH_mm, over=reach, longer=clearance))
    # Below the screws the base needs no more than its wall.
    step = max(unit.back_mm, low - joint.depth_mm - hardware.wall_mm)
    thin = Prism(grown(cavity, hardware.wall_mm), unit.back_mm, step + 0.5 * hardware.wall_mm)
    body = Difference(
        Union((Prism(outer, step, high), thin)), (Prism(cavity, unit.front_mm, high + 1.0), above)
    )
    plate = Prism(unit.plate, unit.back_mm, unit.front_mm)
    base = Difference(Union((body, plate, *unit.added)), (*unit.removed, *joint.holding()))
    top = high + GRIP_mm + hardware.wall_mm
    below = Slab(_thick(wall, under=reach, over=TOUCH_mm, longer=clearance))
    tongue = Prism(
        grown(rim.outline(length, flange), -clearance - aside), float(tops.min()) - shelf_mm, top
    )
    cover = Prism(outer, high + GRIP_mm, top)
    opening = Prism(rim.outline(shelf_mm, flange), low - 1.0, top + 1.0)
    frame: Node = Difference(Union((tongue, cover)), (opening, below, *joint.passing()))
    check_bed(design, (span_mm(outer), span_mm(unit.plate)), high - unit.back_mm, "base")
    parts = (
        HardwarePart("base", base, "resin", (0.0, 0.0, -10.0), "base with camera mount"),
        HardwarePart(
            "frame", frame, "resin", (0.0, 0.0, 25.0), "holds the sheet's rim on the base"
        ),
    )
    return unit.kit + HardwareAssembly(
        parts=parts, joints=(joint,), clearances_mm={"rim in base": clearance}
    )


def _thick(wall: WallSection, *, under: float, over: float, longer: float) -> WallSection:
    """Wall with its rims, thicker below and above and longer."""
    return wall.model_copy(
        update={
            "thickness_mm": wall.thickness_mm + under,
            "rim_flange_mm": wall.rim_flange_mm + over,
            "rim_length_mm": wall.rim_length_mm + longer,
        }
    )


def _joint(design: Design, outer: Rect, beside: float, high: float) -> Joint:
    """Screws through the frame into the base: in its corners and half-way along its sides."""
    hardware = design.hardware
    screw = SCREWS[hardware.screw_clamp]
    width, height = outer.size_mm
    x, y = width / 2.0 - beside / 2.0, height / 2.0 - beside / 2.0
    places = [(x, y), (-x, y), (-x, -y), (x, -y), (0.0, y), (0.0, -y), (x, 0.0), (-x, 0.0)]
    grip = hardware.wall_mm + GRIP_mm
    length = screw.length_mm(grip + screw.engaged_mm(hardware.thread), "the frame")
    cx, cy = outer.centre_mm
    return Joint(
        name="frame",
        screw=screw,
        thread=hardware.thread,
        head_part="frame",
        thread_part="base",
        seats_mm=tuple((cx + a, cy + b, high + grip) for a, b in places),
        directions=((0.0, 0.0, -1.0),) * len(places),
        grip_mm=grip,
        length_mm=length,
        depth_mm=length - grip + END_mm,
    )


def _lean(rim: _Rim) -> float:
    """Steepest lean of the rim, as a tangent; rejected if too steep."""
    # Steepest rim, as the tangent of its lean, that base and frame are made for (20°).
    lean_max = 0.36
    normals = rim.surface.normal(rim.loop.uv)
    lean = float((np.linalg.norm(normals[:, :2], axis=1) / np.abs(normals[:, 2])).max())
    if lean > lean_max:
        raise DesignError(
            "rim-lean-too-large",
            f"no frame is made for a sheet that leans by {np.degrees(np.arctan(lean)):.0f}° at its "
            f"rim (at most {np.degrees(np.arctan(lean_max)):.0f}°); lower the tilt, or set "
            'hardware.parts = "none"',
        )
    return lean


def _simple(points: np.ndarray) -> Outline:
    """Rectangle around points (n, 2) if they lie on one, else their polygon."""
    low, high = points.min(axis=0), points.max(axis=0)
    aside = np.minimum(np.abs(points - low), np.abs(points - high)).min(axis=1)
    if float(aside.max()) < 1e-9 * float((high - low).max()):
        return Rect(size_mm=_pair(high - low), centre_mm=_pair((low + high) / 2.0))
    # Stations along straight edges are left out.
    array = np.array(polygon(points).points_mm)
    before, after = np.roll(array, 1, axis=0), np.roll(array, -1, axis=0)
    way = after - before
    off = (array - before)[:, 0] * way[:, 1] - (array - before)[:, 1] * way[:, 0]
    return polygon(array[np.abs(off) > 1e-6 * np.sum(way**2, axis=1)])


def _middle(outline: Outline) -> Point2:
    if isinstance(outline, Rect):
        return outline.centre_mm
    points = np.array(getattr(outline, "points_mm", [(0.0, 0.0)]))
    return _pair((points.min(axis=0) + points.max(axis=0)) / 2.0)


def _pair(values: np.ndarray) -> Point2:
    return (float(values[0]), float(values[1]))
