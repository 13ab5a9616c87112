"""Whole builds: the published sensor from an empty cache and again, and every other shape.

``python -m benchmarks.build [--quick] [--parts cylinder60,drafts,standard]``
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.harness import Table, run_parts
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
    cache: Path, out: Path, accuracy: str, design: str = "cylinder60"
) -> tuple[float, dict[str, Any]]:
    """Build a shipped design in a process of its own: wall seconds and its JSON summary."""
    words = ["build", design, "--out", str(out), "--accuracy", accuracy, "--json"]
    words += ["--workers", str(WORKERS)]
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", "from phytac_design.cli.app import main; main()", *words],
        env={**os.environ, "PHYTAC_CACHE": str(cache)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return time.perf_counter() - start, json.loads(done.stdout)


def add_stages(table: Table, name: str, timing_s: dict[str, float]) -> None:
    """Seconds of each stage, as it ran beside others."""
    for stage, took in timing_s.items():
        table.add(f"{name}: stage {stage}", took, "s", "-", "reported only")


def add_times(table: Table, scratch: Path, presets: Sequence[str]) -> None:
    """Cold and warm builds of each preset."""
    for accuracy in presets:
        limit = TARGETS_s["cylinder60"][accuracy]
        out = scratch / accuracy
        seconds, summary = run(scratch / "cache", out, accuracy)
        row = f"cylinder60, {accuracy}: whole build, decoder included, empty cache"
        source = f"project target, two cores, {WORKERS} workers; formerly 600 s, 60 s as a draft"
        table.add(row, seconds, "s", limit, source, f"<= {limit:g}")
        add_stages(table, f"cylinder60, {accuracy}", summary["timing_s"])
        seconds, summary = run(scratch / "cache", out, accuracy)
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
    }


if __name__ == "__main__":
    run_parts("build", parts, __doc__ or "")
