"""Thresholds that are far too high for a space: known after a few solves, without their range."""

from phytac_design.mechanics.switch.bowl_check import fillets
from phytac_design.mechanics.switch.feasible_range import WALL_EXPONENT, bowl_fits, limit_N
from phytac_design.mechanics.switch.rubbers import Rubber
from phytac_design.mechanics.switch.switch_space import SwitchSpace

SHARE = 0.6
"""Bowls of this share of a threshold that is far too high do not fit either."""
NEAR = 1.5
"""Below this multiple of the thinnest wall's threshold that share is not pressed: most fit."""
FEW = 3.0
"""The largest threshold that fits is often below this multiple of that of the thinnest wall: this
thinner wall is tried first, which solves faster."""


def far_too_high(threshold_N: float, rubber: Rubber, space: SwitchSpace) -> str:
    """Why even a bowl of ``SHARE`` of a threshold does not fit; "" if one may.

    For every fillet, walls follow from the limit load of the thinnest one by its power law, and are
    pressed on the coarse mesh. As in ``feasible_range``, no wall fits that is thicker than one that
    does not.
    """
    thin, smallest_N = space.wall_min_mm, 0.0
    for fillet in fillets(space):
        load = limit_N(rubber, space, fillet, thin)
        if load is None:
            continue
        if SHARE * threshold_N <= (1.0 if smallest_N else NEAR) * load:
            return ""
        smallest_N = smallest_N or load
        shares = [SHARE * threshold_N / load]
        walls = [
            thin * share ** (1.0 / WALL_EXPONENT) for share in sorted({*shares, min(FEW, *shares)})
        ]
        if all(bowl_fits(rubber, space, fillet, wall) is not None for wall in walls):
            return ""
    if not smallest_N:
        return ""
    most_MPa = rubber.material.modulus_MPa * threshold_N / smallest_N
    return (
        f"nor does a wall for {SHARE * threshold_N:.2g} N. The thinnest that the mold casts "
        f"({thin:g} mm) snaps at {smallest_N:.3g} N: lower switch.threshold_N towards that, or "
        f"take a stiffer rubber, of less than {most_MPa:.3g} MPa (switch.modulus_MPa)"
    )
