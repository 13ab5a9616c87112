"""A build started by the studio: `phytac build` in its own process, followed line by line."""

import asyncio
import os
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from phytac_design.design.design_file import to_toml
from phytac_design.design.spec import Design
from phytac_shapes.errors import InputError, OutputError

ERROR_LINE = re.compile(r"error\[([a-z0-9-]+)\]: ")
"""The line in which the command line reports an error, with its code."""

Json = dict[str, Any]


class BuildRunner:
    """At most one build at a time, into ``exports/NAME`` of the project folder ``root``.

    ``stop_timeouts_s`` is the time to end after SIGINT, and then after SIGTERM.
    """

    stop_timeouts_s = (5.0, 5.0)

    def __init__(self, root: Path) -> None:
        self.root = root
        self._process: asyncio.subprocess.Process | None = None
        self._watch: asyncio.Task[None] | None = None
        self._lines: list[str] = []
        self._stages: list[str] = []
        self._state: Json = {"state": "none"}
        self._number = 0
        self._start_s = 0.0
        self._stopped = False

    @property
    def running(self) -> bool:
        """Whether a build is running."""
        return self._watch is not None and not self._watch.done()

    def state(self) -> Json:
        """State of the build: share done, stage, seconds, and its report."""
        state = dict(self._state)
        if self.running:
            state["seconds"] = round(time.monotonic() - self._start_s, 1)
        return state

    async def start(self, design: Design, accuracy: str, *, force: bool) -> Json:
        """Build a design.

        Raises
        ------
        InputError
            If a build runs already.
        OutputError
            If the process cannot be started.
        """
        if self.running:
            raise InputError(
                "build-running",
                f"{self._state.get('name')} is being built; wait for it, or stop it first",
            )
        out = Path("exports") / design.name
        folder = tempfile.mkdtemp(prefix="phytac-studio-")
        path = Path(folder) / f"{design.name}.toml"
        words = [sys.executable, "-m", "phytac_design", "build", str(path)]
        words += ["--accuracy", accuracy, "--out", str(out), *["--force"] * force]
        try:
            path.write_text(to_toml(design), encoding="utf-8")
            self._process = await asyncio.create_subprocess_exec(
                *words,
                cwd=self.root,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
                limit=64_000,
                # Its own group: signals reach all its processes, and Ctrl-C does not.
                start_new_session=True,
            )
        except OSError as error:
            raise OutputError(
                "build-not-started", f"cannot start a build: {error.strerror}; free disk space"
            ) from None
        self._number += 1
        self._lines, self._stopped, self._start_s = [], False, time.monotonic()
        self._stages = []
        self._state = {
            "state": "running",
            "number": self._number,
            "name": design.name,
            "accuracy": accuracy,
            "out": out.as_posix(),
            "done": 0.0,
            "stage": "starting",
        }
        self._watch = asyncio.create_task(self._follow(self._process, path, out))
        return self.state()

    async def _follow(self, process: asyncio.subprocess.Process, path: Path, out: Path) -> None:
        """Read the build's lines until it ends, then set the final state."""
        try:
            assert process.stdout is not None  # noqa: S101 - it is a pipe
            while True:
                try:
                    line = await process.stdout.readline()
                except ValueError:
                    continue  # a line above the limit is dropped
                if not line:
                    break
                self._add_line(line.decode("utf-8", "replace").rstrip())
            code = await process.wait()
        finally:
            shutil.rmtree(path.parent, ignore_errors=True)
        page = out / "report" / "report.html"
        if code == 0:
            self._state |= {"state": "done", "done": 1.0, "stage": ""}
            if (self.root / page).is_file():
                self._state["report"] = page.as_posix()
        elif self._stopped:
            self._state |= {"state": "stopped", "stage": ""}
        else:
            errors = [found for line in self._lines if (found := ERROR_LINE.match(line))]
            why = errors[-1].string if errors else "".join(self._lines[-1:])
            self._state |= {
                "state": "failed",
                "stage": "",
                "error": why or f"exit code {code}",
                "code": errors[-1][1] if errors else "",
            }
        self._state["seconds"] = round(time.monotonic() - self._start_s, 1)

    def _add_line(self, line: str) -> None:
        if line and len(self._lines) < 2000:
            self._lines.append(line)
        # Stages that have ended, their count, a stage's name, a figure behind it if it is one of
        # these, and the time left where the build predicts it.
        stage = re.match(r"\[(\d+)/(\d+)\] ([a-z-]+)( \d)?(?:.*\(about (\d+) s left\)$)?", line)
        if not stage:
            return
        ended = stage[4] is not None
        self._stages = [name for name in self._stages if name != stage[3]] + [stage[3]] * (
            not ended
        )
        done = int(stage[1]) / max(int(stage[2]), 1)
        if stage[5]:
            elapsed_s = time.monotonic() - self._start_s
            done = elapsed_s / (elapsed_s + float(stage[5]))
        # Predictions change, and stages that run side by side end in another order.
        self._state["done"] = max(self._state["done"], round(done, 3))
        self._state["stage"] = ", ".join(self._stages) or stage[3]

    async def events(self) -> AsyncIterator[Json]:
        """State and new lines, repeatedly until the build has ended."""
        sent = 0
        while True:
            running = self.running and self._state["state"] == "running"
            fresh = self._lines[sent:]
            sent = len(self._lines)
            yield self.state() | {"lines": fresh}
            if not running:
                return
            await asyncio.sleep(0.2)

    async def stop(self) -> Json:
        """Stop the build and its processes; finished stages stay in the cache."""
        process, watch = self._process, self._watch
        if process is None or watch is None or watch.done():
            return self.state()
        self._stopped = True
        # On SIGINT a build leaves complete files.
        for number, timeout in zip(
            (signal.SIGINT, signal.SIGTERM), self.stop_timeouts_s, strict=True
        ):
            _signal(process.pid, number)
            with suppress(TimeoutError):
                await asyncio.wait_for(asyncio.shield(watch), timeout)
                break
        _signal(process.pid, signal.SIGKILL)
        with suppress(TimeoutError):
            await asyncio.wait_for(asyncio.shield(watch), 5.0)
        return self.state()


def _signal(group: int, number: signal.Signals) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(group, number)
