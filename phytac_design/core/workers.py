"""Tasks over worker processes: results as they come; a crash or a hang costs one task.

Workers have one BLAS thread each. On Linux they are forked from a server process, which has one
thread and has imported the module of the first pool's function; elsewhere they are spawned.
Scripts that use a pool must guard their own start with ``if __name__ == "__main__":``.
"""

import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import connection, get_context, parent_process
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, Self

from phytac_design.core.threads import PRELOAD, THREADS, one_thread_each

START_S = 60.0
"""Added to the time limit of a new process's first task, for its imports."""


@dataclass(frozen=True, kw_only=True)
class TaskResult:
    """What became of one task.

    Attributes
    ----------
    index : int
        Position of the task among those of the call.
    value : Any
        What the function returned; None where it did not return.
    lost : str
        Why it did not return: its process died or ran out of time. Else empty.
    """

    index: int
    value: Any = None
    lost: str = ""


_SERVER = threading.Lock()
_served: set[int] = set()
"""Number of this process once it has a server: a worker that starts workers has one of its own."""


def import_ahead(module: str) -> bool:
    """Begin to import what workers will need, in the server, while this process does other things.

    Without effect where the server runs already. Returns whether there is one: there is none on
    systems other than Linux, and where its socket cannot be made (`TMPDIR` may be too long).
    """
    if sys.platform != "linux":
        return False
    from multiprocessing import forkserver, resource_tracker

    with _SERVER:
        if os.getpid() not in _served:
            resource_tracker.ensure_running()  # which unblocks Ctrl-C as it starts
            forkserver.set_forkserver_preload(["phytac_design.core.preloaded"])
            # It finds modules where this process does.
            named = os.pathsep.join([module, os.environ.get("PYTHONPATH", "")])
            try:
                with _starting(**{PRELOAD: named}, PYTHONPATH=os.pathsep.join(sys.path)):
                    forkserver.ensure_running()
            except OSError:
                return False
            _served.add(os.getpid())
        return True


@contextmanager
def _starting(**variables: str) -> Iterator[None]:
    """Environment in which a server or a worker starts, with some more variables."""
    # Until it ignores Ctrl-C, see `_serve`: one that comes while it imports would print a
    # traceback.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with one_thread_each(**{THREADS: "1"}, **variables):
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


class WorkerPool:
    """Processes that run one function on many tasks; use it as a context manager.

    Functions are those of a module, because they are pickled by name; tasks, values and errors are
    pickled. Processes are started when they are first needed and kept until the pool is closed.

    Parameters
    ----------
    work : callable
        ``work(state, task)`` does one task.
    workers : int
        Processes; 0 works in the calling one, without time limits.
    start : callable, optional
        ``start(*arguments)`` makes the state of a process, once; the state is None without it.
    arguments : sequence
        Of ``start``.
    time_limit_s : callable, optional
        Seconds that a task may take, by the task.
    retries : int
        How often a task is repeated whose process died. It then runs alone, after all others.
    tasks_per_process : int, optional
        Tasks after which a process is replaced by a new one.
    """

    def __init__(
        self,
        work: Callable[[Any, Any], Any],
        *,
        workers: int,
        start: Callable[..., Any] | None = None,
        arguments: Sequence[Any] = (),
        time_limit_s: Callable[[Any], float] | None = None,
        retries: int = 1,
        tasks_per_process: int | None = None,
    ) -> None:
        self.work, self.start, self.arguments = work, start, tuple(arguments)
        self.workers, self.retries, self.tasks_per_process = workers, retries, tasks_per_process
        self.time_limit_s = time_limit_s
        self._processes: list[_Process] = []
        self._unused, self._count = list(range(workers)), workers
        """Numbers of processes that may be started, and the next number."""
        self._states: list[Any] = []

    def __enter__(self) -> Self:
        """Return the pool."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Kill all processes."""
        while self._processes:
            self._processes.pop().stop()

    def run(
        self, tasks: Iterable[Any], *, note: Callable[[int, Any], None] = lambda *_: None
    ) -> Iterator[TaskResult]:
        """Results in the order in which they arrive; tasks are taken when a worker is free.

        Parameters
        ----------
        tasks : iterable
            None among them: no other task is ready before the next result has arrived. A
            :class:`Assigned` one goes to a certain one of the workers in :meth:`free`. Neither
            is for ``workers = 0``.
        note : callable
            Called with the index of a task and what its worker passed to :func:`send_note`.

        Raises
        ------
        Exception
            Whatever ``start`` or ``work`` raised.
        """
        if self.workers == 0:
            for index, task in enumerate(tasks):
                if not self._states:
                    self._states.append(self.start(*self.arguments) if self.start else None)
                yield TaskResult(index=index, value=self.work(self._states[0], task))
            return
        queue = _numbered(tasks)
        retries: deque[_Task] = deque()
        try:
            while busy := self._busy(queue) or self._busy(_first(retries)):
                for process in _ready(busy):
                    if process.noted(note):
                        continue
                    task, result = process.result()
                    if process.dead or process.tasks == self.tasks_per_process:
                        self._drop(process)
                    if process.dead and task.attempts <= self.retries:
                        retries.append(replace(task, worker=None))
                    else:
                        yield result
        finally:
            for process in [process for process in self._processes if process.task]:
                self._drop(process)

    def _busy(self, queue: Iterator["_Task | None"]) -> list["_Process"]:
        """Give out tasks to free workers; all processes that have one."""
        while (free := self.free()) and (task := next(queue, None)):
            number = free[0] if task.worker is None else task.worker
            if number not in free:
                raise ValueError(f"worker {number} is not free")
            if number in self._unused:
                self._unused.remove(number)
                self._processes.append(_Process(self.start, self.arguments, self.work, number))
            process = next(each for each in self._processes if each.number == number)
            process.give(task, self.time_limit_s)
        return [process for process in self._processes if process.task]

    def free(self) -> list[int]:
        """Numbers of the workers without a task: processes that run, then those to be started."""
        return [each.number for each in self._processes if each.task is None] + self._unused

    def _drop(self, process: "_Process") -> None:
        """End a process; one with a new number may take its place."""
        process.stop()
        self._processes.remove(process)
        self._unused.append(self._count)
        self._count += 1


class Assigned(NamedTuple):
    """A task for a certain worker of :meth:`WorkerPool.free`, or for any (None)."""

    worker: int | None
    task: Any


def send_note(value: Any) -> None:
    """Pass a value to the ``note`` of :meth:`WorkerPool.run`, from a task on one of its workers."""
    _Process.own_pipe.send(_Note(value))


@dataclass(frozen=True)
class _Note:
    value: Any


def _numbered(tasks: Iterable[Any]) -> Iterator["_Task | None"]:
    index = 0
    for task in tasks:
        if task is None:
            yield None
        else:
            given = task if isinstance(task, Assigned) else Assigned(None, task)
            yield _Task(index, given.task, given.worker)
            index += 1


def _first(queue: deque["_Task"]) -> Iterator["_Task"]:
    if queue:
        yield queue.popleft()


@dataclass
class _Task:
    index: int
    task: Any
    worker: int | None = None
    attempts: int = 0


class _Process:
    """A worker process, its pipe, and the task that it works on."""

    own_pipe: Connection
    """In a worker: its pipe to the process that started it."""

    def __init__(
        self,
        start: Callable[..., Any] | None,
        arguments: tuple[Any, ...],
        work: Callable[[Any, Any], Any],
        number: int,
    ) -> None:
        self.number = number
        forked = import_ahead(work.__module__)
        context: Any = get_context("forkserver" if forked else "spawn")
        self.pipe, other = context.Pipe()
        with _starting():
            # Unpickled, and so imported, in the environment of now.
            given = pickle.dumps((start, arguments, work))
            arguments = (other, dict(os.environ), given)
            self.process = context.Process(target=_serve, args=arguments)
            self.process.start()
        other.close()
        self.task: _Task | None = None
        self.tasks, self.dead = 0, False
        self.limit_s = self.deadline = float("inf")
        self._answer: Any = None

    def give(self, task: _Task, time_limit_s: Callable[[Any], float] | None) -> None:
        """Send a task."""
        if time_limit_s:
            self.limit_s = time_limit_s(task.task)
            self.deadline = time.monotonic() + self.limit_s + (0.0 if self.tasks else START_S)
        self.task = task
        task.attempts += 1
        self.tasks += 1
        # A process that died at its start has closed its pipe: result() finds that.
        with suppress(BrokenPipeError, ConnectionResetError):
            self.pipe.send(task.task)

    def noted(self, note: Callable[[int, Any], None]) -> bool:
        """Pass on a note; False if what has arrived, or is overdue, is the result."""
        self._answer = None
        if not self.pipe.poll():
            return False
        try:
            self._answer = self.pipe.recv()
        except (EOFError, OSError):
            self.dead = True
        if not isinstance(self._answer, _Note) or self.task is None:
            return False
        note(self.task.index, self._answer.value)
        return True

    def result(self) -> tuple[_Task, TaskResult]:
        """Result of the task, which has arrived or is overdue."""
        task, self.task = self.task, None
        if task is None:
            raise RuntimeError("this process has no task")
        if self.dead:
            self.process.join(5.0)  # for its exit code
            lost = f"its process died (exit code {self.process.exitcode}; out of memory?)"
            return task, TaskResult(index=task.index, lost=lost)
        if self._answer is None:
            self.dead, task.attempts = True, sys.maxsize
            return task, TaskResult(index=task.index, lost=f"no answer within {self.limit_s:g} s")
        value, error = self._answer
        if error is not None:
            raise error
        return task, TaskResult(index=task.index, value=value)

    def stop(self) -> None:
        """Kill the process."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _ready(busy: list[_Process]) -> list[_Process]:
    """Wait for those that have answered, died, or are overdue."""
    deadline = min(process.deadline for process in busy)
    timeout = None if deadline == float("inf") else max(deadline - time.monotonic(), 0.0)
    pipes = connection.wait([process.pipe for process in busy], timeout)
    now = time.monotonic()
    return [process for process in busy if process.pipe in pipes or now >= process.deadline]


def _serve(
    pipe: Connection,
    environment: Mapping[str, str],
    given: bytes,
) -> None:
    """Do tasks until the pipe closes; end with the parent, however that ends.

    Parameters
    ----------
    environment : mapping
        Of the parent; a server keeps the one in which it started.
    given : bytes
        What the pool was given, pickled: ``start``, ``arguments``, ``work``.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # The parent handles Ctrl-C and ends its workers.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    os.environ.update(environment)
    for name in set(os.environ) - set(environment):
        del os.environ[name]
    _Process.own_pipe = pipe
    threading.Thread(target=_end_with_parent, daemon=True).start()
    state: Any = None
    failure: Exception | None = None
    start, arguments, work = pickle.loads(given)  # noqa: S301  written by its parent
    try:
        state = start(*arguments) if start else None
    except Exception as error:  # noqa: BLE001  raised in the parent
        failure = error
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            answer = (work(state, task) if failure is None else None, failure)
        except Exception as error:  # noqa: BLE001  raised in the parent
            error.add_note(traceback.format_exc())
            answer = (None, error)
        pipe.send(answer)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
