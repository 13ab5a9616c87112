"""Whole designs at the ends of their ranges: checked and built as a user would, or rejected.

Builds run as ``phytac build --accuracy draft`` in a process of their own, from an empty cache, with
Python's warnings shown: no traceback, no warning, no NaN in the files.
"""

import json
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import load_bundle
from phytac_design.design.design_file import to_toml
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import camera_of, tolerance_mm
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import build_scene, paint_owner
from phytac_design.rules.check import check_design
from phytac_design.rules.design_review import checkup
from phytac_design.stages.build import build
from phytac_design.stages.decoder_stage import limit_facts
from verification.case import Case, Cases, Evidence, Recorder, verify
from verification.designs import SHAPES, base, changed, design_of, scaled

LIMIT_S = 600.0
"""Of a case of this module."""
GRID: dict[str, Any] = {"kind": "straight", "heights": "constant", "height_near_mm": 2.0}
SPIRAL = GRID | {"kind": "spiral", "heights": "power", "height_exponent": 2.0}
SPIRAL |= {"rows": 4, "columns": 14, "height_near_mm": 0.8, "height_far_mm": 4.0}


def cone(half_angle_deg: float) -> dict[str, Any]:
    """Changes that make a cone of this half-angle, near end ø56 mm."""
    slope = math.tan(math.radians(half_angle_deg))
    length = min(36.0, 20.0 / slope)
    rows = max(int(length / math.cos(math.radians(half_angle_deg)) / 7.0), 1)
    shape = {"diameter_near_mm": 56.0, "diameter_far_mm": 56.0 - 2.0 * length * slope}
    heights = {"heights": "power", "height_near_mm": 1.0, "height_far_mm": 4.0}
    layout = GRID | heights | {"rows": rows, "columns": 12 if rows > 2 else 6}
    return {"shape": shape | {"length_mm": length}, "layout": layout}


def dome(*, ring: bool = True) -> dict[str, Any]:
    """Changes that put a marker on the pole of a ø40 mm dome, 16 around it or none."""
    pole = 10.0 * math.pi
    around = [[pole - 8.0, 2.0 * math.pi * k / 6.0] for k in range(6)]
    around += [[pole - 16.0, 2.0 * math.pi * (k + 0.5) / 10.0] for k in range(10)]
    positions = [[pole, 0.0], *(around if ring else [])]
    layout = GRID | {"kind": "explicit", "positions": positions, "height_near_mm": 1.2}
    return {"shape": {"skirt_mm": 0.0}, "layout": layout}


def on_faces(edge_mm: float) -> dict[str, Any]:
    """Changes that make a box with edges of this radius, markers on its faces."""
    places = [[z, s * 35.6 + c] for z in (8.0, 16.0, 24.0) for s in (1, 2, 3) for c in (-6.0, 6.0)]
    layout = GRID | {"kind": "explicit", "positions": places}
    return {"shape": {"edge_radius_mm": edge_mm}, "layout": layout}


def pad(rows: int, size_mm: float, side_px: int) -> dict[str, Any]:
    """Changes that make a square pad of rows by rows markers before a square image."""
    layout = GRID | {"rows": rows, "columns": rows, "colour_pattern": "checkerboard"}
    return {
        "camera": {"width_px": side_px, "height_px": side_px, "focal_px": 0.75 * side_px},
        "layout": layout | {"height_near_mm": 1.0},
        "shape": {"width_mm": size_mm, "height_mm": size_mm},
    }


def check_report(values: Mapping[str, Any], found: Evidence) -> None:
    """Report of ``phytac check``: every figure a number, all markers visible or hidden."""
    report = checkup(design_of(values))
    found.true("no NaN in the report", "NaN" not in json.dumps(report))
    hidden = report["markers"]["count"] if values.get("hidden") else 0
    if hidden or values.get("clear", True):
        found.true(f"{hidden} markers hidden", report["visibility"]["occluded"] == hidden)
    if report["markers"]["count"] == 1:
        found.true("no second marker, no gap", report["visibility"]["min_gap_px"] == math.inf)


def check_crowd(values: Mapping[str, Any], found: Evidence) -> None:
    """Layout, rules and exact map of 10 000 markers: each shows where it projects to."""
    design = design_of(values)
    sensor = check_design(design)
    markers = sensor.markers
    view = camera_of(design, sensor.surface)
    scene = build_scene(sensor, tolerance_mm=tolerance_mm(view, markers))
    owner = paint_owner(rasterise(scene, view).part)
    y, x = np.nonzero(owner >= 0)
    number = np.bincount(owner[y, x], minlength=markers.count)
    found.true("every marker shows", number >= 3)
    mean = np.column_stack([np.bincount(owner[y, x], weights=c) / number for c in (x, y)])
    # The next marker is 14 px away.
    found.add("projection of the tips, px", mean - view.project(markers.tip_mm), 2.0)


def check_pole(values: Mapping[str, Any], found: Evidence) -> None:
    """A marker whose normal is the camera's axis is read by its neighbours."""
    design = design_of(values)
    quiet = {"accuracy": "draft", "progress": lambda _: None}
    with tempfile.TemporaryDirectory() as folder:
        built = build(design, Path(folder), only=["decoder"], **quiet)  # type: ignore[arg-type]
        bundle = load_bundle(built.out / "decoder")
    markers = make_markers(design, design.surface())
    pole = int(np.argmax(markers.mid_mm[:, 2]))
    found.add("the marker lies on the axis, mm", np.hypot(*markers.mid_mm[pole, :2]), 1e-9)
    limits = limit_facts(bundle)
    usable = bundle.stiffness_usable[pole] or bundle.tips.readable[pole]
    listed = pole in limits["switches_unreadable"] and pole in limits["fem_unusable"]
    found.true("K·u and the switch's colour are known to be unusable", listed and not usable)
    force = np.zeros(markers.count)
    force[pole] = 6.0
    shift = (bundle.model.compliance_px @ force).reshape(-1, 2)
    forces = bundle.model.forces("koi_inverse", shift, np.array([pole]))
    found.add("the force that made the shifts", forces[pole] / 6.0 - 1.0, 1e-6)
    noise = bundle.model.inverse_noise_N_px
    found.true("it has the largest noise of all", noise[pole] == noise.max())


def check_build(values: Mapping[str, Any], found: Evidence) -> None:
    """A design built by the command line, or rejected with the expected message in time."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        design = design_of(values)
        (folder / "extreme.toml").write_text(to_toml(design), encoding="utf-8")
        words = ["build", "extreme.toml", "--out", "out", "--accuracy", "draft", *values["words"]]
        done = subprocess.run(
            [sys.executable, "-m", "phytac_design", *words],
            env=os.environ | {"PHYTAC_CACHE": str(folder / "cache")},
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=LIMIT_S,
        )
        texts = [path.read_text("utf-8") for path in (folder / "out").rglob("*.json")]
    found.true("no traceback", "Traceback" not in done.stderr)
    found.true("no warning", not re.search(r"\w+Warning:", done.stderr))
    found.true("no NaN in the files", not any(re.search(r"\bNaN\b", text) for text in texts))
    if values["message"]:
        found.true(f"rejected: {done.stderr[-300:]}", re.search(values["message"], done.stderr))
        found.true("with the exit code of a rejected input", done.returncode in (2, 5))
    else:
        found.true(f"built: {done.stderr[-300:]}", done.returncode == 0)


def cases() -> Cases:
    """Designs that are only checked; those that are built in part; those that are built whole."""
    out = Cases()
    for shape in SHAPES:
        one = {"layout": GRID | {"rows": 1, "columns": 1}}
        out.add_design(shape, "one marker, checked", check_report, one)
    for angle in (0.5, 30.0, 60.0, 89.0):
        out.add_design("cone", f"half-angle {angle:g}°", check_report, cone(angle))
    wide = {"diameter_near_mm": 12.0, "diameter_far_mm": 56.0, "length_mm": 4.0}
    away = {"shape": wide, "layout": GRID | {"rows": 3, "columns": 6}}
    out.add_design("cone", "a wall that faces away", check_report, away, hidden=True)
    out.add_design("cuboid", "edges as sharp as the wall", check_report, on_faces(0.81))
    edge = on_faces(0.81)
    edge["layout"] |= {"positions": [[16.0, 18.0 - 0.81 + 0.81 * math.pi / 4.0]]}
    out.add_design("cuboid", "a marker on a sharp edge", check_report, edge, "refused")
    rod = {"name": "rod", "kind": "cylinder", "radius_mm": 3.0}
    for part, at in (("receptors", [18.0, 0.0]), ("the wall", [19.8, 0.1])):
        fixture = rod | {"from_mm": [*at, 10.0], "to_mm": [*at, 20.0]}
        through = {"layout": SPIRAL, "fixtures": [fixture]}
        name = f"a fixture through {part}"
        out.add_design("cylinder", name, check_report, through, "refused")
    dense = pad(100, 300.0, 2000)
    out.add_design("plane", "10 000 markers on 0.3 m", check_report, dense, "refused")
    out.add_design("plane", "10 000 markers on 0.7 m", check_crowd, pad(100, 700.0, 2400))
    out.add_design("hemisphere", "a marker on the pole", check_pole, dome())
    return out


CASES = cases()


@CASES.parametrize
def test_checks(case: Case, record_property: Recorder) -> None:
    """Designs at the ends of their ranges: checked, or rejected."""
    verify(case, record_property)


def sized(factor: float, force: float, **training: float) -> dict[str, Any]:
    """Changes that scale a cylinder: lengths by ``factor``, forces by ``force``."""
    data = changed(base("cylinder"), {"layout": SPIRAL})
    numbers = {
        "wall": {"thickness_mm": 0.8, "rim_length_mm": 4.0, "rim_flange_mm": 1.6},
        "receptor": {"band_marker_mm": 0.5},
        "switch": {"tip_recess_mm": 0.3, "stroke_mm": 1.5, "threshold_N": 0.5, "release_N": 0.4},
        "print_rules": {"wall_min_mm": 0.4, "hole_min_mm": 0.4, "gap_min_mm": 0.3},
        "training": {"force_min_N": 0.5, "force_max_N": 10.0}
        | {"patch_radius_min_mm": 4.0, "patch_radius_max_mm": 7.0},
    }
    out = scaled(changed(data, numbers), factor)
    for table, field in (("switch", "threshold_N"), ("switch", "release_N")):
        out[table][field] = numbers[table][field] * force
    for field in ("force_min_N", "force_max_N"):
        out["training"][field] = numbers["training"][field] * force
    out["training"] |= training
    return {name: table for name, table in out.items() if isinstance(table, dict)}


def builds() -> Cases:
    """Designs for the command line."""
    out = Cases()

    def add(shape: str, name: str, changes: Any, message: str = "", *words: str) -> None:
        samples = {"samples": 600, "samples_test": 100}
        changes = changes | {"training": samples | changes.get("training", {})}
        expected = {"message": message, "words": words}
        out.add_design(shape, name, check_build, changes, "right", **expected)

    tiny = sized(0.05, 0.05**2)
    add("cylinder", "radius 1 mm", tiny, r"no bowl stands around the hole")
    add("cylinder", "radius 1 mm, all but its switches", tiny, "", "--only", "frames")
    strong = sized(0.05, 0.05**2, force_max_N=10.0)
    add("cylinder", "radius 1 mm, 10 N", strong, r"too strong for this wall", "--only", "decoder")
    add("cylinder", "radius 1 m", sized(50.0, 800.0))
    add("cone", "half-angle 0.5°", cone(0.5))
    add("cone", "half-angle 89°", cone(89.0))
    add("hemisphere", "a marker on the pole", dome())
    lone = r"moves no marker's image.*place more markers beside"
    add("hemisphere", "a lone marker on the pole", dome(ring=False), lone, "--only", "response")
    add("cuboid", "edges 1 % thicker than the wall", on_faces(0.81))
    add("cylinder", "one marker", {"layout": GRID | {"rows": 1, "columns": 1}})
    crowd = {"rows": 16, "columns": 128, "height_exponent": 3.0, "height_far_mm": 8.0}
    large = {"width_px": 2000, "height_px": 2000, "focal_px": 1000.0}
    shape = {"diameter_outer_mm": 200.0, "length_mm": 110.0}
    many = {"shape": shape, "layout": SPIRAL | crowd, "camera": large}
    add("cylinder", "2048 markers", many)
    return out


BUILDS = builds()


@BUILDS.parametrize
def test_builds(case: Case, record_property: Recorder) -> None:
    """Designs at the ends of their ranges: built by the command line, or rejected."""
    verify(case, record_property)
