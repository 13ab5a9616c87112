"""A headless Chromium, and pages in it that note what goes wrong and what is fetched."""

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
WAIT_MS = 120_000
"""Longest wait for anything: machines under load are slow, and software draws."""


@dataclass
class Tab:
    """A page, what its console said of errors, and the addresses that it fetched."""

    page: Page
    errors: list[str] = field(default_factory=list)
    fetched: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.fetched.append(request.url))

    @property
    def foreign(self) -> list[str]:
        """Addresses outside of the page: all but itself and what it holds."""
        own = self.page.url.partition("#")[0]
        kept = ("data:", "blob:", own)
        return [url for url in self.fetched if not url.startswith(kept)]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium of the system; a machine of continuous integration must have one."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        assert os.environ.get("CI") != "true", "no Chromium; tools/system-packages.sh installs it"
        pytest.skip("no Chromium: apt-get install chromium")
    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=program, args=FLAGS, timeout=WAIT_MS)
        yield started
        started.close()


@pytest.fixture(scope="module")
def opened(browser: Browser) -> Iterator[Callable[..., Tab]]:
    """Open a file from disk in a window of its own, and wait until its scripts are done."""
    contexts = []

    def open_file(
        path: Path,
        size: tuple[int, int] = (900, 700),
        *,
        scripts: bool = True,
        before: str = "",
    ) -> Tab:
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, java_script_enabled=scripts
        )
        contexts.append(context)
        context.set_default_timeout(WAIT_MS)
        if before:
            context.add_init_script(before)
        tab = Tab(context.new_page())
        tab.page.goto(path.as_uri(), timeout=WAIT_MS)
        if scripts:
            tab.page.wait_for_selector("html[data-ready]", state="attached")
        return tab

    yield open_file
    for context in contexts:
        context.close()
