"""Motion of the camera and turn of the shell on a sensor with reference marks, in rendered frames.

The sensor is a design with twelve marks on its near rim; presses, frames and judgement are those of
:mod:`benchmarks.camera`. ::

    python -m benchmarks.reference_marks [--quick]
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.camera import Bench, Outcome, decode, moved
from benchmarks.harness import Table, run_parts
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.sensor_limits import axial_rotation
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.vision.reference_marks import ReferenceMarks
from phytac_design.design.design_file import load_design
from phytac_design.design.layout_table import ReferenceMarksSection
from phytac_design.design.spec import Design

DESIGN, PRESSES = "cylinder60", 24

MOTIONS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], float]] = {
    "shift x 0.1 mm": ((0.1, 0, 0), (0, 0, 0), 0.0),
    "shift x 0.3 mm": ((0.3, 0, 0), (0, 0, 0), 0.0),
    "shift z 0.3 mm": ((0, 0, 0.3), (0, 0, 0), 0.0),
    "tilt 0.3 deg": ((0, 0, 0), (0, 0.3, 0), 0.0),
    "roll 0.3 deg": ((0, 0, 0), (0, 0, 0.3), 0.0),
    "zoom 0.3 %": ((0, 0, 0), (0, 0, 0), 0.3),
}
"""Translation, mm, rotation, degrees, and change of focal length, %, after the rest frame."""


def with_marks(design: Design, count: int = 12) -> Design:
    """Return the design with reference marks on its near rim."""
    marks = ReferenceMarksSection(count=count)
    return design.model_copy(update={"reference_marks": marks, "name": f"{design.name}-marks"})


def judged(bench: Bench, bundle: Bundle, shift: object, turn: object, zoom: float) -> Outcome:
    """Outcome of all presses through a camera that has moved."""
    camera = bench.context.sensor.cameras[0]
    through = moved(camera, np.array(shift), np.array(turn, dtype=float), zoom)
    out = Outcome()
    for k in range(bench.pressed.contacts.samples):
        bench.judge(out, k, decode(bundle, bench.frame(k, through)))
    return out


def percent(errors: list[float]) -> float:
    """Mean of relative errors, %."""
    return 100.0 * float(np.mean(errors)) if errors else float("nan")


def note_of(out: Outcome) -> str:
    """Counts of an outcome in words."""
    return (
        f"{out.frames} frames: {out.refused} refused, {out.warned} with warnings, {out.silent} "
        f"contacts silently wrong; middle heights {percent(out.middle_errors):.2g} %, whole "
        f"surface {percent(out.errors):.2g} %; {out.inside} of {out.contacts} forces within their "
        f"95 % interval, {out.missed} not found"
    )


def add_rows(table: Table, bench: Bench) -> None:
    """Rows of all motions, against the clean frames."""
    name, camera = bench.context.design.name, bench.context.sensor.cameras[0]
    bundle = calibrate_rest(bench.bundle, [bench.frame(None, camera)])
    clean = judged(bench, bundle, (0, 0, 0), (0, 0, 0), 0.0)
    case, error = f"{name}, no motion: error at middle heights", percent(clean.middle_errors)
    table.add(case, error, "%", "", "this command", note=note_of(clean))
    for motion, (shift, turn, zoom) in MOTIONS.items():
        out = judged(bench, bundle, shift, turn, zoom)
        for where, errors, still in (
            ("middle heights", out.middle_errors, clean.middle_errors),
            ("whole surface", out.errors, clean.errors),
        ):
            table.add(
                f"{name}, {motion} after the rest frame: error at {where} over the clean one",
                percent(errors) / percent(still),
                "",
                1.2,
                "project target",
                "<= 1.2",
                note_of(out),
            )


def add_turns(table: Table, bench: Bench) -> None:
    """Row of the shell at all symmetric turns: one press each, its switches and its place."""
    name, camera = bench.context.design.name, bench.context.sensor.cameras[0]
    plain, right, silent = bench.bundle, 0, 0
    unmarked = replace(plain, marks=ReferenceMarks())
    for step in range(1, plain.symmetry_order):
        around = axial_rotation(step / plain.symmetry_order)
        seen = replace(
            camera, position_mm=camera.position_mm @ around, rotation=camera.rotation @ around
        )
        rest, out = bench.frame(None, seen), Outcome()
        index = step % bench.pressed.contacts.samples
        frame = bench.frame(index, seen)
        reading = decode(calibrate_rest(plain, [rest]), frame)
        bench.judge(out, index, reading)
        pressed = np.flatnonzero(bench.pressed.switching.bits[index])
        right += np.array_equal(np.intersect1d(reading.koi, pressed), pressed) and not out.silent
        blind = calibrate_rest(unmarked, [rest])
        silent += not any("orientation-ambiguous" in text for text in blind.limits())
    table.add(
        f"{name}, shell turned by each symmetric step: wrong switches or contacts",
        plain.symmetry_order - 1 - right,
        "",
        0,
        "project target",
        "== 0",
        f"{plain.symmetry_order - 1} steps of {360.0 / plain.symmetry_order:g} degrees",
    )
    table.add(
        f"{name}, the same without marks: steps whose ambiguity is not reported",
        silent,
        "",
        0,
        "project target",
        "== 0",
    )


def add_design(table: Table, *, quick: bool) -> None:
    """Rows of all motions and turns."""
    bench = Bench(with_marks(load_design(DESIGN)), 3 if quick else PRESSES)
    add_rows(table, bench)
    add_turns(table, bench)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Return the only part."""
    return {DESIGN: partial(add_design, quick=quick)}


if __name__ == "__main__":
    run_parts("reference_marks", parts, __doc__ or "")
