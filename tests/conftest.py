"""A built small sensor, made once for the whole run, in a cache of its own."""

import fcntl
import gc
import importlib.util
import os
import signal
import sys
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

# As the command line does, before numpy loads (see ``phytac_design.cli.app``).
if "numpy" in sys.modules and "OPENBLAS_NUM_THREADS" not in os.environ:
    # Processes of tests that each use all cores for small matrices take up to ten times as long.
    raise pytest.UsageError(
        "a plugin loads numpy too early: -p no:PLUGIN or OPENBLAS_NUM_THREADS=1"
    )
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Two processes of tests use both cores; more threads only cost their start.
os.environ.setdefault("PHYTAC_THREADS", "1")
# glibc gives the memory of every larger array back and asks for it again: 3 % of the time of tests.
# It reads this when a process starts: as those of pytest-xdist and of tests do.
for name, mebibytes in (("TRIM_THRESHOLD_", 128), ("MMAP_THRESHOLD_", 32), ("TOP_PAD_", 16)):
    os.environ.setdefault(f"MALLOC_{name}", str(mebibytes << 20))


def _own_turn() -> int | None:
    """Wait, in a new environment, until no other process imports what tests import.

    Python compiles a library at its first import: at the same time, each process would do so.
    Returned is the file to close when this one is done.
    """
    found = importlib.util.find_spec("cadquery")
    if found is None or found.origin is None or "PYTEST_XDIST_WORKER" not in os.environ:
        return None
    if sys.dont_write_bytecode or Path(importlib.util.cache_from_source(found.origin)).exists():
        return None
    turn = os.open(__file__, os.O_RDONLY)
    fcntl.flock(turn, fcntl.LOCK_EX)
    return turn


TURN = _own_turn()
# While tests are collected, whatever is imported stays: see ``pytest_runtestloop``.
gc.disable()

from collections.abc import Iterator

from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from phytac_design.engine.stage import graphics_libraries
from phytac_design.stages.build import BuildResult, build
from tests.coarse_switches import coarse_bowls
from tests.designs import QUICK, small


@pytest.fixture(autouse=True)
def _broken_pipes_are_errors() -> None:
    """As Python begins: what another test has called may have had them end the process."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Tests neither use nor fill the user's cache; processes of one run share theirs."""
    base = tmp_path_factory.getbasetemp()
    cache = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "cache"
    cache.mkdir(exist_ok=True)
    pytest.MonkeyPatch().setenv("PHYTAC_CACHE", str(cache))


@pytest.fixture(scope="session", autouse=True)
def _kernels_are_compiled_once(own_cache: None) -> Iterator[None]:
    """Processes wait for the one that compiles a kernel, and load what it has kept."""
    exact = Dispatcher.compile
    cache = Path(os.environ["PHYTAC_CACHE"])

    def compiled(dispatcher: Any, signature: Any) -> Any:
        kernel = f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__} {signature}"
        name = f"{sha256(kernel.encode()).hexdigest()[:16]}.kernel"
        # Numba's own lock comes first in every thread: two locks in two orders would be a deadlock.
        with global_compiler_lock, (cache / name).open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            return exact(dispatcher, signature)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Dispatcher, "compile", compiled)
        yield


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory, own_cache: None) -> BuildResult:
    """The small design, built whole at draft accuracy and with tools, and coarse switches."""
    out = tmp_path_factory.mktemp("exports") / "small"
    with coarse_bowls():
        return build(small(), out, accuracy=QUICK, progress=lambda _: None)


@pytest.fixture
def coarse_switches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """:func:`coarse_bowls` in a cache of its own: no other test takes them for the exact ones."""
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    with coarse_bowls():
        yield


NEEDS_CAD = (
    "tests/fabrication/test_cad.py",
    "tests/fuzz/test_step.py::test_damaged_files_are_refused_in_words",
    "tests/test_build.py::test_folder_is_the_contract",
    "tests/test_build.py::test_report_holds_the_figures",
)


SLOW_FILES = frozenset((Path(__file__).parent / "slow_files.txt").read_text().split())
"""Test files of more than three seconds on two cores; `make check` leaves them out."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark slow files, and skip tests of STEP where the libraries of CadQuery are missing."""
    for item in items:
        if item.path.relative_to(config.rootpath).as_posix() in SLOW_FILES:
            item.add_marker(pytest.mark.slow)
    missing = [name for name, found in graphics_libraries().items() if not found]
    if not missing:
        return
    reason = pytest.mark.skip(reason=f"CadQuery needs {', '.join(missing)}; see README")
    for item in items:
        if item.nodeid.startswith(NEEDS_CAD):
            item.add_marker(reason)


def pytest_collection_finish() -> None:
    """Let the next process collect."""
    if TURN is not None:
        os.close(TURN)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop() -> None:
    """Look for garbage from here on, and not among what has been imported."""
    gc.freeze()
    gc.enable()
