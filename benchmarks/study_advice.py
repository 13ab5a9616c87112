"""Advice for shipped designs: how many pieces, and whether they gain what was predicted."""

import time

from benchmarks.harness import Table
from benchmarks.study_cases import one_thread
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.study.advice.advise import Advice, advise
from phytac_design.study.advice.design_evaluation import FORCES, faults_of
from phytac_design.study.advice.refinement import refine

DESIGNS = ("cylinder60", "hemisphere", "grip")
CLOSE = 0.25
"""A piece came as predicted if its gain is within this share."""
SECONDS = 60.0
POLISHED = "grip"
SOURCE = "each change applied, checked and evaluated: exact, mechanics, load at draft"


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
        row = f"{name}: time of advice"
        source = "processor time, one thread, in a fresh cache; what is there already is quicker"
        table.add(
            row, seconds, "s", SECONDS, source, f"<= {SECONDS:g}" if name == "cylinder60" else None
        )
    if quick:
        return
    done = refine(load_design(POLISHED), accuracy, rounds=4)
    before, after = done.before, done.figures
    row = f"{POLISHED}: force over the middle heights after polishing, share of before"
    note = (
        f"{len(done.steps)} steps judged; {done.why}; gap {before['gap_px']:.1f} → "
        f"{after['gap_px']:.1f} px, pressed {before['load_gap_px']:.1f} → "
        f"{after['load_gap_px']:.1f} px, strain {before['strain']:.4f} → {after['strain']:.4f}"
    )
    value = after["force_middle_N"] / before["force_middle_N"]
    table.add(row, value, "", 1.0, SOURCE, "<= 0.99", note)
    row = f"{POLISHED}: hidden, fused or disturbed markers after polishing"
    table.add(row, faults_of(after), "markers", 0, SOURCE, "<= 0")


def _pieces(table: Table, name: str, found: Advice) -> None:
    """Counts and gains."""
    pieces = found.pieces
    close = [trial for trial in pieces if abs(trial.gain / trial.predicted_gain - 1.0) <= CLOSE]
    far = [trial for trial in pieces if trial not in close]
    row = f"{name}: pieces of advice that helped when applied"
    note = "; ".join(trial.words for trial in pieces)
    table.add(row, len(pieces), "pieces", "", SOURCE, ">= 1", note)
    row = f"{name}: of those, gained as predicted within 25 %"
    source = "gain by slopes against gain of the changed design, judged"
    note = "; ".join(f"{t.variable.name}: {t.gain:.3g} for {t.predicted_gain:.3g}" for t in far)
    table.add(row, len(close), "pieces", len(pieces), source, f">= {len(pieces)}", note)
    best = [trial for trial in pieces if trial.goal in FORCES]
    if best:
        top = max(best, key=lambda trial: trial.gain)
        row = f"{name}: best gain of force"
        source = "reference: predicted by slopes"
        note = f"{top.words}; costs: {', '.join(top.costs) or 'nothing'}"
        table.add(
            row, 100.0 * top.gain, "%", round(100.0 * top.predicted_gain, 2), source, note=note
        )
    broke = [trial for trial in pieces if faults_of(trial.achieved) > faults_of(found.figures)]
    row = f"{name}: pieces of advice that break a rule or a margin"
    note = "tried, and no advice: " + (
        "; ".join(f"{t.variable.name}: {t.reason[:60]}" for t in found.tried) or "none"
    )
    table.add(row, len(broke), "pieces", 0, SOURCE, "<= 0", note)
