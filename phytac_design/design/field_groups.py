"""Which fields of a design file the parts of a sensor depend on: what a changed field invalidates.

A name is a table (``material``), a field (``wall.thickness_mm``), or one of the parts below, which
depend on more where the layout does: heights by lines of sight depend on the cameras.
"""

from collections.abc import Iterable
from typing import Any

from phytac_design.design.spec import Design

TUBE = (
    "receptor.colouring",
    "receptor.diameter_outer_mm",
    "receptor.gap_insert_mm",
    "receptor.thickness_tube_mm",
)
"""What the outer diameter of tubes depends on."""
RECEPTORS = ("bases", "tubes", "markers", "stiffness")
PARTS: dict[str, tuple[str, ...]] = {
    "lens": (
        "camera.model",
        "camera.width_px",
        "camera.height_px",
        "camera.focal_px",
        "camera.focal_ratio",
        "camera.centre_offset_px",
        "camera.distortion",
        "camera.ends",
        "camera.stand_off_mm",
        "camera.fill",
    ),
    # Where the cameras stand and what their lenses do; they keep clear of wall and light bar, and
    # see the reference marks.
    "cameras": ("shape", "wall.thickness_mm", "light", "lens", "reference_marks"),
    # Where receptors stand, and along what.
    "places": (
        "shape",
        "wall.thickness_mm",
        "layout.kind",
        "layout.rows",
        "layout.columns",
        "layout.count",
        "layout.spiral_angle_deg",
        "layout.spiral_from",
        "layout.row_pitch_exponent",
        "layout.positions_csv",
        "layout.positions",
        "receptor.direction",
        "receptor.tilt_deg",
    ),
    "heights": (
        "layout.heights",
        "layout.height_near_mm",
        "layout.height_far_mm",
        "layout.height_exponent",
        "layout.sight_margin_mm",
        "layout.sight_dent_mm",
        "layout.sight_dent_radius_mm",
        "layout.position_heights_mm",
    ),
    "colours": ("layout.colours", "layout.colour_pattern", "layout.position_colours"),
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
        "paints",
    ),
    # The mechanical shell, besides the receptors' places and heights.
    "stiffness": (
        "wall.thickness_mm",
        *TUBE,
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
}


def fields_of(design: Design, names: Iterable[str]) -> tuple[str, ...]:
    """Tables and fields that these names stand for in a design, sorted, without repeats.

    ``bases``, ``tubes`` (with heights) and ``markers`` (with colours) are the receptors, ``trips``
    is what trips a switch.
    """
    found: set[str] = set()
    for name in names:
        if name in RECEPTORS:
            parts: tuple[str, ...] | None = receptor_parts(design, name)
        else:
            parts = trip_parts(design) if name == "trips" else PARTS.get(name)
        found |= {name} if parts is None else set(fields_of(design, parts))
    tables = {name for name in found if "." not in name}
    return tuple(
        sorted(name for name in found if "." not in name or name.partition(".")[0] not in tables)
    )


def receptor_parts(design: Design, name: str) -> tuple[str, ...]:
    """Parts and fields that a design's receptors or their stiffness (``RECEPTORS``) depend on.

    Where the layout is scattered, or heights follow lines of sight, they depend on more; so does
    the stiffness of tubes that end before the coloured band.
    """
    layout = design.layout
    if name == "stiffness":
        band = ("receptor.band_marker_mm",) if design.receptor.has_inserts else ()
        return (*PARTS[name], *band)
    found = ["places"]
    if layout.kind in {"phyllotaxis", "explicit"}:
        # Scattered receptors and their switches keep clear of open edges.
        found += [*TUBE, "switch.footprint_diameter_mm"]
    if name in {"tubes", "markers"}:
        found.append("heights")
        if layout.heights == "line-of-sight" and not layout.position_heights_mm:
            # They clear the neighbours' lines of sight.
            found += [*TUBE, "receptor.band_marker_mm", "cameras"]
    if name == "markers":
        found.append("colours")
    return tuple(found)


def trip_parts(design: Design) -> tuple[str, ...]:
    """Parts and fields that the force depends on at which the camera sees a switch as on.

    A bowl snaps at its threshold. Other families are solved, and seen by the camera as their tips
    come out.
    """
    if design.switch.family == "bowl":
        trips = ("family", "threshold_N", "regions", "footprint_diameter_mm")
        return tuple(f"switch.{name}" for name in trips)
    mold = ("mold.draft_deg", "print_rules.gap_min_mm", "print_rules.wall_min_mm")
    return ("switch", *mold, "markers", "cameras", "bodies")


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
