"""Tasks over processes: same results for any number of them, errors raised, deaths survived."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from phytac_design.core.workers import Assigned, TaskResult, WorkerPool
from phytac_shapes.errors import DesignError
from tests.refusals import refused


def start(base: int) -> int:
    if base < 0:
        raise DesignError("base-below-zero", "base below zero")
    return base


def work(base: int, task: int) -> int:
    if task == 13:
        raise DesignError("number-thirteen", "thirteen")
    return base + task


def die_at_two(_: None, task: int) -> int:
    if task == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def die_once(_: None, mark: Path) -> int:
    if not mark.exists():
        mark.touch()
        os._exit(3)
    return 1


def sleep(_: None, seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def process_id(_: None, __: int) -> int:
    return os.getpid()


def environment(_: None, name: str) -> str | None:
    return os.environ.get(name)


@pytest.mark.parametrize("workers", [0, 1, 3])
def test_every_task_is_done_once(workers: int) -> None:
    with WorkerPool(work, workers=workers, start=start, arguments=(100,)) as pool:
        found = list(pool.run([5, 3, 9, 0]))
        assert sorted((r.index, r.value) for r in found) == [(0, 105), (1, 103), (2, 109), (3, 100)]
        assert list(pool.run([])) == []
        assert [r.value for r in pool.run([7])] == [107]


@pytest.mark.parametrize("workers", [0, 1])
def test_errors_of_workers_are_raised(workers: int) -> None:
    with (
        refused("base-below-zero"),
        WorkerPool(work, workers=workers, start=start, arguments=(-1,)) as pool,
    ):
        list(pool.run([1]))
    with WorkerPool(work, workers=workers, start=start, arguments=(0,)) as pool:
        with refused("number-thirteen"):
            list(pool.run([13]))
        assert [r.value for r in pool.run([1])] == [1]


def test_a_task_that_kills_its_process_costs_no_other() -> None:
    with WorkerPool(die_at_two, workers=2) as pool:
        results = sorted(pool.run(range(5)), key=lambda r: r.index)
    assert [r.value for r in results] == [0, 1, None, 3, 4]
    assert "exit code -9" in results[2].lost


def test_a_task_whose_process_died_is_repeated(tmp_path: Path) -> None:
    with WorkerPool(die_once, workers=1) as pool:
        assert list(pool.run([tmp_path / "a"])) == [TaskResult(index=0, value=1)]
    with WorkerPool(die_once, workers=1, retries=0) as pool:
        assert [r.value for r in pool.run([tmp_path / "b"])] == [None]


def test_a_task_over_its_time_is_lost_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("phytac_design.core.workers.START_S", 0.0)
    with WorkerPool(sleep, workers=1) as pool:
        list(pool.run([0.0]))
        pool.time_limit_s = lambda task: 0.5 if task else 30.0
        results = list(pool.run([100.0, 0.0]))
    assert results[0] == TaskResult(index=0, lost="no answer within 0.5 s")
    assert results[1] == TaskResult(index=1, value=0.0)


def test_processes_are_kept_or_replaced_and_have_one_thread() -> None:
    with WorkerPool(process_id, workers=1) as pool:
        assert len({r.value for r in pool.run(range(3))}) == 1
    with WorkerPool(process_id, workers=1, tasks_per_process=1) as pool:
        assert len({r.value for r in pool.run(range(3))}) == 3
    with WorkerPool(environment, workers=1) as pool:
        assert [r.value for r in pool.run(["OPENBLAS_NUM_THREADS"])] == ["1"]


def test_tasks_for_a_certain_worker() -> None:
    with WorkerPool(process_id, workers=2) as pool:
        assert pool.free() == [0, 1]
        found = sorted(pool.run([Assigned(1, "a"), Assigned(0, "b")]), key=lambda r: r.index)
        again = [r.value for r in pool.run([Assigned(1, "c")])] + [
            r.value for r in pool.run([Assigned(0, "d")])
        ]
    assert again == [r.value for r in found]
    assert len(set(again)) == 2
    with WorkerPool(sleep, workers=2) as pool, pytest.raises(ValueError, match="1 is not free"):
        list(pool.run([Assigned(1, 0.0), Assigned(1, 0.0)]))


def test_a_worker_that_takes_the_place_of_another_has_another_number(tmp_path: Path) -> None:
    with WorkerPool(die_once, workers=1) as pool:
        assert [r.value for r in pool.run([Assigned(0, tmp_path / "a")])] == [1]
        assert pool.free() == [1]


def test_workers_have_the_environment_of_their_call(monkeypatch: pytest.MonkeyPatch) -> None:
    """The server that they are forked from may have started before."""
    monkeypatch.setenv("PHYTAC_TEST", "old")
    for expected in ("old", "new", None):
        if expected is None:
            monkeypatch.delenv("PHYTAC_TEST")
        else:
            monkeypatch.setenv("PHYTAC_TEST", expected)
        with WorkerPool(environment, workers=1) as pool:
            assert [r.value for r in pool.run(["PHYTAC_TEST", "PHYTAC_PRELOAD"])] == [
                expected,
                None,
            ]


AHEAD = """
import gc, sys
from phytac_design.core.workers import WorkerPool, import_ahead
def work(_, name):
    return name in sys.modules, gc.isenabled(), gc.get_freeze_count() > 0
if __name__ == "__main__":
    import_ahead(sys.argv[1])
    with WorkerPool(work, workers=1) as pool:
        print(*(result.value for result in pool.run(["xml.dom.minidom"])))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux alone")
@pytest.mark.parametrize(
    ("module", "folder", "expected"),
    [
        ("xml.dom.minidom", "", "(True, True, True)"),
        ("not_a_module", "", "(False, True, True)"),
        ("fails", "", "(False, True, True)"),
        ("xml.dom.minidom", 90 * "long", "(False, True, False)"),  # no room for a socket's name
    ],
)
def test_workers_have_imported_what_was_named_ahead(
    tmp_path: Path, module: str, folder: str, expected: str
) -> None:
    script = tmp_path / "script.py"
    script.write_text(AHEAD)
    (tmp_path / "fails.py").write_text("raise ValueError")
    temporary = tmp_path / folder[:200]
    temporary.mkdir(exist_ok=True)
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1]), "TMPDIR": str(temporary)}
    done = subprocess.run(
        [sys.executable, str(script), module], env=env, check=True, capture_output=True, text=True
    )
    assert done.stdout.strip() == expected
    assert done.stderr == ""


SLOW = """
import time
from phytac_design.core.workers import import_ahead
if __name__ == "__main__":
    import_ahead("slow")
    print("begun", flush=True)
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        print("stopped")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux alone")
def test_ctrl_c_while_modules_are_imported_ahead_prints_nothing(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SLOW)
    mark = tmp_path / "mark"
    (tmp_path / "slow.py").write_text(
        f"import pathlib, time; pathlib.Path({str(mark)!r}).touch(); time.sleep(1.0)"
    )
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "script.py")],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    _until(mark.exists, 60.0)
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate(timeout=60.0) == ("begun\nstopped\n", "")


PRODUCTS = """
import os, phytac_design.cli.app
import numpy as np
values = np.random.default_rng(0).normal(size=(700, 700))
print(len(os.listdir("/proc/self/task")), (values @ values).tobytes().hex()[:4000])
"""


def test_a_command_gives_the_same_digits_whatever_the_environment() -> None:
    """With two threads of BLAS the last digits differ."""

    def digits(threads: str) -> tuple[str, str]:
        names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
        command = [sys.executable, "-c", PRODUCTS]
        own = os.environ | dict.fromkeys(names, threads)
        done = subprocess.run(command, env=own, check=True, capture_output=True, text=True)
        count, product = done.stdout.split()
        return count, product

    assert digits("2") == digits("1")
    assert digits("2")[0] == "1"


SCRIPT = """
import os, sys, time
from pathlib import Path
from phytac_design.core.workers import WorkerPool
folder = Path(sys.argv[1])
def work(_, task):
    (folder / str(os.getppid())).touch()  # the server
    (folder / str(os.getpid())).touch()
    time.sleep(60)
if __name__ == "__main__":
    list(WorkerPool(work, workers=2).run(range(4)))
"""


def test_workers_end_with_a_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    folder = tmp_path / "pids"
    folder.mkdir()
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    parent = subprocess.Popen(
        [sys.executable, str(script), str(folder)], env=env, stderr=subprocess.DEVNULL
    )
    try:
        _until(lambda: len(list(folder.iterdir())) == 3, 60.0)
    finally:
        parent.kill()
        parent.wait()
    pids = [int(path.name) for path in folder.iterdir()]
    assert len(set(pids) - {parent.pid}) == (3 if sys.platform == "linux" else 2)
    _until(lambda: not any(_alive(pid) for pid in pids), 10.0)


def _alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def _until(reached: "object", seconds: float) -> None:
    assert callable(reached)
    end = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < end
        time.sleep(0.05)
