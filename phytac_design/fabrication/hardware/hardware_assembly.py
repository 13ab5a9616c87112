"""All hardware of a design: the parts that its shape and its cameras need."""

from phytac_design.design.hardware_table import HardwareSection
from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.parts import HardwareAssembly
from phytac_design.fabrication.hardware.rim_ends import End, make_end
from phytac_design.fabrication.hardware.sheet_parts import base_and_frame
from phytac_design.fabrication.hardware.tube_parts import connector, mount
from phytac_design.geometry.envelope import bar_span_mm
from phytac_design.layout.cameras import cameras_of
from phytac_shapes import Surface
from phytac_shapes.errors import DesignError


def make_hardware(design: Design, surface: Surface) -> HardwareAssembly:
    """Parts and joints, with screws as parts, in the sensor's frame.

    Raises
    ------
    DesignError
        If a part does not fit.
    """
    if design.hardware.parts == "none":
        return HardwareAssembly(left_out={"hardware": 'hardware.parts = "none"'})
    kit = _tube(design, surface) if surface.periodic[1] else _sheet(design, surface)
    return kit + HardwareAssembly(parts=kit.screws())


def _has_bar(design: Design, surface: Surface) -> bool:
    near, far = bar_span_mm(design, surface)
    return design.light.bar_radius_mm > 0.0 and far > near


def _tube(design: Design, surface: Surface) -> HardwareAssembly:
    cameras = dict(zip(design.camera.end_numbers, cameras_of(design, surface), strict=True))
    bar = _has_bar(design, surface)
    kit = HardwareAssembly()
    ends = [number for axis, number in surface.edges() if axis == 0]
    for number in ends:
        end = make_end(design, surface, number)
        if number in cameras:
            centre = float(end.local(cameras[number].position_mm[None])[0, 2])
            label = "" if len(cameras) == 1 else ("_far" if number else "_near")
            own = mount(design, surface, end, centre, label=label, ring=not bar)
        else:
            own = connector(design, surface, end, bar_mm=_tip_mm(design, surface, end, bar=bar))
        kit = kit + (own.at_far(end.root_z_mm) if number else own)
    if design.hardware.adapter == "handle" and len(cameras) == len(ends):
        raise DesignError(
            "adapter-end-occupied",
            "a socket for a shaft needs an end without a camera (got hardware.adapter = "
            '"handle"); set it to "none"',
        )
    if bar and len(cameras) == len(ends):
        why = "the bar would have to be held before a camera, where its arms hide markers"
        if len(ends) == 1:
            why = "no end of a dome is free to hold the bar; glue it to the dome's inside"
        kit = kit + HardwareAssembly(left_out={"light bar": why})
    return kit


def _tip_mm(design: Design, surface: Surface, end: End, *, bar: bool) -> float:
    """Where the light bar ends inside, in the frame of the end that holds it; 0 for no bar."""
    if not bar:
        return 0.0
    near, far = bar_span_mm(design, surface)
    return end.root_z_mm - near if end.number else far - end.root_z_mm


def _sheet(design: Design, surface: Surface) -> HardwareAssembly:
    if design.hardware.adapter == "handle":
        raise DesignError(
            "adapter-on-sheet",
            'a sheet has no end for a shaft (got hardware.adapter = "handle"); set it to "none"',
        )
    (camera,) = cameras_of(design, surface)
    bar = _has_bar(design, surface)
    kit = base_and_frame(design, surface, float(camera.position_mm[2]), ring=not bar)
    if bar:
        kit = kit + HardwareAssembly(
            left_out={"light bar": "it would stand before a sheet; use a ring"}
        )
    return kit


def check_hardware(design: Design, surface: Surface) -> None:
    """Reject hardware of the design that does not fit, before anything is made.

    Default hardware that does not fit is left out later instead; no solid is built here.

    Raises
    ------
    DesignError
        With what does not fit.
    """
    if design.hardware != HardwareSection():
        make_hardware(design, surface)
