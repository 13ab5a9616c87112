"""Candidates evaluated by processes here or by Dask: the same rows, also when some are killed."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import psutil
import pytest

from phytac_design.study.search.driver import run_study
from phytac_design.study.search.process_pool import ProcessPool
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.study_folder import RESULTS, parquet_library
from phytac_design.study.search.successive_halving import FAILED, OK, Outcome, SerialPool, Task
from tests.study.search.pool_tasks import Bad, Deadly, Fine, Listening, made
from tests.study.search.studies import space_of, tiny

dask = pytest.importorskip("dask")
pytest.importorskip("distributed")

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


def check_pool(pool: SerialPool, expected: list[dict[str, object]], folder: Path, pid: int) -> None:
    """The same rows when a worker is killed, and one broken task fails alone."""
    killer = threading.Timer(0.3, os.kill, (pid, signal.SIGKILL))
    killer.start()
    done = run_study(study(), space_of(study()), folder, kind="sweep", pool=pool)
    killer.join()
    assert done.new == 40
    assert rows(folder) == expected
    found = outcomes(pool, Bad)
    assert (found[11].status, found[11].reason) == (FAILED, "RuntimeError: broken")


def outcomes(pool: SerialPool, kind: type[Task]) -> dict[int, Outcome]:
    """Outcomes of thirty tasks of which number 11 is of a kind; all others are fine."""
    tasks = [made(kind if k == 11 else Fine, k) for k in range(30)]
    found = {int(task.key): outcome for task, outcome in pool.run(tasks)}
    assert {k for k, outcome in found.items() if outcome.status == OK} == {*range(30)} - {11}
    return found


@pytest.mark.long
def test_a_process_that_is_killed_loses_nothing(
    expected: list[dict[str, object]], tmp_path: Path
) -> None:
    with closing(ProcessPool(2)) as pool:
        list(pool.run([made(Fine, k) for k in range(2)]))
        started = psutil.Process().children(recursive=True)
        names = {each.pid: " ".join(each.cmdline()) for each in started}
        # On Linux they are forked from a server, whose command line they have.
        forked = {each.pid for each in started if "forkserver" in names.get(each.ppid(), "")}
        pids = [pid for pid in names if pid in forked or "spawn_main" in names[pid]]
        assert len(pids) == 2
        check_pool(pool, expected, tmp_path, pids[0])
        found = outcomes(pool, Deadly)
        assert found[11].status == FAILED
        assert "its process died (exit code 9" in found[11].reason
    assert not any(psutil.pid_exists(pid) for pid in pids)


def test_no_process_listens_to_anyone() -> None:
    """Whoever reaches a scheduler of Dask without TLS runs code as its user."""
    pool = ProcessPool(2)
    with closing(pool):
        found = [outcome.reason for _, outcome in pool.run([made(Listening, k) for k in range(9)])]
        assert not [reason for reason in found if "LISTEN" in reason]
        assert len({reason.split()[0] for reason in found} - {str(os.getpid())}) == 2
        own = psutil.Process().net_connections(kind="all")
        assert [link for link in own if link.status == psutil.CONN_LISTEN] == []


class Cluster:
    """A scheduler and a worker as processes of their own, on one port."""

    def __init__(self, protocol: str = "tcp") -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"{protocol}://127.0.0.1:{self.port}"
        listen = ("--host", "127.0.0.1", "--port", str(self.port), "--protocol", protocol)
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
    pool = DaskPool(cluster.listening())
    killer = threading.Timer(0.5, cluster.parts[0].kill)
    killer.start()
    with refused("scheduler-lost"):
        run_study(study(), space_of(study()), tmp_path, kind="sweep", pool=pool)
    killer.join()
    pool.close()
    run_study(study(), space_of(study()), tmp_path, kind="sweep")
    assert rows(tmp_path) == expected


@pytest.mark.long
def test_a_worker_of_dask_that_is_killed_loses_nothing(
    cluster: Cluster, expected: list[dict[str, object]], tmp_path: Path
) -> None:
    with closing(DaskPool(cluster.listening())) as pool:
        (pid,) = pool.client.run(os.getpid).values()
        check_pool(pool, expected, tmp_path, pid)


def test_a_cluster_with_certificates_as_in_the_guide(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The guide's own lines; without the certificate nobody gets in."""
    if not shutil.which("openssl"):
        pytest.skip("no openssl")
    guide = (Path(__file__).parents[3] / "docs" / "guides" / "cluster.md").read_text()
    lines = guide.split("umask 077\n")[1].split("```")[0]
    made = "\n".join(line for line in lines.splitlines() if not line.startswith("export"))
    subprocess.run(["sh", "-ec", made], cwd=tmp_path, check=True, capture_output=True)
    settings = {}
    for name, text in re.findall(r"(DASK_\w+)=(\S+)", lines):
        value = text.replace("$PWD", str(tmp_path))
        monkeypatch.setenv(name, value)
        settings[name[5:].lower().replace("__", ".").replace("_", "-")] = value
    running = Cluster("tls")
    try:
        address = running.listening()
        with dask.config.set(settings), closing(DaskPool(address)) as pool:
            assert outcomes(pool, Bad)[11].status == FAILED
        with refused("scheduler-unreachable") as caught:
            DaskPool(address)
        assert "set Dask's certificates" in str(caught.value)
        monkeypatch.setattr(DaskPool, "connect_s", 1.0)
        with refused("scheduler-unreachable"):
            DaskPool(address.replace("tls", "tcp"))
    finally:
        running.close()
