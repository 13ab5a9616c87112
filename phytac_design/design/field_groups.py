"""Which fields of a design file the parts of a sensor depend on: what a changed field invalidates.

A name is a table (``material``), a field (``wall.thickness_mm``), or one of the parts below, which
depend on more where the layout does: heights by lines of sight depend on the cameras.
"""

from collections.abc import Iterable
from typing import Any

from phytac_design.design.spec import Design

LENS = tuple(
    f"camera.{name}"
    for name in (
        "model",
        "width_px",
        "height_px",
        "focal_px",
        "focal_ratio",
        "centre_offset_px",
        "distortion",
        "ends",
        "stand_off_mm",
        "fill",
    )
)
CAMERAS = ("shape", "wall.thickness_mm", "light", *LENS)
"""Where the cameras stand and what their lenses do; they keep clear of wall and light bar."""
FEET = (
    "shape",
    "wall.thickness_mm",
    *(
        f"layout.{name}"
        for name in (
            "kind",
            "rows",
            "columns",
            "count",
            "spiral_angle_deg",
            "spiral_from",
            "row_pitch_exponent",
            "positions_csv",
            "positions",
        )
    ),
    "receptor.direction",
    "receptor.tilt_deg",
)
"""Where receptors stand, and along what."""
CLEAR = ("receptor.diameter_outer_mm", "switch.footprint_diameter_mm")
"""Scattered receptors and their switches keep clear of open edges."""
HEIGHTS = tuple(
    f"layout.{name}"
    for name in (
        "heights",
        "height_near_mm",
        "height_far_mm",
        "height_exponent",
        "sight_margin_mm",
        "sight_dent_mm",
        "sight_dent_radius_mm",
        "position_heights_mm",
    )
)
SIGHT = ("receptor.diameter_outer_mm", "receptor.band_marker_mm", *CAMERAS)
"""Heights that clear the neighbours' lines of sight."""
COLOURS = ("layout.colours", "layout.colour_pattern", "layout.position_colours")
RECEPTORS = ("feet", "tubes", "markers")
PARTS: dict[str, tuple[str, ...]] = {
    "cameras": CAMERAS,
    # What a camera looks at, besides the markers.
    "bodies": (
        "wall",
        "receptor",
        "switch.tip_diameter_mm",
        "switch.tip_recess_mm",
        "switch.stroke_mm",
        "light",
        "fixtures",
        "camera.ends",
    ),
    # The mechanical shell, besides the receptors' places and heights.
    "stiffness": (
        "wall.thickness_mm",
        "receptor.diameter_outer_mm",
        "receptor.diameter_hole_mm",
        "material",
    ),
    # All that the mechanics and the imaging of presses depend on, but the presses themselves.
    "mechanics": ("tubes", "cameras", "stiffness"),
    # The presses.
    "touch": (
        "training.force_max_N",
        "training.patch_radius_min_mm",
        "training.patch_radius_max_mm",
    ),
    "pictures": ("markers", "cameras", "bodies", "camera.noise_pixel"),
    # What trips a switch.
    "trips": ("switch.threshold_N", "switch.regions", "switch.footprint_diameter_mm"),
}


def fields_of(design: Design, names: Iterable[str]) -> tuple[str, ...]:
    """Tables and fields that these names stand for in a design, sorted, without repeats."""
    found: set[str] = set()
    for name in names:
        if name in RECEPTORS:
            found |= set(receptor_fields(design, name))
        elif name in PARTS:
            found |= set(fields_of(design, PARTS[name]))
        else:
            found.add(name)
    tables = {name for name in found if "." not in name}
    return tuple(
        sorted(name for name in found if "." not in name or name.partition(".")[0] not in tables)
    )


def receptor_fields(design: Design, name: str) -> tuple[str, ...]:
    """Fields that a design's ``feet``, ``tubes`` (with heights), ``markers`` (with colours) read.

    Where the layout is scattered, or heights follow lines of sight, they read more.
    """
    layout = design.layout
    found = [*FEET]
    if layout.kind in {"phyllotaxis", "explicit"}:
        found += CLEAR
    if name in {"tubes", "markers"}:
        found += HEIGHTS
        if layout.heights == "line-of-sight" and not layout.position_heights_mm:
            found += SIGHT
    if name == "markers":
        found += COLOURS
    return tuple(found)


def values_of(design: Design, names: Iterable[str]) -> dict[str, Any]:
    """Plain values of fields by name, for hashing."""
    fields = fields_of(design, names)
    tables = {name.partition(".")[0] for name in fields}
    data = design.model_dump(mode="json", include=tables)
    out: dict[str, Any] = {}
    for name in fields:
        table, dot, field = name.partition(".")
        out[name] = data[table][field] if dot else data[table]
    return out
