"""The report of a dense sensor and a comparison of builds, as a browser sees them; the help."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.harness import Table, median_of
from benchmarks.page_browser import DESKTOP, PHONE, PageMetrics, chromium, look, paints_s, shown
from phytac_design.design.design_file import load_design
from phytac_design.report.built_sensors import read_builds
from phytac_design.report.compare import compare_page
from phytac_design.stages.build import BuildResult, build

DENSE = "cylinder60-dense"
PICTURES = Path(__file__).parents[1] / "docs" / "images"
HELP = "from phytac_design.cli.app import main; main()"


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
            times = paints_s(browser, page, 1 if quick else 5)
            row = f"{case}: first contentful paint, median of {len(times)}"
            source = f"the fastest; Chromium {browser.version}, headless, software GL, from disk"
            table.add(row, times[len(times) // 2], "s", times[0], source, "<= 2")
            seen = look(browser, page)
            _judged(table, case, seen)
            phone = look(browser, page, PHONE)
            _judged(table, f"{case}, phone", phone)


def _judged(table: Table, case: str, seen: PageMetrics) -> None:
    """Rows of one look at a page."""
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
            _judged(table, case, look(browser, page))
            if not quick:
                _pictures(browser, folders[0] / "report" / "report.html")


def help_time(table: Table, *, quick: bool) -> None:
    """Time of ``phytac --help``, in a process of its own."""

    def ask() -> None:
        words = [sys.executable, "-c", HELP, "--help"]
        subprocess.run(words, capture_output=True, check=True, env=dict(os.environ))

    def nothing() -> None:
        subprocess.run([sys.executable, "-c", ""], check=True)

    times = 3 if quick else 9
    row = "phytac --help"
    source = f"s of Python that does nothing; medians of {times}"
    table.add(row, median_of(ask, times), "s", median_of(nothing, times), source, "<= 0.5")
