"""A candidate's climb: rung by rung, as far as the constraints let it; and who of a batch goes on.

A climb is a pure function of plain values, so that it can run in any process and be repeated.
"""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from hashlib import sha256
from typing import Any

import numpy as np

from phytac_design.design.design_file import design_hash
from phytac_design.engine.cache import code_hash
from phytac_design.study.search.candidate import Candidate
from phytac_design.study.search.fidelity_levels import LEVEL_FUNCTIONS
from phytac_design.study.search.measures import LEVELS, MEASURES, best_proxy
from phytac_design.study.search.pareto import ranks
from phytac_design.study.search.space import Params, Space, make_space
from phytac_design.study.search.study_file import Constraint, Study
from phytac_shapes.errors import DesignError, PhytacError

OK, REFUSED, UNFIT, DROPPED, FAILED = "ok", "refused", "unfit", "dropped", "failed"
"""Met everything so far; cannot be made; misses a constraint; others were better; went wrong."""


@dataclass
class Outcome:
    """What became of a candidate.

    Attributes
    ----------
    status : str
        ``OK``, ``REFUSED``, ``UNFIT``, ``DROPPED`` or ``FAILED``.
    rung : str
        Last rung that it tried.
    reason : str
        Why it went no further; "" if nothing stopped it.
    violation : float
        0 if it meets what was looked at; above that, the more rungs are left and the farther it
        is from a bound, the larger.
    measures, seconds : dict
        Figures; processor time of each rung.
    design : str
        Hash of the design under the base's name; "" if its values do not make one.
    """

    status: str = OK
    rung: str = ""
    reason: str = ""
    violation: float = 0.0
    measures: dict[str, float] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    design: str = ""

    def and_then(self, later: "Outcome") -> "Outcome":
        """Both groups of rungs together."""
        return Outcome(
            status=later.status,
            rung=later.rung or self.rung,
            reason=later.reason,
            violation=later.violation,
            measures=self.measures | later.measures,
            seconds=self.seconds | later.seconds,
            design=later.design or self.design,
        )


@dataclass(frozen=True)
class Task:
    """Rungs to climb with some values; ``order`` is its place in the batch."""

    order: int
    key: str
    spec: str
    params: Params
    rungs: tuple[str, ...]

    def run(self) -> dict[str, Any]:
        """Climb; plain values, for a journal and for other processes."""
        return asdict(evaluate_candidate(self.spec, self.params, self.rungs))


def spec_of(study: Study, space: Space) -> str:
    """What a process needs to know of a study, as text."""
    data = {"study": study.model_dump(mode="json"), "base": space.base}
    return json.dumps(data, sort_keys=True)


def task_of(order: int, spec: str, params: Params, rungs: tuple[str, ...]) -> Task:
    """Task with the key of its result: hash of the design's values, the rungs and the program."""
    text = json.dumps([code_hash(), spec, params, rungs], sort_keys=True)
    key = sha256(text.encode()).hexdigest()[:32]
    return Task(order=order, key=key, spec=spec, params=params, rungs=rungs)


@lru_cache(maxsize=8)
def setting(spec: str) -> tuple[Study, Space]:
    """Study and space of :func:`spec_of`'s text; from then on at hand in this process."""
    from pathlib import Path

    from phytac_design.design.design_file import parse_design

    data = json.loads(spec)
    study = Study.model_validate(data["study"])
    base = parse_design(data["base"], f"base of {study.name}")
    return study, make_space(study, Path(), base)


def evaluate_candidate(spec: str, params: Params, rungs: Sequence[str]) -> Outcome:
    """Climb rungs until a constraint or the design itself says no."""
    study, space = setting(spec)
    out = Outcome(rung=rungs[0])
    start = time.process_time()
    try:
        design = space.design(params)
        out.design = design_hash(design)
        candidate = Candidate(design, study)
        for rung in rungs:
            out.rung = rung
            out.measures |= _finite(LEVEL_FUNCTIONS[rung](candidate))
            now = time.process_time()
            out.seconds[rung], start = now - start, now
            out.violation, out.reason = misses(study, rung, out.measures)
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
        out.seconds[out.rung] = time.process_time() - start
        out.violation = _left(study, out.rung) + 1.0
    return out


def _finite(found: Mapping[str, float]) -> dict[str, float]:
    """Measures as plain numbers; those without a value are left out."""
    return {name: float(value) for name, value in found.items() if not np.isnan(value)}


def _left(study: Study, rung: str) -> float:
    """Rungs that were not climbed."""
    return float(sum(LEVELS.index(other) > LEVELS.index(rung) for other in study.rungs))


def misses(study: Study, rung: str, found: Mapping[str, float]) -> tuple[float, str]:
    """How far measures of a rung miss the constraints, and in words; 0 and "" if they do not."""
    total, said = 0.0, []
    for item in study.constraint:
        if MEASURES[item.measure].rung != rung:
            continue
        if item.measure not in found:
            return _left(study, rung) + 1.0, f"{item.measure} has no value"
        away, words = _miss(item, found[item.measure])
        total += away
        said += [words] if words else []
    if not said:
        return 0.0, ""
    return _left(study, rung) + total / (1.0 + total), "; ".join(said)


def _miss(item: Constraint, value: float) -> tuple[float, str]:
    """How far a value is from the bounds, as a share of them, and in words."""
    for bound, sign, word in ((item.min, -1.0, "at least"), (item.max, 1.0, "at most")):
        if bound is not None and sign * (value - bound) > 0.0:
            away = min(abs(value - bound) / max(abs(bound), 1.0), 1e6)
            return away, f"{item.measure} is {value:.6g}, asked is {word} {bound:g}"
    return 0.0, ""


def promoted(study: Study, rung: str, outcomes: Mapping[int, Outcome]) -> set[int]:
    """Those of a batch's candidates that go on after a rung with a share.

    The front of what is known of the objectives first, then the next front; within one, those
    that are nearest to its best values.
    """
    able = [number for number, outcome in sorted(outcomes.items()) if outcome.status == OK]
    share = study.ladder.share.get(rung, 1.0)
    if share >= 1.0 or len(able) < 2:
        return set(able)
    values = predicted_objectives(study, [outcomes[number].measures for number in able])
    if values.shape[1] == 0:
        return set(able)
    spread = np.maximum(np.ptp(values, axis=0), 1e-300)
    total = ((values - values.min(axis=0)) / spread).sum(axis=1)
    order = np.lexsort((np.arange(len(able)), total, ranks(values)))
    keep = int(np.ceil(share * len(able)))
    return {able[number] for number in order[:keep]}


def predicted_objectives(study: Study, found: Sequence[Mapping[str, float]]) -> Any:
    """Objectives (n, k), less is better, or what best predicts each; unpredicted ones left out."""
    known = frozenset.intersection(*(frozenset(one) for one in found))
    columns = []
    for objective in study.objective:
        name = best_proxy(objective.measure, known)
        if name:
            sign = 1.0 if objective.goal == "min" else -1.0
            columns.append([sign * one[name] for one in found])
    return np.array(columns, dtype=np.float64).reshape(len(columns), len(found)).T
