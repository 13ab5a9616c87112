"""Progress of a build: plain lines, and on a terminal one line of what runs at the moment."""

import re
import time
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from phytac_design.cli.options import say


class BuildDisplay:
    """Shows the texts of a build's progress; use it as a context manager.

    Where standard error is a terminal, the last line shows how many stages have ended, the running
    ones, their seconds and the time left, and counters such as ``frames: 3 of 80`` alone.
    """

    def __init__(self) -> None:
        console = Console(stderr=True, highlight=False)
        terminal = console.is_terminal and not console.is_dumb_terminal
        self._live = Live(self, console=console, transient=True) if terminal else None
        self._begun: dict[str, float] = {}
        self._counter = self._ended = ""
        self._end = float("inf")

    def __enter__(self) -> Self:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live:
            self._live.stop()

    def __call__(self, text: str) -> None:
        """Show a text of progress."""
        if self._live is None:
            say(text)
            return
        now = time.monotonic()
        if left := re.search(r" \(about (\d+) s left\)$", text):
            self._end, text = now + float(left[1]), text[: left.start()]
        turn = re.match(r"\[(\d+)/(\d+)\] ([a-z-]+) (…)?", text)
        if turn:
            self._ended = f"{turn[1]} of {turn[2]} stages done"
            self._end = float("inf") if turn[1] == turn[2] else self._end
        if turn and turn[4]:
            self._begun[turn[3]] = now
            return
        if re.search(r": \d+ of \d+", text):
            self._counter = text
            return
        if turn:
            self._begun.pop(turn[3], None)
            self._counter = ""
        self._live.console.print(Text(text))

    def __rich__(self) -> Text:
        """Return the line of what runs at the moment."""
        now = time.monotonic()
        parts = [self._ended] if self._ended else []
        parts += [f"{name} {now - begun:.0f} s" for name, begun in self._begun.items()]
        parts += [self._counter] if self._counter else []
        if self._end < float("inf"):
            parts.append(_left_words(self._end - now))
        return Text("  " + " · ".join(parts), no_wrap=True, overflow="ellipsis")


def _left_words(left_s: float) -> str:
    """Time left, in words that never promise an end at once."""
    if left_s >= 5.0:
        return f"about {5.0 * round(left_s / 5.0):.0f} s left"
    return "some seconds left" if left_s > 0.0 else "longer than predicted"
