"""The decoder on a hand that grips and is hit, at 480 fps: each frame by itself, and warm-started.

The work of a stream on each frame after marker detection: forces, contacts, fault detection. Five
fingers grip cylinder60, and after a tenth of a second something hits what they hold: forces kick
by up to 11 N within 5 ms, ring, and the fingers slip by 1.5 mm. Part ``moving`` of ``decoder``.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.decoder_accuracy import bench
from benchmarks.decoder_data import LINEAR, SEED, DataSetSpec, data_set, units
from benchmarks.decoder_evaluation import train_decoder
from benchmarks.harness import Table
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_decoder.pipeline.frame_reading import Reading, read
from phytac_design.datasets.samples import Samples
from phytac_design.design.spec import Design
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.scenario_file import parse_scenario
from phytac_shapes.arrays import FloatArray

FPS = 480.0
PERIOD_ms = 1e3 / FPS
FRAMES = 96
HIT_S = 0.1
ROUNDS = 3


@dataclass(frozen=True, kw_only=True)
class DecodedFilm:
    """A film decoded.

    Attributes
    ----------
    readings : list of Reading
        One a frame.
    ms : (frames,) float
        What each took.
    """

    readings: list[Reading]
    ms: FloatArray


def forces() -> FloatArray:
    """True force (frames, 5) N of each finger."""
    # Thumb to little finger.
    held_N = np.array([10.0, 6.5, 8.0, 8.0, 7.0])
    kicked_N = np.array([9.0, 11.0, 5.0, -1.5, 6.0])
    on_s, fades_s, rings_Hz = 0.005, 0.02, 55.0
    at = np.arange(FRAMES) / FPS
    grip = np.clip(at / 0.06, 0.05, 1.0) ** 2
    after = np.clip(at - HIT_S, 0.0, None)
    pulse = np.where(after < on_s, np.sin(np.pi * after / on_s), 0.0)
    kick = pulse + 0.5 * np.exp(-after / fades_s) * np.sin(2.0 * np.pi * rings_Hz * after)
    return np.asarray(np.maximum(np.outer(grip, held_N) + np.outer(kick, kicked_N), 0.3))


def job(design: Design, *, quick: bool) -> Job:
    """The hand on the print that the decoder was trained on, a sample a frame."""
    true_N = forces()[:: FRAMES // 8] if quick else forces()
    at = np.arange(FRAMES)[:: FRAMES // 8] / FPS if quick else np.arange(FRAMES) / FPS
    # Thumb and four fingers, shares of length and circumference.
    along, around = (0.62, 0.88, 0.63, 0.38, 0.13), (0.15, 0.62, 0.62, 0.62, 0.62)
    slid = 1.5 / 110.0 * (1.0 - np.exp(-np.clip(at - HIT_S, 0.0, None) / 0.01))
    touches = [
        {
            "sample": k,
            "along": along[finger] + float(slid[k]),
            "around": around[finger],
            "force_N": float(true_N[k, finger]),
            "radius_mm": 6.0,
            "indenter": "sphere",
        }
        for k in range(len(true_N))
        for finger in range(len(along))
    ]
    scenario = {
        "name": "stroke",
        "description": "A hand that grips, and is hit.",
        "kind": "presses",
        "touch": {"samples": len(true_N), "at": touches},
        "unit": {"number": 1},
        "solve": {"route": "points", **(LINEAR if quick else {})},
    }
    return Job(
        design=design,
        scenario=parse_scenario(scenario, "stroke"),
        seed=SEED,
        accuracy="draft" if quick else "standard",
    )


def measured(samples: Samples) -> list[FrameMeasurement]:
    """Measurement of each frame."""
    assert samples.shift_px is not None
    assert samples.bits_read is not None
    return [
        FrameMeasurement(koi=np.flatnonzero(bits), shift_px=shift, found=np.isfinite(shift[:, 0]))
        for shift, bits in zip(samples.shift_px, samples.bits_read, strict=True)
    ]


def decoded(
    bundle: Bundle,
    frames: Sequence[FrameMeasurement],
    estimator: str,
    *,
    follow: bool,
    rounds: int = ROUNDS,
) -> DecodedFilm:
    """All frames in their order; of each the shortest of some rounds' times."""
    took = np.full(len(frames), np.inf)
    readings: list[Reading] = []
    # Tables are prepared once, before the first frame of a stream.
    read(bundle, frames[-1], estimator)
    for _ in range(rounds):
        readings, before = [], None
        for k, frame in enumerate(frames):
            start = time.process_time()
            last = read(bundle, frame, estimator, before=before)
            took[k] = min(took[k], 1e3 * (time.process_time() - start))
            readings.append(last)
            before = last if follow else None
    return DecodedFilm(readings=readings, ms=took)


def error_N(run: DecodedFilm, true_N: FloatArray) -> FloatArray:
    """Error (frames,) N of the sum of all contacts, whose truth is (frames,)."""
    total = [
        sum(contact.force_N for contact in reading.found.contacts)
        if reading.found
        else float(reading.forces_N.sum())
        for reading in run.readings
    ]
    return np.asarray(total - true_N)


def add_rows(table: Table, *, quick: bool) -> None:
    """Time and error of each estimator that streams, by design and trained."""
    first = units(quick=quick)[0]
    here = bench(first)
    film = DataSetSpec(name="stroke", job=job(first.job.design, quick=quick), train=0)
    samples, _ = data_set(film.name, film.job)
    bundle, _ = train_decoder(here.context, here.plain, here.train, names=("auto",))
    head = f"{first.job.design.name} unit 1, five fingers at 480 fps"
    true_N = (forces()[:: FRAMES // 8] if quick else forces()).sum(axis=1)
    for name, model in (("by design", here.plain), ("trained", bundle)):
        add_film(table, f"{head}, {name}", model, measured(samples), true_N)


def add_film(
    table: Table, head: str, model: Bundle, frames: Sequence[FrameMeasurement], true_N: FloatArray
) -> None:
    """Rows of one decoder; ``true_N`` (frames,) is the sum of all forces."""
    note = (
        f"{len(frames)} frames by points, up to {true_N.max():.0f} N in all; forces, contacts and "
        "fault detection, after marker detection; processor time of one core, the shortest of "
        f"{ROUNDS} rounds of each frame"
    )
    inverse = decoded(model, frames, "koi_inverse", follow=False)
    alone = decoded(model, frames, "auto", follow=False)
    followed = decoded(model, frames, "auto", follow=True)
    for words, run in (
        ("koi_inverse", inverse),
        ("auto, each frame by itself", alone),
        ("auto, warm-started from the frame before", followed),
    ):
        _time_rows(table, f"{head}: {words}", run, note)
        row = f"{head}: {words}: error of the sum of forces"
        source = "mean of the true sum, N"
        value = float(np.sqrt(np.mean(error_N(run, true_N) ** 2)))
        table.add(row, value, "N RMS", float(true_N.mean()), source)
    row = f"{head}: auto, warm-started over by itself: median time of a frame"
    source = "each frame by itself, ms of one core, same run"
    value = float(np.median(followed.ms) / np.median(alone.ms))
    table.add(row, value, "ratio", float(np.median(alone.ms)), source)
    _difference_rows(table, head, alone, followed)


def _time_rows(table: Table, head: str, run: DecodedFilm, note: str) -> None:
    for name, share in (("p50", 50), ("p99", 99)):
        row = f"{head}: a frame, {name}"
        source = "a frame's period at 480 fps"
        value = float(np.percentile(run.ms, share))
        table.add(row, value, "ms of one core", PERIOD_ms, source, note=note)


def _difference_rows(table: Table, head: str, alone: DecodedFilm, followed: DecodedFilm) -> None:
    """Difference of warm-started results from those of each frame by itself."""
    apart, other = [], 0
    for one, two in zip(alone.readings, followed.readings, strict=True):
        assert one.found is not None
        assert two.found is not None
        if len(one.found.contacts) != len(two.found.contacts):
            other += 1
            continue
        apart += [
            abs(a.force_N - b.force_N) / a.sd_N
            for a, b in zip(one.found.contacts, two.found.contacts, strict=True)
        ]
    went = sum(
        bool(two.found and two.found.state and two.found.state.age) for two in followed.readings
    )
    row = f"{head}: auto, warm-started against by itself: force difference, p99"
    source = "the same frames, each by itself"
    note = (
        f"largest {max(apart, default=0.0):.2f}; {other} of {len(alone.readings)} frames with "
        f"another number of contacts; {went} frames were warm-started"
    )
    value = float(np.percentile(apart, 99)) if apart else 0.0
    table.add(row, value, "standard deviations", 0.0, source, note=note)
