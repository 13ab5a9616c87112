"""The one driver: asks for candidates, has them climb, keeps what comes of them, and tells."""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from phytac_design.study.search.pool import OwnProcess, Pool
from phytac_design.study.search.sampler import Search, Sweep
from phytac_design.study.search.space import Params, Space
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.study_folder import RESULTS, Store
from phytac_design.study.search.successive_halving import DROPPED, OK, Outcome, promoted, task_of

Progress = Callable[[str], None]
Kind = Literal["sweep", "optimise"]
SAY_EVERY_S = 2.0
JOURNAL = "study.journal"


@dataclass
class StudyRun:
    """What a run of the driver did.

    Attributes
    ----------
    folder : Path
        The study's folder.
    rows : int
        Candidates in its results.
    new : int
        Those of this run.
    seconds : float
        Wall time of this run.
    statuses : dict
        How many of this run's candidates have each status.
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


class _Clock:
    """Says how far a study is, at a steady rate."""

    def __init__(self, progress: Progress, done: StudyRun, total: int) -> None:
        self.progress, self.total = progress, total
        self.start = self.last = time.monotonic()
        self.before = done.rows
        self.statuses: Counter[str] = Counter()

    def tick(self, status: str, count: int) -> None:
        """Count candidates that will not climb on."""
        self.statuses[status] += count
        now = time.monotonic()
        if now - self.last < SAY_EVERY_S:
            return
        self.last = now
        new = self.statuses.total()
        rate = new / (now - self.start)
        left = max(self.total - self.before - new, 0) / rate
        counts = ", ".join(f"{n} {status}" for status, n in self.statuses.most_common())
        self.progress(
            f"{self.before + new} of {self.total} candidates, {rate:.3g}/s, about "
            f"{_span(left)} left ({counts})"
        )


def _span(seconds: float) -> str:
    """Time in words."""
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"


def run_study(
    study: Study,
    space: Space,
    folder: Path,
    *,
    kind: Kind,
    pool: Pool | None = None,
    storage: str = "",
    progress: Progress = lambda _: None,
) -> StudyRun:
    """Run a study, or go on with one that was stopped; the same study gives the same rows.

    Parameters
    ----------
    folder : Path
        The study's own folder.
    kind : str
        ``sweep`` or ``optimise``.
    pool : Pool, optional
        Where candidates climb; this process by default. The caller closes it.
    storage : str
        Database URL of Optuna's trials; a file in the folder by default.

    Raises
    ------
    DesignError
        If the study cannot be carried out.
    OutputError
        If the folder is another study's or cannot be written; what was done is kept.
    """
    start = time.monotonic()
    done = StudyRun(folder)
    store = Store(folder, study, space, kind)
    try:
        source: Sweep | Search
        if kind == "optimise":
            source = Search(study, space, storage or str(folder / JOURNAL))
            _catch_up(store, source, space)
        else:
            source = Sweep(study, space)
        done.rows = store.rows
        clock = _Clock(progress, done, source.total)
        size = study.sampling.batch
        batch = source.ask(store.rows, size)
        while batch and not _over(study, start):
            first = store.rows
            # What depends on this batch cannot be begun before it is done.
            following = source.ask(first + len(batch), size) if source.steady else []
            outcomes = _climb_batch(study, store, batch, following, pool or OwnProcess(), clock)
            rows = [
                store.row(first + order, params, outcomes[order])
                for order, params in enumerate(batch)
            ]
            store.close_batch(rows)
            source.tell(batch, rows)
            batch = following if source.steady else source.ask(store.rows, size)
            done.rows, done.new = store.rows, done.new + len(rows)
            done.statuses.update(row["status"] for row in rows)
        store.join()
    finally:
        store.close()
    done.seconds = time.monotonic() - start
    return done


def _over(study: Study, start: float) -> bool:
    """Whether the study has had its time."""
    return bool(study.budget.seconds) and time.monotonic() - start > study.budget.seconds


def _catch_up(store: Store, source: Search, space: Space) -> None:
    """Tell Optuna of rows that it missed: the driver was killed in between."""
    missed = list(store.read(source.told)) if source.told < store.rows else []
    if missed:
        fields = [axis.field for axis in space.axes]
        source.replay([{name: row[name] for name in fields} for row in missed], missed)


def _climb_batch(
    study: Study,
    store: Store,
    batch: list[Params],
    following: list[Params],
    pool: Pool,
    clock: _Clock,
) -> dict[int, Outcome]:
    """Have a batch climb, group of rungs by group; those with equal values climb once."""
    outcomes: dict[int, Outcome] = {}
    climbing = list(range(len(batch)))
    groups = study.groups()
    later = [task_of(k, store.spec, params, groups[0]) for k, params in enumerate(following)]
    for number, rungs in enumerate(groups):
        last = number == len(groups) - 1
        tasks = {order: task_of(order, store.spec, batch[order], rungs) for order in climbing}
        firsts = {task.key: task for task in reversed(tasks.values())}
        wanted = [task for task in firsts.values() if task.key not in store.open_results]
        alike = Counter(task.key for task in tasks.values())
        for task, outcome in pool.run(wanted, later):
            store.keep(task, outcome)
            if last or outcome.status != OK:
                clock.tick(outcome.status, alike[task.key])
        for order, task in tasks.items():
            found = store.open_results[task.key]
            outcomes[order] = outcomes[order].and_then(found) if order in outcomes else found
        able = {order: outcomes[order] for order in climbing}
        climbing = sorted(promoted(study, rungs[-1], able))
        for order in set(able) - set(climbing):
            if able[order].status == OK and not last:
                outcomes[order] = _dropped(study, rungs[-1], able[order])
    return outcomes


def _dropped(study: Study, rung: str, outcome: Outcome) -> Outcome:
    """A candidate that others of its batch were better than."""
    left = len(study.rungs) - 1 - study.rungs.index(rung)
    reason = f"not among the best {study.ladder.share[rung]:.0%} of its batch after {rung}"
    return outcome.and_then(Outcome(status=DROPPED, rung=rung, reason=reason, violation=left - 0.5))
