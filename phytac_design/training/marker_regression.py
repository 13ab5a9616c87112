"""Forces from marker displacements without a model of the sensor, judged on other presses.

Two regressions: ridge on the displacements, and ridge with a Gaussian kernel. Whole episodes are
held out; what is chosen, scaled and measured for the intervals comes from the other episodes alone.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError

ESTIMATORS = ("mean", "ridge", "kernel")
LEVEL = 0.9
"""Probability of the intervals."""
FOLDS = 5


@dataclass(frozen=True, kw_only=True)
class MarkerData:
    """Frames of a sensor.

    Attributes
    ----------
    displacement : (n, k) float
        Displacements of all markers, in any unit.
    wrench : (n, c) float
        Forces, N, or forces and moments.
    episode : (n,) int
        Press that a frame is of.
    """

    displacement: FloatArray
    wrench: FloatArray
    episode: IntArray

    def of(self, rows: IntArray) -> "MarkerData":
        """Some of the frames."""
        return MarkerData(
            displacement=self.displacement[rows],
            wrench=self.wrench[rows],
            episode=self.episode[rows],
        )


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """Held-out figures of one estimator, for each component of the wrench.

    Attributes
    ----------
    mean_error, rms_error : (c,) float
        Of absolute values, N.
    covered : (c,) float
        Share of true values in the intervals of 90 %.
    half_width : (c,) float
        Of the intervals, N, mean over the folds.
    """

    mean_error: FloatArray
    rms_error: FloatArray
    covered: FloatArray
    half_width: FloatArray


Predict = Callable[[FloatArray], FloatArray]
GRID = tuple(10.0 ** np.arange(-8.0, 1.0))
"""Ridge parameters to choose from, as shares of the mean square of the features."""


def fit(estimator: str, data: MarkerData) -> tuple[Predict, FloatArray]:
    """Learn from frames.

    The ridge parameter is that of least error on episodes held out of these frames, and the errors
    there give the intervals.

    Parameters
    ----------
    estimator : str
        One of :data:`ESTIMATORS`.
    data : MarkerData
        Frames.

    Returns
    -------
    predict : callable
        Wrenches (m, c) of displacements (m, k).
    half_width : (c,) float
        Of the intervals, in the wrench's unit.
    """
    errors = np.empty((len(GRID), *data.wrench.shape))
    for held in folds(data.episode):
        own = data.of(np.setdiff1d(np.arange(len(data.wrench)), held))
        for each, predict in zip(errors, _regressions(estimator, own), strict=True):
            each[held] = predict(data.displacement[held]) - data.wrench[held]
    # Rounding makes the deviation of equal numbers more than 0.
    changes = np.ptp(data.wrench, axis=0) > 0.0
    relative = errors[..., changes] / data.wrench[:, changes].std(axis=0)
    best = int(np.argmin((relative**2).mean(axis=(1, 2))))
    half_width = np.quantile(np.abs(errors[best]), LEVEL, axis=0)
    return _regressions(estimator, data)[best], half_width


def folds(episode: IntArray) -> Iterator[IntArray]:
    """Rows that are held out together: every fold has whole episodes."""
    names = np.random.default_rng(0).permutation(np.unique(episode))
    for part in np.array_split(names, min(FOLDS, len(names))):
        yield np.flatnonzero(np.isin(episode, part))


def judge(data: MarkerData) -> dict[str, Judgement]:
    """Held-out errors and intervals of each estimator; ``mean`` knows no displacement.

    Raises
    ------
    InputError
        If there are too few episodes.
    """
    episodes = len(np.unique(data.episode))
    if episodes < 2 * FOLDS:
        raise InputError(
            "marker-episodes-few",
            f"the data have {episodes} episodes; at least {2 * FOLDS} are needed to hold some out",
        )
    return {name: _judged(name, data) for name in ESTIMATORS}


def _judged(estimator: str, data: MarkerData) -> Judgement:
    size, width = np.empty_like(data.wrench), np.empty_like(data.wrench)
    for held in folds(data.episode):
        own = data.of(np.setdiff1d(np.arange(len(data.wrench)), held))
        predict, width[held] = fit(estimator, own)
        size[held] = np.abs(predict(data.displacement[held]) - data.wrench[held])
    return Judgement(
        mean_error=size.mean(axis=0),
        rms_error=np.sqrt((size**2).mean(axis=0)),
        covered=(size <= width).mean(axis=0),
        half_width=width.mean(axis=0),
    )


def _regressions(estimator: str, data: MarkerData) -> list[Predict]:
    """A regression for each ridge parameter of the grid, from one decomposition."""
    level = data.wrench.mean(axis=0)
    if estimator == "mean":
        return [lambda seen: np.broadcast_to(level, (len(seen), len(level)))] * len(GRID)
    centre = data.displacement.mean(axis=0)
    # One scale for all markers: those that do not move carry noise alone.
    scale = float(data.displacement.std()) or 1.0
    known = (data.displacement - centre) / scale
    squares = (known**2).sum(axis=1)
    far = squares[:, None] + squares - 2.0 * known @ known.T
    spread = float(np.median(far)) or 1.0

    def kernel(seen: FloatArray) -> FloatArray:
        own = (seen - centre) / scale
        product = own @ known.T
        if estimator == "ridge":
            return np.asarray(product)
        apart = (own**2).sum(axis=1)[:, None] + squares - 2.0 * product
        return np.asarray(np.exp(-np.maximum(apart, 0.0) / spread))

    values, vectors = np.linalg.eigh(kernel(data.displacement))
    inside = vectors.T @ (data.wrench - level)
    floor = max(float(values.mean()), 1e-300)

    def regression(strength: float) -> Predict:
        damped = np.maximum(values, 0.0) + strength * floor
        weight = vectors @ (inside / damped[:, None])
        return lambda seen: kernel(seen) @ weight + level

    return [regression(strength) for strength in GRID]
