"""A scripted controller: it closes until the sensor reports a grip, holds that, and lifts."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.environments.grasped_objects import GraspedObject
from phytac_shapes.arrays import FloatArray

TARGETS_N = {"cup": 7.5, "egg": 12.0, "ball": 11.0}
"""Grip that is wanted: well between slipping and crushing, or in the middle of the range."""


@dataclass(kw_only=True)
class GripController:
    """Closes by the difference between the wanted and the reported grip.

    It reads observations alone, no truth. Make a new one for each episode: it never stops lifting.

    Attributes
    ----------
    thing : GraspedObject
        What is held.
    contact_N : float
        Report from which on the object counts as touched; before that the hand closes at a share
        ``approach`` of its speed.
    gain : float
        Share of the fastest closing, for each newton that is wanted and not reported.
    steady_frames : int
        Frames in a row with a grip within ``steady_share`` of the wanted one, before it lifts.
    """

    thing: GraspedObject
    contact_N: float = 0.3
    approach: float = 0.6
    gain: float = 0.08
    steady_frames: int = 8
    steady_share: float = 0.25
    steady: int = 0

    def act(self, observation: dict[str, Any]) -> FloatArray:
        """Return closing and lifting (2,) for an observation of the environment."""
        wanted, grip = TARGETS_N[self.thing.name], float(observation["grip_N"][0])
        error = wanted - grip
        closing = self.approach if grip < self.contact_N else self.gain * error
        if not observation["valid"]:
            closing = 0.0
        near = abs(error) <= self.steady_share * wanted
        # Once it lifts it does not put down again.
        if self.steady < self.steady_frames:
            self.steady = self.steady + 1 if near else 0
        lifting = 1.0 if self.thing.lifted and self.steady >= self.steady_frames else 0.0
        return np.clip(np.array([closing, lifting], dtype=np.float32), -1.0, 1.0)
