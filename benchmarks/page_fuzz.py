"""A million corrupt files over all readers: only ``PhytacError`` may be raised, and soon.

Inputs are numbered: the same number is the same input.
``python -m benchmarks.page_fuzz --reader NAME --input NUMBER`` repeats one.
"""

import math
import random
import resource
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.harness import Table, argument_parser
from benchmarks.page_fuzz_readers import READERS, Files, Reader
from phytac_shapes.errors import PhytacError

INPUTS, QUICK = 1_000_000, 2_800
SECONDS_MAX = 2.0
"""Processor time that an input may take."""
ENDED_S = 20.0
"""Wall time after which an input is given up."""
MEMORY_MAX = 500 << 20
"""Bytes that the process may grow by."""
MESSAGE_MAX = 20_000
TURNS = 3
"""Times that an input is read until it is called slow: a busy machine lends its time to others."""
SHOWN = 300
MEMORY = Path("/dev/shm")  # noqa: S108 - folders in it have names of their own


class Hang(BaseException):
    """An input took too long."""


@dataclass
class FuzzCounts:
    """What became of a reader's inputs."""

    read: int = 0
    refused: int = 0
    cpu_s: float = 0.0
    slowest_s: float = 0.0
    faults: list[str] = field(default_factory=list)

    @property
    def inputs(self) -> int:
        """Number of them."""
        return self.read + self.refused + len(self.faults)


@contextmanager
def little_memory(grow: int = MEMORY_MAX) -> Iterator[None]:
    """Let this process grow by no more than so many bytes; beyond, it gets a MemoryError."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + grow, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextmanager
def little_time(seconds: float) -> Iterator[None]:
    """End what takes longer than so many seconds of wall time with :class:`Hang`."""

    def stop(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def fault_of(
    work: Callable[[], Any], *, seconds: float = ENDED_S
) -> tuple[str | None, bool, float]:
    """What is wrong with how a reader ended (None for nothing), whether it read, and seconds.

    What was slow is tried again; the quickest turn counts.
    """
    slow: tuple[str | None, bool, float] = (None, False, math.inf)
    for _ in range(TURNS):
        fault, done, spent = _ended(work, seconds)
        if fault is not None or spent <= SECONDS_MAX:
            return fault, done, spent
        slow = min(slow, (f"{spent:.1f} s of processor time", done, spent), key=lambda one: one[2])
    return slow


def _ended(work: Callable[[], Any], seconds: float) -> tuple[str | None, bool, float]:
    """The same of one turn, however long it took."""
    begin = time.process_time()
    fault, done = None, False
    try:
        with little_time(seconds):
            work()
        done = True
    except PhytacError as error:
        size = len(str(error))
        fault = f"a message of {size} letters" if size > MESSAGE_MAX else None
    except Hang:
        fault = f"no end within {seconds:g} s"
    except Exception as error:  # noqa: BLE001 - every other one is what is looked for
        fault = f"{type(error).__name__}: {error}"[:SHOWN]
    return fault, done, time.process_time() - begin


class InputFolder:
    """A folder in which each input stands while it is read."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._there: Files = {}

    def put(self, files: Files) -> Path:
        """Write an input's files; what is the same as before stays."""
        for name in self._there.keys() - files.keys():
            (self._folder / name).unlink()
        for name, data in files.items():
            if self._there.get(name) != data:
                (self._folder / name).write_bytes(data)
        self._there = files
        return self._folder


def input_of(name: str, reader: Reader, number: int) -> Files:
    """Input of a number."""
    return reader.make(random.Random(f"{name} {number}"))  # noqa: S311 - nothing secret


def read_inputs(name: str, reader: Reader, numbers: range, place: InputFolder) -> FuzzCounts:
    """Read inputs of some numbers, one after the other."""
    out = FuzzCounts()
    begin = time.process_time()
    with little_memory():
        for number in numbers:
            at = place.put(input_of(name, reader, number))
            fault, done, seconds = fault_of(partial(reader.read, at))
            out.slowest_s = max(out.slowest_s, seconds)
            if fault is not None:
                out.faults.append(f"{name} {number}: {fault}")
            elif done:
                out.read += 1
            else:
                out.refused += 1
    out.cpu_s = time.process_time() - begin
    return out


def run(name: str, count: int) -> FuzzCounts:
    """Read inputs 0 to ``count``, in memory where there is a file system for that."""
    reader = READERS[name]()
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
        return read_inputs(name, reader, range(count), InputFolder(Path(folder)))


def counts(inputs: int) -> dict[str, int]:
    """Inputs of each reader, rounded up."""
    weights = {name: make().weight for name, make in READERS.items()}
    whole = sum(weights.values())
    return {name: -(-inputs * weight // whole) for name, weight in weights.items()}


def fuzz(table: Table, *, quick: bool) -> None:
    """Rows: inputs over all readers, faults, and each reader's rate."""
    chosen = counts(QUICK if quick else INPUTS)
    tallies = {name: run(name, count) for name, count in chosen.items()}
    faults = [fault for tally in tallies.values() for fault in tally.faults]
    row = "fuzz: corrupt inputs over all readers"
    source = f"{len(tallies)} readers"
    value = sum(tally.inputs for tally in tallies.values())
    table.add(row, value, "", INPUTS, source, f">= {QUICK if quick else INPUTS}")
    kinds = Counter(fault.split(": ", 2)[1] for fault in faults)
    row = "fuzz: inputs with a traceback, more than 2 s, 500 MB or 20 000 letters of message"
    source = "each input of its own"
    note = f"{dict(kinds)}; {faults[0]}" if faults else ""
    table.add(row, len(faults), "", 0, source, "== 0", note)
    row = "fuzz: slowest input"
    source = "processor time"
    slowest = max(tally.slowest_s for tally in tallies.values())
    table.add(row, slowest, "s", SECONDS_MAX, source, f"<= {SECONDS_MAX:g}")
    for name, tally in tallies.items():
        row = f"fuzz: {name}, inputs a second"
        source = f"{tally.inputs} inputs, {tally.read} read, {tally.refused} refused"
        table.add(row, tally.inputs / tally.cpu_s, "1/s", "-", source)


def main() -> None:
    """Repeat one input."""
    parser = argument_parser(__doc__ or "")
    parser.add_argument("--reader", required=True, choices=sorted(READERS))
    parser.add_argument("--input", type=int, required=True, help="number of the input")
    given = parser.parse_args()
    reader = READERS[given.reader]()
    with tempfile.TemporaryDirectory() as folder:
        at = InputFolder(Path(folder)).put(input_of(given.reader, reader, given.input))
        for path in at.iterdir():
            print(path.name, path.read_bytes()[:4000])
        reader.read(at)


if __name__ == "__main__":
    main()
