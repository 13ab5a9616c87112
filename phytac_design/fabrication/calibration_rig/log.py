"""The calibration log: what a rig writes while it runs the motion program (``docs/formats.md``).

Its columns are those of ``phytac calibrate``, which reads it as it is; the step, the frame and the
time of each reading stand in a comment line before it.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from phytac_design.fabrication.calibration_rig.program import Program
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.bounded_reader import read_text
from phytac_shapes.errors import InputError

COLUMNS = ("contact_marker", "patch_radius_mm", "force_N", "displacement_mm")
NUMBER_MAX = 2.0**53
SHOWN = 120
BYTES_MAX = 1 << 28
"""A log of days; a larger one is something else."""
NOTE = re.compile(r"#\s*step\s+(\d+)\s*,\s*frame\s+(\d+)\s*,\s*([-+.\deE]+)\s*s\s*$")


@dataclass(frozen=True, kw_only=True)
class Log:
    """Readings of a rig, (n,) each; readings of one frame share step, frame and time.

    Attributes
    ----------
    step, frame : (n,) int
        Step of the program, and number of the camera's frame.
    time_s : (n,) float
        When it was read.
    marker : (n,) int
        Region that was pressed.
    radius_mm, force_N, displacement_mm : (n,) float
        Radius of the indenter's face, force (positive inward) and its travel since the touch.
    """

    step: IntArray
    frame: IntArray
    time_s: FloatArray
    marker: IntArray
    radius_mm: FloatArray
    force_N: FloatArray
    displacement_mm: FloatArray


def log_head(name: str) -> str:
    """First lines of a log of a design, for the rig to go on from."""
    return (
        f"# calibration log of {name}\n"
        "# before each reading: # step STEP, frame FRAME, SECONDS s\n" + ",".join(COLUMNS) + "\n"
    )


def log_text(log: Log, *, name: str, note: str = "") -> str:
    """Log as text; ``note`` becomes a comment at the top."""
    out = [f"# {note}\n" if note else "", log_head(name)]
    before: tuple[int, int] | None = None
    for k in range(len(log.step)):
        here = (int(log.step[k]), int(log.frame[k]))
        if here != before:
            out.append(f"# step {here[0]}, frame {here[1]}, {log.time_s[k]:.3f} s\n")
        before = here
        values = (log.radius_mm[k], log.force_N[k], log.displacement_mm[k])
        out.append(",".join([str(int(log.marker[k])), *(f"{v:.9g}" for v in values)]) + "\n")
    return "".join(out)


def read_log(path: Path) -> Log:
    """Read a log with its steps, frames and times.

    Raises
    ------
    InputError
        If it cannot be read, or a line is not what it should be.
    """
    try:
        lines = read_text(path, encoding="utf-8-sig", bytes_max=BYTES_MAX).splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a log: it is not even text; export it as CSV") from None
    except OSError as error:
        raise InputError(f"no log at {path} ({error.strerror}); check the path") from None
    names: list[str] = []
    note: list[float] = []
    rows: list[list[float]] = []
    for number, line in enumerate(map(str.strip, lines), start=1):
        if line.startswith("#"):
            found = NOTE.match(line)
            note = _numbers_of(path, number, found) if found else note
        elif line and not names:
            names = [word.strip() for word in line.split(",")]
            if sorted(names) != sorted(COLUMNS):
                raise InputError(
                    f"{path} line {number}: a log has the columns {', '.join(COLUMNS)} "
                    f"(got {', '.join(names)}); correct the first line"
                )
        elif line:
            rows.append([*_noted(path, number, note), *_values(path, number, line, names)])
    if not rows:
        raise InputError(f"{path} holds no readings; run the program and write a line per step")
    return _log(np.array(rows))


def _numbers_of(path: Path, number: int, found: re.Match[str]) -> list[float]:
    try:
        values = [float(word) for word in found.groups()]
    except ValueError:
        values = [math.nan]
    if not all(abs(value) <= NUMBER_MAX for value in values):
        raise InputError(
            f"{path} line {number}: step, frame and seconds must be numbers (got "
            f"{found[0][:SHOWN]!r}); correct the line"
        )
    return values


def _noted(path: Path, number: int, note: Sequence[float]) -> Sequence[float]:
    if not note:
        raise InputError(
            f"{path} line {number}: no line '# step STEP, frame FRAME, SECONDS s' stands before "
            "this reading; without it nobody knows its frame"
        )
    return note


def _values(path: Path, number: int, line: str, names: list[str]) -> list[float]:
    words = line.split(",")
    try:
        values = dict(zip(names, map(float, words), strict=True))
    except ValueError:
        raise InputError(
            f"{path} line {number}: {len(names)} numbers are due, comma-separated (got {line!r}); "
            "correct the line or remove it"
        ) from None
    out = [values[name] for name in COLUMNS]
    if not np.all(np.isfinite(out)) or out[0] != int(out[0]) or not 0 <= out[0] <= NUMBER_MAX:
        raise InputError(
            f"{path} line {number}: the marker must be a whole number and all values finite "
            f"(got {line!r}); correct the line or remove it"
        )
    return out


def _log(table: FloatArray) -> Log:
    step, frame, time, marker, radius, force, travel = table.T
    return Log(
        step=step.astype(np.int64),
        frame=frame.astype(np.int64),
        time_s=time,
        marker=marker.astype(np.int64),
        radius_mm=radius,
        force_N=force,
        displacement_mm=travel,
    )


def check_steps(log: Log, program: Program, count: int) -> None:
    """Refuse a log of another program: unknown steps, or markers that the design does not have.

    Raises
    ------
    InputError
        If a step or a marker is out of range.
    """
    each = len(program.displacement_mm) + len(program.force_N)
    steps = len(program.marker) * each
    if int(log.step.max()) >= steps or int(log.marker.max()) >= count:
        raise InputError(
            f"the log has step {log.step.max()} and marker {log.marker.max()}, the program {steps} "
            f"steps and the design {count} markers; use the log of this design's program"
        )
