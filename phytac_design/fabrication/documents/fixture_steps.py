"""Steps of mounting camera, light and connectors, from what the hardware stage reports."""

from collections.abc import Mapping
from typing import Any

from phytac_design.design.spec import Design


def fixture_steps(design: Design, hardware: Mapping[str, Any]) -> list[str]:
    """Steps in order; without built-in hardware, the requirements on the user's own.

    Parameters
    ----------
    hardware : mapping
        Facts of the hardware stage: ``parts``, ``joints``.
    """
    ends = " and ".join(("near", "far")[end] for end in design.camera.end_numbers)
    camera = (
        f"Put the camera before the {ends} end, its lens on the axis; a polarising film before "
        "it, crossed to the one on the light, takes glints away."
    )
    bar = design.light.bar_radius_mm
    light = (
        f"Stick the LED strip around the light bar (radius {bar:g} mm in all) with double-sided "
        "tape, polarising film over it; it lies on the axis."
        if bar > 0.0
        else "Put the ring of LEDs around the camera's lens, polarising film over it."
    )
    parts = [part for part in hardware.get("parts", []) if part["file"]]
    if not parts:
        why = hardware.get("hardware_left_out", "")
        own = f"No holders of ours ({why}): use your own." if why else "Use holders of your own."
        return [own, light, camera, "Close both ends: no light from outside."]
    printed = ", ".join(part["file"] for part in parts)
    joints = [
        f"{joint['joint']}: {joint['count']} × {joint['size']} × {joint['length_mm']:g} mm "
        f"({joint['thread']})."
        for joint in hardware.get("joints", [])
    ]
    return [
        f"Print {printed}; tap the holes or set the inserts before assembly.",
        light,
        camera,
        (
            "Rim and socket are round: turn the shell until `phytac decode` finds every marker in "
            "a frame at rest, then tighten. Where the markers repeat around, mark column 0 "
            "(paint map) on shell and mount first: a frame cannot distinguish those turns."
        ),
        *(f"Screw {joint}" for joint in joints),
        "Look into the dark sensor beside a lamp: no light from outside may show.",
    ]
