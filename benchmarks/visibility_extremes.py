"""Designs at the ends of their ranges, built as a user would: done right, or refused and why.

Each is written to a design file and built with ``phytac build --accuracy draft`` in a process of
its own, from an empty cache, with Python's warnings shown. A row counts what went wrong.
"""

import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit

from benchmarks.harness import Table

LONGEST_S = 570.0
"""A build that takes longer is stopped and counts as failed."""
MEMORY_MAX_BYTES = 12 << 30
"""Address space of a build: one that wants more fails, and leaves the machine alone."""
PROGRAM = (
    "import resource, sys; limit = int(sys.argv.pop(1)); "
    "resource.setrlimit(resource.RLIMIT_AS, (limit, limit)); "
    "from phytac_design.cli.app import main; main()"
)
SOON_S = 10.0
"""A design that cannot be built is refused within this time, Python's start counted."""
BUILT, REFUSED = 0, (2, 5)
"""Exit codes of a build that is done, and of one that is refused with a reason."""

Data = dict[str, Any]
SMALL = {"width_px": 648, "height_px": 486, "focal_px": 242.5}
BASE: Data = {
    "receptor": {"diameter_outer_mm": 2.4, "diameter_hole_mm": 1.4},
    "switch": {"footprint_diameter_mm": 4.0, "tip_diameter_mm": 1.0},
    "light": {"bar_radius_mm": 0.0},
    "camera": SMALL,
    "training": {"samples": 600, "samples_test": 100},
}
GRID: Data = {"kind": "straight", "heights": "constant", "height_near_mm": 2.0}
CYLINDER: Data = {"kind": "cylinder", "diameter_outer_mm": 40.0, "length_mm": 30.0}
SPIRAL: Data = {
    "kind": "spiral",
    "rows": 4,
    "columns": 14,
    "heights": "power",
    "height_exponent": 2.0,
    "height_near_mm": 0.8,
    "height_far_mm": 4.0,
}


@dataclass(frozen=True, kw_only=True)
class Extreme:
    """A design file's content and what must become of it.

    Attributes
    ----------
    name : str
        What is extreme about it.
    data : dict
        Tables of the design file, without its name.
    refused : str
        Pattern of the error that must come; empty for a design that must be built.
    slow : bool
        Left out of a quick run.
    command : str
        Of ``phytac``: ``build`` or ``check``.
    only : str
        Stage to build, with what it needs; all if empty.
    """

    name: str
    data: Data
    refused: str = ""
    slow: bool = True
    command: str = "build"
    only: str = ""


def scaled(data: Data, factor: float, force: float) -> Data:
    """The same sensor, every length times ``factor``, every force times ``force``."""
    out: Data = {}
    for key, value in data.items():
        if isinstance(value, dict):
            out[key] = scaled(value, factor, force)
        elif key.endswith("_mm"):
            out[key] = value * factor
        elif key.endswith("_N"):
            out[key] = value * force
        else:
            out[key] = value
    return out


def whole() -> Data:
    """A ø40 mm cylinder with every length and force that a scaled one must change, written out."""
    return BASE | {
        "shape": CYLINDER,
        "layout": SPIRAL,
        "wall": {"thickness_mm": 0.8, "rim_length_mm": 4.0, "rim_flange_mm": 1.6},
        "receptor": {"diameter_outer_mm": 2.4, "diameter_hole_mm": 1.4, "band_marker_mm": 0.5},
        "switch": {
            "footprint_diameter_mm": 4.0,
            "tip_diameter_mm": 1.0,
            "tip_recess_mm": 0.3,
            "stroke_mm": 1.5,
            "threshold_N": 0.5,
            "release_N": 0.4,
        },
        "print_rules": {"wall_min_mm": 0.4, "hole_min_mm": 0.4, "gap_min_mm": 0.3},
        "training": {
            "samples": 600,
            "samples_test": 100,
            "force_min_N": 0.5,
            "force_max_N": 10.0,
            "patch_radius_min_mm": 4.0,
            "patch_radius_max_mm": 7.0,
        },
    }


def on(shape: Data, layout: Data, **tables: Data) -> Data:
    """A design of a shape and a layout; ``tables`` change others."""
    data = BASE | {"shape": shape, "layout": layout}
    return data | {name: {**data.get(name, {}), **change} for name, change in tables.items()}


def cone(half_angle_deg: float) -> Data:
    """A cone of this half-angle, near end ø56 mm."""
    slope = math.tan(math.radians(half_angle_deg))
    length = min(36.0, 20.0 / slope)
    rows = max(int(length / math.cos(math.radians(half_angle_deg)) / 7.0), 1)
    shape = {
        "kind": "cone",
        "diameter_near_mm": 56.0,
        "diameter_far_mm": 56.0 - 2.0 * length * slope,
        "length_mm": length,
    }
    heights = {"heights": "power", "height_near_mm": 1.0, "height_far_mm": 4.0}
    return on(shape, GRID | heights | {"rows": rows, "columns": 12 if rows > 2 else 6})


def dome() -> Data:
    """A ø40 mm dome with a marker on the pole and 16 around it."""
    pole = 10.0 * math.pi
    positions = [[pole, 0.0]]
    positions += [[pole - 8.0, 2.0 * math.pi * k / 6.0] for k in range(6)]
    positions += [[pole - 16.0, 2.0 * math.pi * (k + 0.5) / 10.0] for k in range(10)]
    layout = {"kind": "explicit", "positions": positions, "heights": "constant"}
    shape = {"kind": "hemisphere", "diameter_outer_mm": 40.0, "skirt_mm": 0.0}
    return on(shape, layout | {"height_near_mm": 1.2})


def box(edge_mm: float) -> Data:
    """A box with edges of this radius, markers on its faces."""
    positions = [[z, s * 35.6 + c] for z in (8.0, 16.0, 24.0) for s in (1, 2, 3) for c in (-6, 6)]
    shape = {"kind": "cuboid", "width_mm": 36.0, "depth_mm": 36.0, "length_mm": 32.0}
    layout = {"kind": "explicit", "positions": positions, "heights": "constant"}
    return on(shape | {"edge_radius_mm": edge_mm}, layout | {"height_near_mm": 2.0})


def pad(rows: int, size_mm: float, side_px: int) -> Data:
    """A square pad of rows by rows markers before a square picture."""
    camera = {"width_px": side_px, "height_px": side_px, "focal_px": 0.75 * side_px}
    layout = GRID | {"rows": rows, "columns": rows, "colour_pattern": "checkerboard"}
    shape = {"kind": "plane", "width_mm": size_mm, "height_mm": size_mm}
    return on(shape, layout | {"height_near_mm": 1.0}, camera=camera)


def crowd() -> Data:
    """16 rows of 128 markers on a ø200 mm cylinder."""
    shape = {"kind": "cylinder", "diameter_outer_mm": 200.0, "length_mm": 110.0}
    lattice = {"rows": 16, "columns": 128, "height_exponent": 3.0, "height_far_mm": 8.0}
    camera = {"width_px": 2000, "height_px": 2000, "focal_px": 1000.0}
    return on(shape, SPIRAL | lattice, camera=camera)


def extremes() -> list[Extreme]:
    """All of them; those that are built first."""
    alone = GRID | {"rows": 1, "columns": 1}
    plate = {"kind": "plane", "width_mm": 50.0, "height_mm": 40.0}
    patch = {"kind": "patch"}
    flat = [[[x, 0.0, 0.0] for x in (0.0, 30.0)] for _ in range(2)]
    tiny, huge = scaled(whole(), 0.05, 0.05**2), scaled(whole(), 50.0, 800.0)
    strong = tiny | {"training": tiny["training"] | {"force_max_N": 10.0}}
    coincident = {"kind": "explicit", "positions": [[1.0, 1.0], [1.0, 1.0]]}
    near = [Extreme(
        name=f"camera {where} the near rim's plane",
        data=on(CYLINDER, SPIRAL, camera={"stand_off_mm": off}),
        refused=r"(stands inside|cannot see).*set camera.stand_off_mm",
        slow=off != 0.0,
    ) for where, off in (("in", 0.0), ("1e-9 mm before", 1e-9))]  # fmt: skip
    rod = {"name": "rod", "kind": "cylinder", "radius_mm": 3.0}
    run_into = [
        ("a fixture through receptors", [18.0, 0.0], r"'rod' overlaps the receptor"),
        ("a fixture through the wall", [19.8, 0.1], r"'rod' (overlaps|goes through|reaches)"),
    ]
    return [
        Extreme(
            name="cylinder of radius 1 mm",
            data=tiny,
            refused=r"no bowl stands around the hole",
        ),
        Extreme(name="cylinder of radius 1 mm, all but its switches", data=tiny, only="frames"),
        Extreme(name="cylinder of radius 1 m", data=huge),
        Extreme(name="cone, half-angle 0.5 deg", data=cone(0.5)),
        Extreme(name="cone, half-angle 89 deg", data=cone(89.0)),
        Extreme(name="hemisphere, a marker on the pole", data=dome()),
        Extreme(name="cuboid, edges 1 % thicker than the wall", data=box(0.81)),
        Extreme(name="one marker", data=on(CYLINDER, alone)),
        Extreme(name="2048 markers on a cylinder", data=crowd()),
        Extreme(
            name="10 000 markers on a plane of 0.7 m, checked only",
            data=pad(100, 700.0, 2400),
            command="check",
        ),
        Extreme(
            name="cylinder of radius 1 mm, 10 N",
            data=strong,
            only="decoder",
            refused=r"too strong for this wall",
        ),
        Extreme(
            name="cuboid, edges of radius 0",
            data=box(0.0),
            refused=r"edge_radius_mm",
            slow=False,
        ),
        Extreme(
            name="coincident markers",
            data=on(plate, coincident | {"heights": "constant", "height_near_mm": 2.0}),
            refused=r"number 0 and number 1 meet: they overlap by 2.40 mm",
            slow=False,
        ),
        Extreme(
            name="patch without area",
            data=on(patch | {"points_mm": flat}, GRID | {"rows": 2, "columns": 2}),
            refused=r"no area at some place \(got 0 mm²",
            slow=False,
        ),
        *near,
        *(
            Extreme(
                name=name,
                data=on(CYLINDER, SPIRAL)
                | {"fixtures": [rod | {"from_mm": [*at, 10.0], "to_mm": [*at, 20.0]}]},
                refused=words,
                slow=False,
            )
            for name, at, words in run_into
        ),
        Extreme(
            name="10 000 markers on a plane of 0.3 m",
            data=pad(100, 300.0, 2000),
            refused=r"less than the radius of its switch footprint",
            slow=False,
        ),
    ]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a build did: exit code, wall seconds, what it wrote to standard error, its report."""

    code: int
    seconds: float
    said: str
    report: Data
    numbers_missing: int


def build(extreme: Extreme, folder: Path) -> Outcome:
    """Build or check it in a process of its own, from an empty cache."""
    file, out = folder / "extreme.toml", folder / "out"
    file.write_text(tomlkit.dumps({"name": "extreme", **extreme.data}), encoding="utf-8")
    words = [extreme.command, str(file)]
    if extreme.command == "build":
        words += ["--out", str(out), "--accuracy", "draft"]
    if extreme.only:
        words += ["--only", extreme.only]
    start = time.perf_counter()
    try:
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, str(MEMORY_MAX_BYTES), *words],
            env={**os.environ, "PHYTAC_CACHE": str(folder / "cache")},
            capture_output=True,
            text=True,
            check=False,
            timeout=LONGEST_S,
        )
    except subprocess.TimeoutExpired:
        return Outcome(
            code=-1, seconds=LONGEST_S, said="stopped: too slow", report={}, numbers_missing=0
        )
    seconds = time.perf_counter() - start
    report, bad = {}, 0
    for path in sorted(out.rglob("*.json")):
        text = path.read_text(encoding="utf-8")
        bad += len(re.findall(r"\bNaN\b", text))
        if path.name == "report.json":
            report = json.loads(text)
    return Outcome(
        code=done.returncode,
        seconds=seconds,
        said=done.stderr,
        report=report,
        numbers_missing=bad,
    )


def faults(extreme: Extreme, got: Outcome) -> list[str]:
    """What is wrong with an outcome, in words."""
    found = []
    if "Traceback" in got.said:
        found.append("a traceback")
    warned = len(re.findall(r"\w+Warning:", got.said))
    if warned:
        found.append(f"{warned} warnings")
    if got.numbers_missing:
        found.append(f"{got.numbers_missing} NaN in its files")
    if not extreme.refused:
        if got.code != BUILT:
            found.append(f"exit code {got.code}: {last_line(got.said)}")
        return found
    if got.code not in REFUSED:
        found.append(f"not refused (exit code {got.code})")
    elif not re.search(extreme.refused, got.said):
        found.append(f"another reason than expected: {last_line(got.said)}")
    if got.seconds > SOON_S:
        found.append(f"refused after {got.seconds:.0f} s only")
    return found


def last_line(said: str) -> str:
    """Last line of an output, short."""
    lines = [line for line in said.strip().splitlines() if line.strip()]
    return lines[-1][:300] if lines else "nothing"


def add_rows(table: Table, *, quick: bool) -> None:
    """One row per extreme: faults found; its note says what it did."""
    for extreme in extremes():
        if quick and extreme.slow:
            continue
        with tempfile.TemporaryDirectory() as folder:
            got = build(extreme, Path(folder))
        wrong = faults(extreme, got)
        if extreme.refused:
            did = f"refused after {got.seconds:.1f} s: {last_line(got.said)}"
        else:
            done = "built" if extreme.command == "build" else "checked"
            did = f"{done} in {got.seconds:.0f} s{accuracy_of(got.report)}"
        table.add(
            f"extreme: {extreme.name}",
            len(wrong),
            "faults",
            reference=0,
            source="`phytac build --accuracy draft`: no traceback, no warning, no NaN; refusals "
            f"within {SOON_S:g} s",
            target="== 0",
            note=f"{'; '.join(wrong)}; {did}" if wrong else did,
        )


def accuracy_of(report: Data) -> str:
    """Markers and error of the decoder on contacts it was not trained on, for a note."""
    if not report:
        return ""
    count = report["markers"]["count"]
    got = report["decoder"].get("koi_inverse", {})
    error, share = got.get("mae_N"), got.get("relative_error")
    said = "" if error is None or share is None else f", force error {error:.3g} N, {share:.0%}"
    return f": {count} markers{said} (simulated)"
