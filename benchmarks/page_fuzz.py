"""A million spoilt files over all readers: only ``PhytacError`` may come out, and soon.

Part of ``python -m benchmarks.page``. Inputs are numbered: the same number is the same input. What
is done lies in a journal below ``$PHYTAC_DATA`` (or the system's temporary folder), so that a run
that was stopped goes on. ``python -m benchmarks.page_fuzz --reader NAME --input NUMBER`` repeats
one.
"""

import json
import math
import os
import random
import resource
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.harness import Table, argument_parser
from benchmarks.page_fuzz_readers import READERS, Files, Reader
from benchmarks.page_fuzz_step import outcomes
from phytac_shapes.errors import PhytacError

INPUTS, QUICK = 1_000_000, 2_800
SECONDS_MAX = 2.0
"""Processor time that an input may take."""
ENDED_S = 20.0
"""Wall time after which an input is given up."""
MEMORY_MAX = 500 << 20
"""Bytes that the process may grow by."""
MESSAGE_MAX = 20_000
SLICE = 2_000
TURNS = 3
"""Times that an input is read until it is called slow: a busy machine lends its time to others."""
STEPS, STEPS_QUICK = (2_000, 400.0), (30, 20.0)
"""STEP files, and the seconds that they may take together."""
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

    def add(self, other: "FuzzCounts") -> None:
        """Count another's as well."""
        self.read += other.read
        self.refused += other.refused
        self.cpu_s += other.cpu_s
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.faults += other.faults


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


def run(name: str, count: int, journal: Path | None, *, until: float = float("inf")) -> FuzzCounts:
    """Read inputs 0 to ``count``; what the journal holds is not read again."""
    total, done = FuzzCounts(), 0
    if journal is not None and journal.is_file():
        for line in journal.read_text().splitlines():
            with suppress(ValueError, KeyError, TypeError):
                entry = json.loads(line)
                if entry.pop("first") == done:
                    total.add(FuzzCounts(**entry))
                    done = total.inputs
    if done >= count:
        return total
    reader = READERS[name]()
    folder = Path(tempfile.mkdtemp(dir=MEMORY if MEMORY.is_dir() else None))
    try:
        place = InputFolder(folder)
        while done < count and time.monotonic() < until:
            piece = read_inputs(name, reader, range(done, min(done + SLICE, count)), place)
            if journal is not None:
                with journal.open("a") as file:
                    file.write(json.dumps({"first": done} | asdict(piece)) + "\n")
            total.add(piece)
            done += piece.inputs
    finally:
        shutil.rmtree(folder)
    return total


def journal_of(name: str) -> Path:
    """Where a reader's journal is."""
    folder = Path(os.environ.get("PHYTAC_DATA", tempfile.gettempdir())) / "page_fuzz"
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{name.replace(' ', '_')}.jsonl"


def counts(inputs: int) -> dict[str, int]:
    """Inputs of each reader, rounded up."""
    weights = {name: make().weight for name, make in READERS.items()}
    whole = sum(weights.values())
    return {name: -(-inputs * weight // whole) for name, weight in weights.items()}


def fuzz(table: Table, *, quick: bool) -> None:
    """Rows: inputs over all readers, faults, and each reader's rate."""
    tallies = {
        name: run(name, count, None if quick else journal_of(name))
        for name, count in counts(QUICK if quick else INPUTS).items()
    }
    faults = [fault for tally in tallies.values() for fault in tally.faults]
    table.add(
        "fuzz: spoilt inputs over all readers",
        sum(tally.inputs for tally in tallies.values()),
        "",
        reference=INPUTS,
        source=f"{len(tallies)} readers",
        target=f">= {QUICK if quick else INPUTS}",
    )
    kinds = Counter(fault.split(": ", 2)[1] for fault in faults)
    table.add(
        "fuzz: inputs with a traceback, more than 2 s, 500 MB or 20 000 letters of message",
        len(faults),
        "",
        reference=0,
        source="each input of its own",
        target="== 0",
        note=f"{dict(kinds)}; {faults[0]}" if faults else "",
    )
    table.add(
        "fuzz: slowest input",
        max(tally.slowest_s for tally in tallies.values()),
        "s",
        reference=SECONDS_MAX,
        source="processor time",
        target=f"<= {SECONDS_MAX:g}",
    )
    _step_rows(table, quick=quick)
    for name, tally in tallies.items():
        table.add(
            f"fuzz: {name}, inputs a second",
            tally.inputs / tally.cpu_s,
            "1/s",
            reference="-",
            source=f"{tally.inputs} inputs, {tally.read} read, {tally.refused} refused",
        )


def _step_rows(table: Table, *, quick: bool) -> None:
    """STEP apart: OpenCASCADE crashes on some files, so that it has a process of its own."""
    found, rate = outcomes(*STEPS_QUICK if quick else STEPS)
    source = f"{found.total()} files, {rate:.1f} a second; each in a process of its own"
    kinds = {
        "read": "read",
        "refused": "refused in words",
        "crashed": "that crash OpenCASCADE, refused as such",
        "no end": "without an end, stopped and refused as such",
    }
    for kind, case in kinds.items():
        table.add(f"fuzz: STEP files {case}", found[kind], "", reference="-", source=source)
    others = [kind for kind in found if kind not in kinds]
    table.add(
        "fuzz: STEP files with any other end",
        sum(found[kind] for kind in others),
        "",
        reference=0,
        source=source,
        target="== 0",
        note=others[0][:SHOWN] if others else "",
    )


def main() -> None:
    """Repeat one input, or work on the journals for some time."""
    parser = argument_parser(__doc__ or "")
    parser.add_argument("--reader", default="", help="one reader")
    parser.add_argument("--input", type=int, default=-1, help="its input of this number")
    parser.add_argument("--count", type=int, default=0, help="inputs of that reader, no journal")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="end after this time")
    given = parser.parse_args()
    if given.input >= 0:
        reader = READERS[given.reader]()
        with tempfile.TemporaryDirectory() as folder:
            at = InputFolder(Path(folder)).put(input_of(given.reader, reader, given.input))
            for path in at.iterdir():
                print(path.name, path.read_bytes()[:4000])
            reader.read(at)
        return
    until = time.monotonic() + given.seconds
    for name, count in counts(INPUTS).items():
        if given.reader in ("", name):
            tally = run(
                name, given.count or count, None if given.count else journal_of(name), until=until
            )
            rate = tally.inputs / max(tally.cpu_s, 1e-9)
            print(name, tally.inputs, "inputs", tally.read, "read", f"{rate:.0f}/s", flush=True)
            print(f"  slowest {tally.slowest_s:.3f} s, faults {len(tally.faults)}", flush=True)
            for fault in tally.faults[:12]:
                print("  ", fault, flush=True)


if __name__ == "__main__":
    main()
