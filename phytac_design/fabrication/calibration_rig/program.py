r"""The motion program: which regions, in which steps, as CSV and as G-code.

The sensor sits on two turning axes and the tool comes along -X::

    machine = Ry(B) · Rz(C) · sensor          outward normal of the region -> +X

C turns the sensor about its own axis, B tips it about y (0 on a cylinder, 90° for a flat pad). The
origin is the sensor's, in the middle of its near rim. X, Y, Z is the middle of the tool's face, and
A turns the tool about its own axis: its notch, which marks u, points along (0, sin A, cos A).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from phytac_design.fabrication.bill import csv_text
from phytac_design.fabrication.calibration_rig.regions import Regions, frames_at
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.calibration.calibration import MAX_DISPLACEMENT_OVER_WALL
from phytac_shapes.arrays import FloatArray, IntArray

ProgramRun = Literal["shell", "decoder"]
COLUMNS = (
    "step", "run", "region", "row", "column", "tool", "patch_radius_mm", "target_force_N",
    "target_displacement_mm", "x_mm", "y_mm", "z_mm", "nx", "ny", "nz",
    "X_mm", "Y_mm", "Z_mm", "A_deg", "B_deg", "C_deg",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Program:
    """Steps of both runs; arrays are over regions unless said otherwise.

    Attributes
    ----------
    marker, tool : (m,) int
        Region and the number of its indenter, from 1.
    radius_mm : (m,) float
        Radius of that indenter's face.
    point_mm, normal : (m, 3) float
        Where its face touches, and the outward normal, in the sensor's frame.
    machine_mm : (m, 3) float
        X, Y, Z of that touch.
    roll_deg, tip_deg, turn_deg : (m,) float
        A, B and C.
    force_N, displacement_mm : (k,) float
        Steps of the decoder's and of the shell's run at every region.
    safe_mm : float
        X at which the sensor may turn.
    bowl_mm : float
        How far switches stand out of the wall: the decoder's run stops before them.
    """

    marker: IntArray
    tool: IntArray
    radius_mm: FloatArray
    point_mm: FloatArray
    normal: FloatArray
    machine_mm: FloatArray
    roll_deg: FloatArray
    tip_deg: FloatArray
    turn_deg: FloatArray
    force_N: FloatArray
    displacement_mm: FloatArray
    safe_mm: float
    hover_mm: float
    bowl_mm: float
    feed_mm_min: float


def turned(point_mm: FloatArray, tip_rad: FloatArray, turn_rad: FloatArray) -> FloatArray:
    """Points (n, 3) of the sensor on the machine, B and C in radians (n,)."""
    x, y, z = np.asarray(point_mm, dtype=np.float64).T
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    x, y = c * x - s * y, s * x + c * y
    c, s = np.cos(tip_rad), np.sin(tip_rad)
    return np.column_stack([c * x + s * z, y, c * z - s * x])


def make_program(sensor: Sensor, regions: Regions, *, bowl_mm: float = 0.0) -> Program:
    """Steps at all regions; ``bowl_mm`` is how far the switches stand out of the wall."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    tip_small = 1e-9
    # Largest displacement of the shell's run over the largest that calibration accepts.
    shell_share = 0.9
    kit, training = design.kit, design.training
    point, normal = surface.point(markers.uv[regions.marker]), markers.normal[regions.marker]
    across = np.hypot(normal[:, 0], normal[:, 1])
    upright = across < tip_small
    angle = np.where(upright, 0.0, np.arctan2(normal[:, 1], np.where(upright, 1.0, normal[:, 0])))
    tip = np.arctan2(normal[:, 2], across)
    turn = np.mod(-angle, 2.0 * np.pi)
    notch = turned(frames_at(surface, markers.uv[regions.marker])[:, :, 0], tip, turn)
    reach = float(np.linalg.norm(np.abs(surface.bounds_mm()).max(axis=0)))
    reach += design.wall.rim_length_mm + design.wall.rim_flange_mm
    steps = np.geomspace(training.force_max_N, training.force_min_N, kit.force_steps)[::-1]
    most = shell_share * MAX_DISPLACEMENT_OVER_WALL * design.wall.thickness_mm
    return Program(
        marker=regions.marker,
        tool=regions.face + 1,
        radius_mm=np.array([face.radius_mm for face in regions.faces], dtype=np.float64)[
            regions.face
        ],
        point_mm=point,
        normal=normal,
        machine_mm=turned(point, tip, turn),
        roll_deg=np.degrees(np.arctan2(notch[:, 1], notch[:, 2])),
        tip_deg=np.degrees(tip),
        turn_deg=np.degrees(turn),
        force_N=steps,
        displacement_mm=most * np.arange(1, kit.shell_steps + 1) / kit.shell_steps,
        safe_mm=float(np.ceil(reach + bowl_mm + kit.hover_mm)),
        hover_mm=kit.hover_mm,
        bowl_mm=bowl_mm,
        feed_mm_min=kit.feed_mm_min,
    )


def steps_of(program: Program) -> Iterator[tuple[int, ProgramRun, int, float]]:
    """Number, run, index of the region and target of every step, the shell's run first."""
    number = 0
    runs: tuple[tuple[ProgramRun, FloatArray], ...] = (
        ("shell", program.displacement_mm),
        ("decoder", program.force_N),
    )
    for run, targets in runs:
        for region in range(len(program.marker)):
            for target in targets.tolist():
                yield number, run, region, target
                number += 1


def program_csv(program: Program, markers: Markers) -> str:
    """CSV with a line for each step."""
    rows = []
    for number, run, k, target in steps_of(program):
        marker = int(program.marker[k])
        place = [int(markers.row[marker]), int(markers.column[marker])]
        aim = [f"{target:.4g}", ""] if run == "decoder" else ["", f"{target:.5f}"]
        lengths = np.concatenate([program.point_mm[k], program.normal[k], program.machine_mm[k]])
        angles = np.array([program.roll_deg[k], program.tip_deg[k], program.turn_deg[k]])
        rows.append(
            [number, run, marker, *(place if markers.in_rows else ["", ""])]
            + [int(program.tool[k]), f"{program.radius_mm[k]:.4g}", *aim]
            + [f"{value + 0.0:.6f}" for value in lengths.round(6)]
            + [f"{value + 0.0:.5f}" for value in angles.round(5)]
        )
    return csv_text(COLUMNS, rows)


def gcode(program: Program, run: ProgramRun, *, name: str) -> str:
    """G-code of one run (RS-274, mm).

    ``M100 P<force> Q<step>`` and ``M101 P<travel> Q<step>`` are the rig's own macros: M100 presses
    on until the load cell reads P newtons and holds, M101 stays where it is, P mm past the touch;
    both then take a frame and write a line of the log.
    """
    # What logs a step: M100 holds a force first, M101 takes the position as it is.
    action = {"decoder": "M100", "shell": "M101"}
    out = [
        f"; {name}: {run} run, {len(program.marker)} regions",
        "; machine = Ry(B) Rz(C) sensor; tool along -X; X Y Z = middle of its face",
        "G21 G90 G94",
    ]
    tool, last = 0, -1
    for number, kind, k, target in steps_of(program):
        if kind != run:
            continue
        touch = program.machine_mm[k]
        # With switches in, the tool stops above their bowls and M100 presses from there.
        stop = float(touch[0]) + (program.bowl_mm if run == "decoder" else 0.0)
        if k != last:
            if last >= 0:
                out += _retreat(program, last)
            if program.tool[k] != tool:
                tool = int(program.tool[k])
                out += [f"G0 X{program.safe_mm:.4f}", f"T{tool} M6 ; indenter_{tool}.stl"]
            out += [
                f"; region {int(program.marker[k])}",
                f"G0 X{program.safe_mm:.4f}",
                "G0 " + _words(program, k),
                f"G0 X{stop + program.hover_mm:.5f}",
                f"G1 X{stop:.5f} F{program.feed_mm_min:g}",
            ]
            last = k
        if run == "shell":
            out.append(f"G1 X{touch[0] - target:.5f} F{program.feed_mm_min:g}")
        out.append(f"{action[run]} P{target:.5g} Q{number}")
    if last >= 0:
        out += _retreat(program, last)
    return "\n".join([*out, "M2"]) + "\n"


def _words(program: Program, region: int) -> str:
    """Y, Z and the angles of a region."""
    k = region
    values = [*program.machine_mm[k, 1:], program.roll_deg[k]]
    values += [program.tip_deg[k], program.turn_deg[k]]
    return " ".join(
        f"{axis}{round(float(value), 5) + 0.0:.5f}"
        for axis, value in zip("YZABC", values, strict=True)
    )


def _retreat(program: Program, region: int) -> list[str]:
    away = program.machine_mm[region, 0] + program.bowl_mm + program.hover_mm
    return [f"G1 X{away:.5f} F{program.feed_mm_min:g}", f"G0 X{program.safe_mm:.4f}"]
