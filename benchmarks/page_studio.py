"""The studio in a browser: how fast views follow controls, saving, a build with its report."""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design

NAMES = ("chromium", "chromium-browser", "google-chrome")
SOFTWARE_GL = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
START = (
    "import typer; from phytac_design.cli.studio_command import studio; typer.run(studio)",
    "cylinder60",
    "--no-browser",
)
MOVES = 60
DRAGS = 10
STEPS = 40
"""Moves of a slider in a drag, a frame (16 ms) apart."""
PATIENCE_MS = 120_000.0
FIELDS: dict[str, tuple[float, float]] = {
    "spiral angle (°)": (30.0, 60.0),
    "diameter outer (mm)": (56.0, 66.0),
    "length (mm)": (100.0, 125.0),
    "rows": (16.0, 24.0),
    "height far (mm)": (8.0, 12.0),
    "focal (px)": (900.0, 1100.0),
}
"""Controls that are moved, and how far."""
DRAG = """async ([path, low, high, steps]) => {
  const slider = document.querySelector(`[data-path='${path}'] input[type=range]`);
  const before = studio.live.times.length;
  for (let k = 0; k < steps; k++) {
    slider.value = low + (high - low) * k / (steps - 1);
    slider.dispatchEvent(new Event("input"));
    await new Promise(done => setTimeout(done, 16));
  }
  const last = performance.now();
  while (document.body.dataset.state === "drawing") await new Promise(done => setTimeout(done, 5));
  return [performance.now() - last, studio.live.times.length - before];
}"""


@contextmanager
def running(root: Path) -> Iterator[str]:
    """Run a studio as a user does, in a process of its own; yields its address."""
    words = [sys.executable, "-c", *START]
    process = subprocess.Popen(words, cwd=root, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        found = re.search(r"http://\S+", process.stderr.readline())
        assert found is not None
        yield found[0]
    finally:
        process.terminate()
        process.wait(30.0)
        process.stderr.close()


def studio(table: Table, quick: bool) -> None:
    """Move controls of `cylinder60`, save it, build it as a draft; what the page asks and says."""
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, NAMES)), None)
    with (
        tempfile.TemporaryDirectory() as name,
        running(Path(name)) as url,
        sync_playwright() as driver,
    ):
        browser = driver.chromium.launch(executable_path=program, args=SOFTWARE_GL)
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.set_default_timeout(PATIENCE_MS)
        wrong: list[str] = []
        asked: list[str] = []
        page.on("console", lambda m: wrong.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        start = time.perf_counter()
        page.goto(url)
        _state(page, "checked")
        row = "studio: from the page's address to the first checked design"
        source = "cylinder60, compiled loops loaded on the way"
        table.add(row, time.perf_counter() - start, "s", "none", source)
        _moves(table, page, 12 if quick else MOVES)
        _drags(table, page, 3 if quick else DRAGS)
        # Back to a design that every stage of a build accepts.
        page.evaluate("while (studio.model.past.length) studio.model.undo()")
        page.evaluate("studio.model.set('layout.spiral_angle_deg', 50)")
        _state(page, "checked")
        _save(table, page, Path(name))
        _build(table, page, "small" if quick else "cylinder60")
        own = (url, "data:", "blob:")
        foreign = [address for address in asked if not address.startswith(own)]
        for what, found in (("console errors", wrong), ("outside requests", foreign)):
            row = f"studio: {what}"
            source = "project target"
            note = "; ".join(list(dict.fromkeys(found))[:3])
            table.add(
                row, len(found), "errors" if found is wrong else "requests", 0, source, "== 0", note
            )
        _axe(table, page)
        browser.close()


def _state(page: Any, state: str) -> None:
    page.locator(f"body[data-state='{state}']").wait_for()


def _moves(table: Table, page: Any, moves: int) -> None:
    """One change at a time, each drawn before the next, some while the check still runs."""
    rng = np.random.default_rng(0)
    before = page.evaluate("studio.live.times.length")
    names = list(FIELDS)
    for move in range(moves):
        name = names[move % len(names)]
        low, high = FIELDS[name]
        value = round(rng.uniform(low, high), 0 if name == "rows" else 2)
        drafts = page.evaluate("studio.live.times.length")
        page.get_by_label(name, exact=True).first.fill(f"{value:g}")
        page.locator(f"body:not([data-drafts='{drafts}'])").wait_for()
        page.wait_for_timeout(float(rng.uniform(50.0, 900.0)))
    times = np.array(page.evaluate("studio.live.times"))[before:] / 1000.0
    for share, target in ((50, None), (95, "<= 1")):
        row = f"studio: cylinder60, from a control's change to all views drawn, p{share}"
        source = f"project target; {len(times)} changes, 3-D drawn by software"
        table.add(row, float(np.percentile(times, share)), "s", 1, source, target)


def _drags(table: Table, page: Any, drags: int) -> None:
    """A slider drawn to and fro: how long after the last move all is drawn, and what is between."""
    late, drawn = [], []
    for drag in range(drags):
        ends = (40.0, 55.0) if drag % 2 else (55.0, 40.0)
        took, drafts = page.evaluate(DRAG, ["layout.spiral_angle_deg", *ends, STEPS])
        late.append(took / 1000.0)
        drawn.append(drafts)
    row = "studio: cylinder60, from a drag's last move to all views drawn, p95"
    source = f"project target; {drags} drags of {STEPS} moves in {0.016 * STEPS:.2g} s"
    table.add(row, float(np.percentile(late, 95)), "s", 1, source, "<= 1")
    row = "studio: drafts drawn during such a drag, mean"
    source = "same drags; a later move takes an earlier one's place"
    table.add(row, float(np.mean(drawn)), "drafts", "none", source)


def _save(table: Table, page: Any, root: Path) -> None:
    page.keyboard.press("Control+s")
    page.locator("#save-name").fill("saved.toml")
    page.locator("#save-text", has_text="spiral_angle_deg").wait_for(state="attached")
    start = time.perf_counter()
    page.get_by_role("button", name="Save", exact=True).click()
    page.locator("#save-dialog").wait_for(state="hidden")
    took = time.perf_counter() - start
    same = load_design(str(root / "saved.toml")).model_dump(mode="json") == page.evaluate(
        "studio.model.resolved"
    )
    source = "the file read again is the design in the page"
    table.add("studio: saving", took, "s", reference="none", source=source)
    table.add("studio: saved file is the design", int(same), "true", 1, source, "== 1")  # fmt: skip


def _build(table: Table, page: Any, what: str) -> None:
    """A draft build, started in the page, until its report shows in the page."""
    if what == "small":
        page.evaluate("studio.model.set('layout.rows', 6)")
        page.evaluate("studio.model.set('shape.length_mm', 50)")
        _state(page, "checked")
    start = time.perf_counter()
    page.get_by_role("button", name="Build", exact=True).click()
    page.locator("#build-state:not(:empty)").wait_for(timeout=1_200_000.0)
    said = page.locator("#build-state").inner_text()
    shown = 0
    if "is built" in said:
        frame = page.frame_locator("#report iframe")
        frame.locator("h1").first.wait_for()
        shown = int(frame.locator("h1").first.inner_text() != "")
    row = "studio: a draft build, from the button to its report in the page"
    source = "the changed cylinder60, empty or filled cache as it stands"
    table.add(row, time.perf_counter() - start, "s", "none", source)
    row = "studio: the build's report shows"
    source = "heading of the report in its frame"
    table.add(row, shown, "true", 1, source, "== 1", "" if shown else said)


def _axe(table: Table, page: Any) -> None:
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    serious = [item["id"] for item in found if item["impact"] in {"serious", "critical"}]
    row = "studio: serious findings of axe-core"
    table.add(row, len(serious), "findings", 0, "axe-core, all rules", "== 0", ", ".join(serious))
