"""How right the decoder is on held-out contacts of virtual prints, and how few samples it needs.

Parts ``accuracy``, ``few`` and ``other_unit`` (prints that it has never seen) of ``decoder``. The
truth is the twin's: large displacements, receptors, print scatter; what is learnt is learnt as
``phytac train`` does. ``python -m benchmarks.decoder --parts accuracy,few,other_unit [--quick]``
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.decoder_data import DataSetSpec, origin, random_subset, units
from benchmarks.decoder_evaluation import (
    LEARNT,
    Evaluation,
    by_design,
    evaluate_decoder,
    mechanics,
    train_decoder,
)
from benchmarks.decoder_rows import (
    ALL,
    FULL,
    MAE,
    MIDDLE,
    PAPER,
    RELATIVE,
    RIMS,
    SEVERAL,
    SHORT,
    SINGLE,
    TARGETS,
    TWIN,
    WORDS,
    Group,
    add_bounds,
    add_claims,
    add_scores,
    add_switches,
    add_tenths,
    allowed,
)
from benchmarks.harness import Table
from phytac_decoder.io.bundle import Bundle
from phytac_design.engine.stage import Context
from phytac_design.training.training_data import DataSet

ENOUGH = 150
PAPER_PERCENT = 2.3
CURVE = ("fem_nn", "auto")
CALIBRATION = 20
CONTACTS = 1000
TRAIN_S = 5.0


@dataclass(frozen=True, kw_only=True)
class UnitDecoder:
    """One unit: the decoder by design, what is learnt from, and what is held out.

    Attributes
    ----------
    case : Case
        Where the data are from.
    context : Context
        Of the decoder's mechanics.
    plain : Bundle
        Decoder that has seen no data.
    train, test : DataSet
        To learn from, and held out.
    """

    case: DataSetSpec
    context: Context
    plain: Bundle
    train: DataSet
    test: DataSet

    @property
    def head(self) -> str:
        """What rows of it begin with."""
        scenario = self.case.job.scenario
        name = self.case.job.design.name
        return f"{name} unit {scenario.unit.number}, {scenario.solve.route}"

    @property
    def note(self) -> str:
        """Where its data are from."""
        return f"{self.case.name}: {origin(self.case.name, self.test.meta)}"

    def judged(self, bundle: Bundle, *, names: Sequence[str] | None = None) -> Evaluation:
        """A decoder on the held-out samples."""
        return evaluate_decoder(self.context, bundle.model, self.test, estimators=names)


def bench(case: DataSetSpec) -> UnitDecoder:
    """Make the decoder, and read or simulate the data."""
    context = mechanics(case.job.design, case.accuracy or case.job.accuracy)
    train, test = case.parts()
    return UnitDecoder(case=case, context=context, plain=by_design(context), train=train, test=test)


def add_rows_accuracy(table: Table, *, quick: bool) -> None:
    """Every estimator on held-out contacts of the unit that it was trained on; three units."""
    each = []
    for number, case in enumerate(units(quick=quick)):
        here = bench(case)
        bundle, facts = train_decoder(here.context, here.plain, here.train)
        judged = here.judged(bundle)
        full = number == 0 and not quick
        _count_row(table, here, judged, target=full)
        add_scores(table, here.head, judged, FULL, targets=TARGETS)
        add_tenths(table, here.head, judged)
        add_bounds(table, here.head, judged, target="<= 1.5")
        add_claims(table, here.head, judged.claims, target=True)
        if here.test.meta.route == "frames":
            add_switches(table, here.head, judged)
        _time_rows(table, here, facts, target=full)
        if number == 0:
            _pairs_rows(table, here, judged)
        each.append(judged)
    _spread_rows(table, each)


def _count_row(table: Table, here: UnitDecoder, judged: Evaluation, *, target: bool) -> None:
    """How many contacts are judged, and where the data are from."""
    judged_ones, count = int(judged.decoded.tripped.sum()), len(judged.decoded.touch)
    row = f"{here.head}: held-out contacts, trained on {here.train.samples.count} samples"
    source = "project target"
    note = (
        f"{here.note}; {count - judged_ones} of them tripped no switch and are apart; the "
        f"{'first samples train' if not here.case.mixed else 'parts are drawn at random'}"
    )
    table.add(row, count, "contacts", CONTACTS, source, f">= {CONTACTS}" if target else None, note)


def _pairs_rows(table: Table, here: UnitDecoder, judged: Evaluation) -> None:
    """The same decoder without its tables of pairs: contacts that stiffen or soften each other."""
    model = here.plain.model
    locator = model.locator
    assert locator is not None
    alone = replace(locator, places=replace(locator.places, pairs=None))
    plain = replace(here.plain, model=replace(model, locator=alone))
    bundle, _ = train_decoder(here.context, plain, here.train, names=("auto",))
    without = here.judged(bundle, names=("auto",))
    for group in (MIDDLE, SINGLE, SEVERAL, RIMS):
        mask = judged.group(*group)
        if not mask.any():
            continue
        now, then = (
            100.0 * one.score("auto", mask)[RELATIVE]["value"] for one in (judged, without)
        )
        row = (
            f"{here.head}: auto, {WORDS[group]}, mean relative error without tables of pairs over "
            "that with them"
        )
        table.add(row, then / now, "ratio", now, "with them, %", note=f"{then:.3g} % without")


def _time_rows(
    table: Table, here: UnitDecoder, facts: Mapping[str, Mapping[str, Any]], *, target: bool
) -> None:
    for name, found in facts.items():
        row = f"{here.head}: training {name} on {here.train.samples.count} samples"
        source = "paper: within 1 min"
        note = f"{found['cpu_seconds']:.2f} s of CPU time"
        value = found["seconds"]
        table.add(row, value, "s", 60.0, source, f"<= {TRAIN_S:g}" if target else None, note)


def _spread_rows(table: Table, each: Sequence[Evaluation]) -> None:
    """Mean over the units, and their spread."""
    name = each[0].data.meta.design
    for estimator in each[0].decoded.decoded_N:
        for group in (ALL, MIDDLE):
            for key, factor, unit in ((RELATIVE, 100.0, "%"), (MAE, 1.0, "N")):
                values = [
                    factor * one.score(estimator, one.group(*group))[key]["value"] for one in each
                ]
                words = "mean relative error" if key == RELATIVE else "mean absolute error"
                row = f"{name}, {len(each)} units: {estimator}, {WORDS[group]}: {words}, mean"
                note = (
                    f"each {', '.join(f'{v:.3g}' for v in values)} {unit}; standard "
                    f"deviation over units {float(np.std(values, ddof=1)):.2g} {unit}"
                )
                value = float(np.mean(values))
                target = TARGETS.get((group, key), {}).get(estimator)
                table.add(row, value, unit, "none", TWIN, target, note)


def add_rows_few(table: Table, *, quick: bool) -> None:
    """Learning curve of the paper's network and of ``auto``, from none on."""
    here = bench(units(quick=quick)[0])
    most = here.train.samples.count
    counts = [n for n in (25, 50, 100, 150, 300, 598) if n < most] + [most]
    errors: dict[tuple[str, Group], dict[int, float]] = {
        (name, group): {} for name in CURVE for group in (ALL, MIDDLE)
    }
    _curve_rows(table, here, "auto", 0, [here.judged(here.plain, names=["auto"])], errors)
    for count in counts[:1] if quick else counts:
        draws: list[Evaluation] = []
        # A point of the curve is the mean of three draws.
        for draw in range(1 if quick or count == most else 3):
            data = random_subset(here.train, count, seed=draw)
            bundle, _ = train_decoder(here.context, here.plain, data, names=CURVE, seed=draw)
            draws.append(here.judged(bundle, names=CURVE))
        for name in CURVE:
            _curve_rows(table, here, name, count, draws, errors)
    for (name, group), curve in errors.items():
        good = [n for n, error in curve.items() if error <= PAPER_PERCENT]
        if good:
            row = (
                f"{here.head}: {name}, {WORDS[group]}: samples from which on it is at the paper's "
                "2.3 %"
            )
            source = "paper: trained on 598"
            note = f"of {', '.join(map(str, curve))}"
            table.add(row, good[0], "samples", 598, source, f"<= {ENOUGH}", note)


def _curve_rows(
    table: Table,
    here: UnitDecoder,
    name: str,
    count: int,
    draws: Sequence[Evaluation],
    errors: dict[tuple[str, Group], dict[int, float]],
) -> None:
    """Mean error of an estimator from so many samples; kept in ``errors``, %."""
    judge = count == ENOUGH or (name == "auto" and count == 0)
    for group in (ALL, MIDDLE):
        mask = draws[0].group(*group)
        values = [100.0 * one.score(name, mask)[RELATIVE]["value"] for one in draws]
        mean = errors[name, group][count] = float(np.mean(values))
        note = [f"{len(values)} draws: {', '.join(f'{v:.3g}' for v in values)} %"]
        if judge and mean > PAPER_PERCENT:
            note.append(allowed(draws[0], mask))
        row = f"{here.head}: {name} from {count} samples, {WORDS[group]}: mean relative error"
        source = f"{PAPER}, all heights, 598 samples"
        target = f"<= {PAPER_PERCENT}" if judge else None
        table.add(row, mean, "%", PAPER_PERCENT, source, target, "; ".join(note))


def add_rows_other_unit(table: Table, *, quick: bool) -> None:
    """Decoders on prints that they have never seen, and with a few samples of these."""
    first, *others = units(quick=quick)
    home = bench(first)
    bundle, _ = train_decoder(home.context, home.plain, home.train)
    for case in others:
        here = bench(case)
        few = random_subset(here.train, CALIBRATION, seed=0)
        again, _ = train_decoder(here.context, here.plain, few, start=bundle)
        ways: tuple[tuple[str, Bundle, Sequence[str]], ...] = (
            ("by design alone", here.plain, ("fem", "koi_inverse", "auto")),
            (f"trained on unit {first.job.scenario.unit.number}", bundle, LEARNT),
            (f"the same and {CALIBRATION} samples of its own", again, LEARNT),
        )
        for words, decoder, names in ways:
            judged = here.judged(decoder, names=names)
            head = f"{here.head}, {words}"
            add_scores(table, head, judged, SHORT)
            add_claims(table, head, judged.claims, target=False)
