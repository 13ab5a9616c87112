"""What other programs make of printed parts: admesh's repairs, prusa-slicer's G-code."""

import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.harness import Table

FAULTS = (
    "Degenerate facets", "Edges fixed", "Facets removed", "Facets added", "Facets reversed",
    "Backwards edges", "Normals fixed", "Total disconnected facets",
)  # fmt: skip
GCODE_MIN_bytes = 20_000
"""A shorter file holds no printed part."""
SLICE_MAX_s = 600.0


def repairs(path: Path) -> int:
    """All faults that admesh counts in a file."""
    report = subprocess.run(["admesh", str(path)], capture_output=True, text=True, check=True)
    lines = dict(line.split(":", 1) for line in report.stdout.splitlines() if ":" in line)
    counts = {key.strip(): value.split() for key, value in lines.items()}
    return sum(int(counts[row][0]) for row in FAULTS)


def sliced(path: Path, *words: str) -> bool:
    """Whether prusa-slicer makes G-code of a file, which it writes beside it."""
    target = path.with_suffix(path.suffix + ".gcode")
    command = ["prusa-slicer", *words, "--export-gcode", str(path), "-o", str(target)]
    try:
        done = subprocess.run(command, capture_output=True, check=False, timeout=SLICE_MAX_s)
        return done.returncode == 0 and target.stat().st_size > GCODE_MIN_bytes
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
