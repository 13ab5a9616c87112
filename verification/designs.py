"""A small sensor of each surface family, and a design made from it by changes."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_shapes import Surface
from phytac_shapes.errors import DesignError

Data = dict[str, Any]

SHAPES: dict[str, Data] = {
    "cylinder": {"diameter_outer_mm": 40.0, "length_mm": 30.0},
    "cone": {"diameter_near_mm": 40.0, "diameter_far_mm": 30.0, "length_mm": 30.0},
    "plane": {"width_mm": 50.0, "height_mm": 40.0},
    "cuboid": {"width_mm": 36.0, "depth_mm": 36.0, "length_mm": 32.0, "edge_radius_mm": 6.0},
    "hemisphere": {"diameter_outer_mm": 40.0, "skirt_mm": 6.0},
    "grip": {"diameters_mm": [40.0, 44.0, 40.0], "length_mm": 36.0},
    "patch": {
        "points_mm": [
            [[x, y, -0.004 * (x * x + y * y)] for x in (-25.0, 0.0, 25.0)]
            for y in (-20.0, 0.0, 20.0)
        ]
    },
}
"""Sizes of one sensor of each family."""
AROUND = ("cylinder", "cone", "cuboid", "hemisphere", "grip")
"""Families that close around the axis."""


def base(shape: str) -> Data:
    """A thin-tubed sensor of a family with about thirty markers, before a 648×486 camera."""
    layout: Data = {"kind": "straight", "rows": 3, "columns": 8}
    if shape in ("plane", "patch"):
        layout |= {"rows": 4, "columns": 5, "colour_pattern": "checkerboard"}
    if shape == "hemisphere":
        layout = {"kind": "phyllotaxis", "count": 24}
    return {
        "name": f"extreme-{shape}",
        "shape": {"kind": shape, **SHAPES[shape]},
        "layout": layout | {"heights": "constant", "height_near_mm": 2.0},
        "receptor": {"diameter_outer_mm": 2.4, "diameter_hole_mm": 1.4},
        "switch": {"footprint_diameter_mm": 4.0, "tip_diameter_mm": 1.0},
        "light": {"bar_radius_mm": 0.0},
        "camera": {"width_px": 648, "height_px": 486, "focal_px": 242.5},
        "training": {"samples": 30, "samples_test": 10},
    }


def changed(data: Mapping[str, Any], changes: Mapping[str, Any]) -> Data:
    """Design data with some fields changed; a table of another kind takes the old one's place."""
    out = dict(data)
    for table, change in changes.items():
        old = out.get(table)
        if isinstance(old, Mapping) and isinstance(change, Mapping):
            same = change.get("kind", old.get("kind")) == old.get("kind")
            out[table] = {**old, **change} if same or table != "shape" else dict(change)
        else:
            out[table] = change
    return out


def design_of(values: Mapping[str, Any]) -> Design:
    """Design of a case: the base of ``values["shape"]`` with ``values["changes"]``."""
    data = changed(base(values["shape"]), values.get("changes", {}))
    return parse_design(data, str(data["name"]))


LENGTHS = ("_mm",)
SQUARED = ("threshold_N", "release_N", "force_min_N", "force_max_N")
"""Forces grow with the square of a sensor's size, so that its strains stay."""


def scaled(data: Any, factor: float) -> Any:
    """Design data with all lengths multiplied by a factor, forces by its square."""
    if not isinstance(data, Mapping):
        return data
    out: Data = {}
    for key, value in data.items():
        if isinstance(value, Mapping):
            out[key] = scaled(value, factor)
        elif key.endswith(LENGTHS):
            out[key] = _times(value, factor)
        elif key in SQUARED:
            out[key] = _times(value, factor**2)
        else:
            out[key] = value
    return out


APART = ("mold", "bench", "kit", "hardware")
"""Tables of parts that do not grow with the sensor."""


def sized(design: Design, factor: float) -> Design | None:
    """Design with the sensor, its print rules and its camera's place scaled.

    None where that leaves a range of the design file.
    """
    data = design.model_dump(mode="json")
    for table in APART:
        del data[table]
    try:
        return parse_design(scaled(data, factor), design.name)
    except DesignError:
        return None


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, list | tuple):
        return [_times(item, factor) for item in value]
    return factor * value if isinstance(value, int | float) else value


def numbers_of(surface: Surface) -> dict[str, Any]:
    """What a surface was made of, by name; every family is a dataclass."""
    family: Any = surface
    return {item.name: getattr(surface, item.name) for item in fields(family)}
