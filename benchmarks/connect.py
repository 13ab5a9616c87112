"""Sensors in other programs.

Part ``mujoco``: spheres pressed on a virtual print in MuJoCo, decoded by its decoder as designed;
the same presses, solved and seen as ``phytac simulate`` does, are beside them. Part ``parts``:
exported parts of all shipped designs in MuJoCo, OpenUSD, yourdfpy, PyBullet and libsdformat. Part
``environments``: grasps in the Gymnasium environments. Part ``recordings``: files for Rerun,
LeRobot and FTP-1, and what a killed program leaves of each kind. Part ``ros2``: the stream as ROS 2
topics. ::

    python -m benchmarks.connect [--parts mujoco,parts,environments,recordings,ros2] [--quick]
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import mujoco
import numpy as np

from benchmarks.connect_environments import grasped, loop_seconds
from benchmarks.connect_parts import exported
from benchmarks.connect_presses import PressRig, found_beside, only
from benchmarks.connect_recordings import recorded
from benchmarks.connect_ros2 import streamed
from benchmarks.decoder_data import job_of, small_design
from benchmarks.decoder_evaluation import by_design, mechanics
from benchmarks.harness import Table, run_parts
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_decoder.pipeline.frame_reading import read
from phytac_design.design.accuracy import PRESETS, Preset
from phytac_design.design.design_file import design_hash
from phytac_design.simulation.contacts import Contacts, draw_contacts
from phytac_design.simulation.imaging.imaging_model import ImagingModel
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.run.virtual_sensor import VirtualSensor
from phytac_design.simulation.solver import Solver
from phytac_design.training.evaluation.contact_scores import interval_coverage
from phytac_design.workflows.mujoco_sensor import PhytacMujoco
from phytac_design.workflows.simulate import imaging_model, observe_rest
from phytac_shapes.arrays import FloatArray

UNIT, SEED = 1, 1
NEAR_MM = 15.0
"""A contact that is found farther from the pressed place is another one."""
RIM_MM = 10.0
"""Nearer to a clamped rim a press hardly moves markers."""


def judged(found: FloatArray, truth_N: FloatArray) -> tuple[float, float]:
    """Mean relative error, %, and share of truths in intervals of 90 %, of rows (force, sd)."""
    error = 100.0 * float(np.mean(np.abs(found[:, 0] - truth_N) / truth_N))
    return error, 100.0 * interval_coverage(found[:, 0], found[:, 1], truth_N, level=0.9)


def claimed(found: FloatArray) -> float:
    """Median standard deviation over force, %, of rows (force, sd)."""
    return 100.0 * float(np.median(found[:, 1] / found[:, 0]))


def simulated(
    job: Job, imaging: ImagingModel, sensor: PhytacMujoco, drawn: Contacts, rows: list[int]
) -> FloatArray:
    """The same presses as ``phytac simulate`` has them, decoded: force and sd, (m, 2)."""
    solver = Solver(job.design, job.surface, job.unit, refine=job.refine)
    out = []
    for row in rows:
        one = only(drawn, row)
        motion = solver.solve(one, one.force_N).motion
        assert motion is not None
        bits = sensor.sensor.switched(one)
        # The same draws as PhytacMujoco takes.
        seen = imaging.points(motion, bits, 1.0, np.random.default_rng(row))
        measured = FrameMeasurement(
            koi=np.flatnonzero(seen.bits), shift_px=seen.shift_px, found=seen.found
        )
        reading = read(sensor.bundle, measured, sensor.estimator)
        out.append(found_beside(reading, job.surface.point(one.uv)[0], NEAR_MM))
    return np.array(out)


def in_mujoco(table: Table, *, quick: bool) -> None:
    """Known forces against MuJoCo's contact forces and decoded ones."""
    design, presses, solved = small_design(), 30 if quick else 500, 5 if quick else 100
    accuracy: Preset = "draft" if quick else "standard"
    decoder = by_design(mechanics(design, accuracy))
    decoder = replace(decoder, design=design.name, design_hash=design_hash(design))
    job = job_of(design, unit=UNIT, accuracy=accuracy)
    sight = observe_rest(job, print)
    imaging = imaging_model(job, views=sight.views, at_rest=sight.rest)
    begin = time.perf_counter()
    virtual = VirtualSensor.of(imaging, design, job.surface, PRESETS[accuracy])
    tabulated_s = time.perf_counter() - begin
    rig = PressRig.of(design)
    sensor = PhytacMujoco(
        rig.model,
        rig.data,
        design=design,
        bundle=decoder,
        body="palm/base",
        patch_radius_mm=lambda _: rig.radius_mm,
        sensor=virtual,
    )
    drawn = draw_contacts(
        rig.sensor, samples=presses, rng=np.random.default_rng([SEED, 37]), most=1
    )
    points = job.surface.point(drawn.uv)
    felt_N, found = np.zeros(presses), np.zeros((presses, 2))
    for row in range(presses):
        rig.press(drawn.uv[row], float(drawn.force_N[row]), float(drawn.radius_mm[row]))
        sensor.reset(row)
        reading = sensor.read()
        felt_N[row] = float(np.linalg.norm(sensor.contacts().force_N.sum(axis=0)))
        found[row] = found_beside(reading, points[row], NEAR_MM)
    name = f"{design.name}, print {UNIT}"
    off = float(np.abs(felt_N / drawn.force_N - 1.0).max())
    table.goal(
        f"{name}: MuJoCo's contact force against the applied one, largest difference",
        100.0 * off,
        "%",
        "<= 1.0",
    )
    read_rows = np.isfinite(found[:, 0])
    table.add(
        f"{name}: presses that are found",
        100.0 * float(read_rows.mean()),
        "%",
        "none",
        f"of {presses}, 0.5 to 25 N within 1 mm of a receptor; weak ones trip no switch",
    )
    error, covered = judged(found[read_rows], felt_N[read_rows])
    table.add(
        f"{name}: decoded against MuJoCo's contact force, mean relative error",
        error,
        "%",
        "none",
        f"{int(read_rows.sum())} presses, decoder as designed, no training",
    )
    table.add(f"{name}: intervals of 90 % that hold it", covered, "%", 90.0, "their claim")
    rows = np.flatnonzero(read_rows)[:: max(int(read_rows.sum()) // solved, 1)][:solved].tolist()
    same = simulated(job, imaging, sensor, drawn, rows)
    both = np.isfinite(same[:, 0])
    theirs, ours = same[both], found[rows][both]
    truth = drawn.force_N[rows][both]
    error_there, covered_there = judged(theirs, truth)
    error_here, covered_here = judged(ours, felt_N[rows][both])
    table.goal(
        f"{name}: mean relative error less that of phytac simulate on the same presses",
        abs(error_here - error_there),
        "percentage points",
        "<= 1.0",
        note=f"{int(both.sum())} presses: {error_here:.2f} % here, {error_there:.2f} % solved one "
        f"by one with large displacements; intervals hold {covered_here:.1f} and "
        f"{covered_there:.1f} %",
    )
    low, high = job.surface.domain[0] + np.array([RIM_MM, -RIM_MM])
    inner = (drawn.uv[rows][both, 0] > low) & (drawn.uv[rows][both, 0] < high)
    for where, chosen in (("near the rims", ~inner), (f"{RIM_MM:g} mm or more from them", inner)):
        gap = float(np.sqrt(np.mean((ours[chosen, 0] / theirs[chosen, 0] - 1.0) ** 2)))
        table.add(
            f"{name}: decoded force against phytac simulate's, press by press, {where}",
            100.0 * gap,
            "% rms",
            "none",
            f"{int(chosen.sum())} presses: the same noise, interpolated tables; standard "
            f"deviations that the decoder claims there are {claimed(theirs[chosen]):.0f} %",
        )
    table.add(f"{name}: tables of the print", tabulated_s, "s", "none", "once, then cached")
    speeds(table, name, rig, sensor, drawn)


def speeds(table: Table, name: str, rig: PressRig, sensor: PhytacMujoco, drawn: Contacts) -> None:
    """Steps per second of processor time with and without the sensor, while a ball presses."""
    strong = int(np.argmin(np.abs(drawn.force_N - 10.0)))
    rig.press(drawn.uv[strong], float(drawn.force_N[strong]), float(drawn.radius_mm[strong]))
    rate_Hz = rig.sensor.design.camera.frame_rate_Hz
    per_frame = round(1.0 / (rate_Hz * rig.model.opt.timestep))
    steps = 200

    def run(every: int) -> float:
        begin = time.process_time()
        for step in range(steps):
            mujoco.mj_step(rig.model, rig.data)
            if every and step % every == 0:
                sensor.read()
        return steps / (time.process_time() - begin)

    sensor.reset()
    sensor.read()
    for case, every in (
        ("without the sensor", 0),
        (f"with a frame every {per_frame} steps ({rate_Hz:g} Hz)", per_frame),
        ("with a frame every step", 1),
    ):
        before_s = loop_seconds()
        # Other programs only slow it down: the fastest of some runs is the machine's own speed.
        rates = [run(every) for _ in range(10)]
        target = ">= 200" if every == 1 else None
        table.add(
            f"{name}: steps per second of processor time {case}",
            max(rates),
            "1/s",
            200.0 if every else "none",
            "project target for the sensor in a loop" if every else "MuJoCo alone, one ball",
            target=target,
            note=f"fastest of {len(rates)} runs of {steps} steps, slowest {min(rates):.0f}; "
            f"20 million iterations of an empty loop of Python took {before_s:.2f} s before and "
            f"{loop_seconds():.2f} s after",
        )


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """The parts, in order."""
    return {
        "mujoco": partial(in_mujoco, quick=quick),
        "parts": partial(exported, quick=quick),
        "environments": partial(grasped, quick=quick),
        "recordings": partial(recorded, quick=quick),
        "ros2": partial(streamed, quick=quick),
    }


if __name__ == "__main__":
    run_parts("connect", parts, "sensors in other programs")
