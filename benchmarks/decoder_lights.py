"""Effects of white balance, exposure, vignetting and aged paint on marker detection."""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.decoder_presses import PressedSensor, rms
from benchmarks.harness import Table
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame, rest_positions
from phytac_design.optics.paint import PAINTS, to_linear
from phytac_shapes.errors import InputError

BALANCE = {"neutral": (1.0, 1.0), "warm": (1.2, 0.8), "cold": (0.8, 1.2), "green": (0.8, 0.8),
           "magenta": (1.2, 1.2)}  # fmt: skip
"""Gains of red and blue, on linear light."""
FADED = 0.3
"""Share of white in aged paint."""


@dataclass
class Light:
    """Results in one light: markers lost, switches wrong, errors of shifts, rejection."""

    lost: int = 0
    wrong: int = 0
    refused: str = ""
    error_px: float = 0.0


def measure(
    bench: PressedSensor,
    chips: list[NDArray[np.float32]],
    poses: list[int],
    *,
    calibrated: bool,
    **light: Any,
) -> Light:
    """Read a rest frame (of the first light on the chip) and pressed ones; see ``shot``."""
    rest, *frames = (bench.shot(chip, k, **light) for k, chip in enumerate(chips))
    out, errors = Light(), []
    try:
        bundle, rest_px = bench.bundle, None
        if calibrated:
            bundle = calibrate_rest(bundle, rest)
        else:
            rest_px = rest_positions(bundle, rest)
        for frame, index in zip(frames, poses, strict=True):
            motion, bits = bench.pose(index)
            seen = measure_frame(bundle, frame, rest_px=rest_px)
            out.lost += int((~seen.found).sum())
            out.wrong += int((np.isin(np.arange(len(bits)), seen.koi) != bits).sum())
            errors.append(seen.shift_px - bench.imaging.exact(motion, bits))
    except InputError as error:
        out.refused = str(error)
        return out
    out.error_px = rms(np.array(errors))
    return out


def add_lights(table: Table, bench: PressedSensor, *, quick: bool) -> None:
    """White balance, exposure and vignetting, before and after calibrating by the rest frame."""
    touches = bench.job.plan.touches
    total = np.bincount(touches.sample, weights=touches.force_N)
    poses = np.argsort(-total)[: 1 if quick else 2].tolist()
    chips = [bench.chip(*bench.at_rest), *(bench.chip(*bench.pose(k)) for k in poses)]
    cases: list[tuple[str, Any, dict[str, dict[str, Any]], bool]] = []
    for stops in (-1.0, 0.0, 1.0):
        grid = {
            f"{name}, vignetting {corner:g}": {"gains": gains, "stops": stops, "corner": corner}
            for (name, gains), corner in product(BALANCE.items(), (0.1, 0.5))
        }
        cases.append((f"{stops:+g} stops", chips, grid, True))
    name = f"as designed, paint with {100 * FADED:g} % of white"
    cases.append((name, _faded(bench, poses), {"neutral": {}}, True))
    cases += [
        (f"{stops:+g} stops, neutral", chips, {"neutral": {"stops": stops}}, False)
        for stops in (() if quick else (-3.0, -2.0, 1.5))
    ]
    usual_px = measure(bench, chips, poses, calibrated=False).error_px
    markers = len(poses) * bench.imaging.count
    for calibrated in (False, True):
        how = "calibrated by the rest frame" if calibrated else "the design's colours"
        for name, light, settings, target in cases:
            seen = {
                key: measure(bench, light, poses, calibrated=calibrated, **setting)
                for key, setting in settings.items()
            }
            label = f"light {name}, {how}"
            _add_light(table, label, seen, usual_px, markers, target=target and calibrated)


def _faded(bench: PressedSensor, poses: list[int]) -> list[NDArray[np.float32]]:
    """Light on the chip where all paint has faded."""
    camera = bench.imaging.cameras[0]
    names = (*bench.job.design.layout.colours, "red")
    paint = to_linear(np.array([PAINTS[name] for name in names]))
    before = camera.paint
    camera.paint = before * ((1.0 - FADED) * paint + FADED) / paint
    try:
        return [bench.chip(*bench.at_rest), *(bench.chip(*bench.pose(k)) for k in poses)]
    finally:
        camera.paint = before


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
