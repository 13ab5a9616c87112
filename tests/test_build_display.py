"""The line of a build on a terminal: stages that have ended, those that run, and the time left."""

from types import SimpleNamespace
from typing import Any

import pytest

from phytac_design.cli.build_display import BuildDisplay


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A display on a terminal whose clock stands still, and the lines above it."""
    display, clock, lines = BuildDisplay(), SimpleNamespace(now=100.0), list[str]()
    console = SimpleNamespace(print=lambda text: lines.append(str(text)))
    monkeypatch.setattr(display, "_live", SimpleNamespace(console=console))
    monkeypatch.setattr("phytac_design.cli.build_display.time.monotonic", lambda: clock.now)
    return SimpleNamespace(display=display, clock=clock, lines=lines)


def line(shown: Any) -> str:
    return str(shown.display.__rich__()).strip()


def test_ended_stages_are_counted_and_running_ones_named(shown: Any) -> None:
    shown.display("[0/5] frames … (about 90 s left)")
    shown.display("[0/5] shell … (about 90 s left)")
    shown.clock.now += 12.0
    assert line(shown) == "0 of 5 stages done · frames 12 s · shell 12 s · about 80 s left"
    shown.display("frames: 3 of 80")
    shown.display("[1/5] shell 12.0 s (about 60 s left)")
    assert line(shown) == "1 of 5 stages done · frames 12 s · about 60 s left"
    assert shown.lines == ["[1/5] shell 12.0 s"]


def test_no_end_is_promised_while_a_stage_runs(shown: Any) -> None:
    shown.display("[3/4] report … (about 10 s left)")
    for later_s, words in ((4.0, "about 5 s left"), (4.0, "some seconds left"),
                           (40.0, "longer than predicted")):  # fmt: skip
        shown.clock.now += later_s
        assert line(shown).endswith(words)
    shown.display("[4/4] report 48.0 s")
    assert line(shown) == "4 of 4 stages done"
