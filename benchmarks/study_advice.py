"""Advice for shipped designs: how many pieces, and whether they gain what was foretold."""

import time

import numpy as np

from benchmarks.harness import Table
from benchmarks.study_cases import one_thread
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.study.advice.advise import Advice, advise
from phytac_design.study.advice.design_evaluation import FORCES, faults_of
from phytac_design.study.advice.refinement import refine
from phytac_design.study.advice.sensitivity import Sensitivity

DESIGNS = ("cylinder60", "hemisphere", "grip")
CLOSE = 0.25
"""A piece came as foretold if its gain is within this share."""
SECONDS = 60.0
POLISHED = "grip"
SOURCE = "each change applied, checked and judged by the rungs exact, mechanics and load at draft"


def advice(table: Table, *, quick: bool) -> None:
    """Advise on each design; what was judged before is taken from the cache, but for its time."""
    one_thread()
    accuracy = PRESETS["draft"]
    for name in DESIGNS[1:2] if quick else DESIGNS:
        design = load_design(name)
        start = time.process_time()
        found = advise(design, accuracy, checks=2 if quick else 5)
        seconds = time.process_time() - start
        _pieces(table, name, found)
        _slopes(table, name, found)
        table.add(
            f"{name}: time of advice",
            seconds,
            "s",
            reference=SECONDS,
            source="processor time, one thread, in a fresh cache; what is there already is quicker",
            target=f"<= {SECONDS:g}" if name == "cylinder60" else None,
        )
    if quick:
        return
    done = refine(load_design(POLISHED), accuracy, rounds=4)
    before, after = done.before, done.figures
    table.add(
        f"{POLISHED}: force over the middle heights after polishing, share of before",
        after["force_middle_N"] / before["force_middle_N"],
        "",
        reference=1.0,
        source=SOURCE,
        target="<= 0.99",
        note=f"{len(done.steps)} steps judged; {done.why}; gap {before['gap_px']:.1f} → "
        f"{after['gap_px']:.1f} px, pressed {before['load_gap_px']:.1f} → "
        f"{after['load_gap_px']:.1f} px, strain {before['strain']:.4f} → {after['strain']:.4f}",
    )
    table.add(
        f"{POLISHED}: hidden, fused or disturbed markers after polishing",
        faults_of(after),
        "markers",
        reference=0,
        source=SOURCE,
        target="<= 0",
    )


def _pieces(table: Table, name: str, found: Advice) -> None:
    """Counts and gains."""
    pieces = found.pieces
    close = [trial for trial in pieces if abs(trial.gain / trial.predicted_gain - 1.0) <= CLOSE]
    far = [trial for trial in pieces if trial not in close]
    table.add(
        f"{name}: pieces of advice that helped when applied",
        len(pieces),
        "pieces",
        reference="",
        source=SOURCE,
        target=">= 1",
        note="; ".join(trial.words for trial in pieces),
    )
    table.add(
        f"{name}: of those, gained as foretold within 25 %",
        len(close),
        "pieces",
        reference=len(pieces),
        source="gain by slopes against gain of the changed design, judged",
        target=f">= {len(pieces)}",
        note="; ".join(
            f"{t.variable.name}: {t.gain:.3g} for {t.predicted_gain:.3g}" for t in far
        ),
    )  # fmt: skip
    best = [trial for trial in pieces if trial.goal in FORCES]
    if best:
        top = max(best, key=lambda trial: trial.gain)
        table.add(
            f"{name}: best gain of force",
            100.0 * top.gain,
            "%",
            reference=round(100.0 * top.predicted_gain, 2),
            source="reference: foretold by slopes",
            note=f"{top.variable.words(top.amount)}; costs: {', '.join(top.costs) or 'nothing'}",
        )
    broke = [trial for trial in pieces if faults_of(trial.achieved) > faults_of(found.figures)]
    table.add(
        f"{name}: pieces of advice that break a rule or a margin",
        len(broke),
        "pieces",
        reference=0,
        source=SOURCE,
        target="<= 0",
        note="tried, and no advice: "
        + ("; ".join(f"{t.variable.name}: {t.reason[:60]}" for t in found.tried) or "none"),
    )


def _slopes(table: Table, name: str, found: Advice) -> None:
    """Slopes of the force against what applying the move did, of all moves that were judged."""
    judged = [t for t in (*found.pieces, *found.tried) if t.achieved and t.slope is not None]
    away = [abs(_error(trial.slope, trial.amount, trial.achieved, found.figures))
            for trial in judged if trial.slope is not None]  # fmt: skip
    if away:
        table.add(
            f"{name}: error of slopes of force over the middle heights, median",
            100.0 * float(np.median(away)),
            "% of the figure",
            reference=0.0,
            source=f"{len(away)} moves of up to an eighth of the field: foretold against judged",
            note=f"worst {100.0 * max(away):.2g} %",
        )


def _error(
    slope: Sensitivity, amount: float, achieved: dict[str, float], figures: dict[str, float]
) -> float:
    """Foretold less achieved force over the middle heights, as a share of what it was."""
    goal = "force_middle_N"
    return (slope.predict(figures, amount)[goal] - achieved[goal]) / figures[goal]
