"""Papers for the bench and the calibration kit, measured on the files of a build."""

import csv
import io
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.document_measurements import (
    fit_shift_mm,
    in_sensor,
    rasterise_pdf,
    read_gcode,
    red_centres_mm,
    tick_places_mm,
    tool_axis,
)
from benchmarks.fabrication_outside import repair_row
from benchmarks.harness import Table
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.fabrication.calibration_rig.program import make_program
from phytac_design.fabrication.calibration_rig.regions import Regions, frames_at, make_regions
from phytac_design.fabrication.calibration_rig.symmetry import find_symmetry
from phytac_design.fabrication.documents.densities import DENSITY_g_cm3
from phytac_design.fabrication.documents.unroll import unroll
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_export import read_stl
from phytac_design.stages.build import build
from phytac_shapes import Surface

SAMPLES = 9
"""Places on each straight move of the program that are looked at."""


def rows_of(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file."""
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))


def map_rows(table: Table, design: Design, out: Path) -> None:
    """Paint map as poppler prints it."""
    surface = design.surface()
    markers = make_markers(design, surface)
    flat = unroll(surface)
    name = design.name
    if shutil.which("pdftoppm") is None:
        print(f"{name}: pdftoppm is not on PATH; the paint map is not measured")
        return
    with tempfile.TemporaryDirectory() as folder:
        page = rasterise_pdf(out / "bench/paint_map.pdf", Path(folder), last=1)[0]
    ticks = tick_places_mm(page)
    whole = float(np.abs((ticks - ticks[0])[:, None] - 10.0 * np.arange(len(ticks))).min(1).max())
    error = max(whole, float(np.abs(np.diff(ticks) - 10.0).max()))
    source = "400 dpi by pdftoppm, page 1"
    row = f"{name}: paint map, 10 mm"
    table.add(row, error, "mm", 10.0, f"{source}; worst of {len(ticks) - 1} ticks", "<= 0.05")
    seen = red_centres_mm(page, design.switch.tip_diameter_mm)
    row = f"{name}: paint map, markers found on it"
    table.add(row, len(seen), "-", markers.count, f"red discs, {source}", f"== {markers.count}")
    # For shapes that unroll, the surface's own unwrapping is the reference.
    due = flat.at(markers.uv) * [1.0, -1.0]
    row = f"{name}: paint map, marker centres"
    value = float(fit_shift_mm(seen, due).max())
    table.add(row, value, "mm", "-", f"{flat.note}; one common shift", "<= 0.05")
    row = f"{name}: paint map, largest local scale"
    value = float(flat.stretch[1])
    reference = float(flat.stretch[0])
    table.add(
        row,
        value,
        "-",
        reference,
        f"singular values against the metric; least as reference; {flat.note}",
    )


def bill_rows(table: Table, design: Design, out: Path) -> None:
    """Masses of the bill against the files' own volumes; sums of the recipe."""
    listed = [row for row in rows_of(out / "bench/bill_of_materials.csv") if row["file"]]
    by_file = np.array([read_stl(out / row["file"]).volume_mm3 for row in listed])
    mass = np.array([float(row["mass_g"]) for row in listed])
    due = by_file * DENSITY_g_cm3["resin"] / 1000.0
    source = f"volumes of {len(listed)} STL files, g in all; worst part"
    value = float(np.abs(mass / due - 1.0).max())
    reference = float(due.sum())
    table.add(
        f"{design.name}: bill, mass of printed parts",
        value,
        "relative",
        reference,
        source,
        "<= 0.001",
    )
    text = (out / "bench/casting.md").read_text(encoding="utf-8")
    grams = dict(
        line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")
    )
    a, b, c, total = (float(grams[key]) for key in ("A", "B", "C", "rubber in all"))
    worst = max(
        abs(a + b + c - total) / total, abs(c / a - 5.0) / 5.0, abs((a + c) / b - 6.0) / 6.0
    )
    bill = rows_of(out / "bench/bill_of_materials.csv")
    rubber = sum(int(r["count"]) * float(r["volume_mm3"]) for r in bill if r["material"] == "tpu")
    asked = rubber / 1000.0 * DENSITY_g_cm3["tpu"] * (1.0 + design.bench.waste_rubber)
    source = "A + B + C, A : C, (A + C) : B, and grams from the bill; rounding to 0.01 g"
    value = max(worst, abs(total / asked - 1.0))
    table.add(
        f"{design.name}: recipe, sums and ratios", value, "relative", total, source, "<= 0.01"
    )


def kit_rows(table: Table, case: tuple[Design, Surface, Markers], out: Path) -> None:
    """Solids of the kit: sound, and fitting where they touch the sensor."""
    import trimesh

    design, surface, markers = case
    files = sorted((out / "kit").glob("*.stl"))
    sound = 0
    for path in files:
        body = trimesh.load_mesh(path)
        sound += int(body.is_watertight and body.is_winding_consistent and body.body_count == 1)
    row = f"{design.name}: kit, sound solids"
    source = "trimesh, from the STL files: watertight, one body"
    table.add(row, sound, "-", len(files), source, f"== {len(files)}")
    repair_row(table, f"{design.name}: kit, ", files)
    regions = make_regions(Sensor.of(design, surface, markers))
    row = f"{design.name}: kit, indenters off the surface"
    source = "corners of the printed face, pushed home, at every region; indenters"
    value = max(_misfit(case, regions, k, out) for k in range(len(regions.faces)))
    table.add(row, value, "mm", len(regions.faces), source, "<= 0.05")


def _misfit(case: tuple[Design, Surface, Markers], regions: Regions, tool: int, out: Path) -> float:
    """Largest distance of a printed face from the outer face, at all regions it serves, mm."""
    design, surface, markers = case
    points = read_stl(out / f"kit/indenter_{tool + 1}.stl").vertices_mm
    radius = regions.faces[tool].radius_mm
    inside = np.hypot(points[:, 0], points[:, 1]) <= radius + 1e-4
    low = np.unique(points[inside & (points[:, 2] < 0.4 * design.kit.shaft_mm)], axis=0)
    own = regions.marker[regions.face == tool]
    worst = 0.0
    for frame, at in zip(
        frames_at(surface, markers.uv[own]), surface.point(markers.uv[own]), strict=True
    ):
        there = low @ frame.T + at
        foot = surface.chart(there)
        gap = np.sum((there - surface.point(foot)) * surface.normal(foot), axis=1)
        worst = max(worst, float(np.ptp(gap)) / 2.0)
    return worst


def program_rows(table: Table, case: tuple[Design, Surface, Markers], out: Path) -> None:
    """Program read back from its G-code: regions, directions, and the way between them."""
    design, surface, markers = case
    name = design.name
    symmetry = find_symmetry(surface, markers)
    reached: set[int] = set()
    worst, least, misses = 0.0, np.inf, 0.0
    for run in ("shell", "decoder"):
        moves = read_gcode((out / f"kit/{run}.gcode").read_text(encoding="utf-8"))
        pressed = [move for move in moves if move.logs]
        at = np.array([move.at for move in pressed])
        region = np.array([move.region for move in pressed])
        reached = set(region.tolist()) if run == "shell" else reached & set(region.tolist())
        aim = np.sum(tool_axis(at) * markers.normal[region], axis=1)
        worst = max(worst, float(np.degrees(np.arccos(np.clip(aim, -1.0, 1.0))).max()))
        off = surface.point(markers.uv[region]) - in_sensor(at)
        along = np.sum(off * markers.normal[region], axis=1)
        side = np.linalg.norm(off - along[:, None] * markers.normal[region], axis=1)
        misses = max(misses, float(side.max()))
        least = min(least, _clearance_mm(surface, [move for move in moves if not move.logs]))
    alike = symmetry.maps[:, sorted(reached)]
    row = f"{name}: program, markers that its regions stand for"
    source = "G-code read back; regions pressed as reference"
    note = f"{symmetry.turns} turns, {symmetry.mirrors} mirrors"
    table.add(row, len(np.unique(alike)), "-", len(reached), source, f"== {markers.count}", note)
    row = f"{name}: program, off the normal"
    table.add(row, worst, "deg", 0.0, "rotations by scipy, both runs", "<= 0.001")
    row = f"{name}: program, beside the region's middle"
    table.add(row, misses, "mm", 0.0, "G-code read back, both runs", "<= 0.001")
    row = f"{name}: program, least height of the way between presses"
    source = "tool's middle over the outer face; 0 is the touch; hover as reference"
    table.add(row, least, "mm", design.kit.hover_mm, source, ">= -0.001")


def _clearance_mm(surface: Surface, moves: list[Any]) -> float:
    """Least height over the outer face of moves at fixed angles; the last of each is the touch."""
    at = np.array([move.at for move in moves if np.isfinite(move.at).all()])
    still = np.all(np.abs(np.diff(at[:, 3:], axis=0)) < 1e-9, axis=1)
    start, end = at[:-1][still], at[1:][still]
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None, None]
    there = in_sensor((start + share * (end - start)).reshape(-1, 6))
    foot = surface.chart(there)
    return float(np.sum((there - surface.point(foot)) * surface.normal(foot), axis=1).min())


def design_rows(table: Table, design: Design, folder: Path) -> None:
    """All rows of one design, from a draft build of its bench files."""
    out = folder / design.name
    result = build(design, out, accuracy="draft", only=["bench"], progress=lambda _: None)
    surface = design.surface()
    case = (design, surface, make_markers(design, surface))
    map_rows(table, design, out)
    bill_rows(table, design, out)
    kit_rows(table, case, out)
    program_rows(table, case, out)
    program = make_program(Sensor.of(*case), make_regions(Sensor.of(*case)))
    row = f"{design.name}: program, steps of both runs"
    source = "markers as reference"
    value = len(program.marker) * (len(program.force_N) + len(program.displacement_mm))
    table.add(row, value, "-", case[2].count, source)
    for stage in ("kit", "bench"):
        row = f"{design.name}: stage {stage}, draft"
        table.add(row, result.timing_s[stage], "s", "-", "wall time when it ran", "<= 4")


def add_rows(table: Table, *, quick: bool) -> None:
    """Rows of every shipped design; ``quick`` takes one."""
    names = ["hemisphere"] if quick else list(shipped_designs())
    with tempfile.TemporaryDirectory() as name:
        for each in names:
            design_rows(table, load_design(each), Path(name))
