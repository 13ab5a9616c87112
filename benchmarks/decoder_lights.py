"""What white balance, exposure, vignetting and aged paint do to the decoder's eyes."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from benchmarks.decoder_presses import PressedSensor, rms
from benchmarks.harness import Table
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame, rest_positions
from phytac_design.optics.paint import PAINTS, to_linear
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import InputError

BALANCE = {"neutral": (1.0, 1.0), "warm": (1.2, 0.8), "cold": (0.8, 1.2), "green": (0.8, 0.8),
           "magenta": (1.2, 1.2)}  # fmt: skip
"""Gains of red and blue, on linear light."""
STOPS, CORNER = (-1.0, 0.0, 1.0), (0.1, 0.5)
"""Exposures, and shares of the light that are missing in the corner."""
FAR_STOPS = (-3.0, -2.0, 1.5)
FADED = 0.3
"""Share of white in aged paint."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """How frames are exposed; see ``PressedSensor.shot``."""

    name: str = "neutral"
    gains: tuple[float, float] = (1.0, 1.0)
    stops: float = 0.0
    corner: float | None = None


@dataclass
class Light:
    """What is found in one light: markers lost, bits wrong, errors of shifts, refusals."""

    lost: int = 0
    wrong: int = 0
    refused: str = ""
    error_px: float = 0.0


def shots(
    bench: PressedSensor, chips: list[NDArray[np.float32]], setting: Setting
) -> list[ImageArray]:
    """Frame of each light on the chip, each with noise of its own."""
    return [
        bench.shot(chip, k, gains=setting.gains, stops=setting.stops, corner=setting.corner)
        for k, chip in enumerate(chips)
    ]


def look(
    bench: PressedSensor, frames: list[ImageArray], poses: list[int], *, calibrated: bool
) -> Light:
    """Read a rest frame (first) and pressed ones."""
    out, errors = Light(), []
    try:
        bundle, rest_px = bench.bundle, None
        if calibrated:
            bundle = calibrate_rest(bundle, frames[0])
        else:
            rest_px = rest_positions(bundle, frames[0])
        for frame, index in zip(frames[1:], poses, strict=True):
            motion, bits = bench.pose(index)
            seen = measure_frame(bundle, frame, rest_px=rest_px)
            out.lost += int((~seen.found).sum())
            out.wrong += int((np.isin(np.arange(len(bits)), seen.koi) != bits).sum())
            errors.append(seen.shift_px - bench.eyes.exact(motion, bits))
    except InputError as error:
        out.refused = str(error)
        return out
    out.error_px = rms(np.array(errors))
    return out


def add_lights(table: Table, bench: PressedSensor, *, quick: bool) -> None:
    """White balance, exposure and vignetting, before and after calibrating by the rest frame."""
    total = np.bincount(bench.job.plan.touches.sample, weights=bench.job.plan.touches.force_N)
    poses = np.argsort(-total)[: 1 if quick else 2].tolist()
    chips = [bench.chip(*bench.at_rest), *(bench.chip(*bench.pose(k)) for k in poses)]
    faded = _faded(bench, poses)
    frames = shots(bench, chips, Setting())
    usual_px = look(bench, frames, poses, calibrated=False).error_px
    for calibrated in (False, True):
        how = "calibrated by the rest frame" if calibrated else "the design's colours"

        def add(
            name: str,
            chips: list[NDArray[np.float32]],
            settings: list[Setting],
            *,
            target: bool,
            how: str = how,
            calibrated: bool = calibrated,
        ) -> None:
            seen = {
                setting.name: look(
                    bench, shots(bench, chips, setting), poses, calibrated=calibrated
                )
                for setting in settings
            }
            markers = len(poses) * bench.eyes.count
            _add_light(table, f"light {name}, {how}", seen, usual_px, markers, target=target)

        for stops in STOPS:
            grid = [
                Setting(name=f"{name}, vignetting {corner:g}", gains=gains, stops=stops,
                        corner=corner)
                for (name, gains), corner in product(BALANCE.items(), CORNER)
            ]  # fmt: skip
            add(f"{stops:+g} stops", chips, grid, target=calibrated)
        add(f"as designed, paint with {100 * FADED:g} % of white", faded, [Setting()],
            target=calibrated)  # fmt: skip
        for stops in () if quick else FAR_STOPS:
            add(f"{stops:+g} stops, neutral", chips, [Setting(stops=stops)], target=False)


def _faded(bench: PressedSensor, poses: list[int]) -> list[NDArray[np.float32]]:
    """Light on the chip where all paint has faded."""
    eye = bench.eyes.cameras[0]
    names = (*bench.job.design.layout.colours, "red")
    paint = to_linear(np.array([PAINTS[name] for name in names]))
    before = eye.paint
    eye.paint = before * ((1.0 - FADED) * paint + FADED) / paint
    try:
        return [bench.chip(*bench.at_rest), *(bench.chip(*bench.pose(k)) for k in poses)]
    finally:
        eye.paint = before


def _add_light(
    table: Table, label: str, seen: dict[str, Light], usual_px: float, markers: int, *, target: bool
) -> None:
    """Rows of several lights together."""
    read = {name: one for name, one in seen.items() if not one.refused}
    refused = [f"{name}: {one.refused}" for name, one in seen.items() if one.refused]
    missed = len(refused) * markers
    wrong = sum(one.wrong for one in read.values())
    row = f"{label}: markers lost or in frames refused, and bits wrong"
    source = "markers in all frames; rendered truth"
    note = f"{len(seen)} lights, {len(refused)} refused, {wrong} bits wrong" + (
        f"; {refused[0]}" if refused else ""
    )
    value = sum(one.lost for one in read.values()) + wrong + missed
    table.add(row, value, "markers", len(seen) * markers, source, "== 0" if target else None, note)
    if read:
        worst = max(read, key=lambda name: read[name].error_px)
        row = f"{label}: error of shifts, over that in the design's light"
        source = "px RMS in the design's light, by the design's colours; truth of the renderer"
        note = f"worst light: {worst}, {read[worst].error_px:.3f} px RMS"
        ratio = read[worst].error_px / usual_px
        table.add(row, ratio, "ratio", usual_px, source, "<= 1.25" if target else None, note)
