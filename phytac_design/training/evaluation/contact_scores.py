"""Errors of contact forces, with intervals by the bootstrap over samples."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist
from typing import Any

import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

RESAMPLES, LEVEL = 1000, 0.95
METRICS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "relative_error": lambda m: m[0],
    "accuracy": lambda m: 1.0 - m[0],
    "absolute_error_mean_N": lambda m: m[1],
    "absolute_error_sd_N": lambda m: _root(m[3] - m[1] ** 2),
    "rmse_N": lambda m: _root(m[3]),
    "bias_N": lambda m: m[2],
    "error_sd_N": lambda m: _root(m[3] - m[2] ** 2),
}
"""From the means of |e|/F, |e|, e and e² over the contacts."""
MEDIANS = {"relative_error_median": 0, "absolute_error_median_N": 1}
"""Row of |e|/F, |e|, e and e² whose median it is."""


def _root(values: FloatArray) -> FloatArray:
    # Rounding can make a variance of zero negative.
    return np.sqrt(np.maximum(values, 0.0))


def _errors(estimate_N: FloatArray, truth_N: FloatArray) -> FloatArray:
    """Return |e|/F, |e|, e and e² of contacts, (4, c)."""
    error = estimate_N - truth_N
    size = np.abs(error)
    return np.stack([size / truth_N, size, error, error**2])


def error_summary(estimate_N: FloatArray, truth_N: FloatArray) -> dict[str, float]:
    """Return errors of estimated against true forces, (c,) each; NaN without contacts.

    Returns
    -------
    dict
        ``accuracy`` is 1 − ``relative_error``, the mean of |error| / force (paper);
        ``absolute_error_sd_N`` is the standard deviation of |error|, ``error_sd_N`` that of the
        signed error, whose mean is ``bias_N``.
    """
    count = len(estimate_N)
    if count == 0:
        return {"contacts": 0} | dict.fromkeys((*METRICS, *MEDIANS), float("nan"))
    errors = _errors(estimate_N, truth_N)
    means = errors.mean(axis=1)
    return (
        {"contacts": count}
        | {name: float(metric(means)) for name, metric in METRICS.items()}
        | {name: float(np.median(errors[row])) for name, row in MEDIANS.items()}
    )


@dataclass(frozen=True, kw_only=True)
class Bootstrap:
    """Bootstrap over samples: contacts of one sample share its noise and its press.

    Attributes
    ----------
    sample : (c,) int
        Sample of each contact, any numbers.
    seed : int
        Seed of the draws.
    resamples : int
        Draws, with replacement, of as many samples as there are.
    together : int
        Numbers in memory at once while medians are resampled.
    """

    sample: IntArray
    seed: int
    resamples: int = RESAMPLES
    together: int = 2_000_000

    @cached_property
    def groups(self) -> tuple[int, IntArray]:
        """Number of samples that have a contact, and the index of each contact's sample."""
        names, member = np.unique(self.sample, return_inverse=True)
        return len(names), member

    @cached_property
    def weights(self) -> IntArray:
        """Draws of each sample, (resamples, samples); the same for every estimator."""
        count = self.groups[0]
        drawn = np.random.default_rng(self.seed).integers(0, count, (self.resamples, count))
        flat = drawn + count * np.arange(self.resamples)[:, None]
        total = np.bincount(flat.ravel(), minlength=self.resamples * count)
        return total.reshape(self.resamples, count)

    def score(
        self, estimate_N: FloatArray, truth_N: FloatArray, chosen: BoolArray
    ) -> dict[str, Any]:
        """Return errors over the chosen contacts, each with its bootstrap interval.

        Returns
        -------
        dict
            ``contacts``, ``samples``, and by measure ``value``, ``low``, ``high``: the central
            95 % of the resamples; NaN for fewer than two samples.
        """
        plain = error_summary(estimate_N[chosen], truth_N[chosen])
        member = self.groups[1][chosen]
        samples = len(np.unique(member))
        tails = dict.fromkeys(plain, (float("nan"), float("nan")))
        if samples > 1:
            tails |= self._tails(_errors(estimate_N[chosen], truth_N[chosen]), member)
        count = plain.pop("contacts")
        return {"contacts": count, "samples": samples} | {
            name: {"value": value, "low": tails[name][0], "high": tails[name][1]}
            for name, value in plain.items()
        }

    def _tails(self, values: FloatArray, member: IntArray) -> dict[str, tuple[float, float]]:
        """Return intervals by measure, from errors (4, c) of contacts."""
        count = self.groups[0]
        sums = np.stack([np.bincount(member, weights=row, minlength=count) for row in values])
        contacts = self.weights @ np.bincount(member, minlength=count)
        some = contacts > 0
        means = (sums @ self.weights[some].T) / contacts[some]
        drawn = {name: measure(means) for name, measure in METRICS.items()}
        for name, row in MEDIANS.items():
            drawn[name] = np.concatenate(list(self._medians(values[row], member, some)))
        share = 50.0 * (1.0 - LEVEL)
        every = np.stack(list(drawn.values()))
        tails = np.percentile(every, [share, 100.0 - share], axis=1)
        return dict(zip(drawn, map(tuple, tails.T.tolist()), strict=True))

    def _medians(
        self, values: FloatArray, member: IntArray, some: BoolArray
    ) -> Iterator[FloatArray]:
        """Yield medians of the resamples, some at a time."""
        order = np.argsort(values)
        ordered, owner = values[order], member[order]
        step = max(self.together // len(values), 1)
        chosen = self.weights[some]
        for first in range(0, len(chosen), step):
            below = np.cumsum(chosen[first : first + step][:, owner], axis=1)
            half = below[:, -1:] / 2.0
            low, high = (below >= half).argmax(axis=1), (below > half).argmax(axis=1)
            yield (ordered[low] + ordered[high]) / 2.0


def interval_coverage(
    force_N: FloatArray, sd_N: FloatArray, truth_N: FloatArray, *, level: float = 0.9
) -> float:
    """Return the share of true forces inside the intervals of the standard deviations.

    Parameters
    ----------
    force_N, sd_N, truth_N : (c,) float
        Decoded force, its standard deviation, true force.
    level : float
        Nominal coverage: 0.9 spans ±1.645 standard deviations of a normal error.

    Returns
    -------
    float
        Near ``level`` for a calibrated estimator; NaN without contacts.
    """
    if len(force_N) == 0:
        return float("nan")
    reach = NormalDist().inv_cdf(0.5 + level / 2.0) * sd_N
    return float((np.abs(force_N - truth_N) <= reach).mean())
