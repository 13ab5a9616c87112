"""A camera that creeps for half an hour under a sensor that is pressed once a minute, rendered.

Presses, frames and judgement are those of :mod:`benchmarks.camera`; each press is held for 20 s,
and one frame is decoded every 10 s. ::

    python -m benchmarks.camera_drift [--quick]
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.camera import Bench, Outcome, bench_of, moved
from benchmarks.harness import Table, run_parts
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.drift import DriftReference, DriftSettings
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_shapes.errors import PhytacError

DESIGN = "cylinder60"
MINUTES, STEP_S, HELD = 30, 10.0, (4, 5)
"""Duration, time between frames, and the frames of each minute in which the sensor is pressed."""
RATE_MM, RATE_DEG = 0.02, 0.02
"""Drift in a minute, along x and about y."""


def film(bench: Bench, rate: float, minutes: int) -> dict[str, Outcome]:
    """Decode half an hour with and without a reference that follows."""
    camera = bench.context.sensor.cameras[0]
    bundle = calibrate_rest(bench.bundle, [bench.frame(None, camera)])
    never = DriftSettings(time_constant_s=np.inf)
    readers = {"followed": DriftReference(bundle), "fixed": DriftReference(bundle, never)}
    out = {name: Outcome() for name in readers}
    each_minute = round(60.0 / STEP_S)
    for number in range(minutes * each_minute):
        minute, phase = divmod(number, each_minute)
        time_s = number * STEP_S
        index = minute % bench.count if phase in HELD else None
        way = rate * time_s / 60.0
        shift, turn_deg = np.zeros((2, 3))
        shift[0], turn_deg[1] = RATE_MM * way, RATE_DEG * way
        through = moved(camera, shift, turn_deg, 0.0)
        measured = measure_frame(bundle, bench.frame(index, through, seed=1000 + number))
        for name, reference in readers.items():
            try:
                reading = reference.read(measured, "auto", time_s)
            except PhytacError as error:
                reading = Reading.none(str(error), error.code)
            bench.judge(out[name], -1 if index is None else index, reading)
    return out


def percent(errors: list[float]) -> float:
    """Mean of relative errors, %."""
    return 100.0 * float(np.mean(errors)) if errors else float("nan")


def add_rows(table: Table, *, quick: bool) -> None:
    """Rows of films with a camera at rest and with one that creeps."""
    minutes = 2 if quick else MINUTES
    bench = bench_of(DESIGN, minutes)
    name = bench.context.design.name
    still, creeping = film(bench, 0.0, minutes), film(bench, 1.0, minutes)
    usual = percent(still["fixed"].errors)
    about = f"{minutes} min, {RATE_MM} mm and {RATE_DEG}° a minute"
    source = "the same film with a camera at rest, reference fixed"
    table.add(f"{name}: camera at rest, reference followed: error of forces, whole surface",
              percent(still["followed"].errors), "%", usual, source,
              note=f"followed: {still['followed']}; fixed: {still['fixed']}")  # fmt: skip
    for way, out in creeping.items():
        row = f"{name}: {about}, reference {way}"
        target = way == "followed"
        table.add(f"{row}: error of forces over that of a camera at rest",
                  percent(out.errors) / usual, "ratio", 1.0, source,
                  "<= 1.2" if target else None, str(out))  # fmt: skip
        table.add(f"{row}: frames refused", out.refused, "frames", 0, "project target",
                  "== 0" if target else None, f"of {out.frames}")  # fmt: skip
        table.add(f"{row}: silently wrong contacts", out.silent, "", 0, "project target",
                  "== 0" if target else None)  # fmt: skip


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Return the only part."""
    return {DESIGN: partial(add_rows, quick=quick)}


if __name__ == "__main__":
    run_parts("camera_drift", parts, __doc__ or "")
