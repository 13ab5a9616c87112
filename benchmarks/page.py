"""Pages that people read: the report, comparisons, the studio; malformed files and disturbed runs.

``python -m benchmarks.page [--quick] [--parts report,compare,help,checks,studio,fuzz,faults]``
"""

import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from benchmarks import page_checks, page_studio
from benchmarks.harness import Table, median_of, run_parts
from benchmarks.page_browser import DESKTOP, PHONE, PageMetrics, chromium, inspect, shown
from phytac_design.design.design_file import load_design
from phytac_design.report.built_sensors import read_builds
from phytac_design.report.compare import compare_page
from phytac_design.stages.build import BuildResult, build
from tests.fuzz.judge import SECONDS_MAX, InputFolder, read_inputs
from tests.fuzz.readers import READERS

DENSE = "cylinder60-dense"
PICTURES = Path(__file__).parents[1] / "docs" / "images"
FAULTS = {
    "builds on full and read-only disks, ended, and two at once": "tests/fuzz/test_build_faults.py",
    "studio under malformed, hostile and slow clients": "tests/studio/test_guard.py",
    "stream server under malformed and slow clients": "tests/decoder/test_serve.py",
}


def built(name: str, folder: Path) -> BuildResult:
    """Draft build of a shipped design."""
    return build(load_design(name), folder / name, accuracy="draft")


def report(table: Table, *, quick: bool) -> None:
    """Build a dense sensor and open its report."""
    with tempfile.TemporaryDirectory() as scratch:
        done = built("hemisphere" if quick else DENSE, Path(scratch))
        page = done.out / "report" / "report.html"
        figures = json.loads((page.parent / "report.json").read_text(encoding="utf-8"))
        case = f"report of {figures['design']}, {figures['markers']['count']} markers"
        table.add(
            f"{case}: size", page.stat().st_size / 1e6, "MB", 0.573, "MB of three.js in it", "<= 15"
        )
        row = f"{case}: its stage"
        source = "s of all stages of the draft, wall"
        table.add(row, done.timing_s["report"], "s", sum(done.timing_s.values()), source)
        with chromium() as browser:
            times = []
            for _ in range(1 if quick else 5):
                with shown(browser, page, DESKTOP) as (_, seen):
                    times.append(seen.paint_s)
            times.sort()
            row = f"{case}: first contentful paint, median of {len(times)}"
            source = f"the fastest; Chromium {browser.version}, headless, software GL, from disk"
            table.add(row, times[len(times) // 2], "s", times[0], source, "<= 2")
            seen = inspect(browser, page)
            _inspection_rows(table, case, seen)
            phone = inspect(browser, page, PHONE)
            _inspection_rows(table, f"{case}, phone", phone)


def _inspection_rows(table: Table, case: str, seen: PageMetrics) -> None:
    """Rows of one inspection of a page."""
    row = f"{case}: until everything is drawn"
    table.add(row, seen.ready_s, "s", seen.paint_s, "s to its first contentful paint")
    row = f"{case}: a turn of the shell, until it is drawn"
    table.add(row, seen.turn_ms, "ms", 16.7, "ms of a frame at 60 Hz; software GL here")
    for what, items in (
        ("errors on the console", seen.errors),
        ("requests outside of the page", seen.foreign),
        ("serious findings of axe-core", seen.serious),
    ):
        row = f"{case}: {what}"
        source = "all colourings, the slider and every fold used"
        table.add(row, len(items), "count", 0, source, "== 0", "; ".join(items[:3]))
    table.add(f"{case}: wider than the window", seen.wide_px, "px", 0, "every fold open", "== 0")


def _pictures(browser: Any, page: Path) -> None:
    """Screenshots for the docs: the top of the page, and on a phone the shell and the map."""
    for name, size in (("desktop", (DESKTOP[0], 1420)), ("phone", (PHONE[0], 1180))):
        with shown(browser, page, size) as (tab, _):
            tab.get_by_label("Colour by").first.select_option("bound_N")
            if name == "phone":
                tab.locator("#shell-and-markers").evaluate("e => e.scrollIntoView()")
            tab.wait_for_timeout(500)
            tab.screenshot(path=PICTURES / f"report-{name}.png")


def compare(table: Table, *, quick: bool) -> None:
    """Put two builds side by side."""
    with tempfile.TemporaryDirectory() as scratch:
        names = ("hemisphere", "plane") if quick else ("cylinder60", DENSE)
        folders = [built(name, Path(scratch)).out for name in names]
        page = Path(scratch) / "comparison.html"

        def make() -> None:
            page.write_text(compare_page(read_builds(folders)), encoding="utf-8")

        case = f"comparison of {' and '.join(names)}"
        table.add(
            f"{case}: making it", median_of(make, 3), "s", len(folders), "builds, made before"
        )
        row = f"{case}: size"
        source = "MB of the builds' own reports"
        value = page.stat().st_size / 1e6
        reference = sum((path / "report" / "report.html").stat().st_size for path in folders) / 1e6
        table.add(row, value, "MB", reference, source, "<= 15")
        with chromium() as browser:
            _inspection_rows(table, case, inspect(browser, page))
            if not quick:
                _pictures(browser, folders[0] / "report" / "report.html")


def help_time(table: Table, *, quick: bool) -> None:
    """Time of ``phytac --help``, in a process of its own."""

    def ask() -> None:
        code = "from phytac_design.cli.app import main; main()"
        words = [sys.executable, "-c", code, "--help"]
        subprocess.run(words, capture_output=True, check=True, env=dict(os.environ))

    def nothing() -> None:
        subprocess.run([sys.executable, "-c", ""], check=True)

    times = 3 if quick else 9
    row = "phytac --help"
    source = f"s of Python that does nothing; medians of {times}"
    table.add(row, median_of(ask, times), "s", median_of(nothing, times), source, "<= 0.5")


def fuzz(table: Table, *, quick: bool) -> None:
    """Read a million malformed files, the same number by each reader (``tests/fuzz``)."""
    target = 2_800 if quick else 1_000_000
    memory = Path("/dev/shm")  # noqa: S108 - folders in it have names of their own
    counts = []
    for name in READERS:
        with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
            numbers = range(-(-target // len(READERS)))
            counts.append(read_inputs(name, numbers, InputFolder(Path(folder))))
    faults = [fault for one in counts for fault in one.faults]
    row = "fuzz: corrupt inputs over all readers"
    total = sum(one.read + one.refused + len(one.faults) for one in counts)
    table.add(row, total, "", target, f"{len(counts)} readers", f">= {target}")
    row = "fuzz: inputs with a traceback, more than 2 s, 500 MB or 20 000 letters of message"
    kinds = Counter(fault.split(": ", 2)[1] for fault in faults)
    note = f"{dict(kinds)}; {faults[0]}" if faults else ""
    table.add(row, len(faults), "", 0, "each input of its own", "== 0", note)
    slowest = max(one.slowest_s for one in counts)
    target_s = f"<= {SECONDS_MAX:g}"
    table.add("fuzz: slowest input", slowest, "s", SECONDS_MAX, "processor time", target_s)


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
        "report": report,
        "compare": compare,
        "help": help_time,
        "checks": page_checks.checks,
        "studio": page_studio.studio,
        "fuzz": fuzz,
        "faults": faults,
    }
    return {name: partial(work, quick=quick) for name, work in works.items()}


if __name__ == "__main__":
    run_parts("page", parts, __doc__ or "")
