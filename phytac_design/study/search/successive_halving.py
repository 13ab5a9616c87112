"""Successive halving: candidates go through fidelity levels, cheap ones first.

A candidate stops where it misses a constraint, and only the best share of a batch is promoted to
the next level. An evaluation is a pure function of plain values: it can run in any process and be
repeated.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from ctypes import CDLL
from dataclasses import asdict, dataclass, field, replace
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from phytac_design.design.design_file import design_hash, parse_design
from phytac_design.engine.cache import code_hash
from phytac_design.study.search.design_space import DesignSpace, Params, make_space
from phytac_design.study.search.fidelity_levels import LEVEL_FUNCTIONS, Candidate
from phytac_design.study.search.measures import LEVELS, MEASURES, best_proxy
from phytac_design.study.search.study_file import Study
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError, PhytacError

OK, REFUSED, UNFIT, DROPPED, FAILED = "ok", "refused", "unfit", "dropped", "failed"
"""Feasible so far; breaks a rule; misses a constraint; not promoted; numerical failure."""


@dataclass
class Outcome:
    """Result of evaluating a candidate.

    Attributes
    ----------
    status : str
        ``OK``, ``REFUSED``, ``UNFIT``, ``DROPPED`` or ``FAILED``.
    rung : str
        Last fidelity level that was tried.
    reason : str
        Why the evaluation stopped; "" if nothing stopped it.
    violation : float
        0 if feasible; grows with the number of levels not reached and the distance from a bound.
    measures, seconds : dict
        Figures; processor time of each level.
    design : str
        Hash of the design under the base's name; "" if the values do not make one.
    """

    status: str = OK
    rung: str = ""
    reason: str = ""
    violation: float = 0.0
    measures: dict[str, float] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    design: str = ""

    def merged(self, later: "Outcome") -> "Outcome":
        """Both groups of levels together."""
        return replace(
            later,
            rung=later.rung or self.rung,
            measures=self.measures | later.measures,
            seconds=self.seconds | later.seconds,
            design=later.design or self.design,
        )


def failed(reason: str) -> Outcome:
    """Result of a candidate whose evaluation did not end."""
    return Outcome(status=FAILED, reason=reason[:500], violation=1e3)


@dataclass(frozen=True)
class Task:
    """Levels to evaluate with some values."""

    key: str
    spec: str
    params: Params
    levels: tuple[str, ...]

    def run(self) -> dict[str, Any]:
        """Evaluate; plain values, for a journal and for other processes."""
        return asdict(evaluate_candidate(self.spec, self.params, self.levels))


def spec_of(study: Study, space: DesignSpace) -> str:
    """What a process needs to know of a study, as JSON."""
    data = {"study": study.model_dump(mode="json"), "base": space.base}
    return json.dumps(data, sort_keys=True)


def task_of(spec: str, params: Params, levels: tuple[str, ...]) -> Task:
    """Task with the key of its result: hash of the design's values, the levels and the program."""
    text = json.dumps([code_hash(), spec, params, levels], sort_keys=True)
    return Task(sha256(text.encode()).hexdigest()[:32], spec, params, levels)


def chunked(tasks: Iterable[Task], workers: int) -> list[list[Task]]:
    """Tasks in chunks; of cheap levels in some eight for each worker.

    Handing out a chunk takes as long as some tenth of a cheap candidate.
    """
    wanted = list(tasks)
    cheap = all(set(task.levels) <= {"rules", "sampled"} for task in wanted)
    size = max(1, len(wanted) // (8 * workers)) if cheap else 1
    return [wanted[first : first + size] for first in range(0, len(wanted), size)]


class SerialPool:
    """Evaluates tasks one after the other in this process; base of pools with workers."""

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
        """Results as they come, in any order; every task once."""
        keep_memory()
        for task in tasks:
            yield task, Outcome(**task.run())

    def close(self) -> None:
        """Release processes and connections."""


@cache
def keep_memory() -> None:
    """Keep freed memory in this process (GNU C library), once.

    Otherwise candidates take 1.1 times their processor time, and 1.6 times where Dask's nanny sets
    ``MALLOC_TRIM_THRESHOLD_`` to 64 KiB (measured on the cylinder's study).
    """
    trim_threshold, mmap_threshold = -1, -3
    with suppress(OSError, AttributeError):  # another C library
        library = CDLL(None)
        library.mallopt(trim_threshold, 256 << 20)
        library.mallopt(mmap_threshold, 32 << 20)


@lru_cache(maxsize=8)
def load_spec(spec: str) -> tuple[Study, DesignSpace]:
    """Study and space of :func:`spec_of`'s text."""
    data = json.loads(spec)
    study = Study.model_validate(data["study"])
    base = parse_design(data["base"], f"base of {study.name}")
    return study, make_space(study, Path(), base)


def evaluate_candidate(spec: str, params: Params, levels: Sequence[str]) -> Outcome:
    """Evaluate levels until a constraint is missed or the design is rejected."""
    study, space = load_spec(spec)
    out = Outcome(rung=levels[0])
    start = process_time()
    try:
        design = space.design(params)
        out.design = design_hash(design)
        candidate = Candidate(design, study)
        for level in levels:
            out.rung = level
            found = LEVEL_FUNCTIONS[level](candidate)
            out.measures |= {k: float(value) for k, value in found.items() if not np.isnan(value)}
            now = process_time()
            out.seconds[level], start = now - start, now
            out.violation, out.reason = constraint_violation(study, level, out.measures)
            if out.reason:
                out.status = UNFIT
                return out
    except DesignError as error:
        out.status, out.reason = REFUSED, str(error)
    except PhytacError as error:
        out.status, out.reason = FAILED, str(error)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError, MemoryError) as error:
        # One candidate at the end of a range must not end a search of thousands.
        out.status, out.reason = FAILED, f"{type(error).__name__}: {error}"
    if out.status != OK:
        out.seconds[out.rung] = process_time() - start
        out.violation = _levels_after(study, out.rung) + 1.0
    return out


def _levels_after(study: Study, level: str) -> int:
    return sum(LEVELS.index(other) > LEVELS.index(level) for other in study.levels)


def constraint_violation(study: Study, level: str, found: Mapping[str, float]) -> tuple[float, str]:
    """By how much the measures of a level miss the constraints, and why; 0 and "" if feasible."""
    total, reasons = 0.0, []
    for item in study.constraint:
        if MEASURES[item.measure].rung != level:
            continue
        if item.measure not in found:
            return _levels_after(study, level) + 1.0, f"{item.measure} has no value"
        value = found[item.measure]
        for bound, sign, word in ((item.min, -1.0, "at least"), (item.max, 1.0, "at most")):
            if bound is not None and sign * (value - bound) > 0.0:
                total += min(abs(value - bound) / max(abs(bound), 1.0), 1e6)
                reasons.append(f"{item.measure} is {value:.6g}, must be {word} {bound:g}")
                break
    if not reasons:
        return 0.0, ""
    return _levels_after(study, level) + total / (1.0 + total), "; ".join(reasons)


def promoted(study: Study, level: str, outcomes: Mapping[int, Outcome]) -> set[int]:
    """Candidates of a batch that go to the level after this one.

    Ranked by non-dominated front of the predicted objectives; within a front, by the sum of the
    normalised objectives.
    """
    feasible = [number for number, outcome in sorted(outcomes.items()) if outcome.status == OK]
    share = study.ladder.share.get(level, 1.0)
    if share >= 1.0 or len(feasible) < 2:
        return set(feasible)
    values = predicted_objectives(study, [outcomes[number].measures for number in feasible])
    if values.shape[1] == 0:
        return set(feasible)
    spread = np.maximum(np.ptp(values, axis=0), 1e-300)
    total = ((values - values.min(axis=0)) / spread).sum(axis=1)
    order = np.lexsort((np.arange(len(feasible)), total, ranks(values)))
    return {feasible[number] for number in order[: int(np.ceil(share * len(feasible)))]}


def predicted_objectives(study: Study, found: Sequence[Mapping[str, float]]) -> FloatArray:
    """Objectives (n, k) to minimise, or the best predictor of each; unpredicted ones omitted."""
    known = frozenset.intersection(*(frozenset(one) for one in found))
    names = [(best_proxy(one.measure, known), one.goal) for one in study.objective]
    columns = [
        [one[name] if goal == "min" else -one[name] for one in found]
        for name, goal in names
        if name
    ]
    return np.array(columns, dtype=np.float64).reshape(len(columns), len(found)).T


def front(values: FloatArray) -> BoolArray:
    """Non-dominated rows (n,) of (n, k) values to minimise; equal rows all count."""
    out = np.ones(len(values), dtype=np.bool_)
    for number, own in enumerate(values):
        if out[number]:
            out &= ~(np.all(values >= own, axis=1) & np.any(values > own, axis=1))
    return out


def ranks(values: FloatArray) -> IntArray:
    """Number of the front (n,) that each of (n, k) values is on, once earlier ones are removed."""
    out = np.full(len(values), -1, dtype=np.int64)
    remaining, number = np.arange(len(values)), 0
    while len(remaining):
        best = front(values[remaining])
        out[remaining[best]] = number
        remaining, number = remaining[~best], number + 1
    return out
