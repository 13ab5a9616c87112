"""Candidates evaluated by the workers of a Dask cluster.

Only the driver writes files, so that a task may run twice: Dask runs the tasks of a dead worker
again. Cheap candidates are submitted in chunks, so that their work outweighs Dask's own.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import suppress
from typing import Any

from phytac_design.engine.cache import code_hash
from phytac_design.study.search.successive_halving import (
    Outcome,
    SerialPool,
    Task,
    chunked,
    failed,
    keep_memory,
)
from phytac_shapes.errors import InputError, MissingPartError


def _library() -> Any:
    try:
        import distributed
    except ImportError:
        raise MissingPartError.of_library("--scheduler", "dask", "study") from None
    return distributed


def run_chunk(tasks: list[Task]) -> list[dict[str, Any]]:
    """Results of a chunk, on a worker."""
    keep_memory()
    return [task.run() for task in tasks]


class DaskPool(SerialPool):
    """A client of a running scheduler.

    Parameters
    ----------
    address : str
        As ``tcp://host:8786``, or ``tls://…`` with the certificates of Dask's configuration.
    say : callable
        Receives messages about waiting.

    Raises
    ------
    InputError
        If the scheduler cannot be reached, has no worker, or one with another version of the
        program.
    """

    connect_s, workers_s = 10.0, 120.0
    """How long to wait for the scheduler, and for its first worker."""

    def __init__(self, address: str, *, say: Callable[[str], None] = lambda _: None) -> None:
        self.library = _library()
        self.address = address
        self.client = self._connect()
        try:
            if not self.client.scheduler_info(n_workers=-1)["workers"]:
                say(f"waiting for workers of {self.address} …")
            self._check_workers()
        except BaseException:
            self.close()
            raise

    def _connect(self) -> Any:
        try:
            return self.library.Client(self.address, timeout=self.connect_s, set_as_default=False)
        except (
            OSError,
            TimeoutError,
            ValueError,
            TypeError,
        ) as error:  # the last without TLS files
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                "scheduler-unreachable",
                f"no scheduler at {self.address} ({reason}); start one with `dask scheduler`, use "
                "--workers, or for tls:// set Dask's certificates. Completed candidates are kept",
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
        chunks: dict[str, list[Task]] = {}
        futures = self.library.as_completed(loop=self.client.loop)

        def submit(chunk: list[Task]) -> None:
            key = f"phytac-{chunk[0].key}-{len(chunk)}"
            chunks[key] = chunk
            futures.add(self.client.submit(run_chunk, chunk, key=key, pure=False))

        try:
            for chunk in chunked(tasks, self.workers):
                submit(chunk)
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
                    yield chunk[0], failed(f"{type(error).__name__}: {error}")
        except (OSError, CancelledError, self.library.comm.core.CommClosedError, StopIteration):
            raise InputError(
                "scheduler-lost",
                f"the scheduler at {self.address} is lost; start it again, and run the same "
                "command: completed candidates are kept",
            ) from None

    def close(self) -> None:
        """Leave the scheduler."""
        with suppress(Exception):  # a lost scheduler cannot be left
            self.client.close()
