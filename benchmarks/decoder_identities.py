"""Markers' names over 10 000 frames of grips at 480 fps: none may take another's.

The hand of :mod:`decoder_speed` closes, slides and lets go again and again: each time with other
fingers, elsewhere, with another force and way, at the camera's noise. Frames are rendered and
followed one by one, each grip in a process of its own.
"""

import multiprocessing
import os
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.decoder_speed import (
    FORCE_N,
    SMALL,
    WHOLE,
    CameraSensor,
    Hand,
    before_camera,
    named_wrongly,
    separable,
)
from benchmarks.harness import Table
from phytac_decoder.pipeline.tracker import Follower
from phytac_design.design.design_file import load_design

DESIGN = "cylinder60"
GRIPS = 34
"""Of 300 frames each: over 10 000."""


@dataclass(frozen=True, kw_only=True)
class FollowedGrip:
    """What became of the names in one grip.

    Attributes
    ----------
    frames, markers : int
        Looked at; markers are those that are separable at rest.
    swapped, lost : int
        Markers nearer to another's true place than to their own, and not found; over all frames.
    on, missed, false : int
        Readable switches that are truly on, of these not seen, and seen though off; likewise.
    largest_px : float
        Farthest that a marker moved.
    """

    frames: int
    markers: int
    swapped: int
    lost: int
    on: int
    missed: int
    false: int
    largest_px: float


def hand(number: int) -> Hand:
    """The hand of one grip: two to five fingers, somewhere, of some force and way."""
    rng = np.random.default_rng(number)
    return Hand(
        fingers=2 + number % 4,
        turned_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        raised_mm=float(rng.uniform(-8.0, 12.0)),
        slide_mm=float(rng.uniform(-10.0, 10.0)),
        force_N=float(rng.uniform(0.4, 1.0)) * FORCE_N,
    )


def followed(number: int, frames: int = WHOLE) -> FollowedGrip:
    """Render one grip and follow its markers from rest."""
    sensor = CameraSensor.of(before_camera(load_design(DESIGN), SMALL))
    eyes, bundle, rng = sensor.eyes, sensor.bundle, np.random.default_rng([7, number])
    still, off = np.zeros((eyes.count, 6)), np.zeros(eyes.count, dtype=np.bool_)
    rest = [eyes.frame(still, off, 1.0, rng)[0] for _ in range(2)]
    sure = separable(sensor, rest)
    follower = Follower(bundle, rest[0])
    readable = bundle.tips.readable & sure
    swapped = lost = on = missed = false = 0
    largest = 0.0
    for motion, bits in hand(number).frames(sensor, frames):
        seen = follower.follow(eyes.frame(motion, bits, 1.0, rng)[0])
        shift = eyes.exact(motion, bits)
        swapped += named_wrongly(bundle, sure, follower.rest_px, shift, seen.position_px)
        lost += int(np.isnan(seen.position_px[sure, 0]).sum())
        read_on = np.isin(np.arange(eyes.count), seen.koi)[readable]
        true = bits[readable]
        on, missed, false = (
            total + int(more.sum())
            for total, more in ((on, true), (missed, true & ~read_on), (false, read_on & ~true))
        )
        largest = max(largest, float(np.linalg.norm(shift, axis=1).max()))
    return FollowedGrip(
        frames=frames,
        markers=int(sure.sum()),
        swapped=swapped,
        lost=lost,
        on=on,
        missed=missed,
        false=false,
        largest_px=largest,
    )


def add_rows(table: Table, *, quick: bool) -> None:
    """All grips, on all cores."""
    work = partial(followed, frames=20 if quick else WHOLE)
    grips = range(2 if quick else GRIPS)
    context = multiprocessing.get_context("spawn")
    with context.Pool(min(os.cpu_count() or 1, len(grips))) as pool:
        runs = pool.map(work, grips, chunksize=1)
    frames = sum(run.frames for run in runs)
    looked = sum(run.frames * run.markers for run in runs)
    head = f"{DESIGN} {SMALL}, {len(runs)} grips of two to five fingers, {frames} frames at 480 fps"
    on = sum(run.on for run in runs)
    row = f"{head}: markers nearer to another's true place than to their own"
    source = "rendered truth"
    note = (
        f"of {looked} looked at: the {min(run.markers for run in runs)} to "
        f"{max(run.markers for run in runs)} of 368 that are separable at rest, followed "
        "from rest through each grip; motions up to "
        f"{max(run.largest_px for run in runs):.1f} px; {sum(run.lost for run in runs)} not found"
    )
    table.add(row, sum(run.swapped for run in runs), "markers", 0, source, "== 0", note)
    row = f"{head}: switches read wrongly, over those that are on"
    source = "readable switches, rendered truth"
    note = (
        f"{sum(run.missed for run in runs)} missed and {sum(run.false for run in runs)} "
        f"false, of {on} on"
    )
    value = sum(run.missed + run.false for run in runs) / max(on, 1)
    table.add(row, value, "relative", 0.0, source, note=note)
