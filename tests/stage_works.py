"""Stages for tests of their runner; light to import, as every worker process does."""

import os
import signal
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from phytac_design.core.cache_folder import cache_root
from phytac_design.engine.stage import Context, Stage, write_facts
from phytac_shapes.errors import DesignError


def meet(context: Context, folder: Path) -> None:
    """Wait for another process that runs this as well; the facts hold the number of this one."""
    place = cache_root().parent / "meeting"
    place.mkdir(exist_ok=True)
    (place / str(os.getpid())).touch()
    deadline = time.monotonic() + 60.0
    while len(list(place.iterdir())) < 2:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    write_facts(folder, {"process": os.getpid()})


def add(context: Context, folder: Path) -> None:
    """One more than the sum of the stages before."""
    numbers = [context.facts(name)["number"] for name in sorted(context.folders)]
    context.progress(f"adding {len(numbers)} numbers")
    write_facts(folder, {"number": 1 + sum(numbers)})


def leave_out(context: Context, folder: Path) -> None:
    """Make nothing, and say why."""
    context.progress("a: left out (no room)")
    write_facts(folder, {"a_left_out": "no room"})


def fail(context: Context, folder: Path) -> None:
    """Fail, but not at once."""
    (folder / "half.txt").write_text("half")
    time.sleep(0.5)
    raise DesignError("thing-bad", "the thing is bad (got 1); make it good")


def fail_at_once(context: Context, folder: Path) -> None:
    """Fail before others do."""
    raise ValueError("a fault of the program")


def wait(context: Context, folder: Path) -> None:
    """Take longer than a test."""
    (folder / "half.txt").write_text("half")
    context.progress(f"process {os.getpid()}")
    time.sleep(60.0)


def die(context: Context, folder: Path) -> None:
    """As if the system had stopped it."""
    (folder / "half.txt").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)


def refusal(context: Context) -> str:
    """Gate that stops every build."""
    return "not good enough"


def graph(**works: tuple[Callable[[Context, Path], None], Sequence[str]]) -> list[Stage]:
    """Stages by name, each with what it runs and what it depends on."""
    return [
        Stage(name=name, design_fields=(), run=work, depends_on=tuple(needs))
        for name, (work, needs) in works.items()
    ]
