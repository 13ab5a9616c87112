"""Which thresholds fit a space, and how that range grows with the modulus."""

from dataclasses import dataclass, replace

import numpy as np

from phytac_design.mechanics.switch.bowl_check import (
    EXTRA_DEPTH_mm,
    UnsuitableBowlError,
    bowl_of,
    evaluate_bowl,
    fillets,
)
from phytac_design.mechanics.switch.curve import press_bowl
from phytac_design.mechanics.switch.rubbers import RUBBERS, Rubber
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_design.mechanics.switch.tolerance import limit_load
from phytac_shapes.errors import DesignError, NumericalError

WALL_EXPONENT = 2.2
"""The limit load goes with this power of the wall, measured on such bowls."""


@dataclass(frozen=True, kw_only=True)
class FeasibleRange:
    """Thresholds that fit a space at one modulus; both grow in proportion to it.

    Attributes
    ----------
    modulus_MPa : float
        The rubber's.
    min_N, max_N : float
        Smallest and largest threshold.
    min_wall_mm, max_wall_mm : float
        Their walls.
    """

    modulus_MPa: float
    min_N: float
    max_N: float
    min_wall_mm: float
    max_wall_mm: float

    def of_modulus(self, modulus_MPa: float) -> "FeasibleRange":
        """Range of the same rubber mixed to another modulus: the same walls."""
        factor = modulus_MPa / self.modulus_MPa
        return replace(
            self, modulus_MPa=modulus_MPa, min_N=factor * self.min_N, max_N=factor * self.max_N
        )


def feasible_range(rubber: Rubber, space: SwitchSpace) -> FeasibleRange | None:
    """Range of thresholds that fit; None if no wall does."""
    fits: list[tuple[float, float, float]] = []
    for fillet in fillets(space):
        low, high = space.wall_min_mm, 0.4 * 0.5 * space.diameter_mm
        first = bowl_fits(rubber, space, fillet, low)
        if first is None:
            continue
        fits.append((first, low, fillet))
        best = fits[-1]
        for _ in range(5):
            middle = float(np.sqrt(low * high))
            found = bowl_fits(rubber, space, fillet, middle)
            if found is None:
                high = middle
            else:
                low, best = middle, (found, middle, fillet)
        fits.append(best)
    if not fits:
        return None
    minimum = min(fits)
    most, wall = _on_fine_mesh(rubber, space, sorted(fits, reverse=True)) or minimum[:2]
    return FeasibleRange(
        modulus_MPa=rubber.material.modulus_MPa,
        min_N=minimum[0],
        min_wall_mm=minimum[1],
        max_N=most,
        max_wall_mm=wall,
    )


def misfit(threshold_N: float, rubber: Rubber, space: SwitchSpace) -> str:
    """Why no bowl has this threshold; "" if one does, as far as a few solves show.

    Walls follow from the load by its power law instead of iteration, and buckling and tolerances
    are not evaluated; see :func:`~phytac_design.mechanics.switch.design.design_switch`.
    """
    mesh_share = 0.01  # loads of the coarse mesh are so near those of the fine one
    too_thick = False
    for fillet in fillets(space):
        wall = space.wall_min_mm
        load = thinnest = limit_N(rubber, space, fillet, wall)
        if thinnest is not None and threshold_N < (1.0 - mesh_share) * thinnest:
            if too_thick:
                break  # rounder fillets ask for thinner walls still
            return (
                f"with the thinnest wall that the mold casts ({wall:g} mm) it snaps at "
                f"{thinnest:.3g} N"
            )
        for _ in range(2):
            if load is not None:
                wall *= (threshold_N / load) ** (1.0 / WALL_EXPONENT)
                load = limit_N(rubber, space, fillet, wall)
        if load is not None and bowl_fits(rubber, space, fillet, wall, refine=2) is not None:
            return ""
        too_thick = True
    return "no wall gives it that snaps, returns and moves the tip far enough"


def smallest_N(rubber: Rubber, space: SwitchSpace) -> float | None:
    """Threshold with the thinnest wall, N, on the coarse mesh; None if it does not snap."""
    return limit_N(rubber, space, fillets(space)[0], space.wall_min_mm)


def fit_words(threshold_N: float, found: FeasibleRange) -> str:
    """What would fit, without a full stop: thresholds of this rubber, moduli for this threshold."""
    low, high = moduli_MPa(threshold_N, found)
    fits = (
        f"From {found.min_N:.3g} to {found.max_N:.3g} N fit with walls of "
        f"{found.min_wall_mm:.3g} to {found.max_wall_mm:.3g} mm"
    )
    softest_MPa, hardest_MPa = 0.05, 100.0  # gels, and the hardest polyurethanes
    if high < softest_MPa or low > hardest_MPa:
        return f"{fits}; no rubber's modulus would do: ask for a threshold nearer to those"
    known = [name for name, one in RUBBERS.items() if low <= one.material.modulus_MPa <= high]
    named = f" (such as {known[0]})" if known else ""
    return f"{fits}; or take a rubber of {low:.3g} to {high:.3g} MPa{named}"


def moduli_MPa(threshold_N: float, found: FeasibleRange) -> tuple[float, float]:
    """Smallest and largest modulus at which a threshold fits the space of a range."""
    scaled = found.modulus_MPa * threshold_N
    return scaled / found.max_N, scaled / found.min_N


def limit_N(rubber: Rubber, space: SwitchSpace, fillet_mm: float, wall_mm: float) -> float | None:
    """Limit load, N, on the coarse mesh; None where the wall does not snap."""
    try:
        bowl = bowl_of(space, fillet_mm, space.stroke_mm + EXTRA_DEPTH_mm, wall_mm)
        hole_mm = space.hole_diameter_mm
        return limit_load(bowl, rubber.material, hole_diameter_mm=hole_mm, refine=1)
    except (DesignError, NumericalError):
        return None


def _on_fine_mesh(
    rubber: Rubber, space: SwitchSpace, fits: list[tuple[float, float, float]]
) -> tuple[float, float] | None:
    """Largest threshold and its wall: the fine mesh sees creases that the coarse one bears."""
    for _, start, fillet in fits:
        wall = start
        for _ in range(7):
            found = bowl_fits(rubber, space, fillet, wall, refine=2)
            if found is not None:
                return found, wall
            wall *= 0.96
            if wall < space.wall_min_mm:
                break
    return None


def bowl_fits(
    rubber: Rubber, space: SwitchSpace, fillet_mm: float, wall_mm: float, *, refine: int = 1
) -> float | None:
    """Limit load, N, of the bowl with a wall, if it does."""
    depth = space.stroke_mm + EXTRA_DEPTH_mm
    for _ in range(3):
        try:
            bowl = bowl_of(space, fillet_mm, depth, wall_mm)
            curve = press_bowl(
                bowl,
                rubber.material,
                hole_diameter_mm=space.hole_diameter_mm,
                refine=refine,
                steps=14,
            )
            return evaluate_bowl(curve, rubber, space).limit_N
        except UnsuitableBowlError as error:
            if not error.shallow or depth > space.depth_max_mm - wall_mm:
                return None
            depth += EXTRA_DEPTH_mm
        except NumericalError:
            return None
    return None
