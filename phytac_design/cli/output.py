"""What the commands print, and how a long one ends."""

import json
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import typer

from phytac_design.cli.options import say


def print_json(facts: Any) -> None:
    """JSON on standard output; figures that do not exist are null."""
    from phytac_design.core.json_values import finite

    typer.echo(json.dumps(finite(facts), indent=1, ensure_ascii=False))


def names_of(text: str) -> list[str]:
    """Names in a list with commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def next_step(text: str) -> None:
    """Last line of a command: what to run or do now."""
    typer.echo(f"next: {text}")


def seldom(seconds: float = 3.0) -> Callable[[str], None]:
    """Progress of quick steps: lines that come sooner after another one are left out."""
    last = float("-inf")

    def report(text: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= seconds:
            last = now
            say(text)

    return report


class TimeLimitError(BaseException):
    """Time is up; no Exception, so that no handler of the code that runs takes it for its own."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise TimeLimitError after so many seconds; without signals (Windows, a thread) never."""
    on_time = hasattr(signal, "SIGALRM") and threading.current_thread() is threading.main_thread()
    if not on_time:
        yield
        return

    def stop(*_: object) -> None:
        raise TimeLimitError(f"not done within {seconds:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def resumable(note: str = "stopped; run the same command again to resume") -> Iterator[None]:
    """Ctrl-C ends the command, with a note, such as that it can be resumed."""
    try:
        yield
    except KeyboardInterrupt:
        say(note)
        raise typer.Exit(130) from None
