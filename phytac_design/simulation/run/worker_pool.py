"""Many samples over worker processes: results as they come, whatever becomes of a process."""

import ctypes
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

from phytac_design.core.threads import THREADS, one_thread_each

AHEAD = 2
"""Samples waiting for each worker: enough to keep it busy, few enough to stop at once."""
DEATH_SIGNAL, KILL = 1, 9
WATCH_S = 1.0
_state: Any = None
"""What ``start`` made in this worker process."""


@dataclass(frozen=True, kw_only=True)
class Crew:
    """A way to work on samples.

    Attributes
    ----------
    start : callable
        ``start(*given)`` makes a worker's state, once in each process. A module's function.
    given : tuple
        Its arguments; pickled.
    work : callable
        ``work(state, index)`` does one sample and gives its facts. A module's function; nothing
        may pass from sample to sample.
    workers : int
        Processes; 0 works in the calling one, whatever becomes of it.
    """

    start: Callable[..., Any]
    given: tuple[Any, ...]
    work: Callable[[Any, int], Any]
    workers: int

    def run(self, indices: Iterable[int]) -> Iterator[tuple[int, Any]]:
        """(index, facts) of each sample as it is done; None for one that killed its process twice.

        Errors of ``start`` and ``work`` are raised here.
        """
        todo = list(indices)
        if self.workers == 0:
            state = self.start(*self.given) if todo else None
            yield from ((index, self.work(state, index)) for index in todo)
            return
        with one_thread_each(THREADS):
            done: set[int] = set()
            for index, facts in self._pool(todo, self.workers):
                done.add(index)
                yield index, facts
            # A process that dies takes the samples waiting in its pool with it: each gets its own.
            for index in [k for k in todo if k not in done]:
                alone = dict(self._pool([index], 1))
                yield index, alone.get(index)

    def _pool(self, todo: list[int], workers: int) -> Iterator[tuple[int, Any]]:
        queue = iter(todo)
        context = get_context("spawn")
        count = max(1, min(workers, len(todo)))
        given = (os.getpid(), self.start, self.given)
        pool = ProcessPoolExecutor(count, context, _begin, given)
        running: dict[Future[Any], int] = {}
        try:
            while True:
                for index in _some(queue, AHEAD * count - len(running)):
                    running[pool.submit(_do, self.work, index)] = index
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        except BrokenProcessPool:
            return
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _some(queue: Iterator[int], count: int) -> Iterator[int]:
    for _, index in zip(range(count), queue, strict=False):
        yield index


def _begin(parent: int, start: Callable[..., Any], given: tuple[Any, ...]) -> None:
    """Make this worker's state; end with the parent, however that ends."""
    global _state  # noqa: PLW0603  the initialiser of a pool has nowhere else to leave its state
    _end_with(parent)
    try:
        _state = start(*given)
    except Exception as error:  # noqa: BLE001  a pool only says that its initialiser failed
        _state = error


def _do(work: Callable[[Any, int], Any], index: int) -> Any:
    if isinstance(_state, Exception):
        raise _state
    return work(_state, index)


def _end_with(parent: int) -> None:
    """End this process when its parent is killed: at once on Linux, else within a second."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(DEATH_SIGNAL, KILL)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
