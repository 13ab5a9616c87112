"""Training of a stiffness field: how an uneven print responds otherwise than its design.

A wall that is thicker here and thinner there moves otherwise under a contact at p than the tables
predict: marker m by D_m(p) px more per newton. Samples of known contacts measure sums of it, ::

    residual_m = Σ u_i · D_m(p_i) + noise

with u the force, reduced where the wall stiffens under it. D_m is a Gaussian process (Rasmussen
and Williams 2006, ch. 2) of covariance ``ρ² h_m(p) h_m(q) exp(-|p - q|²/2l²)``, where h is the
tabulated motion of the marker. With few samples D stays near 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.estimation.contact_fit import ShiftNoise
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.training.marker_gain import (
    CrossValidationFold,
    KnownContacts,
    PredictionResiduals,
)
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class StiffnessFieldSettings:
    """Settings of the Gaussian process, chosen on virtual prints."""

    share: float = 0.03
    """ρ: prior standard deviation of D over the motion. It is below the 7 % by which a wall's
    stiffness varies with its thickness (3 % from place to place), as contacts cover an area."""
    length: float = 2.0
    """l over the radius of the tables' disc."""
    model_error: float = 0.06
    """Share of the motion that the tables miss, independently from contact to contact."""
    samples_max: int = 600
    work_max: float = 1e11
    """Largest third power of the number of samples, times the number of markers: computing time."""
    variance_share_min: float = 0.006
    """A sample is used for a marker if D contributes more than this share of its variance. The
    others, a third, change D by a twentieth of the noise and cost half of the time."""
    missing_variance: float = 1e6
    """Variance of a marker that was not found, over the largest of the others."""


SETTINGS = StiffnessFieldSettings()


class StiffnessField:
    """The field D, fitted to samples.

    Parameters
    ----------
    seen : PredictionResiduals
        Residuals of the samples.
    parts : list of CrossValidationFold
        Their folds, with gains.
    pressed : KnownContacts
        Their contacts.
    places : ResponseTable
        The tables.
    noise : ShiftNoise
        Noise of markers.

    Attributes
    ----------
    enabled : bool
        Whether it changes the tables.
    """

    def __init__(
        self,
        seen: PredictionResiduals,
        parts: Sequence[CrossValidationFold],
        pressed: KnownContacts,
        places: ResponseTable,
        noise: ShiftNoise,
    ) -> None:
        rows = np.unique(pressed.row)
        count = int((SETTINGS.work_max / seen.residual_px.shape[1]) ** (1.0 / 3.0))
        count = min(SETTINGS.samples_max, count)
        if len(rows) > count:
            rows = np.sort(np.random.default_rng(0).permutation(rows)[:count])
        mine = np.isin(pressed.row, rows)
        self.places = places
        self._length_mm = SETTINGS.length * places.radius_mm
        self._point = pressed.point_mm[mine]
        self.enabled = len(self._point) > 0
        self._size = _motion_per_newton(places)
        weight = (
            SETTINGS.share * pressed.linear_N[mine, None] * self._size[places.nearest(self._point)]
        )
        residual = np.empty_like(seen.residual_px)
        for part in parts:
            residual[part.rows] = seen.pick(part.rows).after(part.gain)
        known = np.isfinite(residual[:, :, 0]) & ~seen.on
        residual = np.where(known[:, :, None], residual, 0.0)
        at_rest = np.mean((noise.each_px * np.ones(2 * known.shape[1])).reshape(-1, 2) ** 2, axis=1)
        moved = at_rest + SETTINGS.model_error**2 * np.mean(seen.predicted_px**2, axis=2)
        variance = np.where(known, moved, SETTINGS.missing_variance * moved.max(initial=0.0))
        self._weights = self._solve(
            residual[rows],
            variance[rows],
            at_rest,
            weight,
            np.searchsorted(rows, pressed.row[mine]),
            [np.flatnonzero(part.rows[rows]) for part in parts],
        )

    def table(self, *, without_fold: int | None = None) -> ResponseTable:
        """Return the tables of the uneven print, by all samples or by those of all other folds."""
        if not self.enabled:
            return self.places
        rows = self.places.shift_px
        weights = self._weights[0 if without_fold is None else 1 + without_fold]
        correlation = self._correlation(self.places.point_mm).astype(np.float32)
        change = (correlation @ weights.reshape(len(weights), -1)).reshape(len(rows), -1, 2)
        change = SETTINGS.share * self._size[:, :, None].astype(np.float32) * change
        # Where the wall stiffens under load, D counts for less too.
        softer = np.einsum("pkn,pn->pk", rows, rows[:, 0])
        softer /= np.maximum(softer[:, :1], np.float32(1e-30))
        whole = rows + softer[:, :, None] * change.reshape(len(rows), 1, -1)
        return self.places.with_rows(whole)

    def _correlation(self, points_mm: FloatArray) -> FloatArray:
        """Return the correlation (q, c) of D between points (q, 3) and the contacts."""
        gap = np.sum(points_mm**2, axis=1)[:, None] + np.sum(self._point**2, axis=1)
        gap -= 2.0 * points_mm @ self._point.T
        return np.asarray(np.exp(np.maximum(gap, 0.0) / (-2.0 * self._length_mm**2)))

    def _solve(
        self,
        residual: FloatArray,
        variance: FloatArray,
        at_rest: FloatArray,
        weight: FloatArray,
        sample: IntArray,
        groups: Sequence[IntArray],
    ) -> NDArray[np.float32]:
        """Return kernel weights (1 + folds, c, n, 2): by all samples, and without each fold.

        Parameters
        ----------
        residual : (s, n, 2) float
            Residuals, 0 where a marker was not found.
        variance : (s, n) float
            Their variances, px².
        at_rest : (n,) float
            Variances of the rest positions, which all samples share.
        weight : (c, n) float
            Standard deviations of the contacts' contributions.
        sample : (c,) int
            Row of each contact's sample, ascending.
        groups : list of int arrays
            Rows of each fold.
        """
        count, markers = variance.shape
        out = np.zeros((1 + len(groups), len(sample), markers, 2), dtype=np.float32)
        smooth = self._correlation(self._point).astype(np.float32)
        square = np.zeros_like(variance)
        np.add.at(square, sample, weight**2)
        used = square > SETTINGS.variance_share_min * variance
        fold = np.zeros(count, dtype=np.int64)
        for number, group in enumerate(groups):
            fold[group] = number
        for marker in range(markers):
            rows = np.flatnonzero(used[:, marker])
            mine = np.flatnonzero(used[sample, marker])
            if not len(rows):
                continue
            own, at = weight[mine, marker].astype(np.float32), sample[mine]
            first = np.searchsorted(at, rows)
            half = np.add.reduceat(own[:, None] * smooth[np.ix_(mine, mine)], first, axis=0)
            whole = np.add.reduceat(half * own, first, axis=1).astype(np.float64) + at_rest[marker]
            whole[np.diag_indices(len(rows))] += variance[rows, marker]
            each = _solve_without(whole, residual[rows, marker], fold[rows], len(groups))
            out[:, mine, marker] = own[:, None] * each[:, np.searchsorted(rows, at)]
        return out


def _solve_without(
    whole: FloatArray, residual: FloatArray, fold: IntArray, folds: int
) -> NDArray[np.float64]:
    """Return ``whole⁻¹ residual`` (1 + folds, s, 2) of all rows, and of those without each fold."""
    inverse = np.linalg.inv(whole)
    by_all = inverse @ residual
    out = np.tile(by_all, (1 + folds, 1, 1))
    for number in range(folds):
        group = np.flatnonzero(fold == number)
        # Block inversion: the inverse without some rows.
        back = np.linalg.solve(inverse[np.ix_(group, group)], by_all[group])
        out[1 + number] -= inverse[:, group] @ back
    return out


def _motion_per_newton(places: ResponseTable) -> FloatArray:
    """Return the motion (p, n) of markers by a newton around each place, px."""
    first = places.shift_px[:, 0].reshape(len(places.point_mm), -1, 2)
    square = np.sum(first.astype(np.float64) ** 2, axis=2)
    return np.asarray(np.sqrt(np.mean(square[places.fits[0]], axis=1)))
