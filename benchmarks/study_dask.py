"""Workers, clusters and kills: throughput against independent copies, and the same rows.

``python -m benchmarks.study_dask copy FOLDER COUNT`` is one independent copy; ``drive FOLDER COUNT
ADDRESS`` is a driver that this benchmark kills.
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Table
from benchmarks.study_cases import drawn, one_thread, study_of
from phytac_design.core.parquet_recording import parquet_library
from phytac_design.core.threads import THREADS
from phytac_design.study.search.dask_pool import WORKER_ENVIRONMENT, DaskPool
from phytac_design.study.search.design_space import DesignSpace
from phytac_design.study.search.driver import StudyRun, run_study
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.successive_halving import (
    Outcome,
    Task,
    evaluate_candidate,
    spec_of,
    task_of,
)

RUNGS = ("rules", "sampled")
GO = "go"
ALONE = dict.fromkeys((THREADS, "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
KILL_EVERY_S = 10.0
TURNS = 3
KILLED = 1536
"""Candidates of the study with kills: at two workers it outlasts all kinds of them."""
LOCAL, CLUSTER = "2 local workers", "two-process cluster on loopback"
CASES = {"1 local worker": 1, LOCAL: 2, CLUSTER: 2}
"""Workers of each case."""


def study_for(count: int) -> tuple[Study, DesignSpace]:
    """The cylinder's space, rules and sampled."""
    return study_of(
        "cylinder",
        ladder={"rungs": list(RUNGS)},
        budget={"candidates": count},
        sampling={"batch": 128},
    )


def warm() -> None:
    """Load all that a candidate needs."""
    study, space = study_for(4)
    for params in drawn(study, space, 4):
        evaluate_candidate(spec_of(study, space), params, RUNGS)


def copy(folder: Path, count: int) -> None:
    """A copy of the program that does its own candidates, with files and all, on a signal."""
    one_thread()
    warm()
    study, space = study_for(count)
    (folder / "ready").touch()
    while not (folder.parent / GO).exists():
        time.sleep(0.01)
    start = time.perf_counter()
    run_study(study, space, folder / "study", kind="sweep")
    (folder / "seconds").write_text(str(time.perf_counter() - start))


def copies(number: int, count: int) -> float:
    """Candidates a second of so many copies that run together."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folders = [Path(name) / str(k) for k in range(number)]
        parts = []
        for folder in folders:
            folder.mkdir()
            words = [sys.executable, "-m", __name__, "copy", str(folder), str(count)]
            parts.append(stack.enter_context(subprocess.Popen(words, env=os.environ | ALONE)))
        while not all((folder / "ready").exists() for folder in folders):
            time.sleep(0.05)
        (Path(name) / GO).touch()
        for part in parts:
            part.wait()
        return sum(count / float((folder / "seconds").read_text()) for folder in folders)


class Nothing(Task):
    """A task without work."""

    def run(self) -> dict[str, Any]:
        """As a climb without rungs."""
        return asdict(Outcome())


def overhead_ms(pool: DaskPool, count: int) -> float:
    """What a task costs beside its work, as the driver sees it."""
    study, space = study_for(4)
    spec, params = spec_of(study, space), drawn(study, space, 1)[0]
    tasks = [
        Nothing(order=k, key=f"nothing-{k}", spec=spec, params=params, levels=RUNGS)
        for k in range(count)
    ]
    start = time.perf_counter()
    for _ in pool.run(tasks):
        pass
    return 1e3 * (time.perf_counter() - start) / count


def pooled(pool: DaskPool, count: int, folder: Path) -> StudyRun:
    """Run a study on a pool whose workers have loaded all."""
    study, space = study_for(count)
    spec, early = spec_of(study, space), drawn(study, space, 4 * pool.workers, first=1 << 16)
    for _ in pool.run(task_of(k, spec, params, RUNGS) for k, params in enumerate(early)):
        pass
    return run_study(study, space, folder, kind="sweep", pool=pool)


class Cluster:
    """A scheduler and workers as processes of their own, on loopback."""

    def __init__(self, workers: int) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = int(free.getsockname()[1])
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.scheduler = self._scheduler()
        self.workers = [self._worker() for _ in range(workers)]

    def _start(self, part: str, *words: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", *words, "--no-dashboard"]
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        environment = (
            os.environ
            | WORKER_ENVIRONMENT
            | {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "50"}
        )
        return subprocess.Popen(command, env=environment, **quiet)

    def _scheduler(self) -> "subprocess.Popen[bytes]":
        return self._start("scheduler", "--host", "127.0.0.1", "--port", str(self.port))

    def _worker(self) -> "subprocess.Popen[bytes]":
        return self._start("worker", self.address, "--nthreads", "1", "--no-nanny")

    def kill_worker(self, number: int) -> None:
        """Kill a worker, and start another in its place."""
        self.workers[number].kill()
        self.workers[number].wait()
        self.workers[number] = self._worker()

    def kill_scheduler(self) -> None:
        """Kill the scheduler, and start it and its workers again."""
        self.scheduler.kill()
        self.scheduler.wait()
        self.scheduler = self._scheduler()
        for number in range(len(self.workers)):
            self.kill_worker(number)

    def pool(self) -> DaskPool:
        """A client, once the scheduler listens and all workers are there."""
        while True:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1.0):
                break
            time.sleep(0.1)
        pool = DaskPool(address=self.address)
        pool.client.wait_for_workers(len(self.workers))
        return pool

    def close(self) -> None:
        """End all."""
        for part in (*self.workers, self.scheduler):
            part.kill()
            part.wait()


def rows_of(folder: Path) -> list[dict[str, Any]]:
    """Rows without the seconds that they took."""
    table = parquet_library().parquet.read_table(folder / "results.parquet")
    return [
        {key: value for key, value in row.items() if not key.startswith("seconds.")}
        for row in table.to_pylist()
    ]


@contextmanager
def pool_of(case: str) -> Iterator[DaskPool]:
    """A pool of a case, with all its workers there."""
    with ExitStack() as stack:
        if case == CLUSTER:
            pool = stack.enter_context(closing(Cluster(CASES[case]))).pool()
        else:
            pool = DaskPool(workers=CASES[case])
        yield stack.enter_context(closing(pool))


def dask(table: Table, *, quick: bool) -> None:
    """Throughput of one and two workers and of a cluster; then kills."""
    count, turns = (24, 1) if quick else (256, TURNS)
    ratios: dict[str, list[float]] = {case: [] for case in CASES}
    said: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as name:
        # In turns, since a machine's speed drifts by more than what is asked.
        for turn in range(turns):
            for case, workers in CASES.items():
                alone = copies(workers, count // workers)
                with pool_of(case) as pool:
                    done = pooled(pool, count, Path(name) / f"{case}-{turn}")
                rate = done.new / done.seconds
                ratios[case].append(rate / alone)
                said[case] = f"{rate:.1f}/s against {alone:.1f}/s"
        for case, workers in CASES.items():
            row = (
                f"{case}: throughput over that of {workers} independent "
                f"{'copies run together' if workers > 1 else 'copy'}"
            )
            source = (
                f"{count} candidates, rules and sampled, all loaded before; median of {turns} turns"
            )
            note = (
                f"turns {', '.join(f'{ratio:.2f}' for ratio in ratios[case])}; the last "
                f"{said[case]}; driver and scheduler on the same cores"
            )
            table.add(row, float(np.median(ratios[case])), "ratio", 1.0, source, ">= 0.9", note)
        with pool_of(LOCAL) as pool:
            more = 24 if quick else KILLED
            expected = rows_of(pooled(pool, more, Path(name) / "undisturbed").folder)
            # After a study, since how many candidates travel at once is learnt from it.
            _overhead_row(table, pool, 100 if quick else 2000)
        with closing(Cluster(2)) as cluster:
            cluster.pool().close()
            _killed(table, cluster, Path(name) / "killed", expected)


def _overhead_row(table: Table, pool: DaskPool, count: int) -> None:
    """What a task costs beside its work."""
    row = "a task beside its work, driver, scheduler and two workers on this machine"
    source = "tasks that do nothing, wall time over their number"
    note = "0.1 s is what ten designs a second take"
    table.add(row, overhead_ms(pool, count), "ms", 100.0, source, note=note)


def _killed(table: Table, cluster: Cluster, folder: Path, expected: list[dict[str, Any]]) -> None:
    """Kill a worker every ten seconds, the driver once and the scheduler once."""
    count = len(expected)
    words = [sys.executable, "-m", __name__, "drive", str(folder), str(count), cluster.address]
    kills = {"worker": 0, "driver": 0, "scheduler": 0}

    def driver() -> "subprocess.Popen[bytes]":
        return subprocess.Popen(words, env=os.environ | ALONE, stdout=subprocess.DEVNULL)

    running, start = driver(), time.monotonic()
    events = ["worker", "driver", "worker", "scheduler", *["worker"] * 1000]
    for number, what in enumerate(events):
        left = start + (number + 1) * KILL_EVERY_S - time.monotonic()
        with suppress(subprocess.TimeoutExpired):
            running.wait(max(left, 0.0))
            break
        kills[what] += 1
        if what == "worker":
            cluster.kill_worker(number % 2)
        elif what == "scheduler":
            cluster.kill_scheduler()
        else:
            running.send_signal(signal.SIGKILL)
            running.wait()
            running = driver()
    found = rows_of(folder)
    same = sum(one == other for one, other in zip(found, expected, strict=False))
    row = (
        f"rows equal to the undisturbed ones, {kills['worker']} workers, {kills['driver']} driver "
        f"and {kills['scheduler']} scheduler killed"
    )
    source = f"{count} candidates, a kill every {KILL_EVERY_S:g} s, cluster on loopback"
    note = (
        f"{len(found)} rows; driver ended with {running.returncode}, all but its last run by kill"
    )
    table.add(row, 100.0 * same / len(expected), "%", 100.0, source, ">= 100", note)


def drive(folder: Path, count: int, address: str) -> None:
    """A driver that may be killed."""
    study, space = study_for(count)
    pool = DaskPool(address=address, say=print)
    run_study(study, space, folder, kind="sweep", pool=pool)
    pool.close()


if __name__ == "__main__":
    if sys.argv[1] == "copy":
        copy(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        drive(Path(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
