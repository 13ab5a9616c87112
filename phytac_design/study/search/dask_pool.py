"""Candidates climbed by Dask: processes on this machine, or a cluster's workers; the same code.

Results are content-addressed and only the driver writes, so that a task may run twice: a worker
that dies has its tasks run again by Dask; when the scheduler is lost, the driver waits for it to
come back and gives out again what it has no result of.

Candidates that take less time than Dask needs for a task of its own are given out several at once.
"""

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from phytac_design.core.threads import THREADS
from phytac_design.engine.cache import code_hash
from phytac_design.study.search.pool import keep_memory
from phytac_design.study.search.successive_halving import FAILED, Outcome, Task
from phytac_shapes.errors import InputError, MissingPartError

AHEAD = 2
"""Pieces per worker that are given out ahead, so that none waits for the driver."""
PIECE_S = 1.0
"""Processor time that a piece should hold: some hundred times what Dask needs for it."""
CONNECT_S = 10.0
RETURN_S = 120.0
"""How long a lost scheduler may take to come back."""
WORKERS_S = 120.0
"""How long to wait for a cluster's first worker."""
COUNT_S = 5.0
"""How often workers are counted."""
DEATHS = 10
"""Workers that may die over one task before it is given up."""
QUIET = {"distributed.admin.tick.interval": "500ms", "distributed.worker.profile.enabled": False}
"""Looks at itself less often: Dask's own settings take some 3 % of each process's time."""
WORKER_ENVIRONMENT = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", THREADS), "1"
) | {f"DASK_{name.upper().replace('.', '__')}": str(value) for name, value in QUIET.items()}
"""Environment of workers."""


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


def climb_some(tasks: tuple[Task, ...]) -> list[dict[str, Any]]:
    """Results of a piece, on a worker."""
    keep_memory()
    return [task.run() for task in tasks]


class Pieces:
    """Tasks in pieces of about ``PIECE_S``, by what such tasks took so far; small ones at the end.

    Parameters
    ----------
    tasks : iterable of Task
        All of them.
    spent : dict
        Seconds and number of tasks so far, by their rungs; added to by :meth:`took`.
    """

    def __init__(
        self, tasks: Iterable[Task], spent: defaultdict[tuple[str, ...], list[float]]
    ) -> None:
        self.left, self.alone, self.spent = deque(tasks), deque[Task](), spent

    def take(self, workers: int) -> tuple[Task, ...]:
        """Next piece, of tasks with the same rungs; () if nothing is left."""
        if self.alone:
            return (self.alone.popleft(),)
        if not self.left:
            return ()
        rungs = self.left[0].rungs
        seconds, number = self.spent[rungs]
        fit = PIECE_S * number / seconds if seconds > 0.0 else 1.0
        share = -(-len(self.left) // (2 * workers))
        piece = [self.left.popleft()]
        while len(piece) < min(int(fit), share) and self.left[0].rungs == rungs:
            piece.append(self.left.popleft())
        return tuple(piece)

    def took(self, task: Task, outcome: Outcome) -> None:
        """Learn from a result."""
        spent = self.spent[task.rungs]
        spent[0] += sum(outcome.seconds.values())
        spent[1] += 1.0

    def back(self, piece: tuple[Task, ...]) -> None:
        """Tasks of a piece that failed as a whole: each is to run alone."""
        self.alone.extend(piece)


class DaskPool:
    """A client of a scheduler: its own (``workers``) or a running one (``address``).

    Parameters
    ----------
    workers : int
        Processes to start on this machine, one thread each; 0 with an address.
    address : str
        Of a running scheduler, as ``tcp://host:8786``.
    say : callable
        Told of what is waited for.

    Raises
    ------
    InputError
        If workers cannot be started, or the scheduler cannot be reached, has no worker, or one
        with another program.
    """

    def __init__(
        self, *, workers: int = 0, address: str = "", say: Callable[[str], None] = lambda _: None
    ) -> None:
        (self.dask, self.library), self.say = _libraries(), say
        self.cluster: Any = None
        self.address = address
        self._counted = (0.0, 1)
        self._spent: defaultdict[tuple[str, ...], list[float]] = defaultdict(lambda: [0.0, 0.0])
        self._running: dict[str, tuple[tuple[Task, ...], Any]] = {}
        self._early: dict[str, Outcome] = {}
        if not address:
            try:
                with self.dask.config.set(QUIET):
                    self.cluster = self.library.LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
                        processes=True,
                        dashboard_address=None,
                        silence_logs="ERROR",
                        env=WORKER_ENVIRONMENT,
                        # Any free port: another study may have the usual one.
                        scheduler_kwargs={
                            "allowed_failures": DEATHS,
                            "dashboard_address": "127.0.0.1:0",
                        },
                    )
            except (RuntimeError, OSError, TimeoutError) as error:
                raise InputError(
                    f"{workers} workers could not be started ({error}); take fewer, or none"
                ) from None
            self.address = self.cluster.scheduler_address
        try:
            self.client = self._connect(CONNECT_S)
            self._check_workers()
        except BaseException:
            if self.cluster is not None:
                self.cluster.close()
            raise

    def _connect(self, seconds: float) -> Any:
        try:
            with self.dask.config.set(QUIET):
                client = self.library.Client(self.address, timeout=seconds, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            said = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(
                f"no scheduler at {self.address} ({said}); start one with `dask scheduler`, or "
                "use --workers. What was done is kept"
            ) from None
        self._ends = self.library.as_completed(loop=client.loop)
        self._running = {}
        return client

    def _check_workers(self) -> None:
        """Wait for a first worker, and refuse those that run another program."""
        if not self.client.scheduler_info(n_workers=-1)["workers"]:
            self.say(f"waiting for workers of {self.address} …")
        try:
            self.client.wait_for_workers(1, timeout=WORKERS_S)
        except (TimeoutError, OSError):
            raise InputError(
                f"the scheduler at {self.address} has no worker; start some with `dask worker "
                f"{self.address} --nthreads 1`"
            ) from None
        mine = code_hash()
        for worker, theirs in self.client.run(code_hash, on_error="return").items():
            if theirs != mine:
                said = theirs if isinstance(theirs, Exception) else "another version"
                raise InputError(
                    f"the worker {worker} does not run this program ({said}); install the same "
                    "version there"
                )

    @property
    def workers(self) -> int:
        """Threads that run tasks, as of late."""
        when, count = self._counted
        if time.monotonic() - when > COUNT_S:
            with suppress(OSError):
                info = self.client.scheduler_info(n_workers=-1)["workers"]
                count = max(1, sum(worker["nthreads"] for worker in info.values()))
            self._counted = time.monotonic(), count
        return count

    def run(
        self, tasks: Iterable[Task], following: Iterable[Task] = ()
    ) -> Iterator[tuple[Task, Outcome]]:
        """Results as they come; every task once, however often a worker dies.

        Workers that would wait for the last of the ``tasks`` begin with those ``following``; what
        becomes of these is given when they are asked for.
        """
        wanted, later = {task.key: task for task in tasks}, list(following)
        while wanted:
            for key in [key for key in wanted if key in self._early]:
                yield wanted.pop(key), self._early.pop(key)
            for key, outcome in self._results(wanted, later):
                yield wanted.pop(key), outcome
            if wanted:
                self._come_back()

    def _results(
        self, wanted: Mapping[str, Task], later: Sequence[Task]
    ) -> Iterator[tuple[str, Outcome]]:
        """Results of those wanted, until all are there or the scheduler is lost."""
        pieces = Pieces(self._not_begun([*wanted.values(), *later]), self._spent)

        def more() -> None:
            workers = self.workers
            while len(self._running) <= AHEAD * workers and (piece := pieces.take(workers)):
                key = f"phytac-{piece[0].key}-{len(piece)}"
                future = self.client.submit(climb_some, piece, key=key, pure=False)
                self._running[future.key] = piece, future
                self._ends.add(future)

        try:
            more()
            while wanted and self._running:
                future = next(self._ends)
                piece, _ = self._running.pop(future.key)
                if future.status in {"cancelled", "lost"}:
                    return
                if future.status != "finished" and len(piece) > 1:
                    pieces.back(piece)
                else:
                    for task, outcome in zip(piece, _outcomes(future), strict=True):
                        pieces.took(task, outcome)
                        if task.key in wanted:
                            yield task.key, outcome
                        else:
                            self._early[task.key] = outcome
                more()
        except (OSError, self.library.comm.core.CommClosedError, StopIteration):
            return

    def _not_begun(self, tasks: Iterable[Task]) -> list[Task]:
        """Those that are neither under way nor done, each once."""
        known = {task.key for piece, _ in self._running.values() for task in piece}
        known |= self._early.keys()
        return [
            task for task in {task.key: task for task in tasks}.values() if task.key not in known
        ]

    def _come_back(self) -> None:
        """Wait for a lost scheduler.

        Raises
        ------
        InputError
            If it stays away.
        """
        self.say(f"the scheduler at {self.address} is lost; waiting for it …")
        with suppress(Exception):  # a client whose scheduler is gone may not even close
            self.client.close(timeout=1)
        end = time.monotonic() + RETURN_S
        while True:
            try:
                self.client = self._connect(CONNECT_S)
                self._check_workers()
            except InputError:
                if time.monotonic() > end:
                    raise
                time.sleep(1.0)
            else:
                return

    def close(self) -> None:
        """Leave the scheduler; stop it if it is this one's own."""
        with suppress(Exception):  # a scheduler that is gone cannot be left
            self.client.close()
        if self.cluster is not None:
            self.cluster.close()


def _outcomes(future: Any) -> list[Outcome]:
    """What a piece came to; one task that its worker did not survive is a failed candidate."""
    if future.status == "finished":
        return [Outcome(**found) for found in future.result()]
    error = future.exception()
    said = f"{type(error).__name__}: {error}"[:500]
    return [Outcome(status=FAILED, reason=said, violation=1e3)]
