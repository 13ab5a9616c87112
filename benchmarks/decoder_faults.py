"""Decoding of frames in another light than the design's, and of frames with faults.

Frames are rendered (lens blur, fall-off, vignetting, noise) of contacts that a shell of large
displacement solves.
"""

import copy
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.decoder_damage import FAULTS, Sample
from benchmarks.decoder_evaluation import by_design, mechanics
from benchmarks.decoder_lights import add_lights
from benchmarks.decoder_presses import REFINE, SEEN, PressedSensor, scenario_of
from benchmarks.harness import Table
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import FrameMeasurement, measure_frame
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.serving.torn_frames import TornFrameDetector
from phytac_design.design.design_file import load_design
from phytac_design.stages.build import copy_of
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import InputError

ESTIMATORS = ("koi_inverse", "auto")
WRONG_SHARE, WRONG_N = 0.1, 0.3
"""A force is wrong that a fault changes by more than both."""
TRIES = 4
"""Frames after which a follower has found a press that came at once."""


@dataclass
class FaultCounts:
    """Results of one fault's frames."""

    frames: int = 0
    refused: int = 0
    flagged: int = 0
    followed: int = 0
    wrong: int = 0
    silent: int = 0
    watched: int = 0
    unseen: int = 0
    message: str = ""
    total: list[float] = field(default_factory=list)
    contact: list[float] = field(default_factory=list)


def judged(
    bench: PressedSensor,
    index: int,
    sound: FrameMeasurement,
    seen: FrameMeasurement,
    estimator: str,
) -> tuple[float, float, bool, list[str]]:
    """Relative error of the total, largest of a contact (N), whether wrong, and warnings."""
    bundle, true = bench.bundle, bench.true_N(index)
    forces = seen.forces_N(bundle, estimator)
    before = bench.forces_of(index, sound.forces_N(bundle, estimator))
    after = bench.forces_of(index, forces)
    limit = np.maximum(WRONG_SHARE * np.append(true, 0.0), WRONG_N)
    wrong = bool(abs(after[0] - before[0]) > max(WRONG_SHARE * true.sum(), WRONG_N))
    wrong |= bool((np.abs(after[1] - before[1]) > limit).any())
    error = after[1] - np.append(true, 0.0)
    warnings = seen.warnings(bundle, forces, estimator=estimator)
    return abs(after[0] / true.sum() - 1.0), float(np.abs(error).max()), wrong, warnings


def add_faults(table: Table, bench: PressedSensor, count: int) -> None:
    """Each fault in ``count`` pressed frames; errors, and whether it was flagged."""
    rest = bench.shot(bench.chip(*bench.at_rest), seed=100)
    bundle = calibrate_rest(bench.bundle, rest)
    bench = replace(bench, bundle=bundle)
    chosen = np.flatnonzero(bench.tripped)[: count + 1].tolist()
    chips = {index: bench.chip(*bench.pose(index)) for index in chosen}
    sound = {index: measure_frame(bundle, bench.shot(chips[index], seed=index)) for index in chosen}
    detectors = {
        index: _torn_detector(bench, chips[after], index) for index, after in pairwise(chosen)
    }
    names = [name for name in ESTIMATORS if name in bundle.model.estimators]
    for fault, damage in {"none": _again, **FAULTS}.items():
        tallies = {name: FaultCounts() for name in names}
        for index, sample in _samples(bench, chosen, chips):
            frame = damage(sample)
            follows = _followed(bundle, rest, sample, frame)
            torn = bool(copy.deepcopy(detectors[index]).check([frame]))
            try:
                seen = measure_frame(bundle, frame)
            except InputError as error:
                for tally in tallies.values():
                    tally.frames, tally.refused = tally.frames + 1, tally.refused + 1
                    tally.followed += follows
                    tally.watched += torn
                    tally.message = str(error)
                continue
            for name, tally in tallies.items():
                total, contact, wrong, warnings = judged(bench, index, sound[index], seen, name)
                tally.frames += 1
                tally.followed += follows
                tally.watched += torn
                tally.flagged += bool(warnings)
                tally.wrong += wrong
                tally.silent += wrong and not warnings
                tally.unseen += wrong and not warnings and not torn
                tally.message = warnings[0] if warnings else tally.message
                tally.total.append(total)
                tally.contact.append(contact)
        for name, tally in tallies.items():
            _add_fault(table, fault, name, tally)


def _again(sample: Sample) -> ImageArray:
    return sample.shoot()


def _samples(
    bench: PressedSensor, chosen: list[int], chips: dict[int, NDArray[np.float32]]
) -> Iterator[tuple[int, Sample]]:
    """Samples to damage; the last of ``chosen`` is only joined to the one before."""
    for number, index in enumerate(chosen[:-1]):
        motion, bits = bench.pose(index)
        shoot = partial(bench.shot, chips[index], 1000 + index)
        yield (
            index,
            Sample(
                bundle=bench.bundle,
                frame=shoot(),
                other=bench.shot(chips[chosen[number + 1]], seed=2000 + index),
                shoot=shoot,
                place_px=bench.bundle.rest_px + bench.imaging.exact(motion, bits),
                bits=bits,
                rng=np.random.default_rng([SEEN, index]),
            ),
        )


def _followed(bundle: Bundle, rest: ImageArray, sample: Sample, frame: ImageArray) -> bool:
    """Whether a tracker that has found the press warns about the frame after it."""
    follower = Follower(bundle, rest)
    for attempt in range(TRIES):
        try:
            follower.follow(sample.frame)
        except InputError:
            if attempt + 1 == TRIES:
                return False
            continue
        break
    try:
        seen = follower.follow(frame)
    except InputError:
        return True
    forces = seen.forces_N(bundle, "koi_inverse")
    return bool(seen.flags or seen.warnings(bundle, forces, estimator="koi_inverse"))


def _torn_detector(
    bench: PressedSensor, light: NDArray[np.float32], index: int
) -> TornFrameDetector:
    """Detector that has seen frames of the press before a sample; the last is its ``other``."""
    detector = TornFrameDetector()
    for seed in (
        *(10000 * k + index for k in range(3, 3 + TornFrameDetector.frames_changed_min)),
        2000 + index,
    ):
        if detector.check([bench.shot(light, seed=seed)]):
            raise InputError(
                "noise-draws-equal", f"sample {index}: two draws of the noise are the same"
            )
    return detector


def _add_fault(table: Table, fault: str, estimator: str, tally: FaultCounts) -> None:
    total, contact = tally.total, tally.contact
    where = f"fault {fault}, {estimator}"
    if fault == "none":
        row = f"sound frames with a warning, {estimator}"
        source = "frames, another draw of the noise"
        note = (
            f"by a follower {tally.followed}; by one who holds them against the frame before "
            f"{tally.watched}; message: {tally.message or 'nothing'}"
        )
        table.add(row, tally.flagged, "frames", tally.frames, source, "== 0", note)
    else:
        row = f"{where}: frames with a wrong force and no warning"
        source = (
            f"frames with a force changed by more than {100 * WRONG_SHARE:g} % and {WRONG_N:g} N"
        )
        note = (
            f"{tally.frames} frames: {tally.refused} refused, {tally.flagged} flagged; by a "
            f"follower {tally.followed}; last message: {tally.message or 'nothing'}"
        )
        table.add(row, tally.silent, "frames", tally.wrong, source, "== 0", note)
    if fault == "a frame torn":
        row = f"{where}: the same, by one who holds it against the frame before"
        source = (
            "as serve, live and decode do with recordings and cameras; rows that are the "
            "last frame's to the bit"
        )
        note = f"{tally.watched} of {tally.frames} frames found to be torn"
        table.add(row, tally.unseen, "frames", tally.wrong, source, "== 0", note)
    if not total:
        return
    row = f"{where}: error of the total, median"
    source = "true forces of the contacts; frames that were not refused"
    note = (
        f"worst {np.max(total):.3g}; largest error of one contact, median "
        f"{np.median(contact):.3g} N, worst {np.max(contact):.3g} N; {tally.flagged} of "
        f"{tally.frames} frames flagged"
    )
    table.add(row, float(np.median(total)), "relative", "-", source, note=note)


def add_alarms(table: Table, benches: dict[str, PressedSensor]) -> None:
    """Warnings about sound frames, by the points route."""
    for label, bench in benches.items():
        for estimator in ESTIMATORS:
            _add_alarm(table, label, bench, estimator)


def _add_alarm(table: Table, label: str, bench: PressedSensor, estimator: str) -> None:
    alarms, missing, warnings = 0, 0, ""
    for index, motion in enumerate(bench.motion):
        bits = bench.job.plan.switching.bits[index]
        seen = bench.imaging.points(motion, bits, 1.0, np.random.default_rng([SEEN, index]))
        read = FrameMeasurement(koi=np.flatnonzero(bits), shift_px=seen.shift_px, found=seen.found)
        forces = read.forces_N(bench.bundle, estimator)
        found = read.warnings(bench.bundle, forces, estimator=estimator)
        sound = bool(bench.tripped[index])
        alarms += sound and bool(found)
        missing += not sound and bool(found)
        warnings = found[0] if sound and found else warnings
    row = f"sound samples with a warning, {label}, {estimator}"
    source = (
        "samples by points, all of whose contacts tripped a switch, up to "
        f"{bench.job.design.training.force_max_N:g} N each"
    )
    note = (
        f"of {int((~bench.tripped).sum())} with a contact that trips no switch {missing} "
        f"have a warning of missing forces; message: {warnings or 'nothing'}"
    )
    table.add(row, alarms, "samples", int(bench.tripped.sum()), source, "== 0", note)


def add_rows(table: Table, *, quick: bool) -> None:
    """Lights, faults and false alarms; ``quick``: a smaller camera and few samples."""
    cv2.setNumThreads(1)
    design = load_design("cylinder60")
    if quick:
        half = {"width_px": 1296, "height_px": 972, "focal_px": design.camera.focal_px / 2.0,
                "pixel_um": 2.0 * design.camera.pixel_um}  # fmt: skip
        design = copy_of(design, camera=half)
    bench = PressedSensor.of(
        design, scenario_of(3 if quick else 30, "receptor"), seed=1, quick=quick
    )
    context = mechanics(design, bench.job.accuracy)
    bench = replace(bench, bundle=replace(bench.bundle, model=by_design(context).model))
    add_lights(table, bench, quick=quick)
    add_faults(table, bench, 1 if quick else 20)
    benches = {}
    for label, count in (("receptor", 4 if quick else 120), ("anywhere", 4 if quick else 60)):
        job = replace(bench.job, scenario=scenario_of(count, label), seed=2)
        benches[f"pressed at {label}"] = PressedSensor.pressed(
            job, bench.imaging, bench.bundle, refine=5 if quick else REFINE
        )
    add_alarms(table, benches)
