"""Whole builds: the published sensor from an empty cache and again, and every other shape.

``python -m benchmarks.build [--quick] [--parts cylinder60,drafts,standard,workers]``
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.harness import Table, run_parts
from phytac_design.core.threads import THREADS
from phytac_design.design.design_file import shipped_designs

TARGETS_s = {
    "cylinder60": {"draft": 15.0, "standard": 60.0},
    "others": {"draft": 25.0, "standard": 120.0},
}
"""Project targets of a whole build on two cores, machine quiet, empty cache, two workers.

Before they were 60 s (draft) and 600 s (standard) for every design, as rows of older results say.
"""
WORKERS = 2


def run(
    cache: Path,
    out: Path,
    accuracy: str,
    design: str = "cylinder60",
    *,
    workers: int = WORKERS,
    threads: int | None = None,
    watch: Callable[[int], None] | None = None,
) -> tuple[float, dict[str, Any]]:
    """Build a shipped design in a process of its own: wall seconds and its JSON summary.

    ``watch`` is called with the process's number every second. ``threads`` bounds the threads of
    a build by one worker, which has one for each of up to eight cores otherwise.
    """
    words = ["build", design, "--out", str(out), "--accuracy", accuracy, "--json"]
    words += ["--workers", str(workers)]
    # As for a user, Python keeps the code that it compiles at the first import.
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    env |= {} if threads is None else {THREADS: str(threads)}
    start = time.perf_counter()
    with tempfile.TemporaryFile() as said:
        done = subprocess.Popen(
            [sys.executable, "-c", "from phytac_design.cli.app import main; main()", *words],
            env={**env, "PHYTAC_CACHE": str(cache)},
            stdout=said,
        )
        while watch and done.poll() is None:
            watch(done.pid)
            with suppress(subprocess.TimeoutExpired):
                done.wait(1.0)
        done.wait()
        seconds = time.perf_counter() - start
        if done.returncode:
            raise subprocess.CalledProcessError(done.returncode, words)
        said.seek(0)
        return seconds, json.loads(said.read())


def memory_MB(parent: int) -> float:
    """Proportional set size of a process and its descendants, MB (Linux)."""
    family, total = {parent}, 0.0
    for folder in sorted(Path("/proc").glob("[0-9]*"), key=lambda each: int(each.name)):
        with suppress(OSError, IndexError):
            own = int(folder.name)
            # After the name in brackets come state and parent.
            above = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if own not in family and above not in family:
                continue
            family.add(own)
            lines = (folder / "smaps_rollup").read_text().splitlines()
            total += sum(float(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total / 1024.0


def add_stages(table: Table, name: str, timing_s: dict[str, float]) -> None:
    """Seconds of each stage, as it ran beside others."""
    for stage, took in timing_s.items():
        table.add(f"{name}: stage {stage}", took, "s", "-", "reported only")


def add_times(table: Table, scratch: Path, presets: Sequence[str]) -> None:
    """Cold and warm builds of each preset."""
    # Modules and kernels are compiled once after an installation.
    run(scratch / "cache-first", scratch / "first", "draft")
    for accuracy in presets:
        limit = TARGETS_s["cylinder60"][accuracy]
        # A cache of its own: presets share results of stages without settings.
        out, cache = scratch / accuracy, scratch / f"cache-{accuracy}"
        seconds, summary = run(cache, out, accuracy)
        row = f"cylinder60, {accuracy}: whole build, decoder included, empty cache"
        source = f"project target, two cores, {WORKERS} workers; formerly 600 s, 60 s as a draft"
        table.add(row, seconds, "s", limit, source, f"<= {limit:g}")
        add_stages(table, f"cylinder60, {accuracy}", summary["timing_s"])
        seconds, summary = run(cache, out, accuracy)
        row = f"cylinder60, {accuracy}: the same build again"
        table.add(row, seconds, "s", "seconds", "all stages from the cache", "<= 5")
        row = f"cylinder60, {accuracy}: stages run again"
        table.add(row, len(summary["ran"]), "stages", 0, "cache", "== 0")


def add_shapes(table: Table, *, accuracy: str) -> None:
    """Whole builds of the other shipped designs, each from an empty cache."""
    limit = TARGETS_s["others"][accuracy]
    for design in shipped_designs():
        if design == "cylinder60":
            continue
        with tempfile.TemporaryDirectory() as folder:
            scratch = Path(folder)
            seconds, summary = run(scratch / "cache", scratch / "out", accuracy, design)
            report = json.loads((scratch / "out" / "report" / "report.json").read_text())
        row = f"{design}, {accuracy}: whole build, decoder included, empty cache"
        source = f"project target, two cores, {WORKERS} workers; formerly 600 s, 60 s as a draft"
        table.add(row, seconds, "s", limit, source, f"<= {limit:g}")
        add_stages(table, f"{design}, {accuracy}", summary["timing_s"])
        seen = report["visibility"]
        row = f"{design}: markers hidden or fused"
        source = "reference: all markers"
        value = seen["occluded"] + seen["fused"]
        table.add(row, value, "markers", report["markers"]["count"], source, "== 0")
        row = f"{design}, {accuracy}: KOI inverse, held-out simulated contacts, relative error"
        source = "reference: median bound at 10 N, in newtons"
        value = report["decoder"]["koi_inverse"]["relative_error"]
        table.add(
            row, value, "relative", report["resolution"]["bound"]["10 N"]["force_N_median"], source
        )


def add_workers(table: Table, *, accuracy: str) -> None:
    """Builds of the published sensor by one, two and four workers: time, memory, files.

    Workers of a pool have one thread each; a single worker has one for each core if not limited.
    """
    seconds: dict[int, float] = {}
    files: dict[int, dict[str, str]] = {}
    for workers in (1, 2, 4):
        with tempfile.TemporaryDirectory() as folder:
            cache, out = Path(folder) / "cache", Path(folder) / "out"
            seconds[workers], _ = run(cache, out, accuracy, workers=workers)
            manifest = json.loads((out / "manifest.json").read_text())
            files[workers] = {item["path"]: item["sha256"] for item in manifest["files"]}
        name = f"cylinder60, {accuracy}, workers: {workers}"
        table.add(f"{name}: whole build, empty cache", seconds[workers], "s", "-", "reported only")
    for workers in (1, WORKERS):
        peaks = [0.0]

        def watch(process: int, peaks: list[float] = peaks) -> None:
            peaks.append(memory_MB(process))

        # A run of its own: to read the memory of all processes takes time from them.
        with tempfile.TemporaryDirectory() as folder:
            cache, out = Path(folder) / "cache", Path(folder) / "out"
            run(cache, out, accuracy, workers=workers, watch=watch)
        limit = "<= 3" if workers == WORKERS else None
        source = "project target, of all processes, proportional set size"
        row = f"cylinder60, {accuracy}, workers: {workers}: peak memory"
        table.add(row, max(peaks) / 1024.0, "GiB", 3.0, source, limit)
    with tempfile.TemporaryDirectory() as folder:
        cache, out = Path(folder) / "cache", Path(folder) / "out"
        single, _ = run(cache, out, accuracy, workers=1, threads=1)
    name = f"cylinder60, {accuracy}"
    row, gain = f"{name}: two workers over one, of one thread each", single / seconds[2]
    table.goal(row, gain, "times", ">= 1.6", note=f"that one takes {single:.1f} s")
    row, gain = f"{name}: two workers over one that has all cores", seconds[1] / seconds[2]
    note = "a single worker renders and multiplies with a thread for each core"
    table.add(row, gain, "times", "-", "reported only", note=note)
    report = {path for path in files[1] if path.startswith("report/")}
    for workers in (2, 4):
        either = files[1].keys() | files[workers].keys()
        other = [k for k in either if files[1].get(k) != files[workers].get(k) and k not in report]
        row = f"{name}: files that differ between 1 and {workers} workers"
        source = f"of {len(files[1])}, without the {len(report)} of the report, which has times"
        table.add(row, len(other), "files", 0, source, "== 0", note=", ".join(sorted(other)))


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """All parts by name, in order."""

    def cylinder(table: Table) -> None:
        presets = ("draft",) if quick else ("draft", "standard")
        with tempfile.TemporaryDirectory() as folder:
            scratch = Path(folder)
            add_times(table, scratch, presets)

    return {
        "cylinder60": cylinder,
        "drafts": partial(add_shapes, accuracy="draft"),
        "standard": partial(add_shapes, accuracy="standard"),
        "workers": partial(add_workers, accuracy="draft" if quick else "standard"),
    }


if __name__ == "__main__":
    run_parts("build", parts, __doc__ or "")
