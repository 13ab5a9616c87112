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

from phytac_design.study.search.dask_pool import DaskPool  # noqa: E402 - after the skip
from tests.refusals import refused  # noqa: E402

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
    return kind(key=str(order), spec="", params={}, levels=("rules",))


class Fine(Task):
    """A task that comes to nothing, at once."""

    def run(self) -> dict[str, Any]:
        return asdict(Outcome())


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
    found = {int(task.key): outcome for task, outcome in pool.run(tasks)}
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
        listen = ("--host", "127.0.0.1", "--port", str(self.port))
        self.parts = [
            self.start("scheduler", *listen),
            self.start("worker", self.address, "--nthreads", "1"),
        ]

    def start(self, part: str, *words: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", *words, "--no-dashboard"]
        silent = subprocess.DEVNULL
        return subprocess.Popen(command, stdout=silent, stderr=silent)

    def listening(self) -> str:
        """Its address, once the scheduler listens."""
        end = time.monotonic() + 60.0
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), timeout=1.0).close()
            except OSError:
                assert time.monotonic() < end
                time.sleep(0.1)
            else:
                return self.address

    def close(self) -> None:
        for part in self.parts:
            part.kill()
            part.wait()


@pytest.fixture
def cluster() -> Iterator[Cluster]:
    running = Cluster()
    yield running
    running.close()


def test_a_scheduler_that_is_killed_ends_the_run_and_loses_nothing(
    cluster: Cluster, expected: list[dict[str, object]], tmp_path: Path
) -> None:
    pool = DaskPool(address=cluster.listening())
    killer = threading.Timer(0.5, cluster.parts[0].kill)
    killer.start()
    with refused("scheduler-lost"):
        run_study(study(), space_of(study()), tmp_path, kind="sweep", pool=pool)
    killer.join()
    pool.close()
    run_study(study(), space_of(study()), tmp_path, kind="sweep")
    assert rows(tmp_path) == expected
