#!/usr/bin/env python
"""Can a robot hold a thin cup that it knows nothing about? Force feedback against none.

A robot's thumb and finger close on a cup while it is filled. Below m·g/(2µ) the cup slips,
above its limit it is crushed. The hand commands a *closing*, mm; the resulting force depends on
the cup's stiffness, which the controller does not know. With feedback it closes or opens by the
difference between the force it wants and the force it reads; without, it closes by what would be
right for a cup of the usual stiffness.

The sensor in the loop is simulated: the solver bends the wall (linear, finer mesh than the
decoder's), the switches have hysteresis, the imaging model adds the camera's noise. The thumb
presses on one place and the finger on another; half of the total reading is the grip.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from recorded import Handle, hand, handle, messages_of, moving, quick_of, read, words

from phytac_decoder.serving.wire_protocol import Message
from phytac_design.mechanics.shell.footprints import footprint_shares
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.viscoelasticity import switch_step
from phytac_design.simulation.solver import Solver
from phytac_design.workflows.simulate import imaging_model
from phytac_shapes.arrays import FloatArray

FPS = 60.0
G_N_KG, FRICTION = 9.81, 0.35
EMPTY_KG, FULL_KG = 0.06, 0.25
CRUSHED_N = 12.0
WANTED_N = 8.0
"""Between slipping, 3.5 N when full, and crushing, with a margin for reading errors."""
USUAL_N_MM = 1.0
GAP_MM = 4.0
"""From the open hand to the cup."""
STEP_MM = 0.5
"""Maximum motion of the hand in a frame."""
GAIN_MM_N = 0.06
REACH_MM = 60.0


class Sensor:
    """The simulated sensor: forces of the two pads in, the decoder's message out."""

    def __init__(self, handle_: Handle, *, quick: bool) -> None:
        self._handle = handle_
        scenario = moving(hand("grip"), np.ones((1, 2)))
        scenario = quick_of(scenario) if quick else scenario
        job = Job(design=handle_.design, scenario=scenario, accuracy="draft")
        self._touches, unit = job.plan.touches, job.unit
        self._solver = Solver(
            job.design, job.surface, unit, refine=job.refine, displacement="linear"
        )
        self._imaging = imaging_model(job)
        radius = job.design.switch.footprint_diameter_mm / 2.0
        self._shares = footprint_shares(job.surface, self._touches, unit.markers.uv, radius)
        self._unit, self._frame = unit, 0
        self._rng = np.random.default_rng(0)
        self._motion = [
            self._solver.solve(self._touches, np.eye(2)[pad]).motion for pad in range(2)
        ]
        self.start()

    def start(self) -> None:
        """Reset the switches and the stream."""
        self._bits = np.zeros(len(self._unit.on_N), dtype=np.bool_)
        self._make, self._frame = messages_of(self._handle), 0

    def read(self, force_N: FloatArray) -> Message:
        """The next frame, with forces (2,) N on the pads."""
        carried = force_N @ self._shares
        self._bits = switch_step(self._bits, carried, self._unit.on_N, self._unit.off_N)
        motion = sum(f * m for f, m in zip(force_N, self._motion, strict=True) if m is not None)
        seen = self._imaging.points(np.asarray(motion), self._bits, rng=self._rng)
        self._frame += 1
        return self._make.frame(
            read(self._handle, seen.shift_px, seen.bits & seen.found),
            sequence=self._frame,
            timestamp_s=self._frame / FPS,
        )


@dataclass(kw_only=True)
class Cup:
    """A thin cup between two fingers, while it is filled."""

    stiffness_N_mm: float
    state: str = "standing"

    def force_N(self, closing_mm: float) -> float:
        """Grip at a closing."""
        return self.stiffness_N_mm * max(closing_mm - GAP_MM, 0.0)

    def feel(self, grip_N: float, filled: float, *, lifted: bool) -> str:
        """Update its state."""
        least = (EMPTY_KG + filled * (FULL_KG - EMPTY_KG)) * G_N_KG / (2.0 * FRICTION)
        if self.state in {"crushed", "dropped"}:
            return self.state
        if grip_N > CRUSHED_N:
            self.state = "crushed"
        elif lifted:
            self.state = "held" if grip_N >= least else "dropped"
        return self.state


def trial(
    sensor: Sensor, stiffness_N_mm: float, *, feedback: bool, frames: int
) -> dict[str, FloatArray | str]:
    """Close, lift after two fifths of the time, fill; true and decoded grip."""
    cup, closing = Cup(stiffness_N_mm=stiffness_N_mm), 0.0
    true, felt = np.zeros(frames), np.zeros(frames)
    aim = GAP_MM + WANTED_N / USUAL_N_MM
    sensor.start()
    for k in range(frames):
        grip = cup.force_N(closing)
        lifted = k >= 0.4 * frames
        state = cup.feel(grip, max(0.0, (k / frames - 0.5) / 0.4), lifted=lifted)
        if state in {"crushed", "dropped"}:
            true[k] = grip
            break
        message = sensor.read(np.full(2, grip))
        true[k], felt[k] = grip, message["total_N"] / 2.0
        # Fast in free motion, and slow enough to stop in time after contact.
        step = GAIN_MM_N * (WANTED_N - felt[k]) if feedback else aim - closing
        closing = float(np.clip(closing + np.clip(step, -STEP_MM, STEP_MM), 0.0, REACH_MM))
    return {"state": cup.state, "true_N": true, "read_N": felt}


def main(out: Path, *, quick: bool = False) -> dict[str, str]:
    """Run the example; how each trial ended, by stiffness and whether there was feedback."""
    sensor = Sensor(replace(handle(out), regions=()), quick=quick)
    frames = 50 if quick else 240
    kinds = (0.3, 3.0) if quick else (0.3, 1.0, 3.0)
    fig, axes = plt.subplots(1, len(kinds), figsize=(4.2 * len(kinds), 3.6), layout="constrained")
    ended, lines = {}, ["stiffness_N_mm,feedback,frame,time_s,true_N,read_N"]
    for axis, stiffness in zip(axes, kinds, strict=True):
        for feedback in (False, True):
            went = trial(sensor, stiffness, feedback=feedback, frames=frames)
            true, felt = np.asarray(went["true_N"]), np.asarray(went["read_N"])
            name = "with feedback" if feedback else "without"
            ended[f"{stiffness:g} {name}"] = str(went["state"])
            print(f"cup of {stiffness:g} N/mm {name}: {went['state']}, at most {true.max():.1f} N")
            colour, time_s = ("C0", "C1")[feedback], np.arange(frames) / FPS
            axis.plot(time_s, true, color=colour, label=f"{name}: {went['state']}")
            if feedback:
                axis.plot(time_s, felt, ".", color="k", ms=2, label="decoded")
            lines += [
                f"{stiffness:g},{int(feedback)},{k},{k / FPS:.4f},{true[k]:.4f},{felt[k]:.4f}"
                for k in range(frames)
            ]
        axis.axhline(CRUSHED_N, color="C3", ls="--", lw=0.8)
        axis.axhline(FULL_KG * G_N_KG / (2.0 * FRICTION), color="C2", ls="--", lw=0.8)
        axis.set(title=f"{stiffness:g} N/mm", xlabel="time, s", ylabel="grip, N", ylim=(0, 14))
        axis.legend(fontsize=8, loc="lower right")
    fig.savefig(out / "cup.png", dpi=110)
    plt.close(fig)
    (out / "cup.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"wrote {out / 'cup.csv'} and {out / 'cup.png'}")
    return ended


if __name__ == "__main__":
    given = words(__doc__)
    main(given.out, quick=given.quick)
