"""Candidates evaluated by Dask: processes on this machine, or the workers of a cluster.

Only the driver writes files, so that a task may run twice: Dask runs the tasks of a dead worker
again; if the scheduler is lost, the driver waits for it and submits again what it has no result of.
Candidates that take less time than Dask needs for a task of its own are submitted in chunks.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from phytac_design.core.threads import THREADS
from phytac_design.engine.cache import code_hash
from phytac_design.study.search.successive_halving import (
    FAILED,
    Outcome,
    SerialPool,
    Task,
    keep_memory,
)
from phytac_shapes.errors import InputError, MissingPartError


@dataclass(frozen=True)
class DaskSettings:
    """Times in seconds."""

    chunk_s: float = 1.0
    """Processor time of a chunk: some hundred times what Dask needs for a task."""
    connect_s: float = 10.0
    reconnect_s: float = 120.0
    """How long a lost scheduler may take to come back."""
    workers_s: float = 120.0
    """How long to wait for a cluster's first worker."""
    allowed_failures: int = 10
    """Workers that may die over one task before it is given up."""


SETTINGS = DaskSettings()
_QUIET = {"distributed.admin.tick.interval": "500ms", "distributed.worker.profile.enabled": False}
"""Dask's own monitoring takes some 3 % of each process's time by default."""
WORKER_ENVIRONMENT = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", THREADS), "1"
) | {f"DASK_{name.upper().replace('.', '__')}": str(value) for name, value in _QUIET.items()}


def _libraries() -> tuple[Any, Any]:
    try:
        import dask
        import distributed
    except ImportError:
        raise MissingPartError(
            "--workers and --scheduler need dask; install it with: pip install "
            "'phytac-design[study]'"
        ) from None
    return dask, distributed


def run_chunk(tasks: tuple[Task, ...]) -> list[dict[str, Any]]:
    """Results of a chunk, on a worker."""
    keep_memory()
    return [task.run() for task in tasks]


class DaskPool(SerialPool):
    """A client of a scheduler: its own (``workers``) or a running one (``address``).

    Parameters
    ----------
    workers : int
        Processes to start on this machine, one thread each; 0 with an address.
    address : str
        Of a running scheduler, as ``tcp://host:8786``.
    say : callable
        Receives messages about waiting.

    Raises
    ------
    InputError
        If workers cannot be started, or the scheduler cannot be reached, has no worker, or one
        with another version of the program.
    """

    def __init__(
        self, *, workers: int = 0, address: str = "", say: Callable[[str], None] = lambda _: None
    ) -> None:
        (self.dask, self.library), self.say = _libraries(), say
        self.cluster: Any = None
        self.address = address
        self._seconds: defaultdict[tuple[str, ...], list[float]] = defaultdict(lambda: [0.0, 0.0])
        self._submitted: dict[str, tuple[tuple[Task, ...], Any]] = {}
        self._early: dict[str, Outcome] = {}
        if not address:
            try:
                with self.dask.config.set(_QUIET):
                    self.cluster = self.library.LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
                        processes=True,
                        dashboard_address=None,
                        silence_logs="ERROR",
                        env=WORKER_ENVIRONMENT,
                        # Any free port: another study may use the default one.
                        scheduler_kwargs={
                            "allowed_failures": SETTINGS.allowed_failures,
                            "dashboard_address": "127.0.0.1:0",
                        },
                    )
            except (RuntimeError, OSError, TimeoutError) as error:
                raise InputError(
                    f"{workers} workers could not be started ({error}); use fewer, or none"
                ) from None
            self.address = self.cluster.scheduler_address
        try:
            self.client = self._connect()
        except BaseException:
            if self.cluster is not None:
                self.cluster.close()
            raise

    def _connect(self) -> Any:
        """Client of the scheduler, once it has a worker that runs this version of the program."""
        try:
            with self.dask.config.set(_QUIET):
                client = self.library.Client(
                    self.address, timeout=SETTINGS.connect_s, set_as_default=False
                )
        except (OSError, TimeoutError, ValueError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                f"no scheduler at {self.address} ({reason}); start one with `dask scheduler`, or "
                "use --workers. Completed candidates are kept"
            ) from None
        self._completed = self.library.as_completed(loop=client.loop)
        self._submitted = {}
        if not client.scheduler_info(n_workers=-1)["workers"]:
            self.say(f"waiting for workers of {self.address} …")
        try:
            client.wait_for_workers(1, timeout=SETTINGS.workers_s)
        except (TimeoutError, OSError):
            raise InputError(
                f"the scheduler at {self.address} has no worker; start some with `dask worker "
                f"{self.address} --nthreads 1`"
            ) from None
        mine = code_hash()
        for worker, theirs in client.run(code_hash, on_error="return").items():
            if theirs != mine:
                why = theirs if isinstance(theirs, Exception) else "another version"
                raise InputError(
                    f"the worker {worker} does not run this program ({why}); install the same "
                    "version there"
                )
        return client

    @property
    def workers(self) -> int:
        """Threads that run tasks now."""
        return max(1, int(sum(self.client.nthreads().values())))

    def run(
        self, tasks: Iterable[Task], following: Iterable[Task] = ()
    ) -> Iterator[tuple[Task, Outcome]]:
        """Results as they come; every task once, however often a worker dies.

        Idle workers begin with the tasks ``following``; their results are given when they are
        tasks of a later call.
        """
        wanted, later = {task.key: task for task in tasks}, list(following)
        while wanted:
            for key in wanted.keys() & self._early.keys():
                yield wanted.pop(key), self._early.pop(key)
            with suppress(OSError, self.library.comm.core.CommClosedError, StopIteration):
                self._submit(wanted.values())
                self._submit(later)
                while wanted:
                    for task, outcome in self._next():
                        if task.key in wanted:
                            yield wanted.pop(task.key), outcome
                        else:
                            self._early[task.key] = outcome
            if wanted:
                self._reconnect()

    def _submit(self, tasks: Iterable[Task]) -> None:
        """Submit tasks that are neither running nor done, in chunks of like tasks."""
        known = {task.key for chunk, _ in self._submitted.values() for task in chunk}
        known |= self._early.keys()
        groups: defaultdict[tuple[str, ...], dict[str, Task]] = defaultdict(dict)
        for task in tasks:
            if task.key not in known:
                groups[task.levels][task.key] = task
        for levels, group in groups.items():
            size, todo = self._chunk_size(levels, len(group)), list(group.values())
            for first in range(0, len(todo), size):
                self._submit_chunk(tuple(todo[first : first + size]))

    def _chunk_size(self, levels: tuple[str, ...], count: int) -> int:
        """Tasks of some levels in a chunk, by what such tasks took so far."""
        seconds, number = self._seconds[levels]
        fit = int(SETTINGS.chunk_s * number / seconds) if seconds > 0.0 else 1
        return max(1, min(fit, count // (4 * self.workers)))

    def _submit_chunk(self, chunk: tuple[Task, ...]) -> None:
        key = f"phytac-{chunk[0].key}-{len(chunk)}"
        future = self.client.submit(run_chunk, chunk, key=key, pure=False)
        self._submitted[key] = chunk, future
        self._completed.add(future)

    def _next(self) -> list[tuple[Task, Outcome]]:
        """Results of the next chunk; raises StopIteration if the scheduler is lost."""
        future = next(self._completed)
        chunk, _ = self._submitted.pop(future.key)
        if future.status in {"cancelled", "lost"}:
            raise StopIteration
        if future.status == "finished":
            outcomes = [Outcome(**found) for found in future.result()]
            total = self._seconds[chunk[0].levels]
            total[0] += sum(sum(outcome.seconds.values()) for outcome in outcomes)
            total[1] += len(chunk)
            return list(zip(chunk, outcomes, strict=True))
        if len(chunk) > 1:  # one task may have killed its worker: each runs alone
            for task in chunk:
                self._submit_chunk((task,))
            return []
        error = future.exception()
        reason = f"{type(error).__name__}: {error}"[:500]
        return [(chunk[0], Outcome(status=FAILED, reason=reason, violation=1e3))]

    def _reconnect(self) -> None:
        """Wait for a lost scheduler.

        Raises
        ------
        InputError
            If it stays away.
        """
        self.say(f"the scheduler at {self.address} is lost; waiting for it …")
        with suppress(Exception):  # a client without a scheduler may not even close
            self.client.close(timeout=1)
        end = time.monotonic() + SETTINGS.reconnect_s
        while True:
            try:
                self.client = self._connect()
            except InputError:
                if time.monotonic() > end:
                    raise
                time.sleep(1.0)
            else:
                return

    def close(self) -> None:
        """Leave the scheduler; stop it if this pool started it."""
        with suppress(Exception):  # a lost scheduler cannot be left
            self.client.close()
        if self.cluster is not None:
            self.cluster.close()
