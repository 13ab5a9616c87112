"""Work over processes: the same results for any number of them, errors told, deaths survived."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from phytac_design.simulation.run.worker_pool import Crew
from phytac_shapes.errors import DesignError


def start(base: int) -> int:
    if base < 0:
        raise DesignError("base below zero")
    return base


def work(base: int, index: int) -> int:
    if index == 13:
        raise DesignError("thirteen")
    return base + index


def die_at_two(_: int, index: int) -> int:
    if index == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return index


@pytest.mark.parametrize("workers", [0, 1, 3])
def test_every_sample_is_done_once(workers: int) -> None:
    crew = Crew(start=start, given=(100,), work=work, workers=workers)
    found = list(crew.run([5, 3, 9, 0]))
    assert sorted(found) == [(0, 100), (3, 103), (5, 105), (9, 109)]
    assert list(crew.run([])) == []


def test_errors_of_workers_are_told() -> None:
    with pytest.raises(DesignError, match="below zero"):
        list(Crew(start=start, given=(-1,), work=work, workers=1).run([1]))
    with pytest.raises(DesignError, match="thirteen"):
        list(Crew(start=start, given=(0,), work=work, workers=1).run([13]))


def test_a_sample_that_kills_its_process_costs_no_other() -> None:
    crew = Crew(start=start, given=(0,), work=die_at_two, workers=2)
    assert sorted(crew.run(range(5)), key=lambda item: item[0]) == [
        (0, 0),
        (1, 1),
        (2, None),
        (3, 3),
        (4, 4),
    ]


SCRIPT = """
import os, sys, time
from pathlib import Path
from phytac_design.simulation.run.worker_pool import Crew
folder = Path(sys.argv[1])
def start(): return None
def work(_, index):
    (folder / str(os.getpid())).touch()
    time.sleep(60)
if __name__ == "__main__":
    list(Crew(start=start, given=(), work=work, workers=2).run(range(4)))
"""


def test_workers_end_with_a_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    folder = tmp_path / "pids"
    folder.mkdir()
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    parent = subprocess.Popen(
        [sys.executable, str(script), str(folder)], env=env, stderr=subprocess.DEVNULL
    )
    try:
        _until(lambda: len(list(folder.iterdir())) == 2, 60.0)
    finally:
        parent.kill()
        parent.wait()
    pids = [int(path.name) for path in folder.iterdir()]
    assert len(pids) == 2
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
