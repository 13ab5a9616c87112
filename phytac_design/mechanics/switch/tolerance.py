"""How far the threshold spreads with wall and modulus: by sensitivity, and by sampling."""

from dataclasses import dataclass, replace

import numpy as np

from phytac_design.mechanics.switch.bowl import Bowl
from phytac_design.mechanics.switch.curve import press_bowl, snap_of
from phytac_design.mechanics.switch.hyperelastic import Material
from phytac_design.mechanics.switch.switch_space import Tolerance
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, NumericalError


def limit_load(
    bowl: Bowl, material: Material, *, hole_diameter_mm: float, refine: int
) -> float | None:
    """Limit load, N, of a bowl; None where its force does not fall."""
    curve = press_bowl(
        bowl,
        material,
        hole_diameter_mm=hole_diameter_mm,
        refine=refine,
        steps=10,
        end_mm=0.62 * bowl.depth_mm,  # bowls reach their limit load before
        to_limit=True,
    )
    snap = snap_of(curve)
    return None if snap is None else snap.limit_N


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Spread of the threshold from one switch to the next.

    Attributes
    ----------
    exponent_thickness : float
        d ln F / d ln t; that of the modulus is 1.
    sensitivity_N : float
        Half of the band that holds 95 %, from the slopes alone.
    low_N, high_N : float
        2.5th and 97.5th percentile of the samples.
    mean_N : float
        Their mean.
    """

    exponent_thickness: float
    sensitivity_N: float
    low_N: float
    high_N: float
    mean_N: float


def threshold_spread(
    bowl: Bowl,
    material: Material,
    tolerance: Tolerance,
    *,
    threshold_N: float,
    hole_diameter_mm: float = 1.6,
    samples: int = 4000,
    seed: int = 0,
) -> Spread:
    """Spread of a bowl's threshold; wall and modulus vary normally and on their own.

    The threshold is proportional to the modulus; over the wall it is solved at five places
    between three deviations, and interpolated. Its level comes from ``threshold_N``.

    Raises
    ------
    DesignError
        If the tolerance reaches walls that cannot be, or do not snap.
    """
    from scipy.interpolate import CubicSpline

    reach = 1.5 * tolerance.thickness_mm
    walls = bowl.thickness_mm + np.linspace(-reach, reach, 5) if reach else None
    rng = np.random.default_rng(seed)
    stiffness = 1.0 + 0.5 * tolerance.modulus * rng.standard_normal(samples).clip(-3.0, 3.0)
    if walls is None:
        exponent, force = 0.0, threshold_N * stiffness
    else:
        if walls[0] <= 0.2 * bowl.thickness_mm:
            raise DesignError(
                "tolerance-exceeds-wall",
                f"the wall's tolerance (± {tolerance.thickness_mm:g} mm) eats the wall of "
                f"{bowl.thickness_mm:.3g} mm; cast more precisely, or take a softer rubber, which "
                "asks for a thicker wall",
            )
        loads = _loads(bowl, material, walls, hole_diameter_mm)
        curve = CubicSpline(np.log(walls), np.log(loads))
        middle = np.log(bowl.thickness_mm)
        exponent = float(curve(middle, 1))
        drawn = 0.5 * tolerance.thickness_mm * rng.standard_normal(samples).clip(-3.0, 3.0)
        ratio = np.exp(curve(np.log(bowl.thickness_mm + drawn)) - curve(middle))
        force = threshold_N * ratio * stiffness
    slopes = np.hypot(exponent * tolerance.thickness_mm / bowl.thickness_mm, tolerance.modulus)
    low, high = np.quantile(force, [0.025, 0.975])
    return Spread(
        exponent_thickness=exponent,
        sensitivity_N=float(threshold_N * slopes * 1.96 / 2.0),
        low_N=float(low),
        high_N=float(high),
        mean_N=float(force.mean()),
    )


def _loads(
    bowl: Bowl, material: Material, walls: FloatArray, hole_diameter_mm: float
) -> FloatArray:
    loads = []
    for wall in walls:
        # A bowl of nearly half a sphere grows inward.
        depth = min(bowl.depth_mm, 0.5 * bowl.diameter_mm - float(wall))
        other = replace(bowl, thickness_mm=float(wall), depth_mm=depth)
        try:
            load = limit_load(other, material, hole_diameter_mm=hole_diameter_mm, refine=1)
        except NumericalError:
            load = None
        if load is None:
            raise DesignError(
                "tolerance-prevents-snap",
                f"a bowl with a wall of {wall:.3g} mm, within three deviations of "
                f"{bowl.thickness_mm:.3g} mm, does not snap; cast more precisely, or take a "
                "stiffer rubber, which asks for a thinner wall",
            )
        loads.append(load)
    return np.array(loads)
