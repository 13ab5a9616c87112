"""Streams of random numbers: one for each purpose and index, so that draws do not disturb others.

A sample's draws depend on the seed and on its own number only: not on the number of samples, their
order, or by how many processes.
"""

from enum import IntEnum

import numpy as np


class RandomStream(IntEnum):
    """What random numbers are for."""

    OFFSET = 1
    PRESS = 2
    GRIP = 3
    LEVEL = 4
    THICKNESS = 11
    WAVE = 12
    MODULUS = 13
    MARKER = 14
    HEIGHT = 15
    THRESHOLD = 16
    RELEASE = 17
    PAINT = 18
    NEAR_CAMERA = 19
    FAR_CAMERA = 20


def random_stream(seed: int, purpose: RandomStream, index: int) -> np.random.Generator:
    """Generator of one purpose and one index (a sample, a grip, a print)."""
    scenario_seed = 6  # second word of every seed here; other parts of the simulation use others
    return np.random.default_rng([seed, scenario_seed, int(purpose), index])
