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
from phytac_design.study.search.dask_pool import DaskPool
from phytac_design.study.search.design_space import DesignSpace
from phytac_design.study.search.driver import StudyRun, run_study
from phytac_design.study.search.process_pool import ProcessPool
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.successive_halving import (
    Outcome,
    Task,
    evaluate_candidate,
    spec_of,
    task_of,
)

RUNGS = ("rules", "sampled")
ALONE = dict.fromkeys((THREADS, "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
QUIET = {
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
}
"""Dask's own monitoring takes some 3 % of each process's time by default."""
KILL_EVERY_S = 10.0
CLUSTER = "two-process cluster on loopback"
CASES = {"1 local worker": 1, "2 local workers": 2, CLUSTER: 2}
"""Workers of each case."""

Pool = DaskPool | ProcessPool


def study_for(count: int) -> tuple[Study, DesignSpace]:
    """The cylinder's space, rules and sampled."""
    return study_of(
        "cylinder",
        ladder={"rungs": list(RUNGS)},
        budget={"candidates": count},
        sampling={"batch": 128},
    )


def started(*words: object) -> "subprocess.Popen[bytes]":
    """Start this module as a process of its own, on one thread."""
    command = [sys.executable, "-m", __name__, *map(str, words)]
    return subprocess.Popen(command, env=os.environ | ALONE, stdout=subprocess.DEVNULL)


def copy(folder: Path, count: int) -> None:
    """A copy of the program that does its own candidates, with files and all, on a signal."""
    one_thread()
    study, space = study_for(count)
    for params in drawn(study, space, 4):  # loads all that a candidate needs
        evaluate_candidate(spec_of(study, space), params, RUNGS)
    (folder / "ready").touch()
    while not (folder.parent / "go").exists():
        time.sleep(0.01)
    start = time.perf_counter()
    run_study(study, space, folder / "study", kind="sweep")
    (folder / "seconds").write_text(str(time.perf_counter() - start))


def copies(number: int, count: int) -> float:
    """Candidates a second of so many copies that run together."""
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(name) / str(k) for k in range(number)]
        for folder in folders:
            folder.mkdir()
        parts = [started("copy", folder, count) for folder in folders]
        while not all((folder / "ready").exists() for folder in folders):
            time.sleep(0.05)
        (Path(name) / "go").touch()
        for part in parts:
            part.wait()
        return sum(count / float((folder / "seconds").read_text()) for folder in folders)


class Nothing(Task):
    """A task without work."""

    def run(self) -> dict[str, Any]:
        """As an evaluation without levels."""
        return asdict(Outcome())


def overhead_ms(pool: Pool, count: int) -> float:
    """What a task costs beside its work, as the driver sees it."""
    tasks = [Nothing(key=f"nothing-{k}", spec="", params={}, levels=RUNGS) for k in range(count)]
    start = time.perf_counter()
    for _ in pool.run(tasks):
        pass
    return 1e3 * (time.perf_counter() - start) / count


def pooled(pool: Pool, count: int, folder: Path) -> StudyRun:
    """Run a study on a pool whose workers have loaded all."""
    study, space = study_for(count)
    spec, early = spec_of(study, space), drawn(study, space, 4 * pool.workers, first=1 << 16)
    for _ in pool.run(task_of(spec, params, RUNGS) for params in early):
        pass
    return run_study(study, space, folder, kind="sweep", pool=pool)


class Cluster:
    """A scheduler and workers as processes of their own, on loopback."""

    def __init__(self, workers: int) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = int(free.getsockname()[1])
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.parts = [self._start(number) for number in range(workers + 1)]

    def _start(self, number: int) -> "subprocess.Popen[bytes]":
        words = ["worker", self.address, "--nthreads", "1", "--no-nanny"]
        if number == 0:
            words = ["scheduler", "--host", "127.0.0.1", "--port", str(self.port)]
        command = [sys.executable, "-m", f"distributed.cli.dask_{words[0]}", *words[1:]]
        failures = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "50"}
        return subprocess.Popen(
            [*command, "--no-dashboard"],
            env=os.environ | ALONE | QUIET | failures,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def kill(self, number: int) -> None:
        """Kill the scheduler (0) or a worker, and start another in its place."""
        self.parts[number].kill()
        self.parts[number].wait()
        self.parts[number] = self._start(number)

    def pool(self) -> DaskPool:
        """A client, once the scheduler listens and all workers are there."""
        while True:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1.0):
                break
            time.sleep(0.1)
        pool = DaskPool(self.address)
        pool.client.wait_for_workers(len(self.parts) - 1)
        return pool

    def close(self) -> None:
        """End all."""
        for part in self.parts:
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
def pool_of(case: str) -> Iterator[Pool]:
    """A pool of a case, with all its workers there."""
    with ExitStack() as stack:
        if case == CLUSTER:
            pool: Pool = stack.enter_context(closing(Cluster(CASES[case]))).pool()
        else:
            pool = ProcessPool(CASES[case])
        yield stack.enter_context(closing(pool))


def dask(table: Table, *, quick: bool) -> None:
    """Throughput of one and two workers and of a cluster; then kills."""
    count, turns = (24, 1) if quick else (256, 3)
    ratios: dict[str, list[float]] = {case: [] for case in CASES}
    with tempfile.TemporaryDirectory() as name:
        # In turns, since a machine's speed drifts by more than what is asked.
        for turn in range(turns):
            for case, workers in CASES.items():
                alone = copies(workers, count // workers)
                with pool_of(case) as pool:
                    done = pooled(pool, count, Path(name) / f"{case}-{turn}")
                ratios[case].append(done.new / done.seconds / alone)
        for case, workers in CASES.items():
            row = (
                f"{case}: throughput over that of {workers} independent "
                f"{'copies run together' if workers > 1 else 'copy'}"
            )
            source = (
                f"{count} candidates, rules and sampled, all loaded before; median of {turns} turns"
            )
            note = (
                f"turns {', '.join(f'{ratio:.2f}' for ratio in ratios[case])}; driver and "
                "scheduler on the same cores"
            )
            table.add(row, float(np.median(ratios[case])), "ratio", 1.0, source, ">= 0.9", note)
        with pool_of(CLUSTER) as pool:
            # At two workers these outlast all kinds of kills.
            more = 24 if quick else 1536
            expected = rows_of(pooled(pool, more, Path(name) / "undisturbed").folder)
            row = "a task beside its work, driver, scheduler and two workers on this machine"
            source = "tasks that do nothing, wall time over their number"
            note = "0.1 s is what ten designs a second take"
            value = overhead_ms(pool, 100 if quick else 2000)
            table.add(row, value, "ms", 100.0, source, note=note)
        with closing(Cluster(2)) as cluster:
            cluster.pool().close()
            _killed(table, cluster, Path(name) / "killed", expected)


def _killed(table: Table, cluster: Cluster, folder: Path, expected: list[dict[str, Any]]) -> None:
    """Kill a worker every ten seconds, the driver once and the scheduler once.

    A driver that loses its scheduler ends, and is started again.
    """
    words = ("drive", folder, len(expected), cluster.address)
    kills = {"worker": 0, "driver": 0, "scheduler": 0}
    running, start = started(*words), time.monotonic()
    events = ["worker", "driver", "worker", "scheduler", *["worker"] * 1000]
    for number, what in enumerate(events):
        left = start + (number + 1) * KILL_EVERY_S - time.monotonic()
        with suppress(subprocess.TimeoutExpired):
            if running.wait(max(left, 0.0)) == 0:
                break
        kills[what] += 1
        if what == "worker":
            cluster.kill(1 + number % 2)
            continue
        if what == "scheduler":
            for part in range(3):
                cluster.kill(part)
            cluster.pool().close()
        running.send_signal(signal.SIGKILL)
        running.wait()
        running = started(*words)
    same = sum(one == other for one, other in zip(rows_of(folder), expected, strict=False))
    row = (
        f"rows equal to the undisturbed ones, {kills['worker']} workers, {kills['driver']} driver "
        f"and {kills['scheduler']} scheduler killed"
    )
    source = f"{len(expected)} candidates, a kill every {KILL_EVERY_S:g} s, cluster on loopback"
    table.add(row, 100.0 * same / len(expected), "%", 100.0, source, ">= 100")


def drive(folder: Path, count: int, address: str) -> None:
    """A driver that may be killed."""
    study, space = study_for(count)
    with closing(DaskPool(address)) as pool:
        run_study(study, space, folder, kind="sweep", pool=pool)


if __name__ == "__main__":
    if sys.argv[1] == "copy":
        copy(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        drive(Path(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
