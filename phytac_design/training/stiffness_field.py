"""How an uneven print answers contacts otherwise than its design, from place to place.

A wall that is thicker here and thinner there moves otherwise under a contact at p than the tables
say: marker m by D_m(p) px more per newton. Samples whose contacts are known tell sums of it, ::

    left_m = Σ u_i · D_m(p_i) + noise

with u the force, less where the wall stiffens under it. D_m is smooth over places, and the larger
where the marker moves more: a Gaussian process (Rasmussen and Williams 2006, ch. 2) of covariance
``ρ² h_m(p) h_m(q) exp(-|p - q|²/2l²)``, h being the size of its motion by the tables. With few
samples D stays near 0.
"""

from collections.abc import Sequence
from copy import copy

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

SHARE = 0.03
"""ρ: share of the motion that D is presumed to be: less than the 7 % by which a wall's stiffness
scatters with its thickness (3 % from place to place), for contacts press on more than one place."""
LENGTH = 2.0
"""l over the radius of the tables' disc."""
ROUGH = 0.06
"""Share of the motion that the tables miss of one contact, and otherwise of the next beside it."""
MOST, WORK = 600, 1e11
"""Samples that are learnt from, and their third power times the number of markers, at most: so
the time grows."""
FAINT = 0.006
"""A sample tells of D where D should move the marker by this share of its variance, squared. The
others, a third, change D by a twentieth of the noise, and take half of the time."""
LOST = 1e6
"""Variance of a marker that was not found, over the largest of those that were."""


class StiffnessField:
    """What samples say of D.

    Parameters
    ----------
    seen : Shown
        The samples by the tables.
    parts : list of CrossValidationFold
        Their parts, with gains that the others told.
    pressed : Pressed
        Their contacts.
    places : Places
        The tables.
    noise : Noise
        Of markers.
    seed : int
        Of the draw, where there are more samples than are learnt from.

    Attributes
    ----------
    speaks : bool
        Whether it changes the tables.
    """

    def __init__(
        self,
        seen: PredictionResiduals,
        parts: Sequence[CrossValidationFold],
        pressed: KnownContacts,
        places: ResponseTable,
        noise: ShiftNoise,
        *,
        seed: int = 0,
    ) -> None:
        rows = np.unique(pressed.row)
        most = min(MOST, int((WORK / seen.left_px.shape[1]) ** (1.0 / 3.0)))
        if len(rows) > most:
            rows = np.sort(np.random.default_rng(seed).permutation(rows)[:most])
        mine = np.isin(pressed.row, rows)
        self.places = places
        self._length_mm = LENGTH * places.radius_mm
        self._point = pressed.point_mm[mine]
        self.speaks = len(self._point) > 0
        self._size = _sizes(places)
        weight = SHARE * pressed.linear_N[mine, None] * self._size[places.nearest(self._point)]
        left = np.empty_like(seen.left_px)
        # Each with gains that it did not tell itself.
        for part in parts:
            left[part.rows] = seen.pick(part.rows).after(part.gain)
        known = np.isfinite(left[:, :, 0]) & ~seen.on
        left = np.where(known[:, :, None], left, 0.0)
        still = np.mean((noise.each_px * np.ones(2 * known.shape[1])).reshape(-1, 2) ** 2, axis=1)
        moved = still + ROUGH**2 * np.mean(seen.explained_px**2, axis=2)
        variance = np.where(known, moved, LOST * moved.max(initial=0.0))
        self._told = self._tell(
            left[rows],
            variance[rows],
            still,
            weight,
            np.searchsorted(rows, pressed.row[mine]),
            [np.flatnonzero(part.rows[rows]) for part in parts],
        )

    def silenced(self) -> "StiffnessField":
        """One that says nothing: its tables are those that were given."""
        out = copy(self)
        out.speaks = False
        return out

    def told(self, *, without: int | None = None) -> ResponseTable:
        """Tables of the uneven print; by all samples, or by those of all other parts."""
        if not self.speaks:
            return self.places
        rows = self.places.shift_px
        told = self._told[0 if without is None else 1 + without]
        alike = self._alike(self.places.point_mm).astype(np.float32)
        change = (alike @ told.reshape(len(told), -1)).reshape(len(alike), -1, 2)
        change = SHARE * self._size[:, :, None].astype(np.float32) * change
        # Where the wall stiffens, what is uneven counts for less too.
        softer = np.einsum("pkn,pn->pk", rows, rows[:, 0])
        softer /= np.maximum(softer[:, :1], np.float32(1e-30))
        whole = rows + softer[:, :, None] * change.reshape(len(rows), 1, -1)
        return self.places.with_rows(whole, self.places.pairs)

    def _alike(self, points_mm: FloatArray) -> FloatArray:
        """How alike D is at points (q, 3) and the contacts, (q, c)."""
        gap = np.sum(points_mm**2, axis=1)[:, None] + np.sum(self._point**2, axis=1)
        gap -= 2.0 * points_mm @ self._point.T
        return np.asarray(np.exp(np.maximum(gap, 0.0) / (-2.0 * self._length_mm**2)))

    def _tell(
        self,
        left: FloatArray,
        variance: FloatArray,
        still: FloatArray,
        weight: FloatArray,
        sample: IntArray,
        groups: Sequence[IntArray],
    ) -> NDArray[np.float32]:
        """What D is made of (1 + parts, c, n, 2): told by all samples, and without each part.

        Parameters
        ----------
        left : (s, n, 2) float
            What the tables leave, 0 where a marker was not found.
        variance : (s, n) float
            Its variance, px².
        still : (n,) float
            That of the markers' rest positions, which all samples share.
        weight : (c, n) float
            Standard deviations of the contacts' parts of it.
        sample : (c,) int
            Rows of ``left`` that contacts are of, in order.
        groups : list of int arrays
            Rows of each part.
        """
        count, markers = variance.shape
        out = np.zeros((1 + len(groups), len(sample), markers, 2), dtype=np.float32)
        smooth = self._alike(self._point).astype(np.float32)
        square = np.zeros_like(variance)
        np.add.at(square, sample, weight**2)
        tells = square > FAINT * variance
        part = np.zeros(count, dtype=np.int64)
        for number, group in enumerate(groups):
            part[group] = number
        for marker in range(markers):
            rows = np.flatnonzero(tells[:, marker])
            mine = np.flatnonzero(tells[sample, marker])
            if not len(rows):
                continue
            own, at = weight[mine, marker].astype(np.float32), sample[mine]
            first = np.searchsorted(at, rows)
            half = np.add.reduceat(own[:, None] * smooth[np.ix_(mine, mine)], first, axis=0)
            whole = np.add.reduceat(half * own, first, axis=1).astype(np.float64) + still[marker]
            whole[np.diag_indices(len(rows))] += variance[rows, marker]
            each = _left_out(whole, left[rows, marker], part[rows], len(groups))
            out[:, mine, marker] = own[:, None] * each[:, np.searchsorted(rows, at)]
        return out


def _left_out(
    whole: FloatArray, left: FloatArray, part: IntArray, parts: int
) -> NDArray[np.float64]:
    """``whole⁻¹ left`` (1 + parts, s, 2): by all of s rows, and by those of all parts but one."""
    inverse = np.linalg.inv(whole)
    by_all = inverse @ left
    out = np.tile(by_all, (1 + parts, 1, 1))
    for number in range(parts):
        group = np.flatnonzero(part == number)
        # The inverse without some rows is told by what they have in it.
        back = np.linalg.solve(inverse[np.ix_(group, group)], by_all[group])
        out[1 + number] -= inverse[:, group] @ back
    return out


def _sizes(places: ResponseTable) -> FloatArray:
    """Motion (p, n) of markers by a newton around each place, px."""
    first = places.shift_px[:, 0].reshape(len(places.point_mm), -1, 2)
    square = np.sum(first.astype(np.float64) ** 2, axis=2)
    return np.asarray(np.sqrt(np.mean(square[places.fits[0]], axis=1)))
