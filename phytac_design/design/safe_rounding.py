"""Limits for messages, rounded to the side on which they keep the rule when typed."""

from math import ceil, floor, isfinite, log10

NOISE = 1e-9
"""Steps of the last digit by which rounding of floats alone may pass a limit."""


def at_least(limit: float, digits: int = 4) -> str:
    """Smallest number of some significant digits that is not below a limit."""
    return _rounded(limit, digits, 1)


def at_most(limit: float, digits: int = 4) -> str:
    """Largest number of some significant digits that does not exceed a limit."""
    return _rounded(limit, digits, -1)


def _rounded(limit: float, digits: int, side: int) -> str:
    if not isfinite(limit) or limit == 0.0:
        return f"{limit:g}"
    places = digits - 1 - floor(log10(abs(limit)))
    steps = limit * 10.0**places
    whole = ceil(steps - NOISE) if side > 0 else floor(steps + NOISE)
    return f"{whole / 10.0**places:.{digits + 1}g}"
