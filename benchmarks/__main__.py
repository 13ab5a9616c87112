"""All benchmarks: ``python -m benchmarks`` runs the parts whose rows earlier code has made.

Parts that have been made by the code as it is now are passed over, so that a run that was stopped
continues. ``--list`` only shows them; names of benchmarks restrict the run. ::

    python -m benchmarks [--list] [camera decoder …]
"""

import argparse
import importlib
import json
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarks.harness import RESULTS
from benchmarks.provenance import ROOT, is_current

NAMES = (
    "visibility",
    "fabrication",
    "mechanics",
    "contacts",
    "twin",
    "stability",
    "decoder",
    "hands",
    "paper",
    "camera",
    "camera_drift",
    "demo_frames",
    "reference_marks",
    "single_colour",
    "real_photo",
    "tradeoff",
    "study",
    "connect",
    "build",
    "page",
    "docs",
    "mutation",
)
"""In the order in which they run; ``install`` needs other interpreters and is run by hand."""


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of a benchmark.

    Attributes
    ----------
    benchmark, name : str
        Of which it is, and its own name.
    known : dict
        What made its rows, see :mod:`benchmarks.provenance`; empty if there are none.
    """

    benchmark: str
    name: str
    known: dict[str, Any] = field(default_factory=dict)

    @property
    def current(self) -> bool:
        """Whether its rows need not be made again."""
        return is_current(self.known)

    @property
    def words(self) -> list[str]:
        """Words of the command that runs it."""
        return [sys.executable, "-m", f"benchmarks.{self.benchmark}", "--parts", self.name]

    def __str__(self) -> str:
        """Return one line for a list."""
        seconds, day = self.known.get("seconds"), self.known.get("day", "never")
        state = "current" if self.current else "earlier code" if self.known else "not run"
        took = f"{seconds:8.0f} s" if seconds else f"{'?':>8}  "
        return f"{state:12} {day:10} {took}  {self.benchmark}: {self.name}"


def parts_of(benchmark: str) -> list[Part]:
    """Return the parts of a benchmark, in order."""
    path = RESULTS / f"{benchmark}.json"
    known = json.loads(path.read_text())["parts"] if path.is_file() else {}
    module = importlib.import_module(f"benchmarks.{benchmark}")
    return [
        Part(benchmark=benchmark, name=name, known=known.get(name, {}))
        for name in module.parts(quick=False)
    ]


def run(parts: Sequence[Part]) -> list[Part]:
    """Run parts one after the other; return those that failed."""
    failed = []
    for number, part in enumerate(parts, start=1):
        rest = sum(other.known.get("seconds", 0.0) for other in parts[number - 1 :])
        unknown = sum("seconds" not in other.known for other in parts[number - 1 :])
        left = f"about {rest / 60.0:.0f} min left"
        left += f", and {unknown} parts whose time is not known" if unknown else ""
        print(f"[{number}/{len(parts)}] {shlex.join(part.words[1:])} ({left})", flush=True)
        if subprocess.run(part.words, cwd=ROOT, check=False).returncode:
            failed.append(part)
    return failed


def main() -> None:
    """Run or list."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description="Run the parts whose rows earlier code has made."
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}; or all")
    parser.add_argument("--list", action="store_true", help="only show the parts")
    given = parser.parse_args()
    unknown = [name for name in given.names if name not in NAMES]
    if unknown:
        parser.error(f"no benchmark {unknown[0]!r}; known: {', '.join(NAMES)}")
    parts = [part for name in given.names or NAMES for part in parts_of(name)]
    if given.list:
        print("\n".join(map(str, parts)))
        return
    failed = run([part for part in parts if not part.current])
    subprocess.run([sys.executable, "-m", "benchmarks.tables"], cwd=ROOT, check=True)
    if failed:
        sys.exit(f"failed: {', '.join(f'{part.benchmark} {part.name}' for part in failed)}")


if __name__ == "__main__":
    main()
