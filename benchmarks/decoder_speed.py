"""Marker detection at camera speed: frame to force map on one core, and accuracy of tracking.

Frames are rendered (lens blur, fall-off, vignetting, the design's noise) of a hand of five fingers
that closes, slides and lets go, at 480 fps motion.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmarks.harness import Table
from benchmarks.twin_camera import CameraCase
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.vision.matching import nearest_same_colour_px
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import CAMERA_PRESETS, Design
from phytac_design.layout.cameras import Readers, cameras_of
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.compliance import marker_compliance
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.simulation.condense import condense
from phytac_design.simulation.imaging.imaging_model import ImagingModel
from phytac_design.simulation.linear_response import rigid_slope
from phytac_design.stages.build import copy_of
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray

DESIGNS = ("cylinder60", "cylinder60-dense")
SMALL, LARGE = "640x480", "2592x1944"
PRESETS = {SMALL: "paper_480fps", LARGE: "paper_30fps"}
TARGETS_ms = {SMALL: 1.0, LARGE: 10.0}
WHOLE = 300
"""Frames of the whole grip, 0.6 s at 480 fps."""
FINGERS, FORCE_N, SLIDE_mm, WIDTH_mm = 5, 25.0, 8.0, 4.0
"""Fingers; each one's force, way and half width."""
CLOSED = (0.3, 0.7)
"""From when until when the hand is closed; between them it slides."""
SKIP = 8
"""Frames dropped between those on the way to the first."""
FIRST, FEW = 64, 16
"""Of the larger camera so many frames are rendered, from this on: the hand is closing."""
STRESS = 4.0
"""Motions are also taken so many times as large as linear theory has them at this force."""
SEPARABLE = 0.06
"""Share of the way to the next marker of the same colour."""


@dataclass(frozen=True, kw_only=True)
class CameraSensor:
    """A design before a camera: its imaging model, decoder, and motion under unit forces."""

    case: CameraCase
    imaging: ImagingModel
    bundle: Bundle
    unit_motion: FloatArray

    @classmethod
    def of(cls, design: Design) -> "CameraSensor":
        """The sensor that is the design itself; the decoder's matrices at draft accuracy."""
        case = CameraCase.of(design)
        imaging, markers = case.imaging_model(), case.markers
        mesh = marker_mesh(case.surface, markers, thickness_mm=design.wall.thickness_mm, refine=3)
        model = sensor_model(design, markers, mesh, receptors=True)
        cell = float(np.sqrt(case.surface.area_mm2() / markers.count / np.pi))
        found = marker_compliance(model, mesh, case.surface, markers, load_radius_mm=cell)
        readers = Readers(cameras=cameras_of(design, case.surface), read_by=imaging.nominal.read_by)
        arm = markers.tip_mm - markers.mid_mm
        slope = rigid_slope(readers.jacobian(markers.tip_mm), arm)
        seen = condense(slope, normal=markers.normal, motion=found.motion)
        forces = ForceModel(
            shift_to_mm=seen.shift_to_mm,
            stiffness=seen.stiffness,
            compliance_px=seen.compliance_px,
            height_z_mm=markers.mid_mm[:, 2],
            neighbours=markers.neighbours,
            networks={},
        )
        return cls(
            case=case,
            imaging=imaging,
            bundle=replace(imaging.nominal, model=forces),
            unit_motion=found.motion,
        )


@dataclass(frozen=True, kw_only=True)
class Hand:
    """A hand that closes, slides and lets go.

    Attributes
    ----------
    fingers : int
        Spread evenly around.
    turned_rad, raised_mm : float
        From where the first one usually is, around and up.
    slide_mm, force_N : float
        Way along the axis, and force of each.
    """

    fingers: int = FINGERS
    turned_rad: float = 0.0
    raised_mm: float = 0.0
    slide_mm: float = SLIDE_mm
    force_N: float = FORCE_N

    def frames(self, sensor: CameraSensor, count: int) -> Iterator[tuple[FloatArray, BoolArray]]:
        """Motion (n, 6) and bits (n,) in each of so many frames."""
        place = sensor.bundle.position_mm
        low, high = place[:, 2].min(), place[:, 2].max()
        turn = 2.0 * np.pi * np.arange(self.fingers) / self.fingers
        across = float(np.hypot(place[:, 0], place[:, 1]).mean())
        at = turn + self.turned_rad
        height = low + (high - low) * turn / 7.0 + 12.0 + self.raised_mm
        start = np.column_stack([across * np.cos(at), across * np.sin(at), height])
        for t in np.arange(1, count + 1) / count:
            held = float(np.clip(min(t / CLOSED[0], (1.0 - t) / (1.0 - CLOSED[1])), 0.0, 1.0))
            way = self.slide_mm * np.clip((t - CLOSED[0]) / (CLOSED[1] - CLOSED[0]), 0.0, 1.0)
            tips = start + np.array([0.0, 0.0, way])
            gap = np.linalg.norm(place[:, None] - tips[None], axis=2)
            weight = np.exp(-0.5 * (gap / WIDTH_mm) ** 2)
            share = weight / weight.sum(axis=0)
            force = self.force_N * 0.5 * (1.0 - np.cos(np.pi * held)) * share.sum(axis=1)
            yield sensor.unit_motion @ force, force > sensor.bundle.threshold_N


@dataclass(frozen=True, kw_only=True)
class Film:
    """Frames of a sensor at rest (two), on the way to the grip, and gripped; and the truth.

    Attributes
    ----------
    rest, before, frames : list of (h, w, 3) uint8
        ``before`` are every ``SKIP``-th frame up to the first of ``frames``.
    shift_px : (frames, n, 2) float
        True shift of each marker's paint.
    bits : (frames, n) bool
        Switches that are on.
    """

    rest: list[ImageArray]
    before: list[ImageArray]
    frames: list[ImageArray]
    shift_px: FloatArray
    bits: BoolArray

    def started(self, bundle: Bundle, stride: int) -> Follower:
        """A follower that has come to the first frame."""
        follower = Follower(bundle, self.rest[0], stride=stride)
        for frame in self.before:
            follower.follow(frame, elapsed=SKIP)
        return follower


def film_of(
    sensor: CameraSensor, chosen: range, times: float = 1.0, hand: Hand | None = None
) -> Film:
    """Render frames ``chosen`` of a hand's grip, its motions so many ``times`` as large."""
    imaging, rng = sensor.imaging, np.random.default_rng(5)
    still, off = np.zeros((imaging.count, 6)), np.zeros(imaging.count, dtype=np.bool_)
    rest = [imaging.frame(still, off, 1.0, rng)[0] for _ in range(2)]
    before, frames, shifts, states = [], [], [], []
    for k, (motion, bits) in enumerate((hand or Hand()).frames(sensor, WHOLE)):
        if k in chosen:
            frames.append(imaging.frame(times * motion, bits, 1.0, rng)[0])
            shifts.append(imaging.exact(times * motion, bits))
            states.append(bits)
        elif k < chosen.start and (chosen.start - k) % SKIP == 0:
            before.append(imaging.frame(times * motion, bits, 1.0, rng)[0])
    return Film(
        rest=rest, before=before, frames=frames, shift_px=np.stack(shifts), bits=np.stack(states)
    )


def spent_ms(work: Callable[[], Any]) -> float:
    """Processor milliseconds of one call."""
    start = time.process_time()
    work()
    return 1e3 * (time.process_time() - start)


def plain_opencv(bundle: Bundle, frame: ImageArray) -> None:
    """What a user would write with OpenCV: three masks, labelling, optimal assignment."""
    ycc = cv2.cvtColor(frame, cv2.COLOR_BGR2YCrCb)
    for colour, chroma in enumerate(bundle.colours.chroma):
        low = np.clip(chroma + 128.0 - 45.0, 0, 255)
        high = np.clip(chroma + 128.0 + 45.0, 0, 255)
        mask = cv2.inRange(ycc, np.array([0, *low]), np.array([255, *high]))
        _, _, _, centroids = cv2.connectedComponentsWithStats(mask)
        rest = bundle.rest_px[bundle.colour == colour]
        if len(rest):
            gap = np.linalg.norm(centroids[1:, None] - rest[None], axis=2)
            linear_sum_assignment(gap)


def rms(values: FloatArray) -> float:
    """Root mean square of what is known."""
    return float(np.sqrt(np.nanmean(values**2)))


def add_accuracy(table: Table, label: str, sensor: CameraSensor, film: Film) -> BoolArray:
    """Centroids against the full search; returns the separable markers (n,)."""
    bundle = sensor.bundle
    full_rest = measure_frame(bundle, film.rest[1], rest_px=bundle.rest_px)
    apart = nearest_same_colour_px(bundle.rest_px, bundle.colour)
    sure = separable(sensor, film.rest)
    row = f"{label}: separable markers at rest"
    note = (
        f"found by both ways, and by the full search within {SEPARABLE} of the way to the "
        "next of the same colour from where the renderer has them; the rows below are of these"
    )
    table.add(row, float(sure.mean()), "share", 1.0, "all of them", note=note)
    for stride in (1, 2):
        follower = Follower(bundle, film.rest[0], stride=stride)
        gap = follower.follow(film.rest[1]).position_px - bundle.rest_px - full_rest.shift_px
        follower = film.started(bundle, stride)
        pressed = []
        every = max(len(film.frames) // 12, 1)
        for k, frame in enumerate(film.frames):
            seen = follower.follow(frame)
            if k % every:
                continue
            full = measure_frame(bundle, frame, rest_px=bundle.rest_px)
            on = np.isin(np.arange(len(sure)), full.koi)
            own = full.shift_px + bundle.tip_shift_px(on)
            # Where the full search gives paint the wrong name there is nothing to compare with.
            named = np.linalg.norm(own - film.shift_px[k], axis=1) < SEPARABLE * apart
            pressed.append((seen.position_px - bundle.rest_px - own)[sure & named])
        for name, error in (("at rest", gap[sure]), ("gripped", np.concatenate(pressed))):
            row = f"{label}: centroids against the full search, {name}, stride {stride}"
            source = "measure_frame on the same noisy frames"
            note = (
                f"largest {float(np.nanmax(np.abs(error))):.3f} px; the full search drops "
                "pieces of a marker smaller than 3 px, following does not"
            )
            table.add(
                row, rms(error), "px RMS", 0.0, source, "<= 0.02" if stride == 1 else None, note
            )
    return sure


def separable(sensor: CameraSensor, rest: list[ImageArray]) -> BoolArray:
    """Markers (n,) that are separable in the second of two frames at rest."""
    bundle = sensor.bundle
    full = measure_frame(bundle, rest[1], rest_px=bundle.rest_px)
    apart = nearest_same_colour_px(bundle.rest_px, bundle.colour)
    followed = Follower(bundle, rest[0]).follow(rest[1])
    near = np.linalg.norm(full.shift_px, axis=1) < SEPARABLE * apart
    return np.asarray(full.found & near & followed.found)


def at_wrong_place(bundle: Bundle, true_px: FloatArray, found_px: FloatArray) -> BoolArray:
    """Markers (n,) found (n, 2) nearer to the true place of another of their colour than to theirs.

    NaN is a marker that was not found.
    """
    gap = np.linalg.norm(found_px[:, None] - true_px[None], axis=2)
    gap[bundle.colour[:, None] != bundle.colour[None]] = np.inf
    return np.asarray(gap.min(axis=1) < np.diagonal(gap))


def add_names(table: Table, label: str, sensor: CameraSensor, film: Film, sure: BoolArray) -> None:
    """Whether markers keep their names, and switches theirs."""
    bundle = sensor.bundle
    follower = film.started(bundle, 1)
    seen = [follower.follow(frame) for frame in film.frames]
    # From the place at rest: what the lens does to the paint's centroid is in both.
    moved = np.stack([one.position_px for one in seen]) - follower.rest_px
    error = np.linalg.norm(moved - film.shift_px, axis=2)[:, sure]
    swaps = sum(
        int(at_wrong_place(bundle, follower.rest_px + shift, one.position_px)[sure].sum())
        for one, shift in zip(seen, film.shift_px, strict=True)
    )
    largest = float(np.linalg.norm(film.shift_px, axis=2).max())
    row = f"{label}: markers nearer to another's true place than to their own"
    source = "rendered truth"
    note = (
        f"{len(seen)} frames of a grip, motions up to {largest:.1f} px; error against the "
        f"paint's true shift {rms(error):.3f} px RMS, largest {float(np.nanmax(error)):.2f} px "
        f"(with what hides paint); lost {100.0 * float(np.isnan(error).mean()):.2g} %"
    )
    table.add(row, swaps, "markers", 0, source, "== 0", note)
    every = max(len(seen) // 12, 1)
    full = [measure_frame(bundle, frame).koi for frame in film.frames[::every]]
    readable = bundle.tips.readable & sure
    alone = np.stack([np.isin(np.arange(len(sure)), koi) for koi in full])[:, readable]
    bits = np.stack([np.isin(np.arange(len(sure)), one.koi) for one in seen])[:, readable]
    true = film.bits[:, readable]
    row = f"{label}: switches read wrongly, over those that are on"
    source = "readable switches, rendered truth"
    note = (
        f"{int((~bits & true).sum())} missed and {int((bits & ~true).sum())} false, of "
        f"{int(true.sum())} on in {len(seen)} frames; the full search, of {len(alone)} of these: "
        f"{int((~alone & true[::every]).sum())} missed and "
        f"{int((alone & ~true[::every]).sum())} false"
    )
    value = float((bits != true).sum() / max(true.sum(), 1))
    table.add(row, value, "relative", 0.0, source, note=note)


def add_speed(
    table: Table, label: str, target_ms: float, sensor: CameraSensor, film: Film, repeats: int
) -> None:
    """Milliseconds of one core, beside the plain route on the same frames."""
    bundle, count = sensor.bundle, len(film.frames)
    # To and fro: a film without a cut.
    order = [*range(count), *range(count - 2, 0, -1)]
    words = [frame.reshape(-1).view(np.uint64) for frame in film.frames]
    read = float(np.median([spent_ms(word.max) for word in words * 3]))
    plain = float(np.median([spent_ms(partial(plain_opencv, bundle, f)) for f in film.frames[:12]]))
    for stride in (1, 2):
        follower = film.started(bundle, stride)
        spent: dict[str, list[float]] = {"detection": [], "fem": [], "koi_inverse": []}
        for j in range(repeats + len(order)):
            frame = film.frames[order[j % len(order)]]
            start = time.process_time()
            seen = follower.follow(frame)
            if j < len(order):
                continue
            spent["detection"].append(1e3 * (time.process_time() - start))
            for name in ("fem", "koi_inverse"):
                spent[name].append(spent_ms(partial(seen.forces_N, bundle, name)))
        detection = np.array(spent["detection"])
        for name, part in (
            ("marker detection", detection),
            ("frame to force map by fem", detection + spent["fem"]),
            ("frame to force map by koi_inverse", detection + spent["koi_inverse"]),
        ):
            row = f"{label}: {name}, stride {stride}, p99"
            source = "reading the frame once from memory, ms of one core, same run"
            note = (
                f"median {np.median(part):.3f} ms of {repeats} frames; "
                f"{follower.pixels} of {frame.shape[0] * frame.shape[1]} pixels looked at; of the "
                f"median the force solve takes {np.median(part - detection):.3f} ms"
            )
            value = float(np.percentile(part, 99))
            table.add(row, value, "ms of one core", read, source, f"<= {target_ms:g}", note)
        row = (
            f"{label}: marker detection, stride {stride}, times faster than masks, labelling, "
            "assignment"
        )
        source = "plain OpenCV route, ms of one core, same run; without switches"
        table.add(row, plain / float(np.median(detection)), "ratio", plain, source)


def before_camera(design: Design, size: str) -> Design:
    """A design before the paper's camera of a size, its view unchanged."""
    camera = CAMERA_PRESETS[PRESETS[size]]
    pixel_um = design.camera.pixel_um * design.camera.width_px / camera["width_px"]
    return copy_of(design, camera=camera | {"pixel_um": pixel_um})


def add_rows(table: Table, *, quick: bool, size: str = SMALL) -> None:
    """All designs before a camera; ``quick``: one, and few frames of it."""
    cv2.setNumThreads(1)
    whole = size == SMALL and not quick
    for name in DESIGNS[:1] if quick else DESIGNS:
        sensor = CameraSensor.of(before_camera(load_design(name), size))
        film = film_of(sensor, range(WHOLE) if whole else range(FIRST, FIRST + FEW))
        label = f"{name} {size}, {sensor.imaging.count} markers"
        sure = add_accuracy(table, label, sensor, film)
        add_names(table, label, sensor, film, sure)
        add_speed(table, label, TARGETS_ms[size], sensor, film, 40 if quick else 400)
        if whole:
            film = film_of(sensor, range(WHOLE), STRESS)
            add_names(table, f"{label}, motions times {STRESS:g}", sensor, film, sure)
