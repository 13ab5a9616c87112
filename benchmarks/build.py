"""The whole build of the published sensor: from an empty cache, again, and its report's facts.

``python -m benchmarks.build [--quick]``
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.harness import Table, arguments

PAPER = "paper"


def run(cache: Path, out: Path, accuracy: str) -> tuple[float, dict[str, Any]]:
    """Build ``cylinder60`` in a process of its own: wall seconds and its JSON summary."""
    words = ["build", "cylinder60", "--out", str(out), "--accuracy", accuracy, "--json"]
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", "from phytac_design.cli import main; main()", *words],
        env={**os.environ, "PHYTAC_CACHE": str(cache)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return time.perf_counter() - start, json.loads(done.stdout)


def add_times(table: Table, scratch: Path, presets: dict[str, str]) -> None:
    """Cold and warm builds of each preset."""
    for accuracy, target in presets.items():
        out = scratch / accuracy
        seconds, summary = run(scratch / "cache", out, accuracy)
        table.add(
            f"cylinder60, {accuracy}: whole build, decoder included, empty cache",
            seconds,
            "s",
            reference=300.0 if accuracy == "standard" else 30.0,
            source="project target: 5 min on two cores, 30 s as a draft",
            target=target,
        )
        for stage, took in summary["timing_s"].items():
            table.add(
                f"cylinder60, {accuracy}: stage {stage}",
                took,
                "s",
                reference="-",
                source="reported only",
            )
        seconds, summary = run(scratch / "cache", out, accuracy)
        table.add(
            f"cylinder60, {accuracy}: the same build again",
            seconds,
            "s",
            reference="seconds",
            source="all stages from the cache",
            target="<= 5",
        )
        table.add(
            f"cylinder60, {accuracy}: stages run again",
            len(summary["ran"]),
            "stages",
            reference=0,
            source="cache",
            target="== 0",
        )


def add_facts(table: Table, report: dict[str, Any]) -> None:
    """Figures of the report that the paper gives, or geometry implies."""
    markers, seen, shell = report["markers"], report["visibility"], report["shell"]
    rows: list[tuple[str, float, str, float, str, str]] = [
        ("markers", markers["count"], "-", 368, PAPER, "== 368"),
        ("density below", markers["density_per_cm2"], "/cm2", 1.63, PAPER, "<= 1.64"),
        ("density above", markers["density_per_cm2"], "/cm2", 1.63, PAPER, ">= 1.62"),
        ("occluded", seen["occluded"], "-", 0, "definition in docs/formats.md", "== 0"),
        ("fused", seen["fused"], "-", 0, "definition in docs/formats.md", "== 0"),
        ("bodies", shell["bodies"], "-", 1, "one part", "== 1"),
        ("genus", shell["genus"], "-", 369, "ring 1 + one per through-hole", "== 369"),
        ("STEP valid", float(shell["step_valid"]), "-", 1, "OpenCASCADE BRepCheck", "== 1"),
        ("STEP solids", shell["step_solids"], "-", 1, "one part", "== 1"),
        (
            "mesh against STEP volume",
            abs(shell["volume_difference"]),
            "relative",
            0.0,
            "OpenCASCADE",
            "<= 0.001",
        ),
    ]
    for case, value, unit, reference, source, target in rows:
        table.add(
            f"cylinder60: {case}", value, unit, reference=reference, source=source, target=target
        )


def main() -> None:
    """Run the benchmark."""
    quick = arguments(__doc__ or "").quick
    table = Table("build")
    presets = {"draft": "<= 60"} if quick else {"draft": "<= 60", "standard": "<= 600"}
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        add_times(table, scratch, presets)
        last = scratch / list(presets)[-1] / "report" / "report.json"
        add_facts(table, json.loads(last.read_text()))
    if not quick:
        print(table.write())


if __name__ == "__main__":
    main()
