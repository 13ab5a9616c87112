"""What a camera does to frames: wrong forces that no warning announces.

Presses on a simulated sensor are rendered, the picture or the camera is disturbed after the rest
frame, and the frames are decoded as ``phytac serve`` does, by a decoder that was built from the
design alone. A contact is silently wrong if its frame is valid and without a warning, and its force
is off by more than 10 % and 0.3 N and outside its 95 % interval; so is a pressed contact that
turned a switch on and is not found, and a contact of more than 1 N where nothing presses. ::

    python -m benchmarks.camera [--parts motion,picture] [--presses 24] [--dry]
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.decoder_evaluation import by_design, mechanics
from benchmarks.harness import Table
from phytac_decoder.camera.camera import Camera
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.frame_reading import Reading, read
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.layout.heights_along import along_mm, middle_mm
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.stages.frames_stage import FrameContacts, draw_frame_contacts
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray
from phytac_shapes.errors import PhytacError

MOTIONS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], float]] = {
    "none": ((0, 0, 0), (0, 0, 0), 0.0),
    "shift x 0.02 mm": ((0.02, 0, 0), (0, 0, 0), 0.0),
    "shift z 0.02 mm": ((0, 0, 0.02), (0, 0, 0), 0.0),
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
NEAR_MM = 8.0
"""A contact found within this distance of a pressed one is part of it."""
Picture = Callable[[ImageArray], ImageArray]


def _gain(gain: float) -> Picture:
    return lambda image: np.clip(image.astype(float) * gain, 0, 255).astype(np.uint8)


def _gamma(exponent: float) -> Picture:
    table = (255.0 * (np.arange(256) / 255.0) ** exponent).round().astype(np.uint8)
    return lambda image: np.asarray(cv2.LUT(image, table))


def _balance(blue: float, red: float) -> Picture:
    scale = np.array([blue, 1.0, red])
    return lambda image: np.clip(image.astype(float) * scale, 0, 255).astype(np.uint8)


def _jpeg(quality: int) -> Picture:
    words = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return lambda image: np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, words)[1], 1))


def _blur(sigma_px: float) -> Picture:
    return lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px))


def _noise(sd: float) -> Picture:
    rng = np.random.default_rng(5)
    return lambda image: np.clip(image + rng.normal(0.0, sd, image.shape), 0, 255).astype(np.uint8)


PICTURES: dict[str, Picture] = {
    "exposure x0.7": _gain(0.7),
    "exposure x0.85": _gain(0.85),
    "exposure x1.15": _gain(1.15),
    "exposure x1.4": _gain(1.4),
    "exposure x0.4": _gain(0.4),
    "exposure x2": _gain(2.0),
    "gamma 0.8": _gamma(0.8),
    "gamma 1.25": _gamma(1.25),
    "white balance +10 % red": _balance(1.0, 1.1),
    "white balance +10 % blue": _balance(1.1, 1.0),
    "white balance +20 % red, -20 % blue": _balance(0.8, 1.2),
    "JPEG 90": _jpeg(90),
    "JPEG 60": _jpeg(60),
    "JPEG 30": _jpeg(30),
    "blur 1 px": _blur(1.0),
    "blur 2 px": _blur(2.0),
    "noise 4": _noise(4.0),
    "noise 8": _noise(8.0),
}
"""Disturbances of the picture: OpenCV's JPEG and blur, gain and gamma before clipping, noise."""


@dataclass(kw_only=True)
class Outcome:
    """Counts and relative errors over all presses of one condition."""

    frames: int = 0
    refused: int = 0
    warned: int = 0
    silent: int = 0
    missed: int = 0
    contacts: int = 0
    inside: int = 0
    middle_errors: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)


class Bench:
    """A design's decoder and presses, rendered on demand."""

    def __init__(self, design: Design, presses: int) -> None:
        self.context: Context = mechanics(design, "standard")
        accuracy = replace(self.context.accuracy, frames=presses)
        self.context = replace(self.context, accuracy=accuracy)
        plain = by_design(self.context)
        # The presses are of a linear shell.
        self.bundle: Bundle = replace(plain, model=plain.model.linear)
        self.pressed: FrameContacts = draw_frame_contacts(self.context)
        self.scenes = PressedScene(self.context.sensor, self.context.sensor.cameras[0])

    def frame(self, index: int | None, camera: Camera) -> ImageArray:
        """Noisy frame of one press, or at rest (None), through a camera."""
        motion = np.zeros((self.context.markers.count, 6))
        bits = np.zeros(self.context.markers.count, dtype=np.bool_)
        if index is not None:
            motion, bits = self.pressed.motion[index], self.pressed.switching.bits[index]
        scene = self.scenes.scene(motion, bits)
        rng = np.random.default_rng([7, 0 if index is None else index + 1])
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
        force, place, height, tripped = self.truths(index)
        low, high = middle_mm(self.context.surface)
        assert reading.found is not None
        parts: dict[int, list[tuple[float, float]]] = {}
        for contact in reading.found.contacts:
            gap = np.linalg.norm(place - contact.point_mm, axis=1)
            near = int(np.argmin(gap))
            if gap[near] <= NEAR_MM:
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
            out.silent += error > max(0.1 * force[k], 0.3, half_width) and not warned
            out.errors.append(error / force[k])
            if low <= height[k] <= high:
                out.middle_errors.append(error / force[k])


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


def conditions(bench: Bench, part: str) -> Iterator[tuple[str, Camera, Picture]]:
    """Name, camera and picture of each condition after the rest frame."""
    camera = bench.context.sensor.cameras[0]
    if part == "motion":
        for name, (shift, turn, zoom) in MOTIONS.items():
            yield (
                name,
                moved(camera, np.array(shift), np.array(turn, dtype=float), zoom),
                _gain(1.0),
            )
    else:
        for name, picture in PICTURES.items():
            yield name, camera, picture


def decode(bundle: Bundle, frame: ImageArray) -> Reading:
    """Decode as a stream does: a frame that cannot be read is not valid."""
    try:
        measured = measure_frame(bundle, frame)
        return read(bundle, measured, "auto")
    except PhytacError as error:
        return Reading.none(str(error), error.code)


def add_rows(table: Table, bench: Bench, part: str) -> None:
    """Rows of all conditions, and their sum."""
    name, count = bench.context.design.name, bench.pressed.contacts.samples
    camera = bench.context.sensor.cameras[0]
    rest = bench.frame(None, camera)
    bundle = calibrate_rest(bench.bundle, [rest])
    clean = {} if part == "motion" else {k: bench.frame(k, camera) for k in range(count)}
    silent = 0
    for condition, through, picture in conditions(bench, part):
        out = Outcome()
        for k in range(count):
            frame = clean[k] if clean else bench.frame(k, through)
            bench.judge(out, k, decode(bundle, picture(frame)))
        silent += out.silent
        middle = 100.0 * float(np.mean(out.middle_errors)) if out.middle_errors else float("nan")
        whole = 100.0 * float(np.mean(out.errors)) if out.errors else float("nan")
        table.add(
            f"{name}, {condition} after the rest frame: silently wrong contacts",
            out.silent,
            "",
            0,
            "project target",
            "== 0",
            f"{out.frames} frames: {out.refused} refused, {out.warned} with warnings; middle "
            f"heights {middle:.2g} %, whole surface {whole:.2g} %; {out.inside} of {out.contacts} "
            f"forces within their 95 % interval, {out.missed} not found",
        )
    table.add(f"{name}, {part}: silently wrong in all", silent, "", 0, "project target", "== 0")


def main() -> None:
    """Run the parts that were asked for."""
    parser = argparse.ArgumentParser(description="What a camera does to frames.")
    parser.add_argument("--parts", default="motion,picture")
    parser.add_argument("--presses", type=int, default=24)
    parser.add_argument("--designs", default="cylinder60")
    parser.add_argument("--dry", action="store_true", help="results are not written")
    given = parser.parse_args()
    parts = given.parts.split(",")
    for name in given.designs.split(","):
        design = load_design(name)
        bench = Bench(design, given.presses)
        for part in parts:
            table = Table("camera", part=f"{Path(name).stem} {part}")
            add_rows(table, bench, part)
            if not given.dry:
                table.write(order=[f"{n} {p}" for n in given.designs.split(",") for p in parts])


if __name__ == "__main__":
    main()
