"""The decoder under contacts as hands make them.

Part ``friction``: contacts of the scenario ``platform`` on virtual prints, with and without
friction, are read by decoders that learnt from either. The same decoder without tables of force
along the surface is beside it. Part ``elsewhere``: a decoder that learnt from one print reads what
it has not learnt: other contacts, another stiffness, other prints. Part ``presses``: the decoder by
design, calibrated to a few presses of prints that it has never seen, as ``phytac
calibrate-instance`` does. ::

    python -m benchmarks.hands [--parts friction,elsewhere,presses] [--quick]
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np

from benchmarks.decoder_data import (
    SEED,
    DataSetSpec,
    chosen,
    data_set,
    job_of,
    random_subset,
    set_of,
    small_design,
)
from benchmarks.decoder_evaluation import Evaluation, by_design, evaluate_decoder, mechanics
from benchmarks.harness import Table, run_parts
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_decoder.pipeline.print_identity import for_this_print
from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.design.accuracy import Preset
from phytac_design.design.design_file import load_design, parse_design
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.stages.places_stage import uneven_wall_of
from phytac_design.training.evaluation.contact_scores import interval_coverage
from phytac_design.training.locator_calibration import calibrate_locator
from phytac_design.training.press_places import next_press
from phytac_design.training.training_data import DataSet
from phytac_design.workflows.calibrate_instance import (
    KnownPress,
    calibrate_to_presses,
    designed_locator,
    known_press,
)
from phytac_design.workflows.simulate import observe_rest
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import InputError

LEARNT = 200
FRICTION = {"friction 0 to 0.8": 0.8, "no friction": 0.0}
"""Largest tangential over normal force of the data sets, by name."""
GHOST_N = 1.0
"""A contact where nothing presses counts from this force on."""
NEAR_MM = 5.0
"""Largest distance of a located contact from the pressed one that it is compared with."""
PRESSES = (3, 10, 25)
"""Presses of a print of its own."""
PRINTS, POOL, HELD_OUT = 8, 45, 25
"""Prints that are calibrated, and of each the presses to choose from, and the samples to judge."""
PRESSED: dict[str, object] = {
    "placement": "anywhere",
    "multi_share": 0.0,
    "friction_max": 0.2,
    "force_min_N": 8.0,
    "indenters": [{"kind": "flat"}],
}
"""Presses with a pad, nearly along the normal."""
SCALE_SD = 0.01
"""Error of a scale, over the force."""
TARGETS_PRESSES = {0: "<= 5", 10: "<= 1.5"}
"""Errors at middle heights, %."""


@dataclass(frozen=True, kw_only=True)
class Elsewhere:
    """What a decoder reads that has learnt ``platform`` on unit 1: that, but for these fields."""

    touch: dict[str, object] = field(default_factory=dict)
    scenario: str = "platform"
    prints: tuple[tuple[int, int], ...] = ((SEED, 1),)
    """Seed and unit of each print; the seed draws its contacts, too."""
    modulus: float = 1.0
    modulus_within: float = 0.0
    """Half the range of the modulus, over that of the data, which is drawn for each sample."""
    stiffness_change: float = 0.0
    """``--stiffness-change``, as a share."""


def _elsewhere(design: Design) -> dict[str, Elsewhere]:
    """Conditions by name; radii are of the design's training table."""
    low, high = design.training.patch_radius_min_mm, design.training.patch_radius_max_mm
    edge = {"kind": "cylinder", "radius_share": 0.2, "length_mm": 12.0}
    return {
        "as learnt": Elsewhere(),
        "patches half as wide": Elsewhere(
            touch={"radius_min_mm": low / 2, "radius_max_mm": high / 2}
        ),
        "patches twice as wide": Elsewhere(
            touch={"radius_min_mm": 2 * low, "radius_max_mm": 2 * high}
        ),
        "edges": Elsewhere(touch={"indenters": [edge]}),
        "anywhere": Elsewhere(touch={"placement": "anywhere"}),
        "rims": Elsewhere(touch={"placement": "rims", "multi_share": 0.0}),
        "friction 0.8": Elsewhere(touch={"friction_min": 0.8}),
        "nine pads": Elsewhere(scenario="grips"),
        "modulus +10 %": Elsewhere(modulus=1.1),
        "modulus -10 %": Elsewhere(modulus=0.9),
        "modulus drawn within 10 %": Elsewhere(modulus_within=0.1, stiffness_change=0.06),
        "other instances": Elsewhere(prints=tuple((SEED + 1 + k, 2) for k in range(10))),
    }


@dataclass(frozen=True, kw_only=True)
class Sheared:
    """Force along the surface of located contacts, along u and square to it, N.

    Attributes
    ----------
    error_N : (c, 2) float
        Located minus true force.
    truth_N : (c, 2) float
        True force.
    inside : (c, 3) bool
        Whether each component in the sensor's axes is within its 90 % interval.
    """

    error_N: FloatArray
    truth_N: FloatArray
    inside: BoolArray


def learnt(context: Context, plain: Bundle, data: DataSet, *, shear: bool) -> Bundle:
    """Decoder that learnt from data, with or without tables of force along the surface."""
    locator = plain.model.locator
    assert locator is not None
    if not shear:
        locator = replace(locator, places=replace(locator.places, shear=None))
    rows = np.arange(data.samples.count)
    fitted, _ = calibrate_locator(
        locator,
        data.samples,
        rows,
        force_max_N=plain.force_max_N,
        wall=partial(uneven_wall_of, context),
    )
    return replace(plain, model=replace(plain.model, locator=fitted))


def sheared(judged: Evaluation) -> Sheared:
    """Compare the force along the surface with the truth, where the markers determine it."""
    samples, context = judged.data.samples, judged.context
    touches = samples.touches
    assert touches is not None
    tangents = context.surface.tangents(touches.uv)[:, 0]
    along = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    axes = np.stack([along, np.cross(context.surface.normal(touches.uv), along)], axis=1)
    true_N = np.einsum("ci,cij->cj", touches.friction, axes) * touches.force_N[:, None]
    error, truth, inside = [], [], []
    for sample, found in enumerate(judged.found):
        rows = np.flatnonzero(touches.sample == sample)
        for contact in found.contacts if found else []:
            gap = np.linalg.norm(touches.point_mm[rows] - contact.point_mm, axis=1)
            if not contact.shear_observed or gap.min(initial=np.inf) > NEAR_MM:
                continue
            row = rows[gap.argmin()]
            off = contact.shear_N - true_N[row]
            error.append(axes[row] @ off)
            truth.append(axes[row] @ true_N[row])
            inside.append(np.abs(off) <= 1.645 * contact.shear_sd_N)
    return Sheared(error_N=np.array(error), truth_N=np.array(truth), inside=np.array(inside))


def add_friction(table: Table, *, quick: bool) -> None:
    """Rows of decoders that learnt with and without friction, on both."""
    accuracy: Preset = "draft" if quick else "standard"
    design = small_design() if quick else load_design("cylinder60")
    count, train = (60, 30) if quick else (500, LEARNT)
    solve: dict[str, object] = {"displacement": "linear"} if quick else {}
    sets: dict[str, tuple[DataSet, DataSet]] = {}
    for name, most in FRICTION.items():
        touch: dict[str, object] = {"friction_max": most}
        job = job_of(design, unit=1, samples=count, accuracy=accuracy, touch=touch, solve=solve)
        folder = f"hands-{design.name}-{most:g}"
        sets[name] = DataSetSpec(name=folder, job=job, train=train).parts()
    context = mechanics(design, accuracy)
    plain = by_design(context)
    squarely: dict[bool, float] = {}
    for source, (training, _) in sets.items():
        for shear in (True, False):
            bundle = learnt(context, plain, random_subset(training, train, seed=0), shear=shear)
            for target, (_, held_out) in sets.items():
                judged = evaluate_decoder(context, bundle.model, held_out, estimators=["auto"])
                what = "" if shear else ", force along the surface taken as 0"
                head = f"{design.name} unit 1, points{what}: learnt with {source}"
                mean = _add_rows(table, f"{head}, read with {target}", judged, targets=shear)
                if FRICTION[source] == FRICTION[target] == 0.0:
                    squarely[shear] = mean
    table.goal(
        f"{design.name} unit 1, points: error without friction over that with force along the "
        "surface taken as 0",
        squarely[True] / squarely[False],
        "ratio",
        "<= 1.1",
    )


def _add_rows(table: Table, head: str, judged: Evaluation, *, targets: bool) -> float:
    """Errors, intervals and ghosts of one decoder on one data set; returns the mean error, %."""
    middle, decoded = judged.group("height", "middle"), judged.decoded
    error = (decoded.decoded_N["auto"] - decoded.force_N)[middle]
    share, claims = error / decoded.force_N[middle], judged.claims
    ghosts = claims.nothing_N[claims.nothing_N > GHOST_N]
    frames = judged.data.samples.count
    mean = 100.0 * float(np.abs(share).mean())
    least = 100.0 * judged.least_relative(middle)[0]

    def add(case: str, value: float, unit: str, target: str, note: str = "") -> None:
        case = f"{head}: {case}"
        table.add(case, value, unit, "", "project target", target if targets else None, note)

    add(
        f"middle heights ({int(middle.sum())} contacts), mean relative error",
        mean,
        "%",
        "<= 1.5",
        f"{float(np.abs(error).mean()):.3g} N; the bound with this force unknown allows "
        f"{least:.2g} %",
    )
    together = np.bincount(decoded.sample)[decoded.sample][middle]
    for count in range(1, together.max() + 1):
        one = together == count
        if one.any():
            case = f"{head}: middle heights, mean relative error, {count} contacts at a time"
            value = 100.0 * float(np.abs(share[one]).mean())
            table.add(case, value, "%", "", "project", None, f"{int(one.sum())} contacts")
    add("middle heights, mean of error over force", 100.0 * abs(float(share.mean())), "%", "<= 0.3")
    covered = 100.0 * claims.covered
    note = f"{covered:.3g} %"
    add("share within 90 % intervals: distance from 90 %", abs(covered - 90.0), "%", "<= 5", note)
    add(
        f"contacts over {GHOST_N:g} N where nothing presses, in {frames} frames",
        len(ghosts),
        "",
        "== 0",
        f"{ghosts.sum():.3g} N in sum",
    )
    if not targets:
        return mean
    found = sheared(judged)
    for axis, name in enumerate(("along", "around")):
        rms = np.sqrt(np.mean(found.error_N[:, axis] ** 2))
        true = np.sqrt(np.mean(found.truth_N[:, axis] ** 2))
        note = f"of {true:.3g} N RMS; {len(found.error_N)} contacts"
        table.add(f"{head}: shear {name}, RMS error", float(rms), "N", "", "project", None, note)
    inside = 100.0 * float(found.inside.mean())
    add("shear, share within 90 % intervals", inside, "%", ">= 85")
    return mean


def add_elsewhere(table: Table, *, quick: bool) -> None:
    """Rows of one decoder that learnt from one print, on what it has not learnt."""
    accuracy: Preset = "draft" if quick else "standard"
    design = small_design() if quick else load_design("cylinder60")
    count, train = (30, 30) if quick else (100, LEARNT)
    solve: dict[str, object] = {"displacement": "linear"} if quick else {}
    touch: dict[str, object] = {"friction_max": 0.8}
    total = 60 if quick else 500
    job = job_of(design, unit=1, samples=total, accuracy=accuracy, touch=touch, solve=solve)
    training, _ = DataSetSpec(name=f"hands-{design.name}-0.8", job=job, train=train).parts()
    context = mechanics(design, accuracy)
    bundle = learnt(context, by_design(context), random_subset(training, train, seed=0), shear=True)
    bundle = replace(bundle, learnt_rest_px=_rest_px(design, (SEED, 1), accuracy)[None])
    for name, case in _elsewhere(design).items():
        judged = []
        for own in case.prints:
            samples = -(-count // len(case.prints))
            data = _read_set(design, name, case, own, samples, accuracy=accuracy, solve=solve)
            model = for_this_print(replace(bundle, rest_px=_rest_px(design, own, accuracy))).model
            assert model.locator is not None
            locator = replace(model.locator, stiffness_change=case.stiffness_change)
            model = replace(model, locator=locator)
            judged.append(evaluate_decoder(context, model, data, estimators=["auto"]))
        head = f"{design.name} learnt on unit 1, read: {name}"
        _add_elsewhere_rows(table, head, judged)


def _read_set(
    design: Design,
    name: str,
    case: Elsewhere,
    own: tuple[int, int],
    samples: int,
    *,
    accuracy: Preset,
    solve: dict[str, object],
) -> DataSet:
    """Contacts of one condition on a print ``own``, by its seed and unit.

    They are on receptors at random, so that none is one that was learnt.
    """
    made = replace_modulus(design, case.modulus)
    touch = {"samples": samples, **({} if case.scenario == "grips" else {"placement": "receptor"})}
    job = job_of(
        made,
        scenario=case.scenario,
        seed=own[0],
        unit=own[1],
        accuracy=accuracy,
        solve=solve,
        touch={**touch, **case.touch},
    )
    same = "as learnt" if case.modulus_within else name
    folder = f"hands-{design.name}-{same.replace(' ', '-').replace('%', '')}".rstrip("-")
    folder += f"-{own[0]}" * (len(case.prints) > 1)
    found, meta = data_set(folder, job)
    found = _stiffened(found, case.modulus_within)
    data = set_of(folder, found, meta)
    return chosen(data, np.flatnonzero(found.status != FAILED))


def _stiffened(samples: Samples, within: float) -> Samples:
    """Samples of walls whose modulus is drawn: force over modulus is what moves markers."""
    touches, truth = samples.touches, samples.truth
    if not within or touches is None or truth is None:
        return samples
    factor = np.random.default_rng(5).uniform(1.0 - within, 1.0 + within, samples.count)
    return replace(
        samples,
        touches=replace(touches, force_N=touches.force_N * factor[touches.sample]),
        truth=replace(truth, force_N=truth.force_N * factor[truth.sample]),
    )


@cache
def _rest_px(design: Design, own: tuple[int, int], accuracy: Preset) -> FloatArray:
    """Rest positions (n, 2) of a print, as its data set would hold them."""
    job = job_of(design, seed=own[0], unit=own[1], samples=1, accuracy=accuracy)
    found = observe_rest(job, lambda _: None)
    assert not isinstance(found.rest, str)
    return found.rest.rest_px


def replace_modulus(design: Design, factor: float) -> Design:
    """The design with the wall's modulus multiplied."""
    data = design.model_dump(mode="json")
    data["material"]["modulus_MPa"] *= factor
    return parse_design(data, design.name)


def _add_elsewhere_rows(table: Table, head: str, judged: list[Evaluation]) -> None:
    """Errors, intervals and what was missed or invented, of one condition, over all prints."""
    claims = [one.claims for one in judged]
    share = np.concatenate(
        [
            np.abs(one.decoded.decoded_N["auto"] - one.decoded.force_N) / one.decoded.force_N
            for one in judged
        ]
    )
    middle = np.concatenate([one.group("height", "middle") for one in judged])
    nothing = np.concatenate([one.nothing_N for one in claims])
    ghosts = nothing[nothing > GHOST_N]
    frames = sum(one.data.samples.count for one in judged)
    force, sd, truth = (
        np.concatenate([getattr(one, name) for one in claims])
        for name in ("force_N", "sd_N", "truth_N")
    )
    covered = 100.0 * interval_coverage(force, sd, truth, level=0.9)
    note = (
        f"{covered:.3g} % of {len(force)} contacts; standard deviation "
        f"{100.0 * float(np.median(sd / truth)):.2g} % of the force; "
        f"{sum(one.unmatched for one in claims)} contacts as two or together with another"
    )
    if len(judged) > 1:
        each = [100.0 * one.covered for one in claims]
        stiffness = [np.median(one.truth_N / one.force_N) for one in claims]
        note += (
            f"; of single prints {min(each):.3g} to {max(each):.3g} %, with {min(stiffness):.2f} "
            f"to {max(stiffness):.2f} times the stiffness, standard deviation "
            f"{100.0 * float(np.std(stiffness)):.2g} %"
        )
    case = f"{head}: share within 90 % intervals, distance from 90 %"
    table.add(case, abs(covered - 90.0), "%", "", "project target", "<= 5", note)
    for where, mask in (("middle heights", middle), ("whole surface", np.ones_like(middle))):
        if mask.any():
            mean = 100.0 * float(share[mask].mean())
            note = f"{int(mask.sum())} contacts"
            table.add(f"{head}: {where}, mean relative error", mean, "%", "", "project", None, note)
    case = f"{head}: contacts over {GHOST_N:g} N where nothing presses, in {frames} frames"
    note = f"{ghosts.sum():.3g} N in sum"
    table.add(case, len(ghosts), "", "", "project target", "== 0", note)


def add_presses(table: Table, *, quick: bool) -> None:
    """Rows of a decoder by design that is calibrated to a few presses of prints."""
    accuracy: Preset = "draft" if quick else "standard"
    design = small_design() if quick else load_design("cylinder60")
    solve: dict[str, object] = {"displacement": "linear"} if quick else {}
    context = mechanics(design, accuracy)
    plain, shell = by_design(context), uneven_wall_of(context)
    judged: dict[tuple[str, int], list[Evaluation]] = {}
    for number in range(2 if quick else PRINTS):
        seed = SEED + 1 + number
        sets = []
        for name, touch in (
            ("own", PRESSED | {"samples": POOL}),
            ("held-out", {"placement": "receptor", "samples": 10 if quick else HELD_OUT}),
        ):
            job = job_of(design, seed=seed, unit=2, accuracy=accuracy, touch=touch, solve=solve)
            folder = f"hands-{design.name}-{name}-{seed}"
            sets.append(set_of(folder, *data_set(folder, job)))
        pool = _usable_presses(plain, sets[0].samples)
        drawn = [pool[k] for k in np.random.default_rng(seed).permutation(len(pool))]
        cases = {("by design", 0): plain}
        for how, order in (("at random", drawn), ("where proposed", _as_proposed(plain, pool))):
            for count in PRESSES[:1] if quick else PRESSES:
                known = order[:count]
                cases[how, len(known)], _ = calibrate_to_presses(
                    context.sensor, plain, known, wall=lambda: shell
                )
        for case, bundle in cases.items():
            one = evaluate_decoder(context, bundle.model, sets[1], estimators=["auto"])
            judged.setdefault(case, []).append(one)
    for (how, count), each in judged.items():
        head = f"{design.name}, {len(each)} prints, {count} presses of each, {how}"
        _add_press_rows(table, head, each, TARGETS_PRESSES.get(count))


def _usable_presses(plain: Bundle, samples: Samples) -> list[KnownPress]:
    """Presses that a calibration takes, with the error of a scale."""
    touches, _, shift, bits = samples.points()
    rng, out = np.random.default_rng(5), []
    for row, sample in enumerate(touches.sample.tolist()):
        found = np.isfinite(shift[sample]).all(axis=1)
        koi = np.flatnonzero(bits[sample])
        measured = FrameMeasurement(koi=koi, shift_px=shift[sample], found=found)
        given_N = float(touches.force_N[row] * rng.normal(1.0, SCALE_SD))
        with suppress(InputError):
            out.append(known_press(plain, measured, given_N))
    return out


def _as_proposed(plain: Bundle, pool: list[KnownPress]) -> list[KnownPress]:
    """Presses in the order in which they would be proposed."""
    radius_mm = designed_locator(plain).places.radius_mm
    left, out, pressed = list(pool), [], np.zeros((0, 3))
    while left:
        points = np.stack([press.contact.point_mm for press in left])
        out.append(left.pop(next_press(points, pressed, radius_mm=radius_mm)))
        pressed = np.append(pressed, out[-1].contact.point_mm[None], axis=0)
    return out


def _add_press_rows(table: Table, head: str, judged: list[Evaluation], target: str | None) -> None:
    """Errors and intervals over all prints."""
    share = np.concatenate(
        [
            np.abs(one.decoded.decoded_N["auto"] - one.decoded.force_N) / one.decoded.force_N
            for one in judged
        ]
    )
    middle = np.concatenate([one.group("height", "middle") for one in judged])
    single = np.concatenate([one.group("contact", "single") for one in judged])
    for where, mask, goal in (
        ("middle heights", middle, target),
        ("middle heights, single contacts", middle & single, None),
    ):
        each = f"{int(mask.sum())} contacts"
        mean = 100.0 * float(share[mask].mean())
        case = f"{head}: {where}, mean relative error"
        table.add(case, mean, "%", "", "project target", goal, each)
    claims = [one.claims for one in judged]
    force, sd, truth = (
        np.concatenate([getattr(one, name) for one in claims])
        for name in ("force_N", "sd_N", "truth_N")
    )
    covered = 100.0 * interval_coverage(force, sd, truth, level=0.9)
    note = (
        f"{covered:.3g} % of {len(force)} contacts; standard deviation "
        f"{100.0 * float(np.median(sd / truth)):.2g} % of the force"
    )
    case = f"{head}: share within 90 % intervals, distance from 90 %"
    table.add(case, abs(covered - 90.0), "%", "", "project target", "<= 5", note)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Parts of this benchmark."""
    return {
        "friction": partial(add_friction, quick=quick),
        "elsewhere": partial(add_elsewhere, quick=quick),
        "presses": partial(add_presses, quick=quick),
    }


if __name__ == "__main__":
    run_parts("hands", parts, __doc__ or "")
