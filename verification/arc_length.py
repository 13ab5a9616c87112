"""Arc-length control of a solid of revolution's path, through snap-backs; for verification."""

from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.large.stability import path_deviation
from phytac_design.mechanics.switch.model import AxiModel
from phytac_design.mechanics.switch.switch_path import PathControl, PathPoint, correct
from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class ArcLengthControl(PathControl):
    """Steps of a length in the space of all unknowns, until the unknown reaches its end."""

    def longest(self, points: list[PathPoint]) -> float:
        """Arc-length that moves the unknown by about its longest step where it moves most."""
        return self.longest_mm * min(
            float(np.linalg.norm(p.drive) / max(abs(p.drive[self.unknown]), 1e-300)) for p in points
        )

    def advance(
        self, model: AxiModel, load: FloatArray, points: list[PathPoint], step: float
    ) -> tuple[PathPoint, float]:
        """Point a step further, and its deviation from the path (:func:`path_deviation`)."""
        here = points[-1]
        onward = here.unknowns - points[-2].unknowns if len(points) > 1 else here.drive
        sign = 1.0 if onward @ here.drive >= 0.0 else -1.0
        rate = sign * step / float(np.linalg.norm(here.drive))
        before = rate * here.drive

        def constraint(unknowns: FloatArray) -> tuple[FloatArray, float, float]:
            moved = unknowns - here.unknowns
            return 2.0 * moved, step**2 - float(moved @ moved), 1e-9 * step**2

        guess = (here.unknowns + before, here.load_factor + rate)
        found = correct(model, load, guess, constraint)
        moved = found.unknowns - here.unknowns
        after = step / float(np.linalg.norm(found.drive)) * found.drive
        return found, path_deviation(moved, before, after if moved @ after >= 0.0 else -after)
