"""The studio in a browser: latency of the views, saving, a build with its report."""

import re
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
from benchmarks.page_browser import DESKTOP, chromium, opened, serious_findings
from phytac_design.design.design_file import load_design

START = (
    "import typer; from phytac_design.cli.studio_command import studio; typer.run(studio)",
    "cylinder60",
    "--no-browser",
)
STEPS = 40
"""Moves of a slider in a drag, a frame (16 ms) apart."""
FIELDS: dict[str, tuple[float, float]] = {
    "spiral angle (°)": (30.0, 60.0),
    "diameter outer (mm)": (56.0, 66.0),
    "length (mm)": (100.0, 125.0),
    "rows": (16.0, 24.0),
    "height far (mm)": (8.0, 12.0),
    "focal (px)": (900.0, 1100.0),
}
"""Controls that are moved, and their ranges."""
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
    """Use the studio on `cylinder60`: move, repair, save, build; errors and foreign requests."""
    with (
        tempfile.TemporaryDirectory() as name,
        running(Path(name)) as url,
        chromium() as browser,
    ):
        start = time.perf_counter()
        with opened(browser, url, DESKTOP) as (page, seen):
            page.locator("body[data-drafts]").wait_for()
            row = "studio: from the page's address to its first picture"
            source = "project target; the first start, compiled loops loaded on the way"
            table.add(row, time.perf_counter() - start, "s", 2, source, "<= 2")
            _state(page, "checked")
            row = "studio: from the page's address to the first checked design"
            source = "cylinder60, compiled loops loaded on the way"
            table.add(row, time.perf_counter() - start, "s", "none", source)
            _moves(table, page, 12 if quick else 60)
            _drags(table, page, 3 if quick else 10)
            _repair(table, page)
            _shapes(table, page)
            # Back to a design that every stage of a build accepts.
            page.evaluate("while (studio.model.past.length) studio.model.undo()")
            page.evaluate("studio.model.set('layout.spiral_angle_deg', 50)")
            _state(page, "checked")
            _save(table, page, Path(name))
            _build(table, page, "small" if quick else "cylinder60")
            for what, unit, found in (
                ("console errors", "errors", seen.errors),
                ("outside requests", "requests", seen.foreign),
                ("serious findings of axe-core", "findings", serious_findings(page)),
            ):
                note = "; ".join(list(dict.fromkeys(found))[:3])
                row = f"studio: {what}"
                table.add(row, len(found), unit, 0, "project target", "== 0", note)


def _state(page: Any, state: str) -> None:
    page.locator(f"body[data-state='{state}']").wait_for()


def _moves(table: Table, page: Any, moves: int) -> None:
    """One change at a time, each drawn before the next one."""
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
    """A slider moved to and fro: latency after the last move, and views drawn meanwhile."""
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


def _repair(table: Table, page: Any) -> None:
    """Fuse markers, press the button, apply what it finds."""
    page.evaluate("studio.model.setAll({'layout.spiral_angle_deg': 10, 'layout.height_far_mm': 5})")
    page.locator("#repair").wait_for()
    start = time.perf_counter()
    page.get_by_role("button", name="Find a repair").click()
    page.get_by_role("button", name="Apply").click()
    took = time.perf_counter() - start
    page.locator("body:not([data-state='checked'])").wait_for()
    _state(page, "checked")
    fixed = page.locator("#verdict.bad").count() == 0
    row = "studio: fused markers, repaired by the change that the button finds"
    table.add(row, int(fixed), "", 1, f"found and applied in {took:.1f} s", "== 1")


def _shapes(table: Table, page: Any) -> None:
    """Choose each shape; its example's table takes the shape's place, and is drawn."""
    shapes = page.locator("[data-path='shape.kind'] select")
    kinds = [option for option in shapes.locator("option").all_inner_texts() if option]
    good = []
    for kind in kinds:
        page.evaluate("while (studio.model.past.length) studio.model.undo()")
        _state(page, "checked")
        if page.evaluate("studio.model.value('shape').kind") != kind:
            shapes.select_option(kind)
        page.locator("body[data-state='checked'], body[data-state='refused']").wait_for()
        good += [kind] * (page.locator("#verdict.bad").count() == 0)
    row = "studio: shapes that can be built as soon as they are chosen"
    note = "not: " + (", ".join(kind for kind in kinds if kind not in good) or "none")
    table.add(row, len(good), "shapes", len(kinds), "all", f">= {len(kinds)}", note)


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
    state = page.locator("#build-state").inner_text()
    shown = 0
    if "is built" in state:
        frame = page.frame_locator("#report iframe")
        frame.locator("h1").first.wait_for()
        shown = int(frame.locator("h1").first.inner_text() != "")
    row = "studio: a draft build, from the button to its report in the page"
    source = "the changed cylinder60, empty or filled cache as it stands"
    table.add(row, time.perf_counter() - start, "s", "none", source)
    row = "studio: the build's report shows"
    source = "heading of the report in its frame"
    table.add(row, shown, "true", 1, source, "== 1", "" if shown else state)
