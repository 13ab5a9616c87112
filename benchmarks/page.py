"""Pages that people read: the report, comparisons, the studio, hardening of the readers, the wheel.

``python -m benchmarks.page [--quick] [--parts report,compare,help,studio,fuzz,faults,wheel]``
"""

import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

from benchmarks import page_fuzz, page_report, page_studio, page_wheel
from benchmarks.harness import Table, run_parts

FAULTS = {
    "builds on full and read-only disks, ended, and two at once": "tests/fuzz/test_build_faults.py",
    "studio under malformed, hostile and slow clients": "tests/studio/test_guard.py",
    "stream server under malformed and slow clients": "tests/decoder/test_serve.py",
}


def faults(table: Table, *, quick: bool) -> None:
    """Disturbed builds and servers: the tests of each, and how many fail."""
    with tempfile.TemporaryDirectory() as folder:
        for name, path in list(FAULTS.items())[: 1 if quick else None]:
            report = Path(folder) / "report.xml"
            words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junit-xml={report}", path]
            subprocess.run([sys.executable, *words], check=False)
            suite = next(ET.parse(report).iter("testsuite"))  # noqa: S314 - pytest's own file
            wrong = int(suite.attrib["failures"]) + int(suite.attrib["errors"])
            source = f"{suite.attrib['tests']} tests of {path}"
            table.goal(f"faults: {name}: tests that fail", wrong, "tests", "== 0", source=source)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Parts by name, in order."""
    works: dict[str, Callable[..., None]] = {
        "report": page_report.report,
        "compare": page_report.compare,
        "help": page_report.help_time,
        "studio": page_studio.studio,
        "fuzz": page_fuzz.fuzz,
        "faults": faults,
        "wheel": page_wheel.wheel,
    }
    return {name: partial(work, quick=quick) for name, work in works.items()}


if __name__ == "__main__":
    run_parts("page", parts, __doc__ or "")
