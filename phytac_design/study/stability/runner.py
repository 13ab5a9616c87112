"""Runs cases in worker processes: a hang or a crash of native code is a verdict, not the end."""

import json
import multiprocessing
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from phytac_design.study.stability.case import Case, Outcome
from phytac_design.study.stability.worker import serve
from phytac_shapes.errors import OutputError

START_S = 60.0
"""What a new process may take to import what its first case needs."""


def run_cases(
    cases: Sequence[Case],
    *,
    workers: int = 1,
    journal: Path | None = None,
    mark: str = "",
    done: Callable[[int, Outcome], None] = lambda _, __: None,
) -> list[Outcome]:
    """Outcomes of cases, in their order, whatever the number of workers.

    Parameters
    ----------
    cases : sequence of Case
        With keys of their own.
    workers : int
        Processes.
    journal : Path, optional
        File that keeps each outcome as soon as it is known; a later run takes up from it.
    mark : str
        Of the program and the seed: outcomes of another mark are not taken up.
    done : callable
        Called with the number of cases done so far and the last one's outcome.

    Raises
    ------
    OutputError
        If the journal cannot be written.
    """
    known = _known(journal, mark) if journal else {}
    outcomes: dict[str, Outcome] = {}
    for case in cases:
        if case.key in known:
            outcomes[case.key] = known[case.key]
    waiting = deque(case for case in cases if case.key not in outcomes)
    if journal:
        _open(journal, mark, list(known.values()))
    crew = [_Worker() for _ in range(min(workers, len(waiting)))]
    try:
        while waiting or any(worker.case for worker in crew):
            for worker in crew:
                if worker.case is None and waiting:
                    worker.give(waiting.popleft())
            for outcome in _finished(crew):
                outcomes[f"{outcome.room}: {outcome.name}"] = outcome
                if journal:
                    _write(journal, outcome)
                done(len(outcomes), outcome)
    finally:
        for worker in crew:
            worker.stop()
    return [outcomes[case.key] for case in cases]


@dataclass
class _Worker:
    """One process and the case that it is at."""

    process: BaseProcess | None = None
    pipe: Connection | None = None
    case: Case | None = None
    until: float = 0.0

    def give(self, case: Case) -> None:
        fresh = self.process is None or not self.process.is_alive()
        if fresh:
            self.stop()
            here, there = multiprocessing.get_context("spawn").Pipe()
            self.process = multiprocessing.get_context("spawn").Process(
                target=serve, args=(there,), daemon=True
            )
            self.process.start()
            there.close()
            self.pipe = here
        self.case = case
        self.until = time.monotonic() + case.limit_s + (START_S if fresh else 0.0)
        if self.pipe is not None:
            self.pipe.send(case)

    def stop(self) -> int | None:
        """End the process, at once; its exit code."""
        if self.process is None:
            return None
        if self.pipe is not None:
            self.pipe.close()
        self.process.join(timeout=0.5)
        self.process.kill()
        self.process.join()
        code = self.process.exitcode
        self.process = self.pipe = self.case = None
        return code


def _finished(crew: Sequence[_Worker]) -> list[Outcome]:
    """Outcomes that came in, crashed or are overdue; waits for one at least a little."""
    busy = {worker.pipe: worker for worker in crew if worker.case and worker.pipe}
    wait(list(busy), timeout=0.2)
    out = []
    for pipe, worker in busy.items():
        case = worker.case
        if case is None or pipe is None:
            continue
        if pipe.poll():
            try:
                out.append(Outcome.of(pipe.recv()))
                worker.case = None
            except (EOFError, ConnectionResetError):
                code = worker.stop()
                out.append(_lost(case, f"the process ended (exit code {code})"))
        elif time.monotonic() > worker.until:
            worker.stop()
            out.append(_lost(case, f"no answer within {case.limit_s:g} s"))
    return out


def _lost(case: Case, why: str) -> Outcome:
    return Outcome(room=case.room, name=case.name, shape=case.shape, verdict="wrong", why=why)


def _open(journal: Path, mark: str, kept: Sequence[Outcome]) -> None:
    """Begin a journal anew with what is kept of an older one."""
    text = "".join(_line(item) for item in [{"mark": mark}, *(o.plain() for o in kept)])
    try:
        journal.parent.mkdir(parents=True, exist_ok=True)
        journal.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(
            f"cannot write {journal}: {error.strerror}; choose another folder with --out"
        ) from None


def _write(journal: Path, outcome: Outcome) -> None:
    with journal.open("a", encoding="utf-8") as stream:
        stream.write(_line(outcome.plain()))


def _line(data: Any) -> str:
    return json.dumps(data, ensure_ascii=False) + "\n"


def _known(journal: Path, mark: str) -> dict[str, Outcome]:
    """Outcomes by key of a journal of the same mark; a last line cut short does not count."""
    try:
        lines = journal.read_text(encoding="utf-8").splitlines()
    except OSError:
        return {}
    found: dict[str, Outcome] = {}
    for number, line in enumerate(lines):
        try:
            data = json.loads(line)
            if number == 0 and data.get("mark") != mark:
                return {}
            if number:
                outcome = Outcome.of(data)
                found[f"{outcome.room}: {outcome.name}"] = outcome
        except (ValueError, KeyError, TypeError):
            break
    return found
