"""The decoder on contacts that CalculiX solved on the solid sensor; part ``referee``.

Tips moved as the referee says are seen through the design's own lens, with noise; switches follow
the activation law. Estimators know the design alone, have learnt from the twin's samples of the
sensor as designed, or, as a user calibrates a print, from ten of the referee's own loads: on the
others, ten after ten.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.decoder_data import chosen, nominal, set_of
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
    MIDDLE,
    RELATIVE,
    TARGETS,
    WORDS,
    add_bounds,
    add_claims,
    add_scores,
)
from benchmarks.harness import Table
from benchmarks.referee.contacts import COUNTS
from benchmarks.referee.read import Solved, data_file, read_solved
from phytac_decoder.io.bundle import Bundle
from phytac_design.datasets.samples import (
    STATUSES,
    THEORIES,
    DataSetInfo,
    Samples,
    TouchRows,
    truth_rows,
)
from phytac_design.design.accuracy import Preset
from phytac_design.design.design_file import design_hash, load_design
from phytac_design.engine.stage import Context
from phytac_design.mechanics.large import rotations as rot
from phytac_design.simulation.contacts import Contacts, switch_states
from phytac_design.stages.response_stage import image_response_of
from phytac_design.training.training_data import DataSet
from phytac_shapes.arrays import FloatArray

SOURCE = "CalculiX NLGEOM, quadratic tetrahedra of the CAD (benchmarks/referee)"
OWN = 10
"""Loads of the sensor itself that a decoder learns from."""


def shifts_px(context: Context, item: Solved) -> FloatArray:
    """Shifts (n, 2) of all markers in the image that each is read in.

    The paint turns with its receptor where the referee models it with its tube, and more of it
    shows on one side; elsewhere it moves as the tip, which it is beside.
    """
    see, markers = image_response_of(context), context.markers
    paint = see.watched
    arm = (paint - markers.tip_mm)[item.kept]
    turn = rot.deviation(rot.exponential(item.turn_rad))
    moved = paint + item.motion_mm
    moved[item.kept] += (turn @ arm[..., None])[..., 0]
    out = see.readers.project(moved) - see.rest
    # Of the wall under the receptor, which the slope is of.
    length = (markers.tip_mm - markers.mid_mm)[item.kept]
    wall = item.motion_mm[item.kept] - (turn @ length[..., None])[..., 0]
    motion = np.concatenate([wall, item.turn_rad], axis=1)
    out[item.kept] += np.einsum("nij,nj->ni", see.more[item.kept], motion)
    return np.asarray(out)


def samples_of(context: Context, solved: list[Solved]) -> Samples:
    """Solved contacts as samples of the sensor."""
    design = context.design
    rng = np.random.default_rng(5)
    sizes = [len(item.contact.uv) for item in solved]
    contacts = Contacts.flat(
        sample=np.repeat(np.arange(len(solved)), sizes),
        uv=np.concatenate([item.contact.centres for item in solved]),
        radius_mm=np.concatenate([item.contact.radius_mm for item in solved]),
        force_N=np.concatenate([item.contact.force_N for item in solved]),
        samples=len(solved),
    )
    state = switch_states(context.sensor, contacts)
    shift = np.stack([shifts_px(context, item) for item in solved])
    # A shift is the difference of two positions.
    shift += rng.normal(0.0, float(np.sqrt(2.0)) * design.camera.noise_centroid_px, shift.shape)
    count, number = len(solved), len(contacts.sample)
    total = np.zeros(count)
    np.add.at(total, contacts.sample, contacts.force_N)
    return Samples(
        markers=context.markers.count,
        time_s=np.arange(count, dtype=np.float64),
        sequence=np.arange(count),
        light=np.ones(count),
        status=np.full(count, STATUSES.index("ok")),
        theory=np.full(count, THEORIES.index("large")),
        total_N=total,
        contacts=contacts.counts,
        bits=state.bits,
        bits_read=state.bits,
        shift_px=shift,
        touches=TouchRows(
            sample=contacts.sample,
            uv=contacts.uv,
            point_mm=context.surface.point(contacts.uv),
            radius_mm=contacts.radius_mm,
            force_N=contacts.force_N,
            indenter=np.zeros(number, dtype=np.int64),
            length_mm=np.zeros(number),
            turn_rad=np.zeros(number),
            friction=np.zeros((number, 2)),
        ),
        truth=truth_rows(state.bits, state.owner, state.receptor_force_N),
    )


def data_of(context: Context, solved: list[Solved]) -> DataSet:
    """The same as a data set."""
    design = context.design
    meta = DataSetInfo(
        simulated=True,
        what=f"{len(solved)} contacts of {design.name} solved by CalculiX",
        design=design.name,
        design_hash=design_hash(design),
        route="points",
    )
    return set_of("referee", samples_of(context, solved), meta)


def add_rows_referee(table: Table, *, quick: bool) -> None:
    """All estimators on the referee's contacts of both designs."""
    accuracy: Preset = "draft" if quick else "standard"
    for name in ("grip",) if quick else COUNTS:
        design = load_design(name)
        context = mechanics(design, accuracy)
        solved = read_solved(data_file(name), design, context.markers)
        data = data_of(context, solved[:8] if quick else solved)
        plain = by_design(context)
        head = f"{name}, {data.samples.count} loads of the referee"
        judged = evaluate_decoder(context, plain.model, data)
        add_scores(table, f"{head}, by design alone", judged, FULL, targets=TARGETS, source=SOURCE)
        add_bounds(table, head, judged, target=None)
        add_claims(table, f"{head}, by design alone", judged.claims, target=False)
        if quick:
            continue
        case = nominal(design)
        bundle, _ = train_decoder(context, plain, case.parts()[0])
        again = evaluate_decoder(context, bundle.model, data, estimators=LEARNT)
        add_scores(table, f"{head}, trained on the twin's {case.name}", again, FULL, source=SOURCE)
        add_claims(table, f"{head}, trained on the twin's {case.name}", again.claims, target=False)
        add_own(table, head, list(after_own(context, plain, data)))


def after_own(context: Context, plain: Bundle, data: DataSet) -> Iterator[Evaluation]:
    """``auto`` on all but the :data:`OWN` loads that it has learnt from, of each group of these."""
    count = data.samples.count
    order = np.random.default_rng(6).permutation(count)
    for own in np.array_split(order, round(count / OWN)):
        bundle, _ = train_decoder(context, plain, chosen(data, own), names=("auto",))
        others = chosen(data, np.setdiff1d(order, own))
        yield evaluate_decoder(context, bundle.model, others, estimators=("auto",))


def add_own(table: Table, head: str, each: Sequence[Evaluation]) -> None:
    """Errors and intervals over all groups of loads together."""
    head = f"{head}, after {OWN} of them: auto"
    note = f"{len(each)} groups of {OWN} loads in turn, each judged on all other loads"
    for group in (ALL, MIDDLE):
        masks = [one.group(*group) for one in each]
        counts = [int(mask.sum()) for mask in masks]
        errors = [
            100.0 * one.score("auto", mask)[RELATIVE]["value"]
            for one, mask in zip(each, masks, strict=True)
        ]
        row = f"{head}, {WORDS[group]}: mean relative error"
        table.add(row, float(np.average(errors, weights=counts)), "%", "none", SOURCE, note=note)
    counts = [len(one.claims.truth_N) for one in each]
    share = 100.0 * float(np.average([one.claims.covered for one in each], weights=counts))
    row = f"{head}, share of truths inside 90 % intervals: distance from 90 %"
    words = f"{share:.1f} % of {sum(counts)} readings inside; {note}"
    table.add(row, abs(share - 90.0), "%", 0.0, SOURCE, "<= 5", words)
