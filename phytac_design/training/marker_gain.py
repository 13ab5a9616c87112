"""How the markers of one print show the wall's motion: each one's own gain and noise.

A receptor that stands a little aside or is a little longer than designed, before a camera that
stands a little aside, shows a motion of the wall by another 2×2 matrix than the design's, and so
moves in the image by ``(1 + G) e`` where the tables say ``e``. Contacts of known force, place and
size tell G of every marker by ridge regression (Hoerl and Kennard 1970): with few samples it stays
near 0. What is left then is its noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.estimation.contact_fit import initial_state
from phytac_decoder.estimation.contact_shifts import centre_of, predicted_shifts
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.datasets.samples import FAILED, Samples
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

GAIN_SD = 0.02
"""Presumed standard deviation of G's entries."""
MOVED_px = 0.2
"""Markers that should move by more tell their gain."""
LITTLE_px = 1.0
"""Markers that should move by less tell their noise, that of pixels they move over with it."""
SWITCHED_LEAST = 10
"""Fewer markers with a switch that is on tell nothing of their noise."""
LEAST_px = 1e-4
"""No marker is less noisy."""
PRESUMED = 10.0
"""Measurements that what is presumed of a marker's noise counts for."""
PASSES = 2
"""Of gain and spread in turns."""


@dataclass(frozen=True, kw_only=True)
class KnownContacts:
    """Contacts (c) of samples that were looked at, in their order.

    Attributes
    ----------
    row : (c,) int
        Number of the sample among them.
    point_mm : (c, 3) float
        Centre.
    linear_N : (c,) float
        Force by which the markers would move as far, were the wall linear.
    """

    row: IntArray
    point_mm: FloatArray
    linear_N: FloatArray


@dataclass(frozen=True, kw_only=True)
class PredictionResiduals:
    """What the tables say of contacts of known force, place and size, and what is left of it.

    Attributes
    ----------
    explained_px : (s, n, 2) float
        Shifts by the tables.
    left_px : (s, n, 2) float
        Measured shifts less these; NaN where a marker was not found.
    on : (s, n) bool
        Switches that are on: how much paint a tip covers changes with the load.
    """

    explained_px: FloatArray
    left_px: FloatArray
    on: BoolArray

    def pick(self, rows: BoolArray) -> "PredictionResiduals":
        """Some samples (s,) of these."""
        return PredictionResiduals(
            explained_px=self.explained_px[rows], left_px=self.left_px[rows], on=self.on[rows]
        )

    def after(self, gain: FloatArray) -> FloatArray:
        """What is left (s, n, 2) px once markers have their gain (n, 2, 2)."""
        return np.asarray(self.left_px - np.einsum("kab,skb->ska", gain, self.explained_px))


def predict_residuals(
    locator: ContactLocator, samples: Samples, chosen: IntArray, moments_mm2: FloatArray
) -> tuple[PredictionResiduals, KnownContacts]:
    """Look at samples (k,), whose contacts have second moments (c, 3) less those of the disc.

    Of a sample that failed, or that nothing pressed, nothing is explained and nothing left.
    """
    touches, _, shift, bits = samples.points()
    first = np.searchsorted(touches.sample, np.arange(samples.count + 1))
    explained_px = np.zeros((len(chosen), samples.markers, 2))
    left = np.full(explained_px.shape, np.nan)
    by_a_newton = np.linalg.norm(locator.places.shift_px[:, 0], axis=1)
    pressed: list[tuple[int, FloatArray, float]] = []
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
            states[-1].x[3:] = moments_mm2[row]
        for state, (one, _) in zip(states, predicted_shifts(locator.places, states), strict=True):
            total += one
            linear_N = float(np.linalg.norm(one) / by_a_newton[state.place])
            pressed.append((number, centre_of(locator.places, state), linear_N))
        explained_px[number] = total.reshape(-1, 2)
        left[number] = shift[sample] - explained_px[number]
    contacts = KnownContacts(
        row=np.array([number for number, _, _ in pressed], dtype=np.int64),
        point_mm=np.array([point for _, point, _ in pressed]).reshape(-1, 3),
        linear_N=np.array([force for _, _, force in pressed]),
    )
    return PredictionResiduals(explained_px=explained_px, left_px=left, on=bits[chosen]), contacts


def fit_gains(seen: PredictionResiduals) -> FloatArray:
    """G (n, 2, 2) of every marker."""
    known = np.isfinite(seen.left_px[:, :, 0]) & ~seen.on
    e = np.where(known[:, :, None], seen.explained_px, 0.0)
    r = np.where(known[:, :, None], seen.left_px, 0.0)
    by_marker = np.ascontiguousarray(e.transpose(1, 0, 2))
    square = e.transpose(1, 2, 0) @ by_marker
    both = r.transpose(1, 2, 0) @ by_marker
    moved = known & (np.linalg.norm(e, axis=2) > MOVED_px)
    usual = max(float(np.mean(r[moved] ** 2)), LEAST_px**2) if moved.any() else 1.0
    variance = np.full(e.shape[1], usual)
    gain = np.zeros_like(square)
    for _ in range(PASSES):
        ridge = (variance / GAIN_SD**2)[:, None, None] * np.eye(2)
        # A is symmetric: G A = B.
        gain = np.swapaxes(np.linalg.solve(square + ridge, np.swapaxes(both, 1, 2)), 1, 2)
        after = (r - np.einsum("kab,skb->ska", gain, e)) * moved[:, :, None]
        spent = np.sum(after**2, axis=(0, 2)) + PRESUMED * usual
        variance = spent / (2.0 * moved.sum(axis=0) + PRESUMED)
    return np.asarray(gain)


@dataclass(frozen=True, kw_only=True)
class CrossValidationFold:
    """Gains that a part of the samples is looked at with: those that all others told.

    With gains of its own a sample looks better than a new one does.

    Attributes
    ----------
    rows : (s,) bool
        The part.
    gain : (n, 2, 2) float
        Gains.
    """

    rows: BoolArray
    gain: FloatArray


def cross_validation_folds(
    seen: PredictionResiduals, parts: int, sequence: IntArray | None = None
) -> list[CrossValidationFold]:
    """Samples in so many parts.

    Frames of one press are much alike: ``sequence`` (s,) says which samples are, and these stay in
    one part.
    """
    order = np.arange(len(seen.left_px)) if sequence is None else _numbered(sequence)
    part = order % min(parts, int(order.max()) + 1)
    return [
        CrossValidationFold(rows=part == k, gain=fit_gains(seen.pick(part != k)))
        for k in range(int(part.max()) + 1)
    ]


def _numbered(sequence: IntArray) -> IntArray:
    """Sequences (s,) by numbers from 0, in the order in which they come."""
    _, first, own = np.unique(sequence, return_index=True, return_inverse=True)
    place = np.empty(len(first), dtype=np.int64)
    place[np.argsort(first)] = np.arange(len(first))
    return np.asarray(place[own])


def estimate_marker_noise(
    seen: PredictionResiduals, parts: Sequence[CrossValidationFold]
) -> tuple[FloatArray, float | None]:
    """Noise of markers, by what is left of samples with gains that the others told.

    Returns
    -------
    each_px : (2n,) float
        Standard deviation of shifts, as x0, y0, x1, …, of markers that move little.
    switched_px : float or None
        Standard deviation of those of markers whose switch is on; None if too few are.
    """
    after = np.empty_like(seen.left_px)
    for part in parts:
        after[part.rows] = seen.pick(part.rows).after(part.gain)
    found = np.isfinite(after)
    little = np.linalg.norm(seen.explained_px, axis=2) < LITTLE_px
    known = found & (little & ~seen.on)[:, :, None]
    if not known.any():  # a small sensor, pressed hard
        known = found
    square = np.sum(np.where(known, after, 0.0) ** 2, axis=0)
    number = known.sum(axis=0)
    some = number > 0
    usual = float(np.median(square[some] / number[some])) if some.any() else 1.0
    each = np.sqrt((square + PRESUMED * usual) / (number + PRESUMED))
    each = np.maximum(each, LEAST_px)
    on = after[seen.on[:, :, None] & found]
    few = len(on) < 2 * SWITCHED_LEAST
    return each.reshape(-1), None if few else float(np.sqrt(np.mean(on**2)))


def apply_gain(places: ResponseTable, gain: FloatArray) -> ResponseTable:
    """Tables of a sensor whose markers show motion by ``1 + gain`` (n, 2, 2)."""
    pairs = places.pairs
    if pairs is not None:
        pairs = replace(pairs, axes_px=_shown(pairs.axes_px, gain))
    return places.with_rows(_shown(places.shift_px, gain), pairs)


def _shown(images_px: NDArray[np.float32], gain: FloatArray) -> NDArray[np.float32]:
    """Images (…, 2n) with gains (n, 2, 2)."""
    rows = images_px.reshape(*images_px.shape[:-1], -1, 2)
    whole = gain.astype(np.float32) + np.eye(2, dtype=np.float32)
    x, y = rows[..., 0], rows[..., 1]
    shown = np.empty_like(rows)
    for k in range(2):
        np.add(x * whole[:, k, 0], y * whole[:, k, 1], out=shown[..., k])
    return shown.reshape(images_px.shape)
