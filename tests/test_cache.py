"""The stage cache: whole or not at all, under builds at once, kills, damage and eviction."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from phytac_design.cli.app import app
from phytac_design.cli.cache_command import duration_s, size_bytes
from phytac_design.engine import cache
from tests.refusals import refused

KEY = "a1b2c3d4e5f6" * 5

WORKER = """
import sys, time
from pathlib import Path
from phytac_design.engine import cache
def work(folder):
    (folder / "export").mkdir()
    (folder / "export" / "out.txt").write_text(sys.argv[2])
    print("at it", flush=True)
    time.sleep(float(sys.argv[3]))
    return {"seconds": 0.5}
folder = cache.publish("views", sys.argv[1], work, waiting=lambda: print("waits", flush=True))
print((folder / "export" / "out.txt").read_text())
"""


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def writes(text: str, size: int = 1) -> Callable[[Path], dict[str, Any]]:
    """A stage that writes one file."""

    def work(folder: Path) -> dict[str, Any]:
        (folder / "out.txt").write_text(text * size)
        return {"seconds": 0.1}

    return work


def worker(key: str, text: str, seconds: float) -> subprocess.Popen[str]:
    """Another process that makes a result."""
    args = [sys.executable, "-c", WORKER, key, text, str(seconds)]
    return subprocess.Popen(args, stdout=subprocess.PIPE, text=True)


def line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def hidden(root: Path) -> list[Path]:
    """Scratch folders and locks."""
    return list(root.glob("*/.*"))


def test_a_second_process_waits_for_the_first_and_takes_its_result(root: Path) -> None:
    first = worker(KEY, "first", 1.0)
    assert line(first) == "at it"
    second = worker(KEY, "second", 0.0)
    assert line(second) == "waits"
    assert line(second) == "first"
    assert line(first) == "first"
    for process in (first, second):
        process.communicate()
        assert process.returncode == 0
    assert not hidden(root)


def test_other_keys_are_not_waited_for() -> None:
    slow = worker(KEY, "slow", 30.0)
    assert line(slow) == "at it"
    other = "f" * 60
    folder = cache.publish("views", other, writes("quick"), waiting=lambda: pytest.fail("waited"))
    assert (folder / "out.txt").read_text() == "quick"
    slow.kill()
    slow.communicate()


def test_what_a_killed_process_left_is_redone_and_swept(root: Path) -> None:
    killed = worker(KEY, "half", 60.0)
    assert line(killed) == "at it"
    os.kill(killed.pid, signal.SIGKILL)
    killed.communicate()
    assert len(hidden(root)) == 2
    assert cache.lookup("views", KEY) is None
    begin = time.perf_counter()
    folder = cache.publish("views", KEY, writes("whole"))
    assert time.perf_counter() - begin < 5.0
    assert (folder / "out.txt").read_text() == "whole"
    assert not hidden(root)


def test_prune_sweeps_what_the_dead_left_and_spares_what_the_living_make(root: Path) -> None:
    dead, alive = worker(KEY, "dead", 60.0), worker("b" * 60, "alive", 1.5)
    assert line(dead) == line(alive) == "at it"
    dead.kill()
    dead.communicate()
    done = cache.prune(limit_bytes=0.0)
    assert done.leftovers == 1
    assert line(alive) == "alive"
    alive.communicate()
    assert alive.returncode == 0
    assert not hidden(root)


@pytest.mark.parametrize("harm", ["shorter", "gone", "flipped", "record", "record flipped"])
def test_a_damaged_result_is_reported_and_made_again(harm: str) -> None:
    folder = cache.publish("views", KEY, writes("right"))
    record = folder / cache.RECORD
    if harm == "record":
        record.write_text('{"seconds": 1')
    elif harm == "record flipped":
        record.write_text(record.read_text().replace("0.1", "0.3", 1))
    elif harm == "gone":
        (folder / "out.txt").unlink()
    else:
        (folder / "out.txt").write_text("r" if harm == "shorter" else "wrong")
    reports: list[str] = []
    assert cache.lookup("views", KEY, report=reports.append) is None
    (report,) = reports
    assert "views is damaged" in report
    assert ("stage.json" if "record" in harm else "out.txt") in report
    folder = cache.publish("views", KEY, writes("right"))
    assert (folder / "out.txt").read_text() == "right"


def test_results_are_readable_as_the_umask_says() -> None:
    before = os.umask(0o022)
    try:
        folder = cache.publish("views", KEY, writes("right"))
    finally:
        os.umask(before)
    assert folder.stat().st_mode & 0o777 == 0o755
    assert (folder / "out.txt").stat().st_mode & 0o777 == 0o644


def test_verify_finds_changed_bytes_and_drops_them() -> None:
    folder = cache.publish("views", KEY, writes("right"))
    cache.publish("shell", KEY, writes("other"))
    (folder / "out.txt").write_text("wrong")
    assert cache.damaged() == [folder]
    shown = CliRunner().invoke(app, ["cache", "--verify", "--json"])
    assert shown.exit_code == 0
    assert json.loads(shown.stdout)["damaged"] == 1
    assert cache.lookup("views", KEY) is None
    assert cache.lookup("shell", KEY) is not None


def three() -> list[Path]:
    """Results of 1000 bytes last used 300, 200 and 100 s ago."""
    folders = []
    for number in range(3):
        folder = cache.publish("views", f"{number}" * 60, writes("x", 1000))
        then = time.time() - 100.0 * (3 - number)
        os.utime(folder / cache.RECORD, (then, then))
        folders.append(folder)
    return folders


def test_the_least_recently_used_goes_first() -> None:
    old, middle, new = three()
    assert cache.lookup("views", "0" * 60) == old  # which is now the last used
    size = sum(entry.size_bytes for entry in cache.entries())
    done = cache.prune(limit_bytes=size - 1)
    assert (done.dropped, done.in_use) == (1, 0)
    assert [path.exists() for path in (old, middle, new)] == [True, False, True]


def test_what_was_not_used_for_long_goes() -> None:
    old, middle, new = three()
    assert cache.prune(limit_bytes=float("inf"), older_than_s=250.0).dropped == 1
    assert [path.exists() for path in (old, middle, new)] == [False, True, True]


def test_what_is_read_stays_whatever_the_limit() -> None:
    old, middle, new = three()
    with cache.held(middle) as there:
        assert there
        done = cache.prune(limit_bytes=0.0)
        assert (done.dropped, done.in_use) == (2, 1)
        assert [path.exists() for path in (old, middle, new)] == [False, True, False]
    assert cache.prune(limit_bytes=0.0).dropped == 1
    with cache.held(middle) as there:
        assert not there


def test_full_disk_is_said_with_its_fix(root: Path) -> None:
    def full(folder: Path) -> dict[str, Any]:
        (folder / "half.bin").write_bytes(b"0" * 100)
        raise OSError(errno.ENOSPC, "No space left on device")

    with refused("output-not-writable") as caught:
        cache.publish("views", KEY, full)
    caught.match("phytac cache --prune")
    assert not hidden(root)
    assert cache.lookup("views", KEY) is None


def test_other_errors_of_a_stage_pass_through(root: Path) -> None:
    def broken(_: Path) -> dict[str, Any]:
        raise FileNotFoundError(errno.ENOENT, "no such thing")

    with pytest.raises(FileNotFoundError):
        cache.publish("views", KEY, broken)
    assert not hidden(root)


def test_the_command_shows_and_prunes() -> None:
    three()
    cache.publish("shell", KEY, writes("y", 10))
    shown = CliRunner().invoke(app, ["cache"])
    assert shown.exit_code == 0
    assert "4 results" in shown.stdout
    assert "within 10 GB" in shown.stdout
    pruned = CliRunner().invoke(app, ["cache", "--prune", "0", "--json"])
    facts = json.loads(pruned.stdout)
    assert facts["pruned"]["results"] == 4
    assert facts["results"] == facts["bytes"] == 0


def test_an_empty_cache_is_shown_as_such() -> None:
    shown = CliRunner().invoke(app, ["cache", "--json", "--prune", "1GB", "--verify"])
    assert json.loads(shown.stdout)["results"] == 0


@pytest.mark.parametrize(
    ("text", "size"), [("0", 0.0), ("2GB", 2e9), ("1.5 MB", 1.5e6), ("10k", 1e4), ("3G", 3e9)]
)
def test_sizes(text: str, size: float) -> None:
    assert size_bytes(text) == size


@pytest.mark.parametrize("text", ["", "GB", "-1GB", "5", "2 TB", "nan"])
def test_no_sizes(text: str) -> None:
    with refused("cache-size-invalid") as caught:
        size_bytes(text)
    caught.match("2GB")


def test_times() -> None:
    assert [duration_s(text) for text in ("90s", "30m", "12h", "7d")] == [90, 1800, 43200, 604800]
    with refused("duration-invalid") as caught:
        duration_s("7 weeks")
    caught.match("7d")


@pytest.mark.parametrize("text", ["much", "-1", "nan", "inf"])
def test_a_limit_that_is_no_size_is_refused(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PHYTAC_CACHE_GB", text)
    with refused("cache-size-invalid") as caught:
        cache.limit_bytes()
    caught.match("PHYTAC_CACHE_GB")
