"""Whether the standard deviations of found contacts are right: true forces in their intervals."""

from statistics import NormalDist
from typing import Any

import numpy as np

from phytac_design.training.evaluation.contact_scores import LEVEL, RESAMPLES
from phytac_design.training.evaluation.decoded_contacts import DecodedContacts

LEVELS = (0.9, 0.95)
"""Nominal coverages that are evaluated."""
COVERAGE_90 = (0.85, 0.95)
"""Share of true forces within 90 % intervals that counts as right."""
CONTACTS_MIN = 100
"""Fewer contacts do not tell whether a share of 90 % is right."""


def interval_scores(decoded: DecodedContacts, seed: int = 0) -> dict[str, Any] | None:
    """Return how many true forces lie within the intervals of the contacts that ``auto`` found.

    Contacts are matched by their switches.

    Parameters
    ----------
    decoded : DecodedContacts
        With standard deviations.
    seed : int
        Of the bootstrap over samples: errors in one sample are correlated.

    Returns
    -------
    dict or None
        Plain JSON: ``contacts`` that match and contacts with a switch that was read but no match
        (``unmatched``); the share ``within_90`` and ``within_95`` with its interval; the median
        ``sd_N``; by what ``sd_factor`` standard deviations would have to be larger for 90 %
        intervals to hold 90 %. None if nothing matches.
    """
    if not len(decoded.stated):
        return None
    touch, force, sd, truth = decoded.stated.T
    ratio = np.abs(force - truth) / sd
    # Rows in the samples' touches ascend.
    sample = decoded.sample[np.searchsorted(decoded.touch, touch)]
    _, own = np.unique(sample, return_inverse=True)
    total, rng = np.bincount(own), np.random.default_rng(seed)
    draws = [rng.integers(len(total), size=len(total)) for _ in range(RESAMPLES)]
    shares = {}
    for level in LEVELS:
        inside = ratio <= NormalDist().inv_cdf(0.5 + level / 2.0)
        held = np.bincount(own, weights=inside)
        resampled = [held[draw].sum() / total[draw].sum() for draw in draws]
        low, high = np.quantile(resampled, [0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0])
        shares[f"within_{100 * level:.0f}"] = {
            "value": float(inside.mean()),
            "low": float(low),
            "high": float(high),
        }
    return {
        "contacts": len(ratio),
        "unmatched": int((decoded.read & ~np.isin(decoded.touch, touch)).sum()),
        **shares,
        "sd_N": float(np.median(sd)),
        "sd_factor": float(np.quantile(ratio, 0.9) / NormalDist().inv_cdf(0.95)),
    }


def intervals_text(scores: dict[str, Any]) -> str:
    """One sentence on :func:`interval_scores`, and whether standard deviations are too small."""
    share = scores["within_90"]
    level = round(100.0 * LEVEL)
    text = (
        f"90 % intervals of auto hold {100.0 * share['value']:.0f} % of {scores['contacts']} true "
        f"forces ({level} % interval {100.0 * share['low']:.0f} to {100.0 * share['high']:.0f} %)"
    )
    if scores["contacts"] < CONTACTS_MIN:
        return f"{text}: fewer than {CONTACTS_MIN} contacts do not judge them"
    if share["high"] < COVERAGE_90[0]:
        return (
            f"{text}: its standard deviations are too small for these data, by a factor of "
            f"{scores['sd_factor']:.2g}; train it on data like these"
        )
    if share["low"] > COVERAGE_90[1]:
        return f"{text}: its standard deviations are larger than need be"
    return text
