"""Options of ``python -m pytest verification``: a limit of time and memory, outcomes as a file.

Native code that hangs or grows ends its process: run with ``-n 2`` to have pytest-xdist report such
a case as failed and continue with the others.
"""

import os

# Before numpy loads: workers share the machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import faulthandler
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from verification.case import Cases

LIMIT_S = 300.0
"""Time after which a case has failed, unless its module has another ``LIMIT_S``."""
STDERR = pytest.StashKey[int]()
"""Copy of the standard error, which pytest captures during a test."""
MEMORY_MAX_BYTES = 8 << 30
"""Address space of a process: a case that needs more has failed; the machine must not."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--outcomes FILE``."""
    parser.addoption("--outcomes", help="write the outcome of every case to this JSON-lines file")


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers; limit the memory; start the file of outcomes."""
    config.addinivalue_line("markers", "fast: three cases of each module, within a minute")
    config.stash[STDERR] = os.dup(2)
    path = config.getoption("--outcomes")
    if path and not hasattr(config, "workerinput"):
        Path(path).write_text("", encoding="utf-8")
    try:
        import resource
    except ImportError:
        return  # not on this system: cases share its memory unguarded
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    limit = MEMORY_MAX_BYTES if hard == resource.RLIM_INFINITY else min(MEMORY_MAX_BYTES, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the fast subset."""
    for item in items:
        if isinstance(item, pytest.Function) and hasattr(item, "callspec"):
            cases = getattr(item.module, "CASES", None)
            if isinstance(cases, Cases) and item.callspec.params.get("case") in cases.fast():
                item.add_marker("fast")


@pytest.fixture(autouse=True)
def _time_limit(request: pytest.FixtureRequest) -> Iterator[None]:
    """End the process if a case hangs, even in native code."""
    seconds = getattr(request.module, "LIMIT_S", LIMIT_S)
    faulthandler.dump_traceback_later(seconds, exit=True, file=request.config.stash[STDERR])
    yield
    faulthandler.cancel_dump_traceback_later()


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases neither use nor fill the user's cache."""
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


class _Outcomes:
    """Writes what ``verify`` recorded, and cases that ended their process."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Append the outcome of a case."""
        if report.when != "call" and report.outcome != "failed":
            return
        module, _, name = report.nodeid.removesuffix("]").partition("[")
        outcome: Any = dict(report.user_properties).get("outcome")
        verdict = "right" if report.passed else "wrong"
        why = "" if report.passed else str(report.longrepr)[-300:]
        plain: dict[str, Any] = {
            "name": name or module,
            "verdict": verdict,
            "findings": [],
            "message": "",
            "why": why,
            "facts": {},
            "seconds": report.duration,
        }
        group = Path(module.partition("::")[0]).stem.removeprefix("test_")
        line = json.dumps({"group": group} | (outcome or plain), ensure_ascii=False)
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(line + "\n")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Collect outcomes in the process that has all reports."""
    path = session.config.getoption("--outcomes")
    if path and not hasattr(session.config, "workerinput"):
        session.config.pluginmanager.register(_Outcomes(Path(path)))
