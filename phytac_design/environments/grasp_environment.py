"""Gymnasium environment: grasp a fragile object by what the simulated sensor reports."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import NormalDist
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, MultiBinary

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_design.design.design_file import design_hash, load_design
from phytac_design.design.spec import Design
from phytac_design.environments.grasped_objects import grasped_object
from phytac_design.environments.gripper_model import GripperModel
from phytac_design.simulation.run.virtual_sensor import VirtualSensor
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.decoder_stage import assemble_bundle, untrained_model
from phytac_design.workflows.mujoco_sensor import PhytacMujoco
from phytac_design.workflows.train_decoder import MECHANICS
from phytac_shapes.arrays import FloatArray

G_N_kg = 9.81
CONTACTS = 4
"""Contacts in an observation, the strongest first."""
FORCE_LIMIT_N, PLACE_LIMIT_mm = 500.0, 1000.0
"""Bounds of the observation space; larger values are clipped."""
HELD_mm, SLIPPED_mm = 40.0, 15.0
"""Height from which on an object counts as lifted; lag behind the hand from which it is dropped."""
FILL_s, HOLD_s = 2.0, 1.0
"""Time to fill an object that is lifted; time that it must be held, or squeezed, at the end."""


class GraspEnvironment(gymnasium.Env[dict[str, Any], FloatArray]):
    """Hold an object between a rigid pad and a finger that is the sensor.

    A step is a frame of the sensor's camera: the simulation advances to it and the decoder reads
    it, by :class:`phytac_design.workflows.mujoco_sensor.PhytacMujoco`.

    **Action**, (2,) in [-1, 1]: closing and lifting, as shares of 15 and 60 mm/s.

    **Observation**, a dictionary: what the sensor would report, and the hand's own joints.

    - ``grip_N`` (3,): force of all contacts, and its 90 % interval's ends
    - ``contacts_N`` (4, 3): the same of the strongest contacts; zeros where there are fewer
    - ``contacts_mm`` (4, 3): their places in the sensor's frame
    - ``switches`` (n,): which switches are on
    - ``valid``: 0 where the frame could not be decoded
    - ``hand_mm`` (2,): how far the hand has closed and lifted

    **Reward** of each frame. Cup, egg: height of the object over 40 mm, at most 1. Ball: 1 while
    the true grip is between 5 and 20 N, else 0. A frame that ends in failure: -100.

    **Termination**. ``info["outcome"]`` is ``"held"`` when the object has been lifted (and the cup
    filled) or the ball squeezed for 1 s; ``"crushed"`` when the true grip has exceeded the object's
    limit; ``"dropped"`` when the object, held or not, lags 15 mm behind the hand. It is empty while
    the episode runs. ``info["true_grip_N"]`` is the contact force in the simulation.

    Parameters
    ----------
    thing : {"cup", "egg", "ball"}
        Object that is held; its stiffness is drawn at each reset.
    design : str or Design
        Shipped design, file or design of the sensor.
    bundle : Path, str or Bundle, optional
        Its decoder; by default that of the design, which has learnt nothing: made at first use,
        which takes minutes, and kept in the cache.
    unit : int
        Virtual print, as of ``phytac simulate``.
    accuracy : str
        Preset of the meshes.
    sensor : VirtualSensor, optional
        The print, where it is at hand.
    progress : callable
        Called with a short message while decoder and print are made.

    Raises
    ------
    InputError
        If there is no such object, or the bundle is of another design.
    MissingPartError
        If mujoco is not installed.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        *,
        thing: str,
        design: str | Design = "cylinder60",
        bundle: Path | str | Bundle | None = None,
        unit: int = 1,
        accuracy: str = "standard",
        sensor: VirtualSensor | None = None,
        progress: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.thing = grasped_object(thing)
        of_design = design if isinstance(design, Design) else load_design(design)
        self.gripper = GripperModel.of(of_design, self.thing)
        self.sensor = PhytacMujoco(
            self.gripper.model,
            self.gripper.data,
            design=of_design,
            bundle=bundle or designed_decoder(of_design, accuracy, progress),
            body=self.gripper.body,
            unit=unit,
            accuracy=accuracy,
            sensor=sensor,
            progress=progress,
        )
        self.frame_s = self.sensor.steps_per_frame * float(self.gripper.model.opt.timestep)
        self._reach = NormalDist().inv_cdf(0.95)
        force = Box(0.0, FORCE_LIMIT_N, (CONTACTS, 3))
        self.observation_space = Dict(
            {
                "grip_N": Box(0.0, FORCE_LIMIT_N, (3,)),
                "contacts_N": force,
                "contacts_mm": Box(-PLACE_LIMIT_mm, PLACE_LIMIT_mm, (CONTACTS, 3)),
                "switches": MultiBinary(len(self.sensor.bundle.position_mm)),
                "valid": Discrete(2),
                "hand_mm": Box(-PLACE_LIMIT_mm, PLACE_LIMIT_mm, (2,)),
            }
        )
        self.action_space = Box(-1.0, 1.0, (2,))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Open the hand before an object of another stiffness; see :class:`gymnasium.Env`."""
        super().reset(seed=seed, options=options)
        self.gripper.reset(float(self.np_random.uniform(*self.thing.stiffness_N_mm)))
        self.sensor.reset(int(self.np_random.integers(2**31)))
        self._filled, self._held_s = 0.0, 0.0
        return self._observation(self.sensor.read()), self._info("")

    def step(self, action: FloatArray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Move the hand until the camera's next frame; see :class:`gymnasium.Env`."""
        closing, lifting = np.clip(action, -1.0, 1.0).tolist()
        weight_N = G_N_kg * self.thing.filling_kg * self._filled
        self.gripper.command(closing, lifting, weight_N)
        reading = self.sensor.step()
        outcome, reward = self._judge()
        failed = outcome in {"crushed", "dropped"}
        return (
            self._observation(reading),
            -100.0 if failed else reward,
            bool(outcome),
            False,
            self._info(outcome),
        )

    @property
    def true_grip_N(self) -> float:
        """Contact force on the sensor in the last frame."""
        return float(self.sensor.pressed.force_N.sum()) + self.sensor.elsewhere_N

    def _judge(self) -> tuple[str, float]:
        """Return how the episode ended, empty if it has not, and the reward of a frame."""
        thing, grip = self.thing, self.true_grip_N
        height, hand = self.gripper.moved_mm("rise"), self.gripper.moved_mm("lift")
        if grip > thing.force_max_N:
            return "crushed", 0.0
        if thing.lifted and hand - height > SLIPPED_mm:
            return "dropped", 0.0
        if thing.lifted:
            reward, good = min(max(height / HELD_mm, 0.0), 1.0), height >= HELD_mm
            if good and thing.filling_kg:
                self._filled = min(self._filled + self.frame_s / FILL_s, 1.0)
            ready = good and (self._filled == 1.0 or not thing.filling_kg)
        else:
            ready = grip >= thing.force_min_N
            reward = float(ready)
        self._held_s = self._held_s + self.frame_s if ready else 0.0
        return "held" if self._held_s >= HOLD_s else "", reward

    def _info(self, outcome: str) -> dict[str, Any]:
        return {"outcome": outcome, "true_grip_N": self.true_grip_N}

    def _observation(self, reading: Reading) -> dict[str, Any]:
        found = reading.found.contacts if reading.found and reading.valid else []
        strongest = sorted(found, key=lambda one: -one.force_N)
        force = np.zeros((CONTACTS, 3), dtype=np.float32)
        place = np.zeros((CONTACTS, 3), dtype=np.float32)
        for k, one in enumerate(strongest[:CONTACTS]):
            force[k], place[k] = self._interval(one.force_N, one.sd_N), one.point_mm
        total_sd = float(np.linalg.norm([one.sd_N for one in found]))
        on = np.zeros(len(self.sensor.bundle.position_mm), dtype=np.int8)
        on[reading.koi] = 1
        hand = [self.gripper.moved_mm(joint) for joint in ("close", "lift")]
        limit = PLACE_LIMIT_mm
        return {
            "grip_N": self._interval(sum(one.force_N for one in found), total_sd),
            "contacts_N": force,
            "contacts_mm": np.clip(place, -limit, limit),
            "switches": on,
            "valid": int(reading.valid),
            "hand_mm": np.clip(np.array(hand, dtype=np.float32), -limit, limit),
        }

    def _interval(self, force_N: float, sd_N: float) -> FloatArray:
        """Force, and the ends of its 90 % interval, within the observation space."""
        reach = self._reach * sd_N
        each = np.array([force_N, force_N - reach, force_N + reach], dtype=np.float32)
        return np.clip(each, 0.0, FORCE_LIMIT_N)


def designed_decoder(design: Design, accuracy: str, progress: Callable[[str], None]) -> Bundle:
    """Return the decoder of a design that has seen no data, from the cache or made now."""
    stages = select_stages(MECHANICS)
    context = run_stages(design, stages, accuracy=accuracy, seed=0, force=True, progress=progress)[
        0
    ]
    plain = assemble_bundle(context, untrained_model(context), {})
    return replace(plain, design=design.name, design_hash=design_hash(design))
