"""Tests against mutants: which tests reach a line, and whether one of them fails.

All work is on a copy of the tree in ``build/mutation``. A file of tests runs once under coverage;
what its tests reached, and for how long they ran, is kept until that file or a mutated package
changes. A mutant then meets the tests that reach its lines, the shortest first, until one fails.
Coverage does not see compiled code: there all tests that reach the module, or those that import it,
count, and kernels of both are compiled again, since numba compiles callees into their callers.

Each run is a fork of a process that has the heavy libraries loaded and none of this project.
"""

import hashlib
import json
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

import pytest

from benchmarks.mutants import PACKAGES, Mutant
from benchmarks.provenance import ROOT, bare_code

WORK = ROOT / "build" / "mutation"
TREE = WORK / "tree"
TESTS = (
    "tests/decoder",
    "tests/fabrication/test_switch_set.py",
    "tests/mechanics",
    "tests/optics",
    "tests/simulation",
    "tests/test_layout.py",
    "tests/test_layout_shapes.py",
    "tests/test_sight.py",
    "tests/test_sight_two.py",
)
SECONDS_MAX = 10.0
"""Processor time of the tests that meet a mutant; the first meets it however long it takes."""
AGAIN_SECONDS_MAX = 40.0
"""The same for a survivor that is tried once more."""
GRACE_S, COMPILE_S = 40.0, 120.0
"""Processor time for start, without and with compilation, besides three times that of the tests."""
MEMORY_MAX = 12 * 1024**3
LIBRARIES = (
    *("cv2", "manifold3d", "numba", "numpy", "pydantic", "pytest", "safetensors.numpy"),
    *("scipy.interpolate", "scipy.optimize", "scipy.sparse.linalg", "scipy.spatial", "tomlkit"),
    *("trimesh", "typer"),
)
Reached = dict[str, dict[str, Any]]


def _enter(cache: str, log: str) -> None:
    """Work in the copy of the tree, with the kernels of ``cache``; say nothing."""
    os.setsid()
    os.chdir(TREE)
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1)
    os.dup2(out, 2)
    paths = [str(TREE), str(TREE / "decoder"), str(TREE / "shapes")]
    sys.path[:] = paths + [path for path in sys.path if not path.startswith(str(ROOT))]
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    os.environ["NUMBA_CACHE_DIR"] = cache
    sys.dont_write_bytecode = True
    for name in [name for name in sys.modules if name.partition(".")[0] == "benchmarks"]:
        del sys.modules[name]
    import numba

    numba.config.CACHE_DIR = cache


class _Watch:
    """Of each test: whether it passes, its processor time, and what it reaches."""

    def __init__(self, coverage: Any) -> None:
        self.coverage = coverage
        self.tests: dict[str, float] = {}
        self.failed: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self.coverage.switch_context(item.nodeid)
        begin = time.process_time()
        result = yield
        self.tests[item.nodeid] = time.process_time() - begin
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self.failed.add(report.nodeid)


def _watch(path: str, out: str, cache: str, log: str) -> None:
    """Run one file of tests under coverage, in a process of its own; write what was reached."""
    _enter(cache, log)
    import coverage

    measure = coverage.Coverage(
        data_file=None, include=[f"{TREE}/{p}/*" for p in PACKAGES.values()]
    )
    watch = _Watch(measure)
    measure.start()
    pytest.main(["-q", "-p", "no:cacheprovider", "-m", "not long", path], plugins=[watch])
    measure.stop()
    data = measure.get_data()
    reached: Reached = {
        test: {"seconds": round(seconds, 3), "lines": {}}
        for test, seconds in watch.tests.items()
        if test not in watch.failed
    }
    for file in sorted(data.measured_files()):
        for line, tests in sorted(data.contexts_by_lineno(file).items()):
            for test in reached.keys() & set(tests):
                own = reached[test]["lines"].setdefault(str(Path(file).relative_to(TREE)), [])
                own.append(line)
    Path(out).write_text(json.dumps(reached))


def _meet(tests: list[str], seconds: int, cache: str, log: str) -> None:
    """Run tests in a process of its own until one fails; exit with 1 if one does."""
    _enter(cache, log)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_MAX, MEMORY_MAX))
    code = pytest.main(["-q", "-x", "-p", "no:cacheprovider", *tests])
    os._exit(0 if code == pytest.ExitCode.OK else 1)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a mutant.

    Attributes
    ----------
    outcome : str
        ``killed``, ``timeout`` or ``survived``.
    tests, of : int
        Tests that it met, and that reach it.
    """

    outcome: str
    tests: int
    of: int


class Runner:
    """Copies the tree, and runs tests on it."""

    def __init__(self) -> None:
        for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "PHYTAC_THREADS"):
            os.environ[name] = "1"
        shutil.rmtree(TREE, ignore_errors=True)
        left_out = shutil.ignore_patterns(".*", "build", "dist", "site", "exports", "results")
        shutil.copytree(ROOT, TREE, ignore=left_out)
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(list(LIBRARIES))
        self._cache = WORK / "kernels"
        self._cache.mkdir(exist_ok=True)

    @cached_property
    def reached(self) -> Reached:
        """What every test reaches; runs the files of tests for which that is not known."""
        folder = WORK / "reached"
        folder.mkdir(exist_ok=True)
        sources = [p for name in PACKAGES.values() for p in sorted((TREE / name).rglob("*.py"))]
        code = "".join(bare_code(path.read_text("utf-8")) for path in sources)
        found: Reached = {}
        for path in sorted(p for name in TESTS for p in _test_files(TREE / name)):
            name = path.relative_to(TREE).as_posix()
            digest = hashlib.sha256((code + path.read_text("utf-8")).encode()).hexdigest()[:16]
            out = folder / f"{path.stem}-{digest}.json"
            if not out.is_file():
                print(f"what {name} reaches", flush=True)
                _run(self._context, _watch, name, str(out), str(self._cache), limit_s=1200.0)
            if out.is_file():
                found |= json.loads(out.read_text())
        return found

    def tests(self, mutant: Mutant, *, wide: bool = False) -> list[str]:
        """Tests that reach a mutant, the shortest first.

        ``wide``: all that reach its module, and all of the files that hold one of the former. What
        a fixture or a cache has computed for another test is reached by that one alone.
        """
        lines = set(range(mutant.first_line, mutant.last_line + 1))
        files = {mutant.file}
        while mutant.compiled and not any(files & set(t["lines"]) for t in self.reached.values()):
            files = _importers(files)
        module = {
            test: lines & set(known["lines"].get(mutant.file, ()))
            for test, known in self.reached.items()
            if files & set(known["lines"])
        }
        # Lines that run on import belong to no test.
        chosen = {test for test, own in module.items() if own} or set(module)
        if mutant.compiled:
            chosen = set(module)
        if wide:
            files = {test.partition("::")[0] for test in chosen}
            chosen = set(module) | {t for t in self.reached if t.partition("::")[0] in files}
        return sorted(chosen, key=lambda test: (self.reached[test]["seconds"], test))

    def meet(self, mutant: Mutant, *, again: bool = False) -> Outcome:
        """Run tests on a mutant; ``again``: more of them, and for longer."""
        every = self.tests(mutant, wide=again)
        seconds_max = AGAIN_SECONDS_MAX if again else SECONDS_MAX
        sums = list(accumulate(self.reached[test]["seconds"] for test in every))
        chosen = every[: max(sum(total <= seconds_max for total in sums), 1)]
        if not chosen:
            return Outcome(outcome="survived", tests=0, of=0)
        grace = COMPILE_S if mutant.compiled else GRACE_S
        limit = int(3.0 * sums[len(chosen) - 1] + grace)
        with self._mutated(mutant) as cache:
            code = _run(self._context, _meet, chosen, limit, cache, limit_s=4.0 * limit)
        stopped = {0: "survived", None: "timeout", -signal.SIGXCPU: "timeout"}
        return Outcome(outcome=stopped.get(code, "killed"), tests=len(chosen), of=len(every))

    @contextmanager
    def _mutated(self, mutant: Mutant) -> Iterator[str]:
        """Write the mutant into the tree; yield the folder of compiled kernels to use."""
        path, fresh = TREE / mutant.file, WORK / "fresh"
        path.write_text(mutant.text(), encoding="utf-8")
        shutil.rmtree(fresh, ignore_errors=True)
        try:
            if "import kernel" in path.read_text("utf-8"):
                shutil.copytree(self._cache, fresh)
            if mutant.compiled:
                files = {mutant.file}
                while files != (files := files | _importers(files)):
                    pass
                for stem in {Path(file).stem for file in files}:
                    for compiled in fresh.rglob(f"{stem}.*.nb?"):
                        compiled.unlink()
            yield str(fresh if fresh.exists() else self._cache)
        finally:
            shutil.copy2(ROOT / mutant.file, path)


def _importers(files: set[str]) -> set[str]:
    """Files of the packages that import one of these."""
    names = {Path(file).with_suffix("").as_posix().replace("/", ".") for file in files}
    names = {name.removeprefix("decoder.") for name in names}
    return {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES.values()
        for path in (ROOT / package).rglob("*.py")
        if any(f"from {name} import" in path.read_text("utf-8") for name in names)
    }


def _test_files(path: Path) -> list[Path]:
    """Files of tests of a folder, or the file itself."""
    return sorted(path.rglob("test_*.py")) if path.is_dir() else [path]


def _run(
    context: BaseContext, work: Callable[..., None], *given: object, limit_s: float
) -> int | None:
    """Exit code of work in a fork, negative for a signal; None if it took too long."""
    # Every context has it, but their common base does not declare it.
    process = context.Process(target=work, args=(*given, str(WORK / "log.txt")))  # type: ignore[attr-defined]
    process.start()
    process.join(limit_s)
    code: int | None = process.exitcode
    # Also what it started itself.
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.join()
    return code
