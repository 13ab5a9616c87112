"""Load cases in threads, whose solves with one factor are done together.

A solve with a sparse factor reads all of it: of 8 loads at a time each takes 0.4 times the time, of
32 a third (11,000 unknowns). Each load case waits in its solve until every other one has asked
for a solve, or has ended. What is solved together therefore does not depend on timing.
"""

import threading
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from typing import TypeVar

import numpy as np

from phytac_shapes.arrays import FloatArray

T = TypeVar("T")
Solve = Callable[[FloatArray], FloatArray]


class StoppedError(Exception):
    """The solves were stopped: nobody waits for the load case any more."""


class SharedSolves:
    """Solves of some threads, each round of which is one of many loads.

    Parameters
    ----------
    solve : callable
        Solves for loads (n, c).
    count : int
        Threads.
    """

    def __init__(self, solve: Solve, count: int) -> None:
        self._solve, self._running = solve, count
        self._changed = threading.Condition()
        self._asked: dict[int, FloatArray] = {}
        self._found: dict[int, FloatArray | Exception] = {}
        self._stopped = False

    def ask(self, number: int, load: FloatArray) -> FloatArray:
        """Return the solution (n,) for a load (n,) of one thread, once all others have asked."""
        with self._changed:
            self._asked[number] = load
            self._solve_if_all_wait()
            self._changed.wait_for(lambda: number in self._found or self._stopped)
            found = self._found.pop(number, StoppedError())
        if isinstance(found, Exception):
            raise found
        return found

    def leave(self) -> None:
        """A thread has ended."""
        with self._changed:
            self._running -= 1
            self._solve_if_all_wait()

    def stop(self) -> None:
        """End all threads at their next solve."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def _solve_if_all_wait(self) -> None:
        if self._stopped or not self._asked or len(self._asked) < self._running:
            return
        order = sorted(self._asked)
        found: list[FloatArray] | list[Exception]
        try:
            with np.errstate(all="ignore"):  # each thread checks its own numbers
                solved = self._solve(np.stack([self._asked[k] for k in order], axis=1))
            found = list(np.ascontiguousarray(solved.T))
        except Exception as error:  # noqa: BLE001  each waiting thread raises it
            found = [error] * len(order)
        self._found |= dict(zip(order, found, strict=True))
        self._asked.clear()
        self._changed.notify_all()


_OWN: ContextVar[tuple[Solve, SharedSolves, int] | None] = ContextVar("shared solves")


def shared(solve: Solve, load: FloatArray) -> FloatArray:
    """Return ``solve(load)``; together with those of other threads in :func:`side_by_side`."""
    own = _OWN.get(None)
    if own is None or own[0] != solve:
        return solve(load)
    return own[1].ask(own[2], load)


def side_by_side(solve: Solve, tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Return the results of tasks, in their order, whose :func:`shared` solves are done together.

    Raises
    ------
    Exception
        What the first of the tasks, in their order, raised.
    """
    if len(tasks) < 2:
        return [task() for task in tasks]
    solves = SharedSolves(solve, len(tasks))
    found: dict[int, T] = {}
    errors: dict[int, Exception] = {}

    def run(number: int, task: Callable[[], T]) -> None:
        _OWN.set((solve, solves, number))  # in the context of this thread alone
        try:
            found[number] = task()
        except Exception as error:  # noqa: BLE001  raised by the caller's thread, below
            errors[number] = error
        finally:
            solves.leave()

    # Daemons: an interrupted program does not wait for them.
    threads = [threading.Thread(target=run, args=each, daemon=True) for each in enumerate(tasks)]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    except BaseException:
        solves.stop()
        raise
    if errors:
        raise errors[min(errors)]
    return [found[number] for number in range(len(tasks))]
