"""What a sensor's own data say about forces: a smooth correction, and an honest spread.

Physics leaves errors that vary slowly with place and force (a wall that is thicker here than
there, tables that end at the third power). Their logarithm is learnt by kernel ridge regression,
which is the mean of a Gaussian process (Rasmussen and Williams 2006, eq. 2.25): far from all data
it is 0, and few data say little. How fast it varies with place, force and signal is what makes the
data likeliest.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray

AMPLITUDE, AMPLITUDE_MAX = 0.05, 0.5
"""Least and greatest standard deviation of the logarithm that is presumed: that of the data."""
Lengths = tuple[float, float, float]
"""Length scales of place (over the sensor's size), force (over the greatest) and signal."""
LENGTH = 0.33
"""All of them up to schema 1.6, and while the noise is not known yet."""
LENGTHS: tuple[Lengths, ...] = tuple(product((0.33, 0.5, 0.8), (0.33, 0.6, 1.2), (0.33, 0.6)))
"""Those that are looked at."""
LIKELY_BY = 400
"""Contacts by which they are chosen, at most."""
SIGNAL_SCALE, SIGNAL_LEAST = 0.4, 1e-6
"""Factor on the logarithm of the signal, and its least, px/N."""
SHARE = 0.01
"""Least error of physics, as a share of the force."""
PASSES = 3
"""Rounds of weighing contacts by how well they turn out to be known."""
FACTORS = np.geomspace(0.5, 4.0, 25)
"""Factors on standard deviations that are looked at."""
LAPLACE = 2.0**0.5
"""Standard deviation of a Laplace distribution, over its mean absolute deviation."""
QUANTILE_90 = 1.6449
"""Half-width of a normal distribution's central 90 %, in standard deviations."""


@dataclass(frozen=True, kw_only=True)
class ForceCorrection:
    """Factor on forces by place and force; arrays run over m contacts that it was learnt from.

    Attributes
    ----------
    centre : (m, 5) float
        Features, see :meth:`features`.
    weight : (m,) float
        Of each.
    low_mm, size_mm : (3,) float, float
        Corner of the sensor's box, and its largest side.
    force_max_N : float
        Greatest force.
    spread : float
        Factor on standard deviations.
    spread_share : float
        Standard deviation besides, as a share of the force.
    lengths : (3,) float
        How far the features reach, see :data:`Lengths`.
    """

    centre: FloatArray
    weight: FloatArray
    low_mm: FloatArray
    size_mm: float
    force_max_N: float
    spread: float = 1.0
    spread_share: float = 0.0
    lengths: Lengths = (LENGTH, LENGTH, LENGTH)

    @classmethod
    def plain(cls, *, low_mm: FloatArray, size_mm: float, force_max_N: float) -> "ForceCorrection":
        """One that has learnt nothing: all factors are 1."""
        return cls(
            centre=np.zeros((0, 5)),
            weight=np.zeros(0),
            low_mm=low_mm,
            size_mm=size_mm,
            force_max_N=force_max_N,
        )

    def features(
        self, point_mm: FloatArray, force_N: FloatArray, signal_px: FloatArray
    ) -> FloatArray:
        """Features (c, 5) of contacts at points (c, 3): place over size, force over the most.

        The fifth is the logarithm of the signal (c,), px per newton over all markers: it fades
        towards the rims, where errors change within millimetres.
        """
        place = (point_mm - self.low_mm) / self.size_mm
        faint = SIGNAL_SCALE * np.log(np.maximum(signal_px, SIGNAL_LEAST))
        return np.column_stack([place, force_N / self.force_max_N, faint])

    def factor(
        self, point_mm: FloatArray, force_N: FloatArray, signal_px: FloatArray
    ) -> FloatArray:
        """Factor (c,) on forces."""
        if len(self.weight) == 0:
            return np.ones(len(force_N))
        own = self.features(point_mm, force_N, signal_px)
        return np.asarray(np.exp(kernel(own, self.centre, self.lengths) @ self.weight))

    def spread_N(self, force_N: FloatArray, sd_N: FloatArray) -> FloatArray:
        """Standard deviations (c,) of corrected forces."""
        return np.asarray(np.hypot(self.spread * sd_N, self.spread_share * force_N))


def kernel(a: FloatArray, b: FloatArray, lengths: Lengths) -> FloatArray:
    """Squared-exponential correlation (p, q) of features (p, 5), (q, 5)."""
    place, force, signal = lengths
    scale = np.array([place, place, place, force, signal])
    a, b = a / scale, b / scale
    gap = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * (a @ b.T)
    return np.asarray(np.exp(-0.5 * np.maximum(gap, 0.0)))


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
    """Learn from c contacts: fitted places, forces, signals and spread, and the truth.

    The spread is set so that 90 % of the truths lie within the central 90 %, by residuals that
    leave each contact out (ibid., eq. 5.12), with those of its ``block`` (c,), which are frames of
    one press; and contacts weigh by it.

    Parameters
    ----------
    plain : Correction
        Without data: box and greatest force.
    """
    own = plain.features(point_mm, force_N, signal_px)
    log = np.clip(np.log(truth_N / force_N), -1.0, 1.0)
    size = float(np.clip(np.quantile(np.abs(log), 0.68), AMPLITUDE, AMPLITUDE_MAX))
    spread, share, lengths = 1.0, SHARE, plain.lengths
    weight = np.zeros(len(log))
    for number in range(PASSES):
        noise = (spread * sd_N / force_N) ** 2 + max(share, SHARE) ** 2
        if number == 1:  # the first pass has told the noise
            lengths = _likeliest(own, log, noise, size)
        inverse = np.asarray(np.linalg.inv(size**2 * kernel(own, own, lengths) + np.diag(noise)))
        weight = inverse @ log
        left = _left_out(inverse, weight, block)
        error = np.abs(truth_N - force_N * np.exp(log - left))
        spread, share = fit_spread(error, sd_N, force_N)
    return ForceCorrection(
        centre=own,
        weight=size**2 * weight,
        low_mm=plain.low_mm,
        size_mm=plain.size_mm,
        force_max_N=plain.force_max_N,
        spread=spread,
        spread_share=share,
        lengths=lengths,
    )


def _left_out(inverse: FloatArray, weight: FloatArray, block: IntArray | None) -> FloatArray:
    """How far each contact (c,) is from what those of other blocks say of it."""
    left = weight / np.diagonal(inverse)
    names, count = np.unique(np.arange(len(left)) if block is None else block, return_counts=True)
    for name in names[count > 1]:
        own = np.flatnonzero(block == name)
        left[own] = np.linalg.solve(inverse[np.ix_(own, own)], weight[own])
    return np.asarray(left)


def _likeliest(own: FloatArray, log: FloatArray, noise: FloatArray, size: float) -> Lengths:
    """Length scales that make the data likeliest (ibid., eq. 5.8), by some of the contacts.

    Parameters
    ----------
    own : (c, 5) float
        Features.
    log, noise : (c,) float
        What is to be learnt of each, and the variance of its noise.
    size : float
        Presumed standard deviation of what is to be learnt.
    """
    some = slice(None, None, -(-len(log) // LIKELY_BY))
    own, log, noise = own[some], log[some], noise[some]

    def evidence(lengths: Lengths) -> float:
        root = np.linalg.cholesky(size**2 * kernel(own, own, lengths) + np.diag(noise))
        told = np.linalg.solve(root, log)
        return float(-0.5 * told @ told - np.log(np.diagonal(root)).sum())

    return max(LENGTHS, key=evidence)


def fit_spread(error_N: FloatArray, sd_N: FloatArray, force_N: FloatArray) -> tuple[float, float]:
    """Factor on standard deviations, and share of the force, for 90 % of errors within 90 %.

    Of all such pairs the likeliest, with errors as Laplace has them: some are far larger than
    most.
    """
    best = (np.inf, 1.0, 0.0)
    for factor in FACTORS:
        scale = _share_for(error_N, factor * sd_N, force_N)
        if scale is None:
            continue
        total = np.hypot(factor * sd_N, scale * force_N)
        score = float(np.mean(np.log(total) + LAPLACE * error_N / total))
        best = min(best, (score, float(factor), scale))
    if np.isinf(best[0]):
        # Errors are below the least noise looked at.
        return float(np.quantile(error_N / sd_N, 0.9)) / QUANTILE_90, 0.0
    return best[1], best[2]


def _share_for(error_N: FloatArray, sd_N: FloatArray, force_N: FloatArray) -> float | None:
    """Share of the force that makes up for what noise does not; None where noise is too much."""
    # So that a new one lies within as often (conformal prediction, Vovk et al. 2005).
    level = min(0.9 * (len(error_N) + 1) / len(error_N), 1.0)

    def quantile(share: float) -> float:
        return float(np.quantile(error_N / np.hypot(sd_N, share * force_N), level))

    if quantile(0.0) < QUANTILE_90:
        return None
    low, high = 0.0, 1.0
    for _ in range(30):
        middle = (low + high) / 2.0
        low, high = (middle, high) if quantile(middle) > QUANTILE_90 else (low, middle)
    return high
