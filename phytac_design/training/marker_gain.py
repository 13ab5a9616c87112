"""Training of marker gains: how each marker of one print shows the wall's motion.

A receptor that is a little off its design, before a camera that is a little off, shows a motion of
the wall by another 2×2 matrix than the design's. It moves in the image by ``(1 + G) e`` where the
tables predict ``e``. Contacts of known force, place and size determine G of every marker by ridge
regression (Hoerl and Kennard 1970): with few samples it stays near 0. The residual is its noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.estimation.contact_fit import MarkerNoise, initial_state, moved_share
from phytac_decoder.estimation.contact_shifts import SHEAR_START, centre_of, predicted_shifts
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.datasets.samples import FAILED, REAL, Samples
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class MarkerGainSettings:
    """Priors of the fit, chosen on virtual prints."""

    gain_sd: float = 0.02
    """Standard deviation of G's entries."""
    noise_min_px: float = 1e-4
    still_min: float = 0.01
    """Least variance of a marker that does not move, over the usual one."""
    noise_iterations: int = 20
    """Of still and moved markers in turns; the last ones change neither by a thousandth."""
    prior_count: float = 10.0
    """Weight of the prior of a marker's noise, in measurements."""


SETTINGS = MarkerGainSettings()


@dataclass(frozen=True, kw_only=True)
class KnownContacts:
    """Contacts (c) of chosen samples, in their order.

    Attributes
    ----------
    row : (c,) int
        Number of the sample among the chosen ones.
    point_mm : (c, 3) float
        Centre.
    linear_N : (c,) float
        Force by which a linear wall would move the markers as far.
    touch : (c,) int
        Row of the contact in the samples' touches.
    """

    row: IntArray
    touch: IntArray
    point_mm: FloatArray
    linear_N: FloatArray


@dataclass(frozen=True, kw_only=True)
class PredictionResiduals:
    """Predictions of the tables for known contacts, and their residuals.

    Attributes
    ----------
    predicted_px : (s, n, 2) float
        Predicted shifts.
    residual_px : (s, n, 2) float
        Measured minus predicted shifts; NaN where a marker was not found.
    on : (s, n) bool
        Switches that are on: the paint that a tip covers changes with the load.
    """

    predicted_px: FloatArray
    residual_px: FloatArray
    on: BoolArray

    def pick(self, rows: BoolArray) -> "PredictionResiduals":
        """Return some of the samples (s,)."""
        return PredictionResiduals(
            predicted_px=self.predicted_px[rows],
            residual_px=self.residual_px[rows],
            on=self.on[rows],
        )

    def after(self, gain: FloatArray) -> FloatArray:
        """Return the residuals (s, n, 2) px with gains (n, 2, 2)."""
        return np.asarray(self.residual_px - np.einsum("kab,skb->ska", gain, self.predicted_px))


@dataclass(frozen=True, kw_only=True)
class CrossValidationFold:
    """Some of the samples, and the gains fitted to all others.

    Attributes
    ----------
    rows : (s,) bool
        Samples of the fold.
    gain : (n, 2, 2) float
        Gains.
    """

    rows: BoolArray
    gain: FloatArray


def predict_residuals(
    locator: ContactLocator, samples: Samples, chosen: IntArray, moments_mm2: FloatArray
) -> tuple[PredictionResiduals, KnownContacts]:
    """Compare the chosen samples (k,) with the tables.

    Samples that failed or have no contact have no prediction and NaN as residuals.

    Parameters
    ----------
    moments_mm2 : (c, 3) float
        Second moments of all contacts, less those of the tables' disc.
    """
    touches, _, shift, bits = samples.points()
    first = np.searchsorted(touches.sample, np.arange(samples.count + 1))
    predicted = np.zeros((len(chosen), samples.markers, 2))
    residual = np.full(predicted.shape, np.nan)
    per_newton = np.linalg.norm(locator.places.shift_px[:, 0], axis=1)
    known: list[tuple[int, int, FloatArray, float]] = []
    for number, sample in enumerate(chosen):
        rows = np.arange(first[sample], first[sample + 1])
        rows = rows[touches.force_N[rows] > 0.0]
        if samples.status[sample] == FAILED or len(rows) == 0:
            continue
        total = np.zeros(2 * samples.markers)
        states = []
        for row in rows:
            force = float(touches.force_N[row])
            states.append(
                initial_state(locator.places, locator.prior, touches.point_mm[row], force)
            )
            states[-1].x[3:SHEAR_START] = moments_mm2[row]
            states[-1].x[SHEAR_START:] = touches.friction[row]
        parts = predicted_shifts(locator.places, states)
        for row, state, (one, _) in zip(rows.tolist(), states, parts, strict=True):
            total += one
            linear_N = float(np.linalg.norm(one) / per_newton[state.place])
            known.append((number, row, centre_of(locator.places, state), linear_N))
        # A rig that measures one axis leaves the force along the surface unknown.
        if samples.theory[sample] == REAL and not np.any(touches.friction[rows]):
            slope = np.concatenate([slope[SHEAR_START:] for _, slope in parts])
            total += _sheared_px(locator, total, slope, shift[sample].reshape(-1), bits[sample])
        predicted[number] = total.reshape(-1, 2)
        residual[number] = shift[sample] - predicted[number]
    contacts = KnownContacts(
        row=np.array([number for number, *_ in known], dtype=np.int64),
        touch=np.array([touch for _, touch, *_ in known], dtype=np.int64),
        point_mm=np.array([point for *_, point, _ in known]).reshape(-1, 3),
        linear_N=np.array([force for *_, force in known]),
    )
    return PredictionResiduals(
        predicted_px=predicted, residual_px=residual, on=bits[chosen]
    ), contacts


def _sheared_px(
    locator: ContactLocator,
    total_px: FloatArray,
    slope: FloatArray,
    shift_px: FloatArray,
    on: BoolArray,
) -> FloatArray:
    """Return the shifts (2n,) by unknown force along the surface, as far as the samples show it.

    Parameters
    ----------
    total_px : (2n,) float
        Shifts by normal forces.
    slope : (2c, 2n) float
        Shifts by the force along the surface, over the normal force, of each contact.
    shift_px : (2n,) float
        Measured shifts, NaN where a marker was not found.
    on : (n,) bool
        Switches that are on.
    """
    noise = locator.noise
    variance = noise.each_px**2 + (noise.share * total_px) ** 2
    variance += np.repeat(on, 2) * noise.switched_px**2
    found = np.isfinite(shift_px)
    weighed = slope * np.where(found, 1.0 / variance, 0.0)
    prior = np.eye(len(slope)) / locator.prior.shear_sd**2
    residual = np.where(found, shift_px - total_px, 0.0)
    return np.asarray(np.linalg.solve(weighed @ slope.T + prior, weighed @ residual) @ slope)


def fit_gains(seen: PredictionResiduals) -> FloatArray:
    """Return G (n, 2, 2) of every marker."""
    known = np.isfinite(seen.residual_px[:, :, 0]) & ~seen.on
    e = np.where(known[:, :, None], seen.predicted_px, 0.0)
    r = np.where(known[:, :, None], seen.residual_px, 0.0)
    by_marker = np.ascontiguousarray(e.transpose(1, 0, 2))
    square = e.transpose(1, 2, 0) @ by_marker
    both = r.transpose(1, 2, 0) @ by_marker
    # Only markers that move by more than this determine the noise of the fit.
    moved = known & (np.linalg.norm(e, axis=2) > 0.2)
    usual = max(float(np.mean(r[moved] ** 2)), SETTINGS.noise_min_px**2) if moved.any() else 1.0
    variance = np.full(e.shape[1], usual)
    gain = np.zeros_like(square)
    for _ in range(2):  # gain and variance in turns
        ridge = (variance / SETTINGS.gain_sd**2)[:, None, None] * np.eye(2)
        # A is symmetric: G A = B.
        gain = np.swapaxes(np.linalg.solve(square + ridge, np.swapaxes(both, 1, 2)), 1, 2)
        after = (r - np.einsum("kab,skb->ska", gain, e)) * moved[:, :, None]
        total = np.sum(after**2, axis=(0, 2)) + SETTINGS.prior_count * usual
        variance = total / (2.0 * moved.sum(axis=0) + SETTINGS.prior_count)
    return np.asarray(gain)


def cross_validation_folds(
    seen: PredictionResiduals, folds: int, sequence: IntArray | None = None
) -> list[CrossValidationFold]:
    """Divide samples into so many folds; samples of one ``sequence`` (s,) stay in one fold.

    Frames of one press are much alike: they would validate each other too well.
    """
    number = np.arange(len(seen.residual_px))
    if sequence is not None:
        # Sequences counted in the order in which they first appear.
        _, first, own = np.unique(sequence, return_index=True, return_inverse=True)
        number = np.argsort(np.argsort(first))[own]
    fold = number % min(folds, int(number.max()) + 1)
    return [
        CrossValidationFold(rows=fold == k, gain=fit_gains(seen.pick(fold != k)))
        for k in range(int(fold.max()) + 1)
    ]


def estimate_marker_noise(
    seen: PredictionResiduals, folds: Sequence[CrossValidationFold], moved_px: FloatArray
) -> tuple[MarkerNoise, float | None]:
    """Estimate the noise of markers from residuals with gains of the other folds.

    Parameters
    ----------
    moved_px : (2n,) float
        What the design adds for a marker that has moved far, in proportion.

    Returns
    -------
    noise : MarkerNoise
        That of markers whose switch is off.
    switched_px : float or None
        The same of markers whose switch is on; None if fewer than ten are.
    """
    after = np.empty_like(seen.residual_px)
    for fold in folds:
        after[fold.rows] = seen.pick(fold.rows).after(fold.gain)
    found = np.isfinite(after)
    # Below a pixel: the noise includes that of the pixels which a marker moves over.
    little = np.linalg.norm(seen.predicted_px, axis=2) < 1.0
    known = found & (little & ~seen.on)[:, :, None]
    if not known.any():  # a small sensor under large forces
        known = found
    square = np.where(known, after, 0.0) ** 2
    share = moved_share(seen.predicted_px)[:, :, None]
    grid = np.where(known, share * moved_px.reshape(-1, 2) ** 2, 0.0)
    still, growth = np.ones(square.shape[1:]), 0.0
    for _ in range(SETTINGS.noise_iterations):
        # A measurement says the less of a variance, the larger it is.
        weight = np.where(known, (still / (still + growth * grid)) ** 2, 0.0)
        total, number = np.sum(weight * (square - growth * grid), axis=0), weight.sum(axis=0)
        some = number > 0.0
        usual = max(float(np.median(total[some] / number[some])), 0.0) if some.any() else 1.0
        still = (total + SETTINGS.prior_count * usual) / (number + SETTINGS.prior_count)
        still = np.maximum(still, max(SETTINGS.still_min * usual, SETTINGS.noise_min_px**2))
        weighted = np.where(known, grid / (still + growth * grid) ** 2, 0.0)
        excess = float(np.sum(weighted * (square - still)))
        growth = max(excess, 0.0) / max(float(np.sum(weighted * grid)), 1e-12)
    noise = MarkerNoise(still_px=np.sqrt(still).reshape(-1), moved_px=np.sqrt(growth) * moved_px)
    on = after[seen.on[:, :, None] & found]
    switched = float(np.sqrt(np.mean(on**2))) if len(on) >= 20 else None  # two coordinates each
    return noise, switched


def apply_gain(places: ResponseTable, gain: FloatArray) -> ResponseTable:
    """Return the tables of a sensor whose markers show motion by ``1 + gain`` (n, 2, 2)."""
    pairs = places.pairs
    if pairs is not None:
        pairs = replace(pairs, axes_px=_with_gain(pairs.axes_px, gain))
    shear = places.shear
    if shear is not None:
        shear = shear.with_rows(_with_gain(shear.shift_px, gain))
    return places.with_rows(_with_gain(places.shift_px, gain), pairs=pairs, shear=shear)


def _with_gain(images_px: NDArray[np.float32], gain: FloatArray) -> NDArray[np.float32]:
    """Return images (…, 2n) with gains (n, 2, 2)."""
    rows = images_px.reshape(*images_px.shape[:-1], -1, 2)
    whole = gain.astype(np.float32) + np.eye(2, dtype=np.float32)
    x, y = rows[..., 0], rows[..., 1]
    out = np.empty_like(rows)
    for k in range(2):
        np.add(x * whole[:, k, 0], y * whole[:, k, 1], out=out[..., k])
    return out.reshape(images_px.shape)
