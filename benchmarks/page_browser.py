"""A page in headless Chromium with software GL: paint, drawing, errors, requests, accessibility."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, sync_playwright

from phytac_shapes.errors import MissingPartError

WAIT_MS = 120_000
DESKTOP, PHONE = (1280, 900), (390, 844)
PAINT = "performance.getEntriesByName('first-contentful-paint')[0].startTime / 1000"
TURN = """async turns => {
  const { shell } = document.querySelector('.explorer').explorer, holder = shell.canvas.parentNode;
  const start = performance.now();
  for (let k = 0; k < turns; k++) {
    const before = holder.dataset.drawn;
    shell.turn(0.1, 0);
    while (holder.dataset.drawn === before) await new Promise(requestAnimationFrame);
  }
  return (performance.now() - start) / turns;
}"""


@dataclass(kw_only=True)
class PageMetrics:
    """Measurements of a page in a browser.

    Attributes
    ----------
    paint_s, ready_s : float
        From its opening to the first contentful paint, and until all scripts are done.
    turn_ms : float
        A turn of the shell, until it is drawn.
    errors, foreign : list of str
        Errors on the console, and requested addresses outside of the page.
    serious : list of str
        Rules of axe-core that it breaks seriously or critically.
    wide_px : int
        Excess of its width over the window's.
    """

    paint_s: float = 0.0
    ready_s: float = 0.0
    turn_ms: float = 0.0
    errors: list[str] = field(default_factory=list)
    foreign: list[str] = field(default_factory=list)
    serious: list[str] = field(default_factory=list)
    wide_px: int = 0


@contextmanager
def chromium() -> Iterator[Browser]:
    """Headless Chromium of the system.

    Raises
    ------
    MissingPartError
        If there is none.
    """
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next(filter(None, map(shutil.which, names)), None)
    if program is None:
        raise MissingPartError(
            "missing-library", "no Chromium on this machine; tools/system-packages.sh installs it"
        )
    flags = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=flags)
        yield browser
        browser.close()


@contextmanager
def opened(browser: Browser, url: str, size: tuple[int, int]) -> Iterator[tuple[Page, PageMetrics]]:
    """Open an address in a window of its own; its errors and requests are recorded."""
    context = browser.new_context(viewport={"width": size[0], "height": size[1]})
    context.set_default_timeout(WAIT_MS)
    page = context.new_page()
    seen = PageMetrics()
    page.on("console", lambda m: seen.errors.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda error: seen.errors.append(str(error)))

    def note(request: Any) -> None:
        if not request.url.startswith((url, "data:", "blob:")):
            seen.foreign.append(request.url)

    page.on("request", note)
    page.goto(url, timeout=WAIT_MS)
    yield page, seen
    context.close()


@contextmanager
def shown(
    browser: Browser, path: Path, size: tuple[int, int]
) -> Iterator[tuple[Page, PageMetrics]]:
    """Open a report from disk until all its scripts are done."""
    with opened(browser, path.resolve().as_uri(), size) as (page, seen):
        page.wait_for_selector("html[data-ready]", state="attached")
        seen.ready_s = float(page.evaluate("performance.now() / 1000"))
        seen.paint_s = float(page.evaluate(PAINT))
        yield page, seen


def serious_findings(page: Page) -> list[str]:
    """Rules of axe-core that a page breaks seriously or critically."""
    found = Axe().run(page).response["violations"]
    return [rule["id"] for rule in found if rule["impact"] in {"serious", "critical"}]


def inspect(browser: Browser, path: Path, size: tuple[int, int] = DESKTOP) -> PageMetrics:
    """Open a report and use all its controls."""
    with shown(browser, path, size) as (page, seen):
        seen.turn_ms = float(page.evaluate(TURN, 20))
        select = page.get_by_label("Colour by").first
        for option in select.locator("option").all():
            select.select_option(str(option.get_attribute("value")))
        page.locator(".map circle").first.hover()
        for slider in page.locator(".press input").all():
            slider.fill("0")
        for summary in page.locator("summary").all():
            summary.click()
        wide = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        seen.wide_px = max(int(wide), 0)
        seen.serious = serious_findings(page)
    return seen
