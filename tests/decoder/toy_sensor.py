"""A sensor of thirty markers that is drawn, pressed and decoded in milliseconds."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.io.bundle import Bundle, save_bundle
from phytac_decoder.vision.switch_detection import TipModel
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.decoder.test_forces import make_bundle
from tests.decoder.test_marker_detection import GREY, MODEL, PAINTS, lattice

SCALE = 8
TIP = np.array([9.0, 0.0])
"""A tip stands this far from its marker, px, and moves with it."""


def toy_bundle() -> Bundle:
    """Markers 10 mm apart on a plane; a newton moves its marker by a pixel to the right."""
    rest, colour, near = lattice()
    base, count = make_bundle(), len(rest)
    row, column = np.divmod(np.arange(count), 6)
    compliance = np.zeros((2 * count, count))
    compliance[2 * np.arange(count), np.arange(count)] = 1.0
    camera = Camera.on_axis(width_px=160, height_px=120, focal_px=80, stand_off_mm=30)
    return replace(
        base,
        cameras=(camera,),
        read_by=np.zeros(count, dtype=np.int64),
        colours=MODEL,
        colour=colour,
        position_mm=np.column_stack([10.0 * column, 10.0 * row, np.zeros(count)]),
        head_mm=camera.position_mm + 40.0 * camera.rays(rest),
        rest_px=rest,
        tip_bias_px=np.zeros((count, 2)),
        tips=TipModel(
            on_px=rest + TIP, red_rest_px=np.zeros(count), red_on_px=np.full(count, 12.0)
        ),
        model=replace(
            base.model,
            shift_to_mm=np.tile([1.0, 0.0], (count, 1)),
            stiffness=np.eye(count),
            compliance_px=compliance,
            height_z_mm=np.zeros(count),
            neighbours=near,
        ),
        threshold_N=np.full(count, 0.5),
    )


def toy_frame(pressed: Mapping[int, float] | None = None, *, tips: bool = True) -> ImageArray:
    """The camera's view (120, 160, 3) with some markers pressed, by force in N, and their tips."""
    rest, colour, _ = lattice()
    image = np.full((120 * SCALE, 160 * SCALE, 3), GREY, dtype=np.uint8)

    def disc(centre: FloatArray, radius: float, paint: str) -> None:
        # Pixel centres of the small image are integers.
        x, y = np.round((centre + 0.5) * SCALE - 0.5).astype(int).tolist()
        cv2.circle(image, (x, y), round(radius * SCALE), PAINTS[paint][::-1], -1)

    for marker, place in enumerate(rest):
        force = (pressed or {}).get(marker, 0.0)
        moved = place + np.array([force, 0.0])
        disc(moved, 3.5, ("blue", "green")[colour[marker]])
        if force and tips:
            disc(moved + TIP, 2.0, "red")
    return np.asarray(cv2.resize(image, (160, 120), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def toy_recording(folder: Path, forces_N: list[Mapping[int, float]]) -> tuple[Path, Path]:
    """The bundle's folder, and that of a PNG for each frame."""
    decoder, frames = folder / "decoder", folder / "frames"
    save_bundle(toy_bundle(), decoder)
    frames.mkdir()
    for number, pressed in enumerate(forces_N):
        cv2.imwrite(str(frames / f"frame_{number}.png"), toy_frame(pressed))
    return decoder, frames
