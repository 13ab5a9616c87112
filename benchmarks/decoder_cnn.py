"""The paper's end-to-end baseline, a convolutional network on frames, with 598 and 3909 samples.

The paper reads 48 % and 93.0 % accuracy off its own with as many. Frames are 640 × 480, reduced to
160 × 120; simulating them takes half an hour of two cores, and learning as long.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.cnn_baseline import (
    TrainedCnn,
    TrainingSettings,
    marker_forces,
    places_in_frame,
    read_frames,
    train_cnn,
)
from benchmarks.decoder_data import (
    LINEAR,
    SEED,
    data_folder,
    data_set,
    job_of,
    origin,
    small_design,
)
from benchmarks.decoder_speed import SMALL, before_camera
from benchmarks.harness import Table
from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.design.design_file import load_design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import camera_of
from phytac_design.simulation.run.job import Job
from phytac_design.training.evaluation.contact_scores import Bootstrap
from phytac_design.training.levenberg_marquardt import split_samples
from phytac_shapes.arrays import FloatArray, IntArray

COUNTS, JUDGE = (598, 3909), 150
"""Samples to learn from, the fewer among the more, and held out from both."""
PAPER = {598: 48.0, 3909: 93.0}
"""Accuracy, %."""
CONDITIONS = (
    "given which switches are truly on; the force of a contact is the sum over its switches; "
    "contacts that turned on none are left out"
)


@dataclass(frozen=True, kw_only=True)
class ContactForces:
    """Contacts of the held-out samples: sample, true and decoded force of each, (c,)."""

    sample: IntArray
    force_N: FloatArray
    decoded_N: FloatArray


def job(*, quick: bool) -> tuple[str, Job, tuple[int, ...]]:
    """Name of the data set, its job, and the numbers of samples to train on."""
    given: dict[str, Any] = {"unit": 1, "route": "frames", "accuracy": "draft"}
    if quick:
        design, given["samples"], given["solve"] = small_design(), 24, LINEAR
    else:
        design, given["samples"] = load_design("cylinder60"), COUNTS[-1] + JUDGE
    made = replace(job_of(before_camera(design, SMALL), **given), keep="frames")
    return ("quick-cnn", made, (18,)) if quick else ("cnn", made, COUNTS)


def learn(
    name: str, made: Job, samples: Samples, order: IntArray, how: TrainingSettings
) -> tuple[TrainedCnn, IntArray]:
    """Train on samples in a given order, shared out 8.5 : 0.5 : 1; and those it learnt from."""
    assert samples.bits is not None
    images = read_frames(data_folder() / name, order)
    training, validation, _ = split_samples(len(order), seed=SEED)
    trained = train_cnn(
        images,
        samples.bits[order],
        marker_forces(samples)[order],
        places=_places(made),
        training=training,
        validation=validation,
        seed=SEED,
        settings=how,
    )
    return trained, np.sort(order[training])


def _places(made: Job) -> FloatArray:
    """Where the tips of the markers are in the image without load."""
    camera = camera_of(made.design, made.surface)
    markers = make_markers(made.design, made.surface)
    size = (made.design.camera.width_px, made.design.camera.height_px)
    return places_in_frame(camera.project(markers.tip_mm), size)


def judge(name: str, trained: TrainedCnn, samples: Samples, held: IntArray) -> ContactForces:
    """Contacts of held-out samples as the network reads them."""
    truth, touches = samples.truth, samples.touches
    assert truth is not None
    assert touches is not None
    assert samples.bits is not None
    forces = np.zeros((samples.count, samples.markers))
    forces[held] = trained.forces(read_frames(data_folder() / name, held), samples.bits[held])
    mine = np.isin(truth.sample, held) & (truth.touch >= 0)
    contact, owner = np.unique(truth.touch[mine], return_inverse=True)
    read = forces[truth.sample[mine], truth.marker[mine]]
    return ContactForces(
        sample=touches.sample[contact],
        force_N=np.bincount(owner, weights=truth.force_N[mine]).astype(np.float64),
        decoded_N=np.bincount(owner, weights=read).astype(np.float64),
    )


def add_rows(table: Table, *, quick: bool) -> None:
    """Accuracy of the baseline, beside the paper's and beside guessing the mean."""
    name, made, counts = job(quick=quick)
    samples, meta = data_set(name, made)
    usable = np.flatnonzero(samples.status != FAILED)
    # The rig goes column by column: drawn at random, no side is left out.
    order = np.random.default_rng(SEED).permutation(usable)
    how = TrainingSettings(epochs=2) if quick else TrainingSettings()
    about = f"{origin(name, meta)}; {CONDITIONS}"
    for count in counts:
        trained, taught = learn(name, made, samples, order[:count], how)
        known = judge(name, trained, samples, taught)
        found = judge(name, trained, samples, np.sort(order[counts[-1] :]))
        _add(table, count, trained, known, found, about)
    row = "cnn: parameters"
    source = "paper; its layers are not published"
    table.add(row, trained.parameters / 1e3, "thousand", 758.4, source)


def _add(
    table: Table,
    count: int,
    trained: TrainedCnn,
    known: ContactForces,
    found: ContactForces,
    about: str,
) -> None:
    """Rows of one network: on training contacts (``known``) and on further ones (``found``)."""
    guess = np.full(len(found.force_N), known.force_N.mean())
    # Of all constants the one with the least relative error, of the contacts learnt from.
    weights = 1.0 / known.force_N
    rank = np.argsort(known.force_N)
    half = np.searchsorted(np.cumsum(weights[rank]), 0.5 * weights.sum())
    best = np.full(len(found.force_N), known.force_N[rank[half]])
    everyone = np.ones(len(guess), dtype=np.bool_)
    bootstrap = Bootstrap(sample=found.sample, seed=SEED)
    score = {
        key: bootstrap.score(value, found.force_N, everyone)
        for key, value in (("cnn", found.decoded_N), ("guess", guess), ("best", best))
    }
    cnn = score["cnn"]
    label = f"cnn on {count} samples, {cnn['contacts']} further contacts"

    def percent(case: str, key: str, measure: str, reference: float | str, source: str) -> None:
        row = score[key][measure]
        note = f"95 % interval {100.0 * row['low']:.1f} to {100.0 * row['high']:.1f}; {about}"
        table.add(case, 100.0 * row["value"], "%", reference, source, note=note)

    paper, off = PAPER.get(count, "-"), 100.0 - PAPER[count] if count in PAPER else "-"
    source = "paper, real sensor, as many samples"
    percent(f"{label}: accuracy", "cnn", "accuracy", paper, source)
    percent(f"{label}: relative error", "cnn", "relative_error", off, "paper: 1 − accuracy")
    percent(f"{label}: median relative error", "cnn", "relative_error_median", "-", "not given")
    source = "guessing the mean force of the contacts that were learnt from"
    for measure, case in (
        ("absolute_error_mean_N", "MAE"),
        ("absolute_error_sd_N", "SD of the absolute error"),
    ):
        row, guessed = cnn[measure], score["guess"][measure]["value"]
        note = f"95 % interval {row['low']:.2f} to {row['high']:.2f}; {about}"
        target = f"<= {guessed:.6g}" if case == "MAE" else None
        table.add(f"{label}: {case}", row["value"], "N", guessed, source, target, note)
    source = "the constant with the least relative error on the contacts that were learnt from"
    percent(f"{label}: accuracy of the best single guess", "best", "accuracy", "-", source)
    everyone = np.ones(len(known.force_N), dtype=np.bool_)
    own = Bootstrap(sample=known.sample, seed=SEED)
    table.add(
        f"cnn on {count} samples: accuracy on what it learnt from",
        100.0 * own.score(known.decoded_N, known.force_N, everyone)["accuracy"]["value"],
        "%",
        100.0 * cnn["accuracy"]["value"],
        "on further contacts; the difference is overfitting",
    )
    note = f"best of its rounds: {trained.rounds}; one thread"
    source = "paper, of image-based networks"
    row = f"cnn on {count} samples: training"
    table.add(row, trained.seconds, "s", "several hours", source, note=note)
