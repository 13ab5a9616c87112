"""Small designs for tests."""

from typing import Any

from phytac_design.design_file import load_design, parse_design
from phytac_design.spec import Design


def changed(base: str = "cylinder60", **tables: Any) -> Design:
    """A shipped design with some fields changed."""
    data = load_design(base).model_dump(mode="json")
    for name, change in tables.items():
        data[name] = {**data[name], **change} if isinstance(change, dict) else change
    return parse_design(data, "test design")


def small(**tables: Any) -> Design:
    """ø60 × 60, 8 rows × 14 columns, a 1296×972 camera, little data: builds in seconds."""
    base: dict[str, Any] = {
        "name": "small",
        "shape": {"length_mm": 60.0},
        "layout": {"rows": 8, "columns": 14, "height_far_mm": 6.0},
        "camera": {"width_px": 1296, "height_px": 972, "focal_px": 485.0},
        "training": {"samples": 120, "samples_test": 60},
    }
    for name, change in tables.items():
        base[name] = {**base.get(name, {}), **change} if isinstance(change, dict) else change
    return changed(**base)
