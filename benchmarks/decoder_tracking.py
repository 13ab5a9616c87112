"""Marker identities in films of grips that go wrong: drops, occlusion, jumps, poor pictures.

Hands grip cylinder60 with motions four times as large as those of :mod:`decoder_speed`, and four to
six times as fast. Each rendered film then loses frames, is partly covered, or is distorted so far
in one frame that markers lie where their neighbours were. Part ``tracking`` of ``decoder``.
"""

import multiprocessing
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np

from benchmarks.decoder_speed import (
    SMALL,
    STRESS,
    WHOLE,
    CameraSensor,
    Hand,
    at_wrong_place,
    before_camera,
    film_of,
)
from benchmarks.harness import Table
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.tracker import Follower
from phytac_design.design.design_file import load_design
from phytac_design.stages.build import copy_of
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError

DESIGN, MIDDLE = "cylinder60", "1280x960"
TOLERATED = 10
"""Frames for which an id may be wrong."""


@dataclass(frozen=True, kw_only=True)
class TrackingFilm:
    """A rest frame, frames, and where the markers truly are in them.

    Attributes
    ----------
    rest : (h, w, 3) uint8
        Unloaded sensor.
    frames : list of (h, w, 3) uint8
        What the tracker is given.
    true_px : (frames, n, 2) float
        Centroid of each marker's paint.
    number : list of int
        Of each frame at the camera, from 1.
    """

    rest: ImageArray
    frames: list[ImageArray]
    true_px: FloatArray
    number: list[int]


Fault = Callable[[TrackingFilm], TrackingFilm]


def kept(film: TrackingFilm, keep: list[int]) -> TrackingFilm:
    """Frames ``keep`` of a film."""
    return replace(
        film,
        frames=[film.frames[k] for k in keep],
        true_px=film.true_px[keep],
        number=[film.number[k] for k in keep],
    )


def one_in_three_dropped(film: TrackingFilm) -> TrackingFilm:
    """Without every third frame."""
    return kept(film, [k for k in range(len(film.frames)) if k % 3 != 2])


def bursts_dropped(film: TrackingFilm) -> TrackingFilm:
    """Without five frames after every ten."""
    return kept(film, [k for k in range(len(film.frames)) if k % 15 < 10])


def covered(film: TrackingFilm) -> TrackingFilm:
    """Ten frames, while the hand closes, partly behind a dark patch as large as a finger."""
    frames = list(film.frames)
    start = len(frames) // 6
    height, width = frames[0].shape[:2]
    for k in range(start, start + 10):
        frames[k] = frames[k].copy()
        centre = (int(0.62 * width), int(0.5 * height))
        cv2.ellipse(frames[k], (centre, (0.17 * width, 0.6 * height), 20.0), (18, 22, 30), -1)
    return replace(film, frames=frames)


def distorted(film: TrackingFilm, push: float, sd: float) -> TrackingFilm:
    """A third of the frames with a smooth bulge pushed aside at once, and back at once.

    Parameters
    ----------
    push, sd : float
        Displacement at the bulge's centre and its width, over the picture's width; with infinite
        ``sd`` all of the picture is displaced.
    """
    height, width = film.rest.shape[:2]
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float64)
    # Where markers are small and near each other.
    centre = np.array([0.57 * width, 0.44 * height])

    def field(place: FloatArray) -> FloatArray:
        gap = np.sum((place - centre) ** 2, axis=-1, keepdims=True)
        most = push * width * np.array([0.8, 0.6])
        return np.asarray(most * np.exp(-0.5 * gap / (sd * width) ** 2))

    source = grid
    for _ in range(20):  # where the paint at each pixel comes from
        source = grid - field(source)
    x, y = np.moveaxis(source.astype(np.float32), -1, 0)
    frames, true = list(film.frames), film.true_px.copy()
    for k in range(len(frames) // 3, 2 * len(frames) // 3):
        frames[k] = cv2.remap(frames[k], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        true[k] += field(true[k])
    return replace(film, frames=frames, true_px=true)


FAULTS: dict[str, Fault] = {
    "no fault": lambda film: film,
    "one frame in three dropped": one_in_three_dropped,
    "bursts of five frames dropped": bursts_dropped,
    "a dark patch over ten frames": covered,
    "a bulge of 1/80 of the width in one frame": lambda film: distorted(film, 1 / 80, 0.07),
    "a bulge of 1/40 of the width in one frame": lambda film: distorted(film, 1 / 40, 0.07),
    "a knock of 1/80 of the width in one frame": lambda film: distorted(film, 1 / 80, np.inf),
    "a knock of 1/40 of the width in one frame": lambda film: distorted(film, 1 / 40, np.inf),
}
"""In cylinder60's picture the nearest markers of one colour are 1/100 of its width apart."""


def poor(image: ImageArray, rng: np.random.Generator) -> ImageArray:
    """Blur of 1.2 px, a tint, noise of 6 levels and JPEG 60."""
    out = cv2.GaussianBlur(image, (0, 0), 1.2) * np.array([0.9, 1.0, 1.1])
    noisy = np.clip(np.rint(out + rng.normal(0.0, 6.0, out.shape)), 0, 255).astype(np.uint8)
    code = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 60])[1]
    return np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), dtype=np.uint8)


def degraded(film: TrackingFilm) -> TrackingFilm:
    """The same film by a poor camera, rest frame and all."""
    rng = np.random.default_rng(3)
    frames = [poor(frame, rng) for frame in film.frames]
    return replace(film, rest=poor(film.rest, rng), frames=frames)


@dataclass(frozen=True, kw_only=True)
class Tracked:
    """How one film was tracked.

    Attributes
    ----------
    wrong : (n,) int
        Longest run of frames in which each marker was reported at another's place, without a right
        report between.
    lost, rejected : float
        Share of markers not reported, and of frames rejected.
    ms : (frames,) float
        Processor time of each.
    """

    wrong: IntArray
    lost: float
    rejected: float
    ms: FloatArray


def tracked(bundle: Bundle, film: TrackingFilm) -> Tracked:
    """Track a film from its rest frame on."""
    # A picture that is too poor to measure colours in is tracked with the design's.
    with suppress(InputError):
        bundle = calibrate_rest(bundle, film.rest)
    follower, last = Follower(bundle, film.rest), 0
    run, longest = np.zeros((2, len(bundle.colour)), dtype=np.int64)
    lost, ms, rejected = [], [], 0
    for frame, true_px, number in zip(film.frames, film.true_px, film.number, strict=True):
        start = time.process_time()
        try:
            seen = follower.follow(frame, elapsed=float(number - last)).position_px
        except InputError:
            seen, rejected = np.full_like(true_px, np.nan), rejected + 1
        ms.append(1e3 * (time.process_time() - start))
        last = number
        found = np.isfinite(seen[:, 0])
        run = np.where(at_wrong_place(bundle, true_px, seen), run + 1, np.where(found, 0, run))
        longest = np.maximum(longest, run)
        lost.append(1.0 - float(found.mean()))
    return Tracked(
        wrong=longest,
        lost=float(np.mean(lost)),
        rejected=rejected / len(film.frames),
        ms=np.array(ms),
    )


@dataclass(frozen=True, kw_only=True)
class Grip:
    """A hand before a camera; every ``step``-th frame of 300 is rendered."""

    size: str
    hand: Hand
    step: int

    def film(self) -> tuple[Bundle, TrackingFilm]:
        """Render it; the true places are those of the renderer."""
        cv2.setNumThreads(1)
        design = before_camera(load_design(DESIGN), SMALL)
        width, height = map(int, self.size.split("x"))
        scale = width / design.camera.width_px
        camera: dict[str, float] = {"width_px": width, "height_px": height}
        camera["focal_px"] = scale * design.camera.focal_px
        camera["pixel_um"] = design.camera.pixel_um / scale
        sensor = CameraSensor.of(copy_of(design, camera=camera))
        film = film_of(sensor, range(0, WHOLE, self.step), STRESS, self.hand)
        return sensor.bundle, TrackingFilm(
            rest=film.rest[0],
            frames=film.frames,
            true_px=sensor.bundle.rest_px + film.shift_px,
            number=list(range(1, len(film.frames) + 1)),
        )

    def measured(self) -> dict[str, Tracked]:
        """Track its film with each fault, by a good and by a poor camera."""
        bundle, film = self.film()
        out = {}
        for name, fault in FAULTS.items():
            faulty = fault(film)
            out[f"{self.size}, {name}"] = tracked(bundle, faulty)
            out[f"{self.size}, poor picture, {name}"] = tracked(bundle, degraded(faulty))
        return out


GRIPS = (
    Grip(size=MIDDLE, hand=Hand(), step=6),
    Grip(size=SMALL, hand=Hand(), step=4),
    Grip(size=SMALL, hand=Hand(fingers=3, turned_rad=0.7, raised_mm=-8.0, slide_mm=-8.0), step=4),
)


def add_rows(table: Table, *, quick: bool) -> None:
    """All grips, the cameras side by side."""
    grips = GRIPS[1:2] if quick else GRIPS
    with multiprocessing.get_context("spawn").Pool(min(len(grips), 2)) as pool:
        each = pool.map(Grip.measured, grips, chunksize=1)
    for name in dict.fromkeys(name for films in each for name in films):
        add_films(table, name, [films[name] for films in each if name in films])


def add_films(table: Table, name: str, films: list[Tracked]) -> None:
    """Row of the films with one fault before one camera."""
    row = f"{DESIGN} {name}, motions times {STRESS:g}: ids wrong for over {TOLERATED} frames"
    longest = np.concatenate([film.wrong for film in films])
    ms = np.concatenate([film.ms for film in films])
    lost, rejected = (
        100.0 * float(np.mean([getattr(film, part) for film in films]))
        for part in ("lost", "rejected")
    )
    note = (
        f"{len(films)} films, {len(ms)} frames; of {len(longest)} ids {int((longest > 0).sum())} "
        f"were ever wrong, for up to {longest.max()} frames; {lost:.3g} % not reported, "
        f"{rejected:.3g} % of frames rejected; a frame takes {np.median(ms):.2f} ms of one core "
        f"(median), {ms.max():.1f} at most"
    )
    value = int((longest > TOLERATED).sum())
    table.add(row, value, "ids", 0, "rendered truth", "== 0", note)
