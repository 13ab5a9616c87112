"""The decoder on all shapes, and over a thousand cycles; parts ``shapes`` and ``cycles``."""

import numpy as np

from benchmarks.decoder_accuracy import PAPER_PERCENT, UnitDecoder, bench
from benchmarks.decoder_data import cycles, of_shape, units
from benchmarks.decoder_evaluation import Evaluation, train_decoder
from benchmarks.decoder_rows import (
    ALL,
    FULL,
    RELATIVE,
    TARGETS,
    TWIN,
    Targets,
    add_bounds,
    add_claims,
    add_scores,
    add_switches,
)
from benchmarks.harness import Table
from phytac_design.design.design_file import shipped_designs
from phytac_shapes.arrays import BoolArray

SHAPE_TARGETS: Targets = {**TARGETS, (ALL, RELATIVE): {"auto": f"<= {PAPER_PERCENT}"}}


def add_rows_shapes(table: Table, *, quick: bool) -> None:
    """Every shape's decoder on held-out contacts of the print that it was trained on."""
    # The dense one is another layout of a shape that is there.
    names = [name for name in shipped_designs() if name != "cylinder60-dense"]
    for name in names[:1] if quick else names:
        here = bench(of_shape(name, quick=quick))
        bundle, _ = train_decoder(here.context, here.plain, here.train)
        judged = here.judged(bundle)
        add_scores(table, here.head, judged, FULL, targets=SHAPE_TARGETS)
        add_bounds(table, here.head, judged, target=None)
        add_claims(table, here.head, judged.claims, target=False)
        row = f"{here.head}: samples that were learnt from"
        table.add(row, here.train.samples.count, "samples", 598, "paper", note=here.note)


def add_rows_cycles(table: Table, *, quick: bool) -> None:
    """What creep and a fading light do to a decoder that was trained on an elastic wall."""
    home = bench(units(quick=quick)[0])
    bundle, _ = train_decoder(home.context, home.plain, home.train)
    case = cycles(quick=quick)
    _, data = case.parts()
    here = UnitDecoder(
        case=case, context=home.context, plain=home.plain, train=home.train, test=data
    )
    judged = here.judged(bundle)
    cycle = case.job.scenario.cycle
    assert cycle is not None
    number = data.samples.sequence
    phase = np.tile(cycle.phases, len(number) // len(cycle.phases))
    sampled = np.unique(number)
    # Cycles at the start and at the end that are compared.
    some = min(3, len(sampled) // 2)
    ends = {"first": sampled[:some], "last": sampled[-some:]}
    for name in judged.decoded.decoded_N:
        _drift_rows(table, here, judged, name, {k: np.isin(number, v) for k, v in ends.items()})
    # The sensor is at rest after phase 3 of a cycle.
    _rest_rows(table, here, judged, np.asarray(phase) > 3.0)
    if data.meta.route == "frames":
        add_switches(table, f"{here.head}, cycles", judged)


def _drift_rows(
    table: Table, here: UnitDecoder, judged: Evaluation, name: str, ends: dict[str, BoolArray]
) -> None:
    """Error of an estimator in the first and in the last cycles, (s,) each."""
    decoded = judged.decoded
    error = (decoded.decoded_N[name] - decoded.force_N) / np.maximum(decoded.force_N, 1e-12)
    head = f"{here.head}, cycles of 10 N: {name}"
    bias = {}
    for words, samples in ends.items():
        part = error[decoded.tripped & samples[decoded.sample]]
        which = np.unique(here.test.samples.sequence[samples])
        bias[words] = 100.0 * float(part.mean())
        row = f"{head}: mean relative error, {words} cycles"
        note = (
            f"cycles {', '.join(str(k + 1) for k in which)}; {len(part)} presses; mean error "
            f"with its sign {bias[words]:.3g} %"
        )
        table.add(row, 100.0 * float(np.abs(part).mean()), "%", 0.0, TWIN, note=note)
    row = f"{head}: drift from the first to the last cycles"
    note = (
        "the wall creeps by 8 % of its compliance over three decades (assumed): under the "
        "same force it moves more, which no decoder of positions can tell from a stronger one"
    )
    table.add(row, bias["last"] - bias["first"], "% of force", 0.0, TWIN, note=note)


def _rest_rows(table: Table, here: UnitDecoder, judged: Evaluation, rest: BoolArray) -> None:
    """Forces read after each release, and what the markers still show; ``rest`` is (s,)."""
    decoded, samples = judged.decoded, here.test.samples
    assert samples.shift_px is not None
    # Every sample counts that did not fail; forces on no contact count as elsewhere.
    free = rest[decoded.evaluated]
    worst = max(float(np.abs(force[free]).max()) for force in decoded.elsewhere_N.values())
    light = samples.light[rest]
    shift = np.sqrt(np.nanmean(np.sum(samples.shift_px[rest] ** 2, axis=2), axis=1))
    row = f"{here.head}, cycles: largest force read at rest, {int(free.sum())} rests, any estimator"
    note = (
        f"RMS shift of markers at rest {shift[0]:.3f} px after the first cycle, "
        f"{shift[-1]:.3f} px after the last; light {light[0]:.3f} and {light[-1]:.3f} of the start"
    )
    table.add(row, worst, "N", 0.0, TWIN, "== 0", note)
