"""Printed parts of every shipped design: print rules of shells, molds both ways, hardware.

The stages check their parts before they write them; their results are read from their facts. admesh
and prusa-slicer judge the files.
"""

import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.accuracy import PRESETS, Accuracy, Preset
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Stage
from phytac_design.fabrication.printing.overhang import stand
from phytac_design.fabrication.printing.print_checks import check_shell
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.rules.check import check_design
from phytac_design.solids.mesh_export import read_stl, write_stl
from phytac_design.solids.solid_mesh import shell_manifold, to_triangles
from phytac_design.stages.build import copy_of, run_stages, select_stages
from phytac_design.stages.hardware_stage import HARDWARE
from phytac_design.stages.mold_stage import MOLD

MAIN = "cylinder60"


def repairs(path: Path) -> int:
    """All faults that admesh counts in a file."""
    faults = (
        "Degenerate facets", "Edges fixed", "Facets removed", "Facets added", "Facets reversed",
        "Backwards edges", "Normals fixed", "Total disconnected facets",
    )  # fmt: skip
    report = subprocess.run(
        ["admesh", str(path)], capture_output=True, text=True, errors="replace", check=True
    )
    lines = dict(line.split(":", 1) for line in report.stdout.splitlines() if ":" in line)
    counts = {key.strip(): value.split() for key, value in lines.items()}
    return sum(int(counts[row][0]) for row in faults)


def sliced(path: Path, *words: str) -> bool:
    """Whether prusa-slicer makes G-code of a file, which it writes beside it."""
    target = path.with_suffix(path.suffix + ".gcode")
    command = ["prusa-slicer", *words, "--export-gcode", str(path), "-o", str(target)]
    try:
        done = subprocess.run(command, capture_output=True, check=False, timeout=600.0)
        # A shorter file holds no printed part.
        return done.returncode == 0 and target.stat().st_size > 20_000
    except (subprocess.TimeoutExpired, FileNotFoundError):
        return False


def repair_row(table: Table, label: str, files: Sequence[Path]) -> None:
    """Row: repairs of all files, where admesh is on PATH."""
    if shutil.which("admesh"):
        row, source = f"{label}repairs by admesh", "files, all its counts of faults"
        table.add(row, sum(map(repairs, files)), "-", len(files), source, "== 0")


def slice_row(table: Table, label: str, files: Sequence[Path], *words: str) -> None:
    """Row: files not sliced, where prusa-slicer is on PATH."""
    if shutil.which("prusa-slicer"):
        start = time.perf_counter()
        failed = sum(not sliced(path, *words) for path in files)
        source = f"files, {time.perf_counter() - start:.1f} s in all"
        row = f"{label}files not sliced by prusa-slicer"
        table.add(row, failed, "-", len(files), source, "== 0")


def printing_rows(table: Table, *, quick: bool) -> None:
    """Violations of the print rules by shipped shells, and their suggested build direction."""
    for name in ["plane"] if quick else shipped_designs():
        case = check_design(load_design(name))
        mesh = to_triangles(shell_manifold(case))
        with tempfile.TemporaryDirectory() as folder:
            write_stl(mesh, Path(folder) / "shell.stl")
            printed = read_stl(Path(folder) / "shell.stl")
        start = time.perf_counter()
        report = check_shell(case, printed)
        seconds = time.perf_counter() - start
        row = f"{name}: violations of the SLA rules"
        source = f"chord 0.01 mm, {len(mesh.triangles)} triangles, {seconds:.1f} s"
        table.add(row, len(report.violations), "-", 0, source, "== 0")
        up = np.array([0.0, 0.0, 1.0])
        upright, best = stand(mesh, RayTree(mesh), up, case.design.print_rules), report.standing
        row = f"{name}: overhang as suggested over axis upright"
        source = (
            f"mm2 upright; suggested: {best.height_mm:.0f} mm high (upright "
            f"{upright.height_mm:.0f}), supports {best.support_volume_mm3:.0f} mm3 (upright "
            f"{upright.support_volume_mm3:.0f}), cups {best.cup_count} (upright "
            f"{upright.cup_count})"
        )
        value = best.overhang_area_mm2 / max(upright.overhang_area_mm2, 1e-9)
        table.add(row, value, "ratio", upright.overhang_area_mm2, source)


def ran(
    stage: Stage, design: Design, preset: Preset, out: Path
) -> tuple[dict[str, Any], list[Path], float]:
    """Facts of a stage that follows the switch's, its STL files, and its processor seconds."""
    context = run_stages(
        design,
        select_stages(["switch"]),
        accuracy=preset,
        seed=0,
        force=True,
        progress=lambda _: None,
    )[0]
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    start = time.process_time()
    stage.run(context, out)
    seconds = time.process_time() - start
    return json.loads((out / "facts.json").read_text()), sorted(out.rglob("*.stl")), seconds


def mold_rows(table: Table, *, quick: bool) -> None:
    """Molds of both ways, audited by their stage: the closed, shrunk halves hold the switches."""
    preset: Preset = "draft" if quick else "standard"
    for name in ["hemisphere"] if quick else shipped_designs():
        design = load_design(name)
        for way in ("rigid", "silicone-master"):
            with tempfile.TemporaryDirectory() as folder:
                changed = copy_of(design, mold={"way": way})
                facts, files, seconds = ran(MOLD, changed, preset, Path(folder) / way)
                _mold_rows(table, f"{name}, {way}", changed, PRESETS[preset], facts, seconds)
                repair_row(table, f"{name}, {way}: ", files)
                files.sort(key=lambda path: -path.stat().st_size)
                # Of large designs the largest plate of the rigid mold alone: slicing takes minutes.
                small = name in {"hemisphere", "patch", "plane"} and not quick
                count = None if small else int(way == "rigid")
                coarse = ("--layer-height", "0.3", "--fill-density", "5%")
                slice_row(table, f"{name}, {way}: ", files[:count], *coarse)


def _mold_rows(
    table: Table,
    label: str,
    design: Design,
    accuracy: Accuracy,
    facts: dict[str, Any],
    seconds: float,
) -> None:
    draft, tolerance = design.mold.draft_deg, accuracy.cad_tolerance_mm
    source = "projected area, all parts"
    row = f"{label}: area that is caught when parts are pulled"
    table.add(row, facts["undercut_mm2"], "mm2", 0, source, "<= 0.01")
    row = f"{label}: least draft of any face"
    table.add(row, facts["least_draft_deg"], "deg", draft, "mold.draft_deg", f">= {draft - 2e-3:g}")
    row = f"{label}: volume that closed parts share"
    table.add(row, facts["shared_mm3"], "mm3", 0, "boolean intersection", "<= 0.05")
    row = f"{label}: volume of the cavities, worst error"
    source = "each kind of switch, its section revolved; cavities shrunk"
    table.add(row, 100.0 * facts["volume_error"], "%", 0, source, "<= 0.5")
    row = f"{label}: Hausdorff distance of the shrunk cavities from the switches"
    target = f"<= {tolerance:g}"
    table.add(row, facts["hausdorff_mm"], "mm", tolerance, "tolerance of the mesh", target)
    row = f"{label}: stage mold, {len(facts['sets'])} sets"
    source = "cavities; audit and files included"
    table.add(row, seconds, "s of one core", facts["cavities"], source, "<= 15")


def hardware_rows(table: Table, *, quick: bool) -> None:
    """Hardware: collisions, joints, light, view, outside programs, time of the stage."""
    names = ["plane"] if quick else sorted(shipped_designs(), key=lambda item: item != MAIN)
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            design, out = load_design(name), Path(folder) / name
            facts, files, _ = ran(HARDWARE, design, "draft", out)
            if name == MAIN:
                # The first run imported CAD and compiled loops.
                limits: dict[Preset, str] = {"draft": "<= 4", "standard": "<= 15"}
                for preset, limit in limits.items():
                    facts, files, seconds = ran(HARDWARE, design, preset, out)
                    source = "bodies in the STEP assembly; CAD already imported"
                    row = f"{name}: hardware stage, {preset}"
                    table.add(row, seconds, "s", facts["step"]["bodies"], source, limit)
            _hardware_rows(table, name, facts)
            repair_row(table, f"{name}: hardware, ", files)
            slice_row(table, f"{name}: hardware, ", files)


def _hardware_rows(table: Table, name: str, facts: dict[str, Any]) -> None:
    pairs = facts["interference"]["pairs"]
    row = f"{name}: hardware, interference of all pairs"
    source = "pairs of bodies, intersected by manifold3d: shell, switches, hardware, screws"
    table.add(row, facts["interference"]["shared_mm3"], "mm3", pairs, source, "<= 1e-6")
    joints = facts["joints"]
    row = f"{name}: hardware, joints whose measured holes disagree"
    source = "joints; diameters measured by rays in the meshes of both sides"
    table.add(row, sum(not joint["agree"] for joint in joints), "-", len(joints), source, "== 0")
    light = facts["light"]
    row = f"{name}: hardware, ways of light from inside to outside"
    source = "rays from inside; receptors' holes count as closed where a bowl covers them"
    value = light["leaks"] + light["holes_uncovered"]
    table.add(row, value, "-", light["lines_checked"], source, "== 0")
    view = facts["view"]
    row = f"{name}: hardware, lines of sight to markers that are cut"
    source = "lines from the camera to the markers' painted faces"
    table.add(row, view["lines_cut"], "-", view["lines_checked"], source, "== 0")
