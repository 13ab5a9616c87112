"""Whole builds: the published sensor from an empty cache and again, and every other shape.

``python -m benchmarks.build [--quick] [--parts cylinder60,drafts,standard]``
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.harness import Table, run_parts
from phytac_design.design.design_file import shipped_designs

PAPER = "paper"


def run(
    cache: Path, out: Path, accuracy: str, design: str = "cylinder60"
) -> tuple[float, dict[str, Any]]:
    """Build a shipped design in a process of its own: wall seconds and its JSON summary."""
    words = ["build", design, "--out", str(out), "--accuracy", accuracy, "--json"]
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", "from phytac_design.cli.app import main; main()", *words],
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


def add_shapes(table: Table, *, accuracy: str, target: str) -> None:
    """Whole builds of the other shipped designs, each from an empty cache."""
    for design in shipped_designs():
        if design == "cylinder60":
            continue
        with tempfile.TemporaryDirectory() as folder:
            scratch = Path(folder)
            seconds, summary = run(scratch / "cache", scratch / "out", accuracy, design)
            report = json.loads((scratch / "out" / "report" / "report.json").read_text())
        slowest = max(summary["timing_s"], key=summary["timing_s"].get)
        table.add(
            f"{design}, {accuracy}: whole build, decoder included, empty cache",
            seconds,
            "s",
            reference=summary["timing_s"][slowest],
            source=f"reference: its slowest stage, {slowest}",
            target=target,
        )
        seen = report["visibility"]
        table.add(
            f"{design}: markers hidden or fused",
            seen["occluded"] + seen["fused"],
            "markers",
            reference=report["markers"]["count"],
            source="reference: all markers",
            target="== 0",
        )
        table.add(
            f"{design}, {accuracy}: KOI inverse, held-out simulated contacts, relative error",
            report["decoder"]["koi_inverse"]["relative_error"],
            "relative",
            reference=report["resolution"]["bound"]["10 N"]["force_N_median"],
            source="reference: median bound at 10 N, in newtons",
        )


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """All parts by name, in order."""

    def cylinder(table: Table) -> None:
        presets = {"draft": "<= 60"} if quick else {"draft": "<= 60", "standard": "<= 600"}
        with tempfile.TemporaryDirectory() as folder:
            scratch = Path(folder)
            add_times(table, scratch, presets)
            last = scratch / list(presets)[-1] / "report" / "report.json"
            add_facts(table, json.loads(last.read_text()))

    return {
        "cylinder60": cylinder,
        "drafts": partial(add_shapes, accuracy="draft", target="<= 60"),
        "standard": partial(add_shapes, accuracy="standard", target="<= 600"),
    }


def main() -> None:
    """Run all parts, or those named."""
    run_parts("build", parts, __doc__ or "")


if __name__ == "__main__":
    main()
