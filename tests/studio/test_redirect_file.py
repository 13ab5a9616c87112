"""The studio opens in a browser, and no other user of the machine learns its token by that."""

import os
import re
import signal
import stat
import subprocess
import sys
import time
import webbrowser
from pathlib import Path

import pytest

from phytac_design.studio import redirect_file
from phytac_design.studio.redirect_file import opened_in_browser
from phytac_design.studio.server import StudioServer
from tests.studio.place import DESIGN

PHYTAC = "from phytac_design.cli.app import main; main()"
BROWSER = """#!/bin/sh
file="${1#file://}"
stat -c %a "$file" > seen.part
echo "$@" >> seen.part
cat "$file" >> seen.part
mv seen.part seen
"""
"""Stands in for a browser: notes its arguments and the file it was to show."""


@pytest.mark.parametrize(
    "sign", [pytest.param(signal.SIGTERM, marks=pytest.mark.long), signal.SIGINT]
)
def test_the_token_is_in_no_command_line_and_the_file_is_removed(
    tmp_path: Path, sign: signal.Signals
) -> None:
    browser = tmp_path / "browser"
    browser.write_text(BROWSER)
    browser.chmod(0o755)
    (tmp_path / "x.toml").write_text(DESIGN)
    process = subprocess.Popen(
        [sys.executable, "-c", PHYTAC, "studio", "x.toml"],
        cwd=tmp_path,
        env={**os.environ, "BROWSER": f"{browser} %s"},
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    try:
        line = process.stderr.readline()
        url = re.findall(r"http://\S+", line)[0]
        token = url.split("/")[-2]
        until = time.monotonic() + 20.0
        while not (tmp_path / "seen").exists():
            assert time.monotonic() < until
            time.sleep(0.02)
        mode, arguments, page = (tmp_path / "seen").read_text().split("\n", 2)
        assert mode == "600"
        assert arguments.startswith("file:///")
        assert token not in arguments
        assert url in page
        assert len(list(tmp_path.glob("phytac-studio-*"))) == 1
        process.send_signal(sign)
        assert process.wait(timeout=20.0) == (130 if sign == signal.SIGINT else -sign)
    finally:
        process.kill()
        process.stderr.close()
    assert list(tmp_path.glob("phytac-studio-*")) == []


def test_a_folder_that_cannot_be_written_is_no_obstacle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: bool(opened.append(url)))
    (tmp_path / "file").touch()
    with opened_in_browser("http://127.0.0.1:1/<&/", tmp_path / "file" / "no") as found:
        assert not found
        path = Path(opened[0].removeprefix("file://"))
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert "<&" not in path.read_text()
    assert not path.exists()


def test_a_browser_gets_from_the_file_to_the_studio(
    running: StudioServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A browser calls the file another site than the studio."""
    from tests.studio.test_page import CHROMIUM, PLAIN, playwright

    opened: list[str] = []
    monkeypatch.setattr(redirect_file.webbrowser, "open", opened.append)
    with (
        opened_in_browser(running.url, tmp_path),
        playwright.sync_playwright() as play,
        play.chromium.launch(executable_path=CHROMIUM, args=PLAIN) as browser,
    ):
        page = browser.new_page()
        page.goto(opened[0])
        page.wait_for_url(running.url, timeout=20_000.0)
        page.locator("body[data-drafts]").wait_for(timeout=20_000.0)
