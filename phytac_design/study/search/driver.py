"""The driver of a study: draws candidates, evaluates them, stores their rows."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import Literal

from phytac_design.study.search.design_space import DesignSpace, Params
from phytac_design.study.search.sampler import Search, Sweep
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.study_folder import RESULTS, Store
from phytac_design.study.search.successive_halving import (
    DROPPED,
    OK,
    Outcome,
    SerialPool,
    promoted,
    task_of,
)

Progress = Callable[[str], None]
Kind = Literal["sweep", "optimise"]


@dataclass
class StudyRun:
    """What one run of the driver did.

    Attributes
    ----------
    folder : Path
        The study's folder.
    rows, new : int
        Candidates in its results, and those of this run.
    seconds : float
        Wall time of this run.
    statuses : Counter
        Number of this run's candidates by status.
    """

    folder: Path
    rows: int = 0
    new: int = 0
    seconds: float = 0.0
    statuses: Counter[str] = field(default_factory=Counter)

    @property
    def results(self) -> Path:
        """The rows."""
        return self.folder / RESULTS


class _ProgressReporter:
    """Logs rate and remaining time, at most every two seconds."""

    def __init__(self, progress: Progress, before: int, total: int) -> None:
        self.progress, self.before, self.total = progress, before, total
        self.start = self.last = time.monotonic()
        self.statuses: Counter[str] = Counter()

    def add(self, status: str, count: int) -> None:
        """Count candidates whose evaluation has ended."""
        self.statuses[status] += count
        now = time.monotonic()
        if now - self.last < 2.0:
            return
        self.last = now
        done = self.before + self.statuses.total()
        rate = self.statuses.total() / (now - self.start)
        left = timedelta(seconds=round(max(self.total - done, 0) / rate))
        counts = ", ".join(f"{n} {status}" for status, n in self.statuses.most_common())
        self.progress(
            f"{done} of {self.total} candidates, {rate:.3g}/s, about {left} remaining ({counts})"
        )


def run_study(
    study: Study,
    space: DesignSpace,
    folder: Path,
    *,
    kind: Kind,
    pool: SerialPool | None = None,
    storage: str = "",
    progress: Progress = lambda _: None,
) -> StudyRun:
    """Run or resume a study; the same study gives the same rows.

    Parameters
    ----------
    folder : Path
        The study's own folder.
    kind : str
        ``sweep`` or ``optimise``.
    pool : SerialPool, optional
        Where candidates are evaluated; this process by default. The caller closes it.
    storage : str
        Database URL of Optuna's trials; a file in the folder by default.

    Raises
    ------
    DesignError
        If the study is not valid.
    OutputError
        If the folder is another study's or cannot be written; completed candidates are kept.
    """
    start = time.monotonic()
    run = StudyRun(folder)
    store = Store(folder, study, space, kind)
    try:
        source: Sweep | Search
        if kind == "optimise":
            source = Search(study, space, storage or str(folder / "study.journal"))
            if source.known < store.rows:  # the driver was killed before Optuna had the last batch
                missed = store.read(source.known)
                fields = [axis.field for axis in space.axes]
                source.replay([{name: row[name] for name in fields} for row in missed], missed)
        else:
            source = Sweep(study, space)
        run.rows = store.rows
        reporter = _ProgressReporter(progress, store.rows, source.total)
        limit_s = study.budget.seconds or float("inf")
        while time.monotonic() - start <= limit_s:
            batch = source.ask(store.rows, study.sampling.batch)
            if not batch:
                break
            outcomes = _evaluate_batch(study, store, batch, pool or SerialPool(), reporter)
            first = store.rows
            rows = [store.row(first + k, own, outcomes[k]) for k, own in enumerate(batch)]
            store.close_batch(rows)
            source.tell(batch, rows)
            run.rows, run.new = store.rows, run.new + len(rows)
            run.statuses.update(row["status"] for row in rows)
        store.merge()
    finally:
        store.close()
    run.seconds = time.monotonic() - start
    return run


def _evaluate_batch(
    study: Study, store: Store, batch: list[Params], pool: SerialPool, reporter: _ProgressReporter
) -> dict[int, Outcome]:
    """Outcomes of a batch, one group of levels after the other; equal values are evaluated once."""
    outcomes: dict[int, Outcome] = {}
    remaining = set(range(len(batch)))
    groups = study.level_groups()
    for levels in groups:
        last, level = levels == groups[-1], levels[-1]
        tasks = {k: task_of(store.spec, batch[k], levels) for k in sorted(remaining)}
        copies = Counter(task.key for task in tasks.values())
        unique = {task.key: task for task in tasks.values() if task.key not in store.open_results}
        for task, outcome in pool.run(unique.values()):
            store.keep(task, outcome)
            if last or outcome.status != OK:
                reporter.add(outcome.status, copies[task.key])
        for k, task in tasks.items():
            outcomes[k] = outcomes.get(k, Outcome()).merged(store.open_results[task.key])
        remaining = promoted(study, level, {k: outcomes[k] for k in tasks})
        for k in tasks.keys() - remaining:
            if outcomes[k].status == OK and not last:
                above = len(study.levels) - 1 - study.levels.index(level)
                reason = (
                    f"not among the best {study.ladder.share[level]:.0%} of its batch after {level}"
                )
                outcomes[k] = outcomes[k].merged(
                    Outcome(status=DROPPED, rung=level, reason=reason, violation=above - 0.5)
                )
    return outcomes
