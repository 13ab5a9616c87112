"""Identities of markers over 10 000 frames of grips at 480 fps: none may take another's.

The hand of :mod:`decoder_speed` closes, slides and lets go in 34 grips, each with other fingers,
place, force and slide, with the camera's noise. Each grip is rendered and tracked in its own
process.
"""

import multiprocessing
import os
from collections import Counter
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


def hand(number: int) -> Hand:
    """Hand of one grip: two to five fingers at a random place, force and slide."""
    rng = np.random.default_rng(number)
    return Hand(
        fingers=2 + number % 4,
        turned_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
        raised_mm=float(rng.uniform(-8.0, 12.0)),
        slide_mm=float(rng.uniform(-10.0, 10.0)),
        force_N=float(rng.uniform(0.4, 1.0)) * FORCE_N,
    )


def tracked(number: int, frames: int = WHOLE) -> tuple[Counter[str], int, float]:
    """Track one grip from rest: counts over all frames, separable markers, largest shift in px."""
    sensor = CameraSensor.of(before_camera(load_design(DESIGN), SMALL))
    imaging, bundle, rng = sensor.imaging, sensor.bundle, np.random.default_rng([7, number])
    unmoved, off = np.zeros((imaging.count, 6)), np.zeros(imaging.count, dtype=np.bool_)
    rest = [imaging.frame(unmoved, off, 1.0, rng)[0] for _ in range(2)]
    sure = separable(sensor, rest)
    follower = Follower(bundle, rest[0])
    readable = bundle.tips.readable & sure
    counts: Counter[str] = Counter(frames=frames)
    largest = 0.0
    for motion, bits in hand(number).frames(sensor, frames):
        seen = follower.follow(imaging.frame(motion, bits, 1.0, rng)[0])
        shift = imaging.exact(motion, bits)
        read_on = np.isin(np.arange(imaging.count), seen.koi)[readable]
        true = bits[readable]
        counts.update(
            looked=int(sure.sum()),
            swapped=named_wrongly(bundle, sure, follower.rest_px, shift, seen.position_px),
            lost=int(np.isnan(seen.position_px[sure, 0]).sum()),
            on=int(true.sum()),
            missed=int((true & ~read_on).sum()),
            false=int((read_on & ~true).sum()),
        )
        largest = max(largest, float(np.linalg.norm(shift, axis=1).max()))
    return counts, int(sure.sum()), largest


def add_rows(table: Table, *, quick: bool) -> None:
    """All grips, on all cores."""
    work = partial(tracked, frames=20 if quick else WHOLE)
    grips = range(2 if quick else 34)
    context = multiprocessing.get_context("spawn")
    with context.Pool(min(os.cpu_count() or 1, len(grips))) as pool:
        each, markers, largest = zip(*pool.map(work, grips, chunksize=1), strict=True)
    total = sum(each, Counter[str]())
    head = (
        f"{DESIGN} {SMALL}, {len(each)} grips of two to five fingers, {total['frames']} frames at "
        "480 fps"
    )
    row = f"{head}: markers nearer to another's true place than to their own"
    note = (
        f"of {total['looked']} observations: the {min(markers)} to {max(markers)} of 368 that are "
        "separable at rest, tracked from rest through each grip; motions up to "
        f"{max(largest):.1f} px; {total['lost']} not found"
    )
    table.add(row, total["swapped"], "markers", 0, "rendered truth", "== 0", note)
    row = f"{head}: switches read wrongly, over those that are on"
    source = "readable switches, rendered truth"
    note = f"{total['missed']} missed and {total['false']} false, of {total['on']} on"
    value = (total["missed"] + total["false"]) / max(total["on"], 1)
    table.add(row, value, "relative", 0.0, source, note=note)
