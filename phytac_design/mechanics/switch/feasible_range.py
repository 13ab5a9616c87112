"""Which thresholds fit a space, and how that range grows with the modulus."""

from dataclasses import dataclass, replace

import numpy as np

from phytac_design.mechanics.switch.bowl_check import (
    DEEPER_mm,
    MisfitError,
    fillets,
    judge,
    shape_of,
)
from phytac_design.mechanics.switch.curve import press_bowl
from phytac_design.mechanics.switch.rubbers import Rubber
from phytac_design.mechanics.switch.space import Space
from phytac_shapes.errors import NumericalError

FINER = 7
"""Walls, each 4 % thinner, that are tried on the fine mesh for the largest threshold."""


@dataclass(frozen=True, kw_only=True)
class Feasible:
    """Thresholds that fit a space at one modulus; both grow in proportion to it.

    Attributes
    ----------
    modulus_MPa : float
        The rubber's.
    least_N, most_N : float
        Smallest and largest threshold.
    least_wall_mm, most_wall_mm : float
        Their walls.
    """

    modulus_MPa: float
    least_N: float
    most_N: float
    least_wall_mm: float
    most_wall_mm: float

    def at(self, modulus_MPa: float) -> "Feasible":
        """Return the range at another modulus."""
        factor = modulus_MPa / self.modulus_MPa
        return replace(
            self,
            modulus_MPa=modulus_MPa,
            least_N=factor * self.least_N,
            most_N=factor * self.most_N,
        )


def feasible_range(rubber: Rubber, space: Space) -> Feasible | None:
    """Range of thresholds that fit; None if no wall does."""
    fits: list[tuple[float, float, float]] = []
    for fillet in fillets(space):
        low, high = space.wall_min_mm, 0.4 * 0.5 * space.diameter_mm
        first = _fits(rubber, space, fillet, low)
        if first is None:
            continue
        fits.append((first, low, fillet))
        best = fits[-1]
        for _ in range(5):
            middle = float(np.sqrt(low * high))
            found = _fits(rubber, space, fillet, middle)
            if found is None:
                high = middle
            else:
                low, best = middle, (found, middle, fillet)
        fits.append(best)
    if not fits:
        return None
    least = min(fits)
    most, wall = _on_fine_mesh(rubber, space, sorted(fits, reverse=True)) or least[:2]
    return Feasible(
        modulus_MPa=rubber.material.modulus_MPa,
        least_N=least[0],
        least_wall_mm=least[1],
        most_N=most,
        most_wall_mm=wall,
    )


def _on_fine_mesh(
    rubber: Rubber, space: Space, fits: list[tuple[float, float, float]]
) -> tuple[float, float] | None:
    """Largest threshold and its wall: the fine mesh sees creases that the coarse one bears."""
    for _, start, fillet in fits:
        wall = start
        for _ in range(FINER):
            found = _fits(rubber, space, fillet, wall, refine=2)
            if found is not None:
                return found, wall
            wall *= 0.96
            if wall < space.wall_min_mm:
                break
    return None


def _fits(
    rubber: Rubber, space: Space, fillet_mm: float, wall_mm: float, *, refine: int = 1
) -> float | None:
    """Limit load, N, of the bowl with a wall, if it does."""
    depth = space.stroke_mm + DEEPER_mm
    for _ in range(3):
        try:
            bowl = shape_of(space, fillet_mm, depth, wall_mm)
            curve = press_bowl(
                bowl,
                rubber.material,
                hole_diameter_mm=space.hole_diameter_mm,
                refine=refine,
                steps=14,
                arc="never",
            )
            return judge(curve, rubber, space).limit_N
        except MisfitError as error:
            if not error.shallow or depth > space.depth_max_mm - wall_mm:
                return None
            depth += DEEPER_mm
        except NumericalError:
            return None
    return None
