"""Small designs for tests."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design, parse_design
from phytac_design.design.spec import Design

CAMERA: dict[str, Any] = {"width_px": 432, "height_px": 324, "focal_px": 161.0}
FINE_CAMERA: dict[str, Any] = {"width_px": 1296, "height_px": 972, "focal_px": 485.0}
"""For what is judged by parts of a pixel."""
COARSE = replace(
    PRESETS["draft"],
    frames=1,
    sample_share=0.01,
    press_places=1,
    refine=2,
    truth_refine=3,
    place_share=1.5,
    cad_tolerance_mm=0.2,
    step=True,
    tools=True,
)
"""The least accuracy: for what does not depend on how well anything is computed."""
QUICK = replace(PRESETS["draft"], tools=True)
"""A draft with all that a sensor is made with."""


def changed(base: str = "cylinder60", **tables: Any) -> Design:
    """A shipped design with some fields changed."""
    data = load_design(base).model_dump(mode="json")
    for name, change in tables.items():
        data[name] = {**data[name], **change} if isinstance(change, dict) else change
    return parse_design(data, "test design")


def small(**tables: Any) -> Design:
    """ø60 × 60, 8 rows × 14 columns, an 864×648 camera, little data: builds in seconds."""
    base: dict[str, Any] = {
        "name": "small",
        "shape": {"length_mm": 60.0},
        "layout": {"rows": 8, "columns": 14, "height_far_mm": 6.0},
        "camera": {"width_px": 864, "height_px": 648, "focal_px": 323.3},
        "training": {"samples": 120, "samples_test": 60},
    }
    for name, change in tables.items():
        base[name] = {**base.get(name, {}), **change} if isinstance(change, dict) else change
    return changed(**base)


def tiny(**tables: Any) -> Design:
    """Sixteen markers before a small camera; with ``COARSE``, for what needs every stage."""
    base: dict[str, Any] = {
        "shape": {"length_mm": 24.0},
        "layout": {"rows": 2, "columns": 8, "height_far_mm": 4.0},
        "camera": CAMERA,
        "training": {"samples": 40, "samples_test": 20},
    }
    for name, change in tables.items():
        base[name] = {**base.get(name, {}), **change} if isinstance(change, dict) else change
    return small(**base)


def fused() -> Design:
    """Few markers in straight rows, of which some fuse in the camera."""
    layout = {"kind": "straight", "rows": 12, "columns": 3, "height_far_mm": 2.0}
    return small(name="one", layout=layout, camera=CAMERA)


def of_shape(kind: str, shape: dict[str, Any], layout: dict[str, Any], **tables: Any) -> Design:
    """A thin-tubed sensor of any family with no light bar, before an 864×648 camera."""
    data: dict[str, Any] = {
        "name": f"drawn-{kind}",
        "shape": {"kind": kind, **shape},
        "layout": layout,
        "receptor": {"diameter_outer_mm": 2.4, "diameter_hole_mm": 1.4},
        "switch": {"footprint_diameter_mm": 4.0, "tip_diameter_mm": 1.0},
        "light": {"bar_radius_mm": 0.0},
        "camera": {"width_px": 864, "height_px": 648, "focal_px": 323.0},
        "training": {"samples": 30, "samples_test": 10},
    }
    for name, change in tables.items():
        data[name] = {**data.get(name, {}), **change}
    return parse_design(data, f"drawn {kind}")


PITCH_MM = 8.0
"""About how far the markers of drawn designs are apart: a switch trips under a marker's cell."""
AROUND: dict[str, Any] = {"heights": "power", "height_exponent": 2.0, "height_near_mm": 0.8}
"""Convex heights: the far receptors of a shape that closes around keep their line of sight."""


def _around(
    rng: np.random.Generator, length_mm: float, girth_mm: float, far_mm: float
) -> dict[str, Any]:
    """Rows and columns, an even number, that are ``PITCH_MM`` apart; spiral or straight."""
    return AROUND | {
        "kind": str(rng.choice(["spiral", "straight"])),
        "rows": max(int(length_mm / PITCH_MM), 2),
        "columns": 2 * int(girth_mm / PITCH_MM / 2.0),
        "height_far_mm": far_mm,
    }


def _cylinder(rng: np.random.Generator) -> Design:
    size, length = rng.uniform(30.0, 44.0), rng.uniform(24.0, 40.0)
    shape = {"diameter_outer_mm": size, "length_mm": length}
    return of_shape("cylinder", shape, _around(rng, length, np.pi * size, 4.0))


def _cone(rng: np.random.Generator) -> Design:
    near, length = rng.uniform(36.0, 46.0), rng.uniform(24.0, 36.0)
    shape = {
        "diameter_near_mm": near,
        "diameter_far_mm": near * rng.uniform(0.7, 0.85),
        "length_mm": length,
    }
    return of_shape("cone", shape, _around(rng, length, 2.2 * near, 3.0))


def _cuboid(rng: np.random.Generator) -> Design:
    width, depth, length = rng.uniform(30.0, 40.0), rng.uniform(30.0, 40.0), rng.uniform(24.0, 36.0)
    edge = rng.uniform(6.0, 9.0)
    shape = {"width_mm": width, "depth_mm": depth, "length_mm": length, "edge_radius_mm": edge}
    return of_shape("cuboid", shape, _around(rng, length, 2.0 * (width + depth) - 12.0, 2.5))


def _grip(rng: np.random.Generator) -> Design:
    size, length = rng.uniform(34.0, 42.0), rng.uniform(32.0, 44.0)
    shape = {"diameters_mm": (size * rng.uniform(0.93, 1.07, 4)).tolist(), "length_mm": length}
    return of_shape("grip", shape, _around(rng, length, 2.9 * size, 4.0))


def _hemisphere(rng: np.random.Generator) -> Design:
    size = rng.uniform(30.0, 40.0)
    shape = {"diameter_outer_mm": size, "skirt_mm": float(rng.choice([0.0, rng.uniform(4.0, 8.0)]))}
    area = np.pi * size * (size / 2.0 + shape["skirt_mm"])
    layout = {"kind": "phyllotaxis", "count": int(area / PITCH_MM**2)}
    return of_shape("hemisphere", shape, layout | {"heights": "constant", "height_near_mm": 1.2})


def _sheet(rng: np.random.Generator, width_mm: float, height_mm: float) -> dict[str, Any]:
    kind = str(rng.choice(["straight", "phyllotaxis"]))
    rows, columns = int(height_mm / PITCH_MM), int(width_mm / PITCH_MM)
    return {
        "kind": kind,
        "colour_pattern": "checkerboard",
        "rows": rows,
        "columns": columns,
        "count": int(0.8 * rows * columns),
        "heights": "constant",
        "height_near_mm": 2.5,
    }


def _plane(rng: np.random.Generator) -> Design:
    width, height = rng.uniform(44.0, 64.0), rng.uniform(36.0, 50.0)
    shape = {"width_mm": width, "height_mm": height, "tilt_deg": rng.uniform(-10.0, 10.0)}
    return of_shape("plane", shape, _sheet(rng, width, height), camera={"focal_px": 233.0})


def _patch(rng: np.random.Generator) -> Design:
    width, height, rise = rng.uniform(44.0, 64.0), rng.uniform(36.0, 50.0), rng.uniform(0.5, 4.0)
    x, y = width * np.linspace(-0.5, 0.5, 4), height * np.linspace(-0.5, 0.5, 4)
    points = [
        [
            [float(a), float(b), float(rise * (2.0 - (2 * a / width) ** 2 - (2 * b / height) ** 2))]
            for a in x
        ]
        for b in y
    ]
    layout = _sheet(rng, width, height)
    return of_shape("patch", {"points_mm": points}, layout, camera={"focal_px": 233.0})


DRAWN: dict[str, Callable[[np.random.Generator], Design]] = {
    "cylinder": _cylinder,
    "cone": _cone,
    "cuboid": _cuboid,
    "grip": _grip,
    "hemisphere": _hemisphere,
    "plane": _plane,
    "patch": _patch,
}


def drawn(kind: str, seed: int) -> Design:
    """A whole small design of a family, its sizes and layout drawn at random: 20 to 80 markers."""
    return DRAWN[kind](np.random.default_rng(seed))
