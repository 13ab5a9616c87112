"""How the twin sees: points against frames, noise, what a camera's faults do, the renderer."""

from functools import partial

import numpy as np

from benchmarks.harness import Table
from benchmarks.twin_camera import (
    FORCE_N,
    SAMPLES,
    CameraCase,
    camera_chain,
    faults,
    quarter,
    readable,
    renderers,
    rms,
    samples_of_a_pixel,
    timed,
)
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.stages.build import copy_of
from phytac_shapes.arrays import FloatArray

DRAWS = 16
"""Draws of noise that are averaged, to leave that which hangs on the place on the pixels."""


def points_and_frames(table: Table, case: CameraCase, count: int) -> None:  # noqa: PLR0915 - rows
    """Displacements of both kinds of points against noise-free frames; noise; seconds."""
    name, eyes = case.design.name, case.eyes(samples=SAMPLES)
    _, ready = timed(lambda: eyes.status)
    if eyes.status:
        table.add(f"{name}: can be read", 0.0, "-", reference=1.0, source="rest frame",
                  target=">= 1", note=eyes.status)  # fmt: skip
        return
    both = {
        "paint": eyes,
        "pixels": case.eyes(centroids="pixels", at_rest=eyes.rest, samples=SAMPLES),
    }
    still, off = np.zeros((case.markers.count, 6)), np.zeros(case.markers.count, dtype=np.bool_)
    zero = eyes.read(eyes.frame(still, off)).shift_px
    fixed = case.eyes(wall_follows=False, at_rest=eyes.rest, samples=SAMPLES)
    motions, every = case.pressed(count)
    found: dict[str, list[FloatArray]] = {"paint": [], "pixels": []}
    seconds: dict[str, list[float]] = {"paint": [], "pixels": [], "frame": [], "read": []}
    frames, wall, put_in, wrong, lost = [], [], [], 0, 0
    for own in both.values():
        own.points(motions[0], every[0])  # compiled and measured once
    for motion, bits in zip(motions, every, strict=True):
        images, spent = timed(partial(eyes.frame, motion, bits))
        seen, read = timed(partial(eyes.read, images))
        seconds["frame"].append(spent)
        seconds["read"].append(read)
        frames.append(seen.shift_px - zero)
        wall.append(fixed.read(fixed.frame(motion, bits)).shift_px - zero - frames[-1])
        wrong += int((seen.bits != bits).sum())
        lost += int((~seen.found).sum())
        exact = eyes.points(motion, bits).shift_px
        noisy = [
            eyes.points(motion, bits, rng=np.random.default_rng(k)).shift_px for k in range(DRAWS)
        ]
        put_in.append(np.mean(noisy, axis=0) - exact)  # the noise of a frame is nearly gone
        for kind, own in both.items():
            points, spent = timed(partial(own.points, motion, bits))
            found[kind].append(points.shift_px)
            seconds[kind].append(spent)
    shift = np.linalg.norm(np.array(frames), axis=2)
    moving = shift > 0.1 * np.nanmax(shift, axis=1, keepdims=True)
    loads = (
        f"{count} samples of one to three contacts of {FORCE_N:g} N, linear shell; greatest shift "
        f"{np.nanmax(shift):.1f} px; frames with lens blur, fall-off, vignetting, without noise; "
        f"{wrong} bits read wrong, {lost} markers not found"
    )
    for kind in both:
        error = np.array(found[kind]) - np.array(frames)
        for which, pick in (("all markers", np.ones_like(moving)), ("that move", moving)):
            whole, noise = rms(error[pick]), rms(np.array(put_in)[pick])
            row = f"{name}: points ({kind}) against frames, {which}: beyond the noise put in"
            source = "frames through the decoder's eyes"
            note = (
                f"{whole:.3f} px RMS in all, {noise:.3f} of it the marker's place on the "
                f"pixels, which points have as noise; {loads}"
            )
            value = float(np.sqrt(max(whole**2 - noise**2, 0.0)))
            table.add(row, value, "px RMS", 0.0, source, "<= 0.05", note)
    row = f"{name}: shift that changes if the wall in frames stands still"
    source = "frames whose wall follows its receptors"
    note = f"greatest {np.nanmax(np.abs(np.array(wall))):.2g} px"
    table.add(row, rms(np.array(wall)), "px RMS", 0.0, source, note=note)
    rest = eyes.at_rest
    given = case.design.camera.noise_centroid_px
    for what, values in (("noise of a frame", rest.noise_px), ("place on pixels", rest.grid_px)):
        row = f"{name}: centroid error, {what}, median of all markers"
        source = "the design's camera.noise_centroid_px"
        note = f"{np.nanmin(values):.2g} to {np.nanmax(values):.2g} px, RMS {rms(values):.2g} px"
        table.add(row, float(np.nanmedian(values)), "px", given, source, note=note)
    row = f"{name}: a sample by points (paint)"
    source = "a sample by frames: rendered, exposed, read"
    note = (
        f"points (pixels) {np.median(seconds['pixels']):.2f} s; a frame "
        f"{np.median(seconds['frame']):.2f} s, reading it {np.median(seconds['read']):.2f} s; "
        f"measuring the unit at rest {ready:.1f} s, once"
    )
    value = float(np.median(seconds["paint"]))
    reference = float(np.median(seconds["frame"])) + float(np.median(seconds["read"]))
    table.add(row, value, "s of one core", reference, source, note=note)


def add_rows(table: Table, *, quick: bool) -> None:
    """Rows of how the twin sees."""
    if quick:
        case = CameraCase.of(quarter(load_design("hemisphere")))
        points_and_frames(table, case, 1)
        faults(table, case)
        camera_chain(table, case, quick=True)
        samples_of_a_pixel(table, case, quick=True)
        renderers(table, case)
        readable(table, case)
        return
    for name in sorted(shipped_designs()):
        case = CameraCase.of(load_design(name))
        readable(table, case)
        if name in {"cylinder60", "plane", "hemisphere"}:
            points_and_frames(table, case, 3)
        if name == "cylinder60":
            faults(table, case)
            camera_chain(table, case, quick=False)
            samples_of_a_pixel(table, case, quick=False)
            renderers(table, case)
    two = copy_of(load_design("cylinder60"), camera={"ends": "both"})
    two = two.model_copy(update={"name": "cylinder60 with a camera at both ends"})
    points_and_frames(table, CameraCase.of(two), 2)
