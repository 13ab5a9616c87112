"""Training of a :class:`ForceCorrection` from contacts of known force.

Length scales are those that maximise the marginal likelihood (Rasmussen and Williams 2006,
eq. 5.8); the spread is calibrated on leave-one-out residuals (eq. 5.12).
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from phytac_decoder.estimation.force_correction import ForceCorrection, Lengths, kernel
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class CorrectionSettings:
    """Settings of the fit, chosen on simulated sensors."""

    amplitude: tuple[float, float] = (0.05, 0.5)
    """Bounds of the prior standard deviation of the logarithm; within, that of the data."""
    length_grid: tuple[Lengths, ...] = tuple(
        product((0.33, 0.5, 0.8), (0.33, 0.6, 1.2), (0.33, 0.6))
    )
    length_contacts_max: int = 400
    """Contacts that the length scales are chosen by, at most."""
    share_min: float = 0.01
    """Smallest error of the physics, as a share of the force."""
    iterations: int = 3
    """Iterations of fit and spread."""
    quantile_90: float = 1.6449
    """Half-width of a normal distribution's central 90 %, in standard deviations."""


SETTINGS = CorrectionSettings()


def fit_correction(
    plain: ForceCorrection,
    *,
    point_mm: FloatArray,
    force_N: FloatArray,
    signal_px: FloatArray,
    sd_N: FloatArray,
    truth_N: FloatArray,
    block: IntArray | None = None,
) -> ForceCorrection:
    """Fit a correction to c contacts: estimated places, forces, signals and spread, true forces.

    The spread is set so that 90 % of the true forces lie within the central 90 % interval, or more
    where that of the fit itself is wider. Its residuals leave out each contact with those of its
    ``block`` (c,), the frames of one press. Contacts are weighted by the spread.

    Parameters
    ----------
    plain : ForceCorrection
        Without data: bounding box and largest force.
    """
    own = plain.features(point_mm, force_N, signal_px)
    log = np.clip(np.log(truth_N / force_N), -1.0, 1.0)
    size = float(np.clip(np.quantile(np.abs(log), 0.68), *SETTINGS.amplitude))
    spread, share, lengths = 1.0, SETTINGS.share_min, plain.lengths
    weight = np.zeros(len(log))
    for number in range(SETTINGS.iterations):
        noise = (spread * sd_N / force_N) ** 2 + max(share, SETTINGS.share_min) ** 2
        if number == 1:  # the first iteration has estimated the noise
            lengths = _most_likely_lengths(own, log, noise, size)
        inverse = np.asarray(np.linalg.inv(size**2 * kernel(own, own, lengths) + np.diag(noise)))
        weight = inverse @ log
        residual = _leave_out_residuals(inverse, weight, block)
        error = np.abs(truth_N - force_N * np.exp(log - residual))
        spread, share = fit_spread(error, sd_N, force_N)
    return replace(
        plain,
        centre=own,
        weight=size**2 * weight,
        # Never less than the fit states: data hold no camera that moves, nor contacts elsewhere.
        spread=max(spread, 1.0),
        spread_share=share,
        lengths=lengths,
    )


def _leave_out_residuals(
    inverse: FloatArray, weight: FloatArray, block: IntArray | None
) -> FloatArray:
    """Return the difference of each contact (c,) from the prediction by all other blocks."""
    out = weight / np.diagonal(inverse)
    names, count = np.unique(np.arange(len(out)) if block is None else block, return_counts=True)
    for name in names[count > 1]:
        own = np.flatnonzero(block == name)
        out[own] = np.linalg.solve(inverse[np.ix_(own, own)], weight[own])
    return np.asarray(out)


def _most_likely_lengths(
    own: FloatArray, log: FloatArray, noise: FloatArray, size: float
) -> Lengths:
    """Return the length scales of the largest marginal likelihood, by some of the contacts.

    Parameters
    ----------
    own : (c, 5) float
        Features.
    log, noise : (c,) float
        Logarithms to fit, and the variances of their noise.
    size : float
        Prior standard deviation of the logarithm.
    """
    some = slice(None, None, -(-len(log) // SETTINGS.length_contacts_max))
    own, log, noise = own[some], log[some], noise[some]

    def log_likelihood(lengths: Lengths) -> float:
        root = np.linalg.cholesky(size**2 * kernel(own, own, lengths) + np.diag(noise))
        white = np.linalg.solve(root, log)
        return float(-0.5 * white @ white - np.log(np.diagonal(root)).sum())

    return max(SETTINGS.length_grid, key=log_likelihood)


def fit_spread(error_N: FloatArray, sd_N: FloatArray, force_N: FloatArray) -> tuple[float, float]:
    """Return a factor on standard deviations and a share of the force, for 90 % within 90 %.

    Of all such pairs it is the most likely one under a Laplace distribution of the errors, whose
    tails are heavy.
    """
    best = (np.inf, 1.0, 0.0)
    for factor in np.geomspace(0.5, 4.0, 25):
        scale = _share_for(error_N, factor * sd_N, force_N)
        if scale is None:
            continue
        total = np.hypot(factor * sd_N, scale * force_N)
        # √2: standard deviation of a Laplace distribution over its mean absolute deviation.
        score = float(np.mean(np.log(total) + 2.0**0.5 * error_N / total))
        best = min(best, (score, float(factor), scale))
    if np.isinf(best[0]):
        # The errors are below the smallest factor.
        return float(np.quantile(error_N / sd_N, 0.9)) / SETTINGS.quantile_90, 0.0
    return best[1], best[2]


def _share_for(error_N: FloatArray, sd_N: FloatArray, force_N: FloatArray) -> float | None:
    """Return the share of the force that completes the noise; None where noise is too large."""
    # The level at which a new error lies within as often (conformal prediction, Vovk et al. 2005).
    level = min(0.9 * (len(error_N) + 1) / len(error_N), 1.0)

    def quantile(share: float) -> float:
        return float(np.quantile(error_N / np.hypot(sd_N, share * force_N), level))

    if quantile(0.0) < SETTINGS.quantile_90:
        return None
    low, high = 0.0, 1.0
    for _ in range(30):
        middle = (low + high) / 2.0
        low, high = (middle, high) if quantile(middle) > SETTINGS.quantile_90 else (low, middle)
    return high
