"""Candidates evaluated by Dask: the same rows, also when workers and the scheduler are killed."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from phytac_design.study.search.driver import run_study
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.study_folder import RESULTS, parquet_library
from phytac_design.study.search.successive_halving import FAILED, OK, Outcome, Task
from tests.study.search.studies import space_of, tiny

distributed = pytest.importorskip("distributed")

from phytac_design.study.search.dask_pool import (  # noqa: E402 - after the skip
    SETTINGS,
    DaskPool,
)

# Dask's own threads and sockets end a little after what started them.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning"),
]


def study() -> Study:
    return tiny(budget={"candidates": 40}, sampling={"batch": 16, "start": 8})


def rows(folder: Path) -> list[dict[str, object]]:
    table = parquet_library().parquet.read_table(folder / RESULTS)
    return [
        {key: value for key, value in row.items() if not key.startswith("seconds.")}
        for row in table.to_pylist()
    ]


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, object]]:
    out = tmp_path_factory.mktemp("expected")
    run_study(study(), space_of(study()), out, kind="sweep")
    return rows(out)


@pytest.fixture(scope="module")
def pool() -> Iterator[DaskPool]:
    made = DaskPool(workers=2)
    yield made
    made.close()


class Bad(Task):
    """A task whose program is broken."""

    def run(self) -> dict[str, Any]:
        raise RuntimeError("broken")


def made(kind: type[Task], order: int) -> Task:
    return kind(order=order, key=str(order), spec="", params={}, levels=("rules",))


class Fine(Task):
    """A task that comes to nothing, at once."""

    def run(self) -> dict[str, Any]:
        return asdict(Outcome(seconds={"rules": SETTINGS.chunk_s / 8.0}))


class Noted(Task):
    """A task that says in a file, its ``spec``, that it ran."""

    def run(self) -> dict[str, Any]:
        with Path(self.spec).open("a") as file:
            file.write(f"{self.key}\n")
        return asdict(Outcome(seconds={"rules": SETTINGS.chunk_s / 4.0}))


def test_what_follows_is_begun_early_and_run_once(pool: DaskPool, tmp_path: Path) -> None:
    log = tmp_path / "ran"
    tasks = [
        Noted(order=k, key=f"noted-{k}", spec=str(log), params={}, levels=(f"level {k // 8}",))
        for k in range(24)
    ]
    for first in range(0, 24, 8):
        batch, later = tasks[first : first + 8], tasks[first + 8 : first + 16]
        found = list(pool.run(batch, later))
        assert sorted(task.order for task, _ in found) == [task.order for task in batch]
        if later:
            end = time.monotonic() + 20.0
            while not set(log.read_text().split()) & {task.key for task in later}:
                assert time.monotonic() < end
                time.sleep(0.02)
    assert sorted(log.read_text().split()) == sorted(task.key for task in tasks)


def test_chunks_hold_as_much_as_they_should(pool: DaskPool) -> None:
    levels = ("test chunks",)
    assert pool._chunk_size(levels, 400) == 1
    pool._seconds[levels] = [10.0 * SETTINGS.chunk_s / 8.0, 10.0]
    assert pool._chunk_size(levels, 400) == 8
    assert pool._chunk_size(levels, 40) == 5
    assert pool._chunk_size(levels, 3) == 1
    pool._seconds[levels] = [100.0 * SETTINGS.chunk_s, 10.0]
    assert pool._chunk_size(levels, 400) == 1


def test_a_worker_that_is_killed_loses_nothing(
    pool: DaskPool, expected: list[dict[str, object]], tmp_path: Path
) -> None:
    pids = list(pool.client.run(os.getpid).values())
    assert len(pids) == len(set(pids)) == pool.workers == 2
    killer = threading.Timer(0.3, os.kill, (pids[0], signal.SIGKILL))
    killer.start()
    done = run_study(study(), space_of(study()), tmp_path, kind="sweep", pool=pool)
    killer.join()
    # One that is broken takes none of its chunk with it.
    tasks = [made(Bad if k == 11 else Fine, k) for k in range(30)]
    found = {task.order: outcome for task, outcome in pool.run(tasks)}
    assert done.new == 40
    assert rows(tmp_path) == expected
    assert {k for k, outcome in found.items() if outcome.status == OK} == {*range(30)} - {11}
    assert (found[11].status, found[11].reason) == (FAILED, "RuntimeError: broken")


class Cluster:
    """A scheduler and a worker as processes of their own, on one port."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.parts: list[subprocess.Popen[bytes]] = []
        self.scheduler()
        self.start("worker", self.address, "--nthreads", "1", "--no-dashboard")

    def start(self, *words: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]]
        silent = subprocess.DEVNULL
        part = subprocess.Popen(command, stdout=silent, stderr=silent)
        self.parts.append(part)
        return part

    def scheduler(self) -> "subprocess.Popen[bytes]":
        return self.start(
            "scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"
        )

    def close(self) -> None:
        for part in self.parts:
            part.kill()
            part.wait()


@pytest.fixture
def cluster() -> Iterator[Cluster]:
    running = Cluster()
    yield running
    running.close()


def test_a_scheduler_that_is_killed_and_comes_back_loses_nothing(
    cluster: Cluster, expected: list[dict[str, object]], tmp_path: Path
) -> None:
    end = time.monotonic() + 60.0
    while True:
        try:
            socket.create_connection(("127.0.0.1", cluster.port), timeout=1.0).close()
            break
        except OSError:
            assert time.monotonic() < end
            time.sleep(0.1)
    said: list[str] = []
    pool = DaskPool(address=cluster.address, say=said.append)
    first = cluster.parts[0]

    def again() -> None:
        first.kill()
        first.wait()
        cluster.scheduler()
        cluster.start("worker", cluster.address, "--nthreads", "1", "--no-dashboard")

    killer = threading.Timer(0.5, again)
    killer.start()
    try:
        run_study(study(), space_of(study()), tmp_path, kind="sweep", pool=pool)
    finally:
        killer.join()
        pool.close()
    assert any("is lost" in text for text in said)
    assert rows(tmp_path) == expected
