"""Whether the forces and places of a data set belong to its pictures, before it is learnt from.

A force gauge that is stuck, or a log whose rows belong to other pictures, would give a decoder that
is wrong and states narrow intervals.
"""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from phytac_decoder.estimation.locator import ContactLocator
from phytac_design.datasets.samples import FAILED, FLAGGED, Samples
from phytac_design.training.locator_calibration import match_contacts
from phytac_design.training.training_data import DataSet
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError

# Chosen on simulated data sets of five shapes (40 samples each of platform, grips and
# paper-protocol): 70 % of the samples or more match; the scatter is 0.03 to 0.25, and 0.42 for nine
# pads on a flat wall. With forces permuted it is 0.77, with pictures one off 5 % match.
LOOKED_AT = 100
"""Samples that are decoded, spread evenly over the data."""
CONTACTS_MIN = 10
"""Fewer samples or contacts are not judged."""
MATCHED_MIN = 0.2
"""Least share of samples with a switch on in which a contact is found where it was pressed."""
EQUAL_MAX, MOVED_MIN = 0.01, 0.25
"""Forces whose scatter (standard deviation of the logarithm) is below the first are all the same;
the markers contradict that if forces decoded from them scatter by more than the second."""
SCATTER_MAX = 0.6
"""Scatter of decoded over recorded forces from which on they do not belong together."""

FLAGGED_MAX = 0.25
"""Share of flagged samples from which on data are doubtful, as in a log that is imported."""


def flagged_share(sets: Sequence[DataSet]) -> str:
    """Warning if many samples of data sets are flagged, with the usual reason; "" otherwise."""
    total = flagged = 0
    reasons: Counter[str] = Counter()
    for item in sets:
        samples = item.samples
        own = np.flatnonzero(samples.status == FLAGGED)
        total += samples.count
        flagged += len(own)
        reasons.update(reason for k in own.tolist() for reason in samples.why(k))
    if flagged <= FLAGGED_MAX * total:
        return ""
    return (
        f"{flagged} of {total} samples are flagged in the data, most often as: "
        f"{reasons.most_common(1)[0][0]}; do forces, places and pictures belong together?"
    )


def check_agreement(locator: ContactLocator, samples: Samples) -> str:
    """Compare recorded contacts with those that the decoder by design finds.

    Returns
    -------
    str
        A warning if recorded forces do not follow the motion of the markers; "" if they do, or if
        fewer than ``CONTACTS_MIN`` can be compared.

    Raises
    ------
    InputError
        If hardly any contact is found where it was pressed, or all recorded forces are the same
        while those that the markers show are not.
    """
    touches, _, _, bits = samples.points()
    on = np.flatnonzero(bits.any(axis=1) & (samples.status != FAILED))
    if len(on) < CONTACTS_MIN or not len(touches.force_N):
        return ""
    chosen = on[np.unique(np.linspace(0, len(on) - 1, LOOKED_AT).round().astype(np.int64))]
    matches = None
    with suppress(InputError):  # none matches
        matches = match_contacts(locator, samples, chosen)
    found = 0 if matches is None else len(np.unique(touches.sample[matches.touch]))
    if matches is None or found < MATCHED_MIN * len(chosen):
        raise InputError(
            "contacts-elsewhere",
            f"in {len(chosen) - found} of {len(chosen)} samples with a switch on no contact is "
            "found where the data have one pressed: rows and pictures do not belong together; "
            "check the numbers of the frames (one off?), the clock's --offset-s, and the positions "
            "and their frame",
        )
    if len(matches.touch) < CONTACTS_MIN:
        return ""
    recorded, decoded = matches.truth_N, np.maximum(matches.force_N, 1e-6)
    if _scatter(recorded) < EQUAL_MAX and _scatter(decoded) > MOVED_MIN:
        low, high = np.quantile(decoded, (0.1, 0.9))
        raise InputError(
            "forces-all-equal",
            f"the recorded force is {np.median(recorded):.3g} N in all contacts, but the markers "
            f"move as under {low:.2g} to {high:.2g} N: a decoder would learn to read "
            f"{np.median(recorded):.3g} N everywhere; check the force gauge and its column, or, if "
            "every press has the same weight, add presses with another one",
        )
    scatter = _scatter(decoded / recorded)
    if scatter > SCATTER_MAX:
        return (
            "recorded forces do not follow the motion of the markers: those decoded by design "
            f"differ from them by a factor of {np.exp(scatter):.2g} (one standard deviation, of "
            f"{len(recorded)} contacts); check that rows and pictures belong together, and the "
            "force gauge"
        )
    return ""


def _scatter(values: FloatArray) -> float:
    """Robust standard deviation of the logarithm of positive values (c,)."""
    logarithm = np.log(values)
    normal = 1.4826  # standard deviation of a normal distribution over its median deviation
    return normal * float(np.median(np.abs(logarithm - np.median(logarithm))))
