"""Candidates evaluated by Dask: processes on this machine, or the workers of a cluster.

Only the driver writes files, so that a task may run twice: Dask runs the tasks of a dead worker
again. Cheap candidates are submitted in chunks, so that their work outweighs Dask's own.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import suppress
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

WORKER_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    THREADS: "1",
    # Dask's own monitoring takes some 3 % of each process's time by default.
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
}


def _libraries() -> tuple[Any, Any]:
    try:
        import dask
        import distributed
    except ImportError:
        raise MissingPartError(
            "missing-library",
            "--workers and --scheduler need dask; install it with: pip install "
            "'phytac-design[study]'",
        ) from None
    return dask, distributed


def run_chunk(tasks: list[Task]) -> list[dict[str, Any]]:
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

    connect_s, workers_s = 10.0, 120.0
    """How long to wait for the scheduler, and for its first worker."""

    def __init__(
        self, *, workers: int = 0, address: str = "", say: Callable[[str], None] = lambda _: None
    ) -> None:
        dask, self.library = _libraries()
        self.cluster: Any = None
        self.address = address
        try:
            with dask.config.set({"distributed.admin.tick.interval": "500ms"}):
                if not address:
                    self.cluster = self._start(workers)
                    self.address = self.cluster.scheduler_address
                self.client = self._connect()
            if not self.client.scheduler_info(n_workers=-1)["workers"]:
                say(f"waiting for workers of {self.address} …")
            self._check_workers()
        except BaseException:
            if self.cluster is not None:
                self.cluster.close()
            raise

    def _start(self, workers: int) -> Any:
        """A scheduler and workers on this machine."""
        try:
            return self.library.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
                silence_logs="ERROR",
                env=WORKER_ENVIRONMENT,
                # Any free port: another study may use the default one.
                scheduler_kwargs={"allowed_failures": 10, "dashboard_address": "127.0.0.1:0"},
            )
        except (RuntimeError, OSError, TimeoutError) as error:
            raise InputError(
                "workers-not-started",
                f"{workers} workers could not be started ({error}); use fewer, or none",
            ) from None

    def _connect(self) -> Any:
        try:
            return self.library.Client(self.address, timeout=self.connect_s, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                "scheduler-unreachable",
                f"no scheduler at {self.address} ({reason}); start one with `dask scheduler`, or "
                "use --workers. Completed candidates are kept",
            ) from None

    def _check_workers(self) -> None:
        """Wait for a worker; reject those that run another version of the program."""
        try:
            self.client.wait_for_workers(1, timeout=self.workers_s)
        except (TimeoutError, OSError):
            raise InputError(
                "scheduler-without-workers",
                f"the scheduler at {self.address} has no worker; start some with `dask worker "
                f"{self.address} --nthreads 1`",
            ) from None
        mine = code_hash()
        for worker, theirs in self.client.run(code_hash, on_error="return").items():
            if theirs != mine:
                why = theirs if isinstance(theirs, Exception) else "another version"
                raise InputError(
                    "worker-version-differs",
                    f"the worker {worker} does not run this program ({why}); install the same "
                    "version there",
                )

    @property
    def workers(self) -> int:
        """Threads that run tasks now."""
        return max(1, int(sum(self.client.nthreads().values())))

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
        """Results as they come; every task once, however often a worker dies.

        Raises
        ------
        InputError
            If the scheduler is lost.
        """
        wanted = list(tasks)
        # A cheap candidate takes some ten times what Dask needs for a task.
        cheap = all(set(task.levels) <= {"rules", "sampled"} for task in wanted)
        size = max(1, len(wanted) // (8 * self.workers)) if cheap else 1
        chunks: dict[str, list[Task]] = {}
        futures = self.library.as_completed(loop=self.client.loop)

        def submit(chunk: list[Task]) -> None:
            key = f"phytac-{chunk[0].key}-{len(chunk)}"
            chunks[key] = chunk
            futures.add(self.client.submit(run_chunk, chunk, key=key, pure=False))

        try:
            for first in range(0, len(wanted), size):
                submit(wanted[first : first + size])
            while chunks:
                future = next(futures)
                chunk = chunks.pop(future.key)
                error = future.exception()
                if error is None:
                    found = [Outcome(**plain) for plain in future.result()]
                    yield from zip(chunk, found, strict=True)
                elif len(chunk) > 1:
                    for task in chunk:  # one of them may have killed its worker: each runs alone
                        submit([task])
                else:
                    reason = f"{type(error).__name__}: {error}"[:500]
                    yield chunk[0], Outcome(status=FAILED, reason=reason, violation=1e3)
        except (OSError, CancelledError, self.library.comm.core.CommClosedError, StopIteration):
            raise InputError(
                "scheduler-lost",
                f"the scheduler at {self.address} is lost; start it again, and run the same "
                "command: completed candidates are kept",
            ) from None

    def close(self) -> None:
        """Leave the scheduler; stop it if this pool started it."""
        with suppress(Exception):  # a lost scheduler cannot be left
            self.client.close()
        if self.cluster is not None:
            self.cluster.close()
