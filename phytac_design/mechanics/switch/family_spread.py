"""How far the threshold of any family spreads with wall, diameter, assembly height and modulus."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.switch.switch_space import Tolerance
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class FamilyTolerance(Tolerance):
    """How well switches repeat, each ± at two standard deviations.

    Attributes
    ----------
    diameter_mm : float
        Of the outer diameter; walls keep their thickness.
    height_mm : float
        Of the height at which a switch is glued, and of the length of its stem.
    """

    diameter_mm: float = 0.05
    height_mm: float = 0.05


@dataclass(frozen=True, kw_only=True)
class FamilySpread:
    """Spread of the threshold from one switch to the next.

    Attributes
    ----------
    thickness, diameter, height, modulus : float
        Half of the change of the threshold between both limits of one tolerance, relative.
    low_N, high_N : float
        2.5th and 97.5th percentile of the samples.
    worst_low_N, worst_high_N : float
        Threshold with all four at the limits that lower or raise it.
    band : float
        Larger distance of ``low_N`` and ``high_N`` to the threshold, relative.
    """

    thickness: float
    diameter: float
    height: float
    modulus: float
    low_N: float
    high_N: float
    worst_low_N: float
    worst_high_N: float
    band: float


def spread_of(
    factors: Callable[[str, float], float | None],
    tolerance: FamilyTolerance,
    *,
    threshold_N: float,
    samples: int = 4000,
    seed: int = 0,
) -> FamilySpread:
    """Spread of a threshold whose errors vary normally and on their own, within three deviations.

    Parameters
    ----------
    factors : callable
        Threshold over its nominal value, with an error in mm of ``"thickness"``, ``"diameter"`` or
        ``"height"``; None where the switch does not work. It is asked at three deviations and at
        half of that, on both sides, and interpolated on logarithms; errors multiply. The
        threshold is proportional to the modulus.
    tolerance : FamilyTolerance
        What varies.
    threshold_N : float
        Nominal threshold.

    Raises
    ------
    DesignError
        If the tolerance reaches switches that do not work.
    """
    from scipy.interpolate import CubicSpline

    rng = np.random.default_rng(seed)
    drawn = 0.5 * rng.standard_normal((4, samples)).clip(-3.0, 3.0)
    stiffness = np.log1p(tolerance.modulus * np.append(drawn[0], [-1.0, 1.0]))
    total = stiffness[:-2]
    single = {"modulus": stiffness[-2:]}
    for row, name in enumerate(("thickness", "diameter", "height"), 1):
        limit = getattr(tolerance, f"{name}_mm")
        if limit == 0.0:
            single[name] = np.zeros(2)
            continue
        errors = limit * np.linspace(-1.5, 1.5, 5)
        curve = CubicSpline(errors, _logarithms(factors, name, errors))
        total = total + curve(limit * drawn[row])
        single[name] = curve(limit * np.array([-1.0, 1.0]))
    low, high = threshold_N * np.exp(np.quantile(total, [0.025, 0.975]))
    both = np.array([np.sort(ends) for ends in single.values()])
    worst = threshold_N * np.exp(both.sum(axis=0))
    half = {name: float(0.5 * np.ptp(np.exp(ends))) for name, ends in single.items()}
    return FamilySpread(
        **half,
        low_N=float(low),
        high_N=float(high),
        worst_low_N=float(worst[0]),
        worst_high_N=float(worst[1]),
        band=float(max(high / threshold_N - 1.0, 1.0 - low / threshold_N)),
    )


def _logarithms(
    factors: Callable[[str, float], float | None], name: str, errors: FloatArray
) -> FloatArray:
    out = []
    for error in errors:
        factor = 1.0 if error == 0.0 else factors(name, float(error))
        if factor is None or not (np.isfinite(factor) and factor > 0.0):
            raise DesignError(
                "tolerance-prevents-switch",
                f"with {error:+.3g} mm of {name}, within three deviations, the switch does not "
                "work; cast or assemble more precisely, or take another family or rubber",
            )
        out.append(np.log(factor))
    return np.array(out)
