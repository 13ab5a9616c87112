"""What a camera does to frames: wrong forces that no warning announces.

Presses on a simulated sensor are rendered, the camera or the picture is disturbed, and the frames
are decoded as ``phytac serve`` does, by a decoder that was built from the design alone, or in the
parts ``trained`` by one that has learnt from rendered frames of this sensor. Pictures are
disturbed after the rest frame (*drift*), before it as well (*both*), and with nothing pressed
(*idle*). A contact is silently wrong if its frame is valid and without a warning, and its force is
off by more than 10 % and 0.3 N and outside its 95 % interval; so is a pressed contact that turned
a switch on and is not found, and a contact of more than 1 N where nothing presses. One contact in
twenty leaves its interval of 95 %: the notes say how many of the pressed ones would be silently
wrong if all errors were exactly as stated. Intervals by design allow for prints of another
stiffness, which this sensor does not have: nearly all errors lie within them. ::

    python -m benchmarks.camera [--parts "cylinder60 motion"] [--quick]
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from pathlib import Path

import cv2
import numpy as np

from benchmarks.camera_faults import HARD, MILD, Picture
from benchmarks.decoder_data import data_set, job_of, set_of
from benchmarks.decoder_evaluation import by_design, mechanics
from benchmarks.hands import learnt
from benchmarks.harness import Table, run_parts
from phytac_decoder.camera.camera import Camera
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.frame_reading import Reading, read
from phytac_design.core.workers import WorkerPool
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.layout.heights_along import along_mm, middle_mm
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.simulation.run.job import Job
from phytac_design.stages.renders_stage import FrameContacts, draw_frame_contacts
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray
from phytac_shapes.errors import PhytacError

MOTIONS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], float]] = {
    "none": ((0, 0, 0), (0, 0, 0), 0.0),
    "shift x 0.02 mm": ((0.02, 0, 0), (0, 0, 0), 0.0),
    "shift z 0.02 mm": ((0, 0, 0.02), (0, 0, 0), 0.0),
    "roll 0.05 deg": ((0, 0, 0), (0, 0, 0.05), 0.0),
    "shift x 0.05 mm": ((0.05, 0, 0), (0, 0, 0), 0.0),
    "shift x 0.1 mm": ((0.1, 0, 0), (0, 0, 0), 0.0),
    "shift z 0.1 mm": ((0, 0, 0.1), (0, 0, 0), 0.0),
    "tilt 0.1 deg": ((0, 0, 0), (0, 0.1, 0), 0.0),
    "roll 0.1 deg": ((0, 0, 0), (0, 0, 0.1), 0.0),
    "zoom 0.05 %": ((0, 0, 0), (0, 0, 0), 0.05),
    "zoom 0.3 %": ((0, 0, 0), (0, 0, 0), 0.3),
    "shift x 0.3 mm": ((0.3, 0, 0), (0, 0, 0), 0.0),
    "tilt 0.3 deg": ((0, 0, 0), (0, 0.3, 0), 0.0),
}
"""Translation, mm, rotation, degrees, and change of focal length, %, after the rest frame."""
FAR = ("zoom 0.3 %", "shift x 0.3 mm", "tilt 0.3 deg")
"""Motions that sensors without reference marks refuse."""
PICTURES = {"mild": MILD, "hard": HARD}
"""Disturbances of the picture, by kind."""
WORKERS = 2
"""Processes that share the conditions of a part."""
DESIGNS = ("cylinder60", "examples/uses/handle.toml", "hemisphere", "grip")
TRAINED = DESIGNS[:2]
"""Designs whose decoders are trained too."""
PRESSES = 100
LEARNT = 200
"""Samples that a trained decoder has learnt from."""
NEAR_MM = 8.0
"""A contact found within this distance of a pressed one, or within the distance of markers if that
is longer, is part of it."""


@dataclass(kw_only=True)
class Outcome:
    """Counts and relative errors over all presses of one condition."""

    frames: int = 0
    refused: int = 0
    warned: int = 0
    silent: int = 0
    expected: float = 0.0
    missed: int = 0
    contacts: int = 0
    inside: int = 0
    inside_90: int = 0
    middle_errors: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)

    def __str__(self) -> str:
        """Return the counts in one line."""
        middle = 100.0 * float(np.mean(self.middle_errors)) if self.middle_errors else np.nan
        whole = 100.0 * float(np.mean(self.errors)) if self.errors else np.nan
        return (
            f"{self.frames} frames, {self.refused} refused, {self.warned} with warnings, "
            f"{self.silent} silent ({self.expected:.2g} by chance); "
            f"middle heights {middle:.2g} %, whole surface {whole:.2g} %, "
            f"{self.inside} of {self.contacts} within 95 % intervals, "
            f"{self.inside_90} within 90 %, {self.missed} not found"
        )


class Bench:
    """A design's decoder, by design or trained, and presses, rendered on demand."""

    def __init__(self, design: Design, presses: int, *, trained: bool = False) -> None:
        self.context: Context = mechanics(design, "standard")
        accuracy = replace(self.context.accuracy, frames=presses)
        self.context = replace(self.context, accuracy=accuracy)
        plain = by_design(self.context)
        # The presses are of a linear shell.
        self.bundle: Bundle = replace(plain, model=plain.model.linear)
        if trained:
            name, job = training_of(design, presses)
            samples, meta = data_set(name, job)
            self.bundle = learnt(self.context, self.bundle, set_of(name, samples, meta), shear=True)
        self.pressed: FrameContacts = draw_frame_contacts(self.context)
        self.scenes = PressedScene(self.context.sensor, self.context.sensor.cameras[0])

    @property
    def near_mm(self) -> float:
        """How far a contact may be from where it was pressed."""
        area = self.context.surface.area_mm2() / self.context.markers.count
        return max(NEAR_MM, float(np.sqrt(area)))

    @property
    def count(self) -> int:
        """Number of presses."""
        return self.pressed.contacts.samples

    def frame(self, index: int | None, camera: Camera, *, seed: int | None = None) -> ImageArray:
        """Noisy frame of one press, or at rest (None), through a camera."""
        motion = np.zeros((self.context.markers.count, 6))
        bits = np.zeros(self.context.markers.count, dtype=np.bool_)
        if index is not None:
            motion, bits = self.pressed.motion[index], self.pressed.switching.bits[index]
        scene = self.scenes.scene(motion, bits)
        number = 0 if index is None else index + 1
        rng = np.random.default_rng([7, number if seed is None else seed])
        noise = self.context.design.camera.noise_pixel
        return render_frame(scene, camera, noise_std=noise, rng=rng)

    def truths(self, index: int) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Force, place (3,), distance from the near rim and switched on or not of each contact."""
        rows = np.flatnonzero(self.pressed.contacts.sample == index)
        contacts, surface = self.pressed.contacts.of(index), self.context.surface
        height = along_mm(surface, contacts.uv)
        tripped = self.pressed.switching.tripped[rows]
        return contacts.force_N, surface.point(contacts.uv), height, tripped

    def judge(self, out: Outcome, index: int, reading: Reading) -> None:
        """Compare one reading with the press."""
        out.frames += 1
        if not reading.valid:
            out.refused += 1
            return
        warned = bool(reading.warnings)
        out.warned += warned
        assert reading.found is not None
        if index < 0:
            out.silent += sum(one.force_N > 1.0 for one in reading.found.contacts) * (not warned)
            return
        force, place, height, tripped = self.truths(index)
        low, high = middle_mm(self.context.surface)
        parts: dict[int, list[tuple[float, float]]] = {}
        for contact in reading.found.contacts:
            gap = np.linalg.norm(place - contact.point_mm, axis=1)
            near = int(np.argmin(gap))
            if gap[near] <= self.near_mm:
                parts.setdefault(near, []).append((contact.force_N, contact.sd_N))
            else:
                out.silent += contact.force_N > 1.0 and not warned
        for k in np.flatnonzero(tripped).tolist():
            if k not in parts:
                out.missed += 1
                out.silent += not warned
                continue
            found, sd = np.array(parts[k]).T
            error = abs(float(found.sum()) - float(force[k]))
            half_width = 1.96 * float(np.hypot.reduce(sd))
            out.contacts += 1
            out.inside += error <= half_width
            out.inside_90 += 1.96 * error <= 1.645 * half_width
            limit = max(0.1 * force[k], 0.3, half_width)
            out.silent += error > limit and not warned
            out.expected += 0.0 if warned else math.erfc(1.96 / np.sqrt(2.0) * limit / half_width)
            out.errors.append(error / force[k])
            if low <= height[k] <= high:
                out.middle_errors.append(error / force[k])


def training_of(design: Design, presses: int) -> tuple[str, Job]:
    """Folder and job of the data that a trained decoder learns from.

    Contacts are those of ``platform`` with friction, in rendered frames of the nominal sensor; as
    the presses, of a linear shell.
    """
    count = min(LEARNT, 20 * presses)
    job = job_of(
        design,
        unit=0,
        samples=count,
        route="frames",
        touch={"friction_max": 0.8},
        solve={"displacement": "linear"},
    )
    return f"camera-{design.name}-{count}", job


def moved(camera: Camera, shift: FloatArray, turn_deg: FloatArray, zoom: float) -> Camera:
    """The camera after a motion in the sensor frame, turned about its own centre."""
    scale = 1.0 + zoom / 100.0
    lens = camera.lens
    turn = cv2.Rodrigues(np.radians(turn_deg))[0]
    return replace(
        camera,
        lens=replace(lens, fx_px=lens.fx_px * scale, fy_px=lens.fy_px * scale),
        position_mm=camera.position_mm + shift,
        rotation=camera.rotation @ turn.T,
    )


def decode(bundle: Bundle, frame: ImageArray) -> Reading:
    """Decode as a stream does: a frame that cannot be read is not valid."""
    try:
        return read(bundle, measure_frame(bundle, frame), "auto")
    except PhytacError as error:
        return Reading.none(str(error), error.code)


def judge_all(bench: Bench, bundle: Bundle, frames: Iterator[tuple[int, ImageArray]]) -> Outcome:
    """Decode frames of presses by their numbers; -1 is a frame at rest."""
    out = Outcome()
    for index, frame in frames:
        bench.judge(out, index, decode(bundle, frame))
    return out


def add_row(
    table: Table, design: str, condition: str, modes: dict[str, Outcome], *, target: bool
) -> tuple[int, float]:
    """Row of one condition in one or more modes; return the silently wrong ones, and by chance."""
    silent = int(sum(out.silent for out in modes.values()))
    notes = "; ".join(f"{mode}: {out}" for mode, out in modes.items())
    case = f"{design}, {condition}: silently wrong contacts"
    table.add(case, silent, "", 0, "project target", "== 0" if target else None, notes)
    return silent, sum(out.expected for out in modes.values())


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Conditions of one design, with what they share.

    Attributes
    ----------
    bench : Bench
        Decoder and presses.
    rest : (h, w, 3) uint8
        Undisturbed frame at rest.
    calibrated : Bundle
        Decoder with that rest frame.
    """

    bench: Bench
    rest: ImageArray
    calibrated: Bundle

    @classmethod
    def of(cls, design: str, presses: int, trained: bool) -> "Conditions":
        """Return those of a design."""
        bench = bench_of(design, presses, trained=trained)
        rest = bench.frame(None, bench.context.sensor.cameras[0])
        return cls(bench=bench, rest=rest, calibrated=calibrate_rest(bench.bundle, [rest]))

    @property
    def camera(self) -> Camera:
        """Camera that has not moved."""
        return self.bench.context.sensor.cameras[0]

    @cached_property
    def clean(self) -> list[ImageArray]:
        """Undisturbed frame of each press."""
        return [self.bench.frame(k, self.camera) for k in range(self.bench.count)]

    @cached_property
    def still(self) -> list[ImageArray]:
        """Undisturbed frames with nothing pressed."""
        return [self.bench.frame(None, self.camera, seed=1000 + k) for k in range(8)]

    def moved(self, name: str) -> dict[str, Outcome]:
        """Outcome, by mode, with a camera that has moved after the rest frame."""
        shift, turn, zoom = MOTIONS[name]
        through = moved(self.camera, np.array(shift), np.array(turn, dtype=float), zoom)
        frames = ((k, self.bench.frame(k, through)) for k in range(self.bench.count))
        return {"drift": judge_all(self.bench, self.calibrated, frames)}

    def disturbed(self, picture: Picture) -> dict[str, Outcome]:
        """Outcomes, by mode, of disturbed pictures."""
        rng = np.random.default_rng(11)
        pressed = [picture(frame, rng) for frame in self.clean]
        modes = {"drift": judge_all(self.bench, self.calibrated, iter(enumerate(pressed)))}
        idle = ((-1, picture(frame, rng)) for frame in self.still)
        modes["idle"] = judge_all(self.bench, self.calibrated, idle)
        try:
            lit = calibrate_rest(self.bench.bundle, [picture(self.rest, rng)])
            modes["both"] = judge_all(self.bench, lit, iter(enumerate(pressed)))
        except PhytacError:
            modes["both"] = Outcome(frames=len(pressed), refused=len(pressed))
        return modes


def outcomes_of(conditions: Conditions, task: tuple[str, str]) -> dict[str, Outcome]:
    """Outcomes, by mode, of one condition by its kind and name."""
    kind, name = task
    if kind == "motion":
        return conditions.moved(name)
    return conditions.disturbed(PICTURES[kind][name])


def add_refusals(table: Table, design: str, outcomes: Sequence[dict[str, Outcome]]) -> None:
    """Row of mild conditions, the first of which is no disturbance."""

    def stopped(out: Outcome) -> float:
        return (out.refused + out.warned) / out.frames

    usual = stopped(outcomes[0]["drift"])
    refused = [max(map(stopped, modes.values())) > usual + 0.1 for modes in outcomes]
    table.goal(
        f"{design}: mild conditions that are refused or warned of",
        float(np.mean(refused)),
        "",
        "<= 0.1",
        note="in any mode, in a tenth more frames than undisturbed ones are",
    )


def add_sum(table: Table, design: str, part: str, counts: list[tuple[int, float]]) -> None:
    """Row of all conditions of a part."""
    silent, expected = np.sum(counts, axis=0).tolist()
    case = f"{design}, {part}: silently wrong in all"
    note = f"{expected:.1f} by chance if all errors were as stated"
    table.add(case, silent, "", 0, "project target", "== 0", note)


def add_chance(table: Table, design: str, part: str, counts: list[tuple[int, float]]) -> None:
    """Row of all conditions of a part, for intervals that some errors have to leave."""
    silent, expected = np.sum(counts, axis=0).tolist()
    case = f"{design}, {part}: silently wrong over those by chance"
    note = f"{silent:.0f} in all, {expected:.1f} by chance if all errors were as stated"
    table.goal(case, silent / expected, "ratio", "<= 1", note=note)


def add_mild(table: Table, design: str, outcomes: dict[str, dict[str, Outcome]]) -> None:
    """Rows of the errors in mild conditions, over all modes."""
    found = {
        f"{name}, {mode}": out
        for name, modes in outcomes.items()
        for mode, out in modes.items()
        if out.contacts
    }
    error = {name: 100.0 * float(np.mean(out.middle_errors)) for name, out in found.items()}
    worst = max(error, key=lambda name: error[name])
    note = f"{worst}; {error['none, drift']:.2g} % undisturbed"
    case = f"{design}, mild conditions: largest mean error at middle heights"
    table.goal(case, error[worst], "%", "<= 2", note=note)
    inside = sum(out.inside for out in found.values())
    contacts = sum(out.contacts for out in found.values())
    case = f"{design}, mild conditions: contacts within 95 % intervals"
    table.goal(case, 100.0 * inside / contacts, "%", ">= 95", note=f"{inside} of {contacts}")


def add_near(table: Table, design: str, outcomes: dict[str, Outcome], *, trained: bool) -> None:
    """Rows of motions that are no further than what sensors without reference marks allow."""
    still = outcomes["none"]
    near = {name: out for name, out in outcomes.items() if name not in FAR}
    for what, errors in (("middle heights", "middle_errors"), ("whole surface", "errors")):
        share = {
            name: float(np.mean(getattr(out, errors)) / np.mean(getattr(still, errors)))
            for name, out in near.items()
        }
        worst = max(share, key=lambda name: share[name])
        case = f"{design}, motions up to 0.1 mm and 0.1 deg: largest error over undisturbed, {what}"
        table.goal(case, share[worst], "ratio", "<= 1.2", note=worst)
    if not trained:
        return
    held = {name: 100.0 * out.inside_90 / out.contacts for name, out in near.items()}
    worst = max(held, key=lambda name: abs(held[name] - 90.0))
    case = f"{design}, motions up to 0.1 mm and 0.1 deg: share within 90 % intervals"
    note = f"{held[worst]:.3g} % with {worst}, {held['none']:.3g} % undisturbed"
    off = abs(held[worst] - 90.0)
    table.goal(f"{case}: largest distance from 90 %", off, "%", "<= 5", note=note)


@cache
def bench_of(design: str, presses: int, *, trained: bool) -> Bench:
    """Return the presses on a design; all its parts share them."""
    return Bench(load_design(design), presses, trained=trained)


def add_part(table: Table, *, design: str, kind: str, trained: bool, quick: bool) -> None:
    """Rows of one kind of disturbance on one design."""
    names = list(MOTIONS if kind == "motion" else PICTURES[kind])
    presses = 3 if quick else PRESSES
    own = load_design(design).name
    if trained:
        data_set(*training_of(load_design(design), presses))  # before the workers look for it
        own += " trained"
    outcomes: list[dict[str, Outcome]] = [{}] * len(names)
    arguments = (design, presses, trained)
    with WorkerPool(outcomes_of, workers=WORKERS, start=Conditions.of, arguments=arguments) as pool:
        for result in pool.run([(kind, name) for name in names]):
            if result.lost:
                raise RuntimeError(f"{names[result.index]}: {result.lost}")
            outcomes[result.index] = result.value
            print(f"{names[result.index]} is done", flush=True)
    by_name = dict(zip(names, outcomes, strict=True))
    counts = [add_row(table, own, name, by_name[name], target=not trained) for name in names]
    (add_chance if trained else add_sum)(table, own, kind, counts)
    if kind == "mild":
        add_refusals(table, own, outcomes)
        add_mild(table, own, by_name)
    if kind == "motion":
        drift = {name: modes["drift"] for name, modes in by_name.items()}
        add_near(table, own, drift, trained=trained)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Parts by name, in order."""
    by_name: dict[str, Callable[[Table], None]] = {}
    for trained, designs in ((False, DESIGNS), (True, TRAINED)):
        for design in designs:
            for kind in ("motion", "mild", "hard"):
                name = f"{Path(design).stem} {'trained ' if trained else ''}{kind}"
                by_name[name] = partial(
                    add_part, design=design, kind=kind, trained=trained, quick=quick
                )
    return by_name


if __name__ == "__main__":
    run_parts("camera", parts, __doc__ or "")
