"""Whether a reader handles a malformed file as it must: ``PhytacError`` alone, soon, in bounds."""

import math
import random
import resource
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from phytac_shapes.errors import PhytacError
from tests.fuzz.readers import READERS, Files

SECONDS_MAX = 2.0
"""Processor time of one input."""


class Hang(BaseException):
    """An input took too long."""


@dataclass
class FuzzCounts:
    """Results of a reader's inputs: read, rejected, faults, and the slowest one."""

    read: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    faults: list[str] = field(default_factory=list)


@contextmanager
def little_memory(grow: int = 500 << 20) -> Iterator[None]:
    """Limit the growth of this process to so many bytes; beyond, it gets a MemoryError."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + grow, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextmanager
def little_time(seconds: float) -> Iterator[None]:
    """Raise :class:`Hang` after so many seconds of wall time."""

    def stop(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def fault_of(work: Callable[[], Any], *, seconds: float = 20.0) -> tuple[str | None, bool, float]:
    """Fault of a reader (None if it behaved), whether it read the file, and processor seconds.

    A slow run is repeated twice and the fastest counts, since a busy machine slows single runs.
    """
    slow: tuple[str | None, bool, float] = (None, False, math.inf)
    for _ in range(3):
        fault, done, spent = _run(work, seconds)
        if fault is not None or spent <= SECONDS_MAX:
            return fault, done, spent
        slow = min(slow, (f"{spent:.1f} s of processor time", done, spent), key=lambda one: one[2])
    return slow


def _run(work: Callable[[], Any], seconds: float) -> tuple[str | None, bool, float]:
    """The same of one run, however long it took."""
    begin = time.process_time()
    fault, done = None, False
    try:
        with little_time(seconds):
            work()
        done = True
    except PhytacError as error:
        size = len(str(error))
        fault = f"a message of {size} letters" if size > 20_000 else None
    except Hang:
        fault = f"no end within {seconds:g} s"
    except Exception as error:  # noqa: BLE001 - every other one is a fault
        fault = f"{type(error).__name__}: {error}"[:300]
    return fault, done, time.process_time() - begin


class InputFolder:
    """A folder that holds the files of one input at a time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._there: Files = {}

    def put(self, files: Files) -> Path:
        """Write an input's files; unchanged ones stay."""
        for name in self._there.keys() - files.keys():
            (self._folder / name).unlink()
        for name, data in files.items():
            if self._there.get(name) != data:
                (self._folder / name).write_bytes(data)
        self._there = files
        return self._folder


def read_inputs(name: str, numbers: Iterable[int], place: InputFolder) -> FuzzCounts:
    """Read inputs of a reader by their numbers; the same number is always the same input."""
    reader, out = READERS[name](), FuzzCounts()
    with little_memory():
        for number in numbers:
            rng = random.Random(f"{name} {number}")  # noqa: S311 - nothing secret
            at = place.put(reader.make(rng))
            fault, done, seconds = fault_of(partial(reader.read, at))
            out.slowest_s = max(out.slowest_s, seconds)
            if fault is not None:
                out.faults.append(f"{name} {number}: {fault}")
            elif done:
                out.read += 1
            else:
                out.refused += 1
    return out
