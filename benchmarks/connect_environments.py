"""Gymnasium environments: how the scripted controller fares, and steps per second."""

import time
from dataclasses import replace

import numpy as np

from benchmarks.decoder_data import small_design
from benchmarks.harness import Table
from phytac_design.design.accuracy import Preset
from phytac_design.stages.virtual_sensor_stage import virtual_sensor

UNIT = 1
STEADY_FRAMES = 30
"""The last frames of an episode, in which the grip is held."""
LOOP = 20_000_000
"""Iterations of that loop."""


def grasped(table: Table, *, quick: bool) -> None:
    """Grasp each object a number of times; the frame's cost includes MuJoCo and the controller."""
    import gymnasium

    from phytac_design.environments.grasp_environment import designed_decoder
    from phytac_design.environments.grip_controller import GripController

    design, episodes = small_design(), 2 if quick else 20
    accuracy: Preset = "draft" if quick else "standard"
    bundle = designed_decoder(design, accuracy, print)
    sensor = virtual_sensor(design, unit=UNIT, accuracy=accuracy, progress=print)
    for name in ("Cup", "Egg", "Ball"):
        environment = gymnasium.make(
            f"phytac/{name}-v0", design=design, bundle=bundle, sensor=sensor
        )
        own = environment.unwrapped
        controller = GripController(thing=own.thing)
        held, steps, rates, peak_N, grips = 0, 0, [], 0.0, []
        environment.reset(seed=0)
        environment.step(np.zeros(2, dtype=np.float32))
        before_s = loop_seconds()
        for seed in range(episodes):
            begin = time.process_time()
            seen, info = environment.reset(seed=seed)
            driver, rows, done = replace(controller), [], False
            while not done:
                seen, _, terminated, truncated, info = environment.step(driver.act(seen))
                rows.append((info["true_grip_N"], *seen["grip_N"]))
                done = terminated or truncated
            rates.append(len(rows) / (time.process_time() - begin))
            steps += len(rows)
            held += info["outcome"] == "held"
            peak_N = max(peak_N, *(row[0] for row in rows))
            grips += rows[-STEADY_FRAMES:]
        true, found, low, high = np.array(grips).T
        case = f"{design.name}, print {UNIT}: {name.lower()}"
        table.goal(
            f"{case}: episodes in which the scripted controller holds it",
            100.0 * held / episodes,
            "%",
            ">= 100",
            note=f"of {episodes}, stiffness {own.thing.stiffness_N_mm} N/mm; largest true grip "
            f"{peak_N:.1f} N, crushed above {own.thing.force_max_N:g} N",
        )
        table.add(
            f"{case}: reported against true grip while held, mean relative error",
            100.0 * float(np.mean(np.abs(found / true - 1.0))),
            "%",
            "none",
            "decoder as designed, no training",
        )
        table.add(
            f"{case}: intervals of 90 % that hold the true grip",
            100.0 * float(np.mean((low <= true) & (true <= high))),
            "%",
            90.0,
            "their claim",
        )
        table.goal(
            f"{case}: steps of the environment per second of processor time",
            float(np.median(rates)),
            "1/s",
            ">= 200",
            note=f"median of {episodes} episodes, {min(rates):.0f} to {max(rates):.0f}; "
            f"{steps} steps, each a frame of 30 Hz: {own.sensor.steps_per_frame} steps of "
            f"MuJoCo and a decoded frame; 20 million iterations of an empty loop of Python took "
            f"{before_s:.2f} s before and {loop_seconds():.2f} s after",
        )


def loop_seconds() -> float:
    """Processor time of an empty loop: how fast the machine is at this moment."""
    begin = time.process_time()
    for _ in range(LOOP):
        pass
    return time.process_time() - begin
