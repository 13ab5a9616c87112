"""Reports of a running stream, whose reader may have stopped reading."""

import contextlib
import os
import queue
import sys
import threading
import time
from typing import Self

from phytac_design.cli.options import say


class ConsoleReporter:
    """Lines on standard error, written by a thread of its own.

    A call returns at once, whatever is behind standard error: where a pipe is full or closed,
    reports are lost, and the stream continues.

    Parameters
    ----------
    waiting : int
        Reports that may wait for their reader; those that come after them go.
    flush_s : float
        At the end the last reports have this long to go out.
    """

    def __init__(self, waiting: int = 256, flush_s: float = 1.0) -> None:
        self.waiting, self.flush_s = waiting, flush_s
        self._waiting: queue.Queue[str | None] = queue.Queue(waiting)
        self._thread = threading.Thread(target=self._write, name="reports", daemon=True)
        self._thread.start()

    def __call__(self, text: str) -> None:
        """Write a line, unless too many wait already."""
        with contextlib.suppress(queue.Full):
            self._waiting.put_nowait(text)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        until = time.monotonic() + self.flush_s
        with contextlib.suppress(queue.Full):
            self._waiting.put(None, timeout=self.flush_s)
        self._thread.join(timeout=max(until - time.monotonic(), 0.0))

    def _write(self) -> None:
        while (text := self._waiting.get()) is not None:
            # A file that is closed is a ValueError.
            with contextlib.suppress(OSError, ValueError):
                _put(text)


def _put(text: str) -> None:
    """Write a line without Python's buffer: a thread that hangs in it would block the exit."""
    try:
        handle = sys.stderr.fileno()
    except (AttributeError, OSError):
        # None, or what stands in for it, such as in a test.
        say(text)
        return
    left = f"{text}\n".encode(sys.stderr.encoding, "backslashreplace")
    while left:
        left = left[os.write(handle, left) :]
