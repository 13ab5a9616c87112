"""How many designs a second a core looks at, and what each further level costs and predicts."""

import time

import numpy as np
from scipy.stats import spearmanr

from benchmarks.harness import Table
from benchmarks.study_cases import SPACES, drawn, one_thread, study_of
from phytac_design.study.search.measures import MEASURES, measures_up_to
from phytac_design.study.search.successive_halving import OK, Outcome, evaluate_candidate, spec_of

CHEAP = ("rules", "sampled")
SOURCE = (
    "processor time of one process on one thread, compiled code loaded before; target formerly "
    "10, which all shapes met"
)
WARM = 3
TWINS = {"cylinder": 1, "cone": 10, "hemisphere": 1}
"""Decoders that are built; the cone's are the cheapest that are no dome."""
ALL = ("rules", "sampled", "exact", "mechanics", "load", "twin")
PRESSED = ("rules", "sampled", "exact", "mechanics", "load")


def rate(table: Table, *, quick: bool) -> None:
    """A thousand designs through layout, rules, sampled visibility, density and surrogate."""
    one_thread()
    each = 20 if quick else 334
    spent, looked, done = 0.0, 0, 0
    for shape in SPACES:
        study, space = study_of(shape)
        spec = spec_of(study, space)
        candidates = drawn(study, space, each)
        for params in candidates[:WARM]:
            evaluate_candidate(spec, params, CHEAP)
        start, wall = time.process_time(), time.perf_counter()
        outcomes = [evaluate_candidate(spec, params, CHEAP) for params in candidates]
        seconds, wall = time.process_time() - start, time.perf_counter() - wall
        able = [outcome for outcome in outcomes if outcome.status == OK]
        own = sum(sum(outcome.seconds.values()) for outcome in able)
        counts = [outcome.measures["marker_count"] for outcome in able]
        row = f"{shape}: designs a second and core, those that pass the rules"
        note = (
            f"{len(able)} of {each} pass; {min(counts):.0f} to {max(counts):.0f} markers, "
            f"median {np.median(counts):.0f}; all {each} in {seconds:.1f} s of processor and "
            f"{wall:.1f} s of wall time; rules {1e3 * _mean(able, 'rules'):.0f} ms, sampled "
            f"{1e3 * _mean(able, 'sampled'):.0f} ms"
        )
        table.add(row, len(able) / own, "1/s", "", SOURCE, ">= 30", note)
        spent, looked, done = spent + seconds, looked + each, done + len(able)
    row = "designs a second and core, all that were drawn"
    note = f"{looked} designs, of which {done} pass the rules; refused ones stop there"
    table.add(row, looked / spent, "1/s", "", SOURCE, ">= 30", note)


def _mean(outcomes: list[Outcome], rung: str) -> float:
    return float(np.mean([outcome.seconds[rung] for outcome in outcomes]))


def ladder(table: Table, *, quick: bool) -> None:
    """What each rung costs and how well it puts designs in the order of the next."""
    one_thread()
    each = 4 if quick else 16
    for shape in SPACES:
        study, space = study_of(shape, ladder={"rungs": list(ALL)})
        # A level is most informative where the others accept designs: no constraint, all rungs.
        spec = spec_of(study, space)
        able = [
            params
            for params in drawn(study, space, 4 * each)
            if evaluate_candidate(spec, params, ("rules",)).status == OK
        ][:each]
        found = [evaluate_candidate(spec, params, PRESSED) for params in able]
        found = [outcome for outcome in found if outcome.status == OK]
        twins = able[: 1 if quick else TWINS[shape]]
        judged = [evaluate_candidate(spec, params, ("twin",)) for params in twins]
        _costs(table, shape, found, judged)
        _orders(table, shape, found, judged)


def _costs(table: Table, shape: str, found: list[Outcome], judged: list[Outcome]) -> None:
    for rung in (*PRESSED, "twin"):
        seconds = [
            outcome.seconds[rung] for outcome in (judged if rung == "twin" else found)
            if rung in outcome.seconds
        ]  # fmt: skip
        row = f"{shape}: {rung}, each"
        source = f"median of {len(seconds)} designs, processor time, one thread, draft"
        table.add(row, float(np.median(seconds)), "s", "", source)


def _orders(table: Table, shape: str, found: list[Outcome], judged: list[Outcome]) -> None:
    """Spearman of each measure with what it stands in for."""
    joined = [one.merged(other) for one, other in zip(found, judged, strict=False)]
    for name in measures_up_to(ALL):
        earlier = MEASURES[name].proxy
        rows = joined if MEASURES[name].rung == "twin" else found
        pairs = np.array(
            [
                (row.measures[earlier], row.measures[name])
                for row in rows
                if earlier in row.measures and name in row.measures
            ]
        )
        if len(pairs) < 4 or float(np.ptp(pairs, axis=0).min()) == 0.0:
            continue
        source = f"{len(pairs)} designs that pass the rules, drawn evenly, none left out"
        value = float(spearmanr(pairs[:, 0], pairs[:, 1]).statistic)
        table.add(f"{shape}: {earlier} against {name}", value, "Spearman", 1.0, source)
