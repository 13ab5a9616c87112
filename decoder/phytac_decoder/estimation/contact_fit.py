"""Maximum-a-posteriori contacts behind marker shifts, given their number: Gauss-Newton on tables.

A marker that is far off is likely an outlier: a neighbour hides its paint, or something shines
next to it. Once a fit has settled, the cost of such a marker grows only with the logarithm, as
under a distribution with power-law tails (Huber 1981, ch. 7): iteratively reweighted least squares.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property

import numpy as np

from phytac_decoder.camera.camera_motion import CameraMotion, median
from phytac_decoder.estimation.contact_shifts import (
    SHEAR_START,
    UNKNOWNS,
    ContactState,
    predicted_shifts,
)
from phytac_decoder.mechanics.interaction_table import InteractionCache
from phytac_decoder.mechanics.response_table import ResponseTable, axes_turn
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """Settings of the fit, chosen on simulated contacts."""

    iterations_max: int = 8
    step_tolerance: float = 2e-3
    """Change of every force, relative, and of every centre, in cm, below which a fit ends."""
    step_mm: float = 2.0
    step_mm2: float = 4.0
    """Longest steps of centre and moments: the range of the cubic between places."""
    unweighted_iterations: int = 3
    """Iterations in which all markers count fully, so that a poor start rejects none."""
    robust_threshold: float = 2.5
    """Distance of a marker, over the usual one in the frame, from which it is down-weighted."""
    place_distance_max: float = 0.85
    """Largest distance of a contact from a place, in spacings; half a diagonal is 0.71."""
    force_min_N: float = 0.02
    place_sds: float = 2.0
    moments_sds: float = 4.0
    """Distance of a centre, and of moments, from the prior, over its standard deviations, at which
    the prior has half of its weight."""
    prior_growth_max: float = 3.0
    """Largest growth of the prior's variance, less 1: a contact has not left its switches."""
    alike: float = 1.25
    """Factor on predicted noise: errors of neighbouring markers are alike, so that together they
    are worth less. Forces at known places in rendered frames of ``handle`` and ``hemisphere``
    scatter by 1.1 to 1.6 times what independent noise gives."""
    grid_px: float = 0.15
    """Shift of a marker at which half of the variance by the grid of pixels has come: 0.13 px in
    rendered frames of ``hemisphere``, 0.2 px in those of ``handle``, whose pixels differ
    fourfold."""


SETTINGS = FitSettings()


@dataclass(frozen=True, kw_only=True)
class ContactPrior:
    """Prior of a contact before shifts are measured.

    Attributes
    ----------
    place_mm : float
        Standard deviation, along and around, of its centre about the switches that it turned on.
    moments_mm2 : (3,) float
        Means of its second moments xx, xy, yy, less those of the tables' disc.
    moments_sd_mm2 : (3,) float
        Their standard deviations.
    force_N : float
        Standard deviation of its force about 0: no contact is far stronger than the sensor is
        designed for, however weakly markers beside a rim respond.
    shear_sd : float
        Standard deviation of each component of the force along the surface, over the normal force.
    """

    place_mm: float
    moments_mm2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moments_sd_mm2: tuple[float, float, float] = (3.0, 2.0, 3.0)
    force_N: float = 1e3
    shear_sd: float = 0.4


@dataclass(frozen=True, kw_only=True)
class MarkerNoise:
    """Noise of each marker's shift, which grows with the shift.

    Where a marker's paint meets the grid of pixels moves its centroid. At rest that error is the
    same in all frames, and cancels.

    Attributes
    ----------
    still_px, moved_px : (2n,) float
        Standard deviation of each coordinate (x0, y0, x1, …) of a marker that does not move, and
        what is added where it has moved far.
    """

    still_px: FloatArray
    moved_px: FloatArray

    @cached_property
    def squares(self) -> tuple[FloatArray, FloatArray]:
        """Variances (2n,) px² of both."""
        return self.still_px**2, self.moved_px**2

    def variance(self, shift_px: FloatArray) -> FloatArray:
        """Return the variance (2n,) px² of shifts (2n,)."""
        still, moved = self.squares
        share = moved_share(shift_px.reshape(-1, 2))
        return np.asarray(still + (moved.reshape(-1, 2) * share[:, None]).reshape(-1))

    def chi2_at(self, noise_px: float) -> float:
        """Return the reduced χ² of frames with a larger noise, 1 or more; half of them moved."""
        still, moved = self.squares
        return max(float(np.mean(noise_px**2 / (still + 0.5 * moved))), 1.0)


def moved_share(shift_px: FloatArray) -> FloatArray:
    """Return the share (…,) of the variance by the grid of pixels of shifts (…, 2)."""
    size = np.sqrt(shift_px[..., 0] ** 2 + shift_px[..., 1] ** 2)
    return np.asarray(size / (size + SETTINGS.grid_px))


@dataclass(frozen=True, kw_only=True)
class ShiftNoise:
    """Standard deviations of measured shifts about those of the tables.

    Attributes
    ----------
    centroid_px : float
        Usual standard deviation of a coordinate; where that of each marker is known, only that
        which a camera may have.
    share : float
        Further standard deviation as a share of the predicted shift: the tables are not exact.
    switched_px : float
        Further standard deviation of receptors whose red tip is out: it covers paint.
    markers : MarkerNoise, optional
        That of each marker, in place of ``centroid_px``.
    fitted : bool
        It was fitted to a sensor's own data; otherwise predicted by the design's rendered frames.
    """

    centroid_px: float
    share: float = 0.02
    switched_px: float = 0.5
    markers: MarkerNoise | None = None
    fitted: bool = False

    @property
    def each_px(self) -> FloatArray | float:
        """Standard deviation of each coordinate, (2n,), or one for all."""
        return self.markers.still_px if self.markers else self.centroid_px

    @cached_property
    def median_px(self) -> float:
        """Median of these."""
        return float(np.median(self.each_px))

    @property
    def known(self) -> bool:
        """Whether χ² means anything: noise that is neither fitted nor predicted may be far off."""
        return self.markers is not None

    @property
    def alike(self) -> float:
        """Noise that a fit presumes over that of single markers."""
        return SETTINGS.alike if self.markers and not self.fitted else 1.0

    @property
    def chi2_allowed(self) -> float:
        """Reduced χ² of the largest noise that a camera may have."""
        return self.markers.chi2_at(self.centroid_px) if self.markers else 1.0

    def variance(
        self, shift_px: FloatArray, pressed_px: FloatArray, scale: float = 1.0
    ) -> FloatArray:
        """Return the variance (2n,) px² of shifts (2n,), of which contacts make ``pressed_px``.

        ``scale`` is the frame's noise over the usual one.
        """
        own = self.markers.variance(shift_px) if self.markers else self.centroid_px**2
        factor = (scale * self.alike) ** 2
        return np.asarray(factor * own + (self.share * pressed_px) ** 2)

    def scaled(self, factor: float) -> "ShiftNoise":
        """Return noise that is larger by a factor."""
        if self.markers is None:
            return replace(self, centroid_px=factor * self.centroid_px)
        still, moved = self.markers.still_px, self.markers.moved_px
        markers = MarkerNoise(still_px=factor * still, moved_px=factor * moved)
        return replace(self, markers=markers)


@dataclass(frozen=True, kw_only=True)
class ShiftObservation:
    """Shifts of one frame.

    Attributes
    ----------
    shift_px : (2n,) float
        As (x0, y0, x1, y1, …); 0 where a marker was not found.
    found : (2n,) bool
        Where it was found.
    koi : (m,) int
        Markers whose switch is on.
    camera_motion : CameraMotion, optional
        Shifts by motion of the cameras, with its prior in this frame.
    noise_scale : float
        Noise of this frame over the usual one.
    """

    shift_px: FloatArray
    found: BoolArray
    koi: IntArray
    camera_motion: CameraMotion | None = None
    noise_scale: float = 1.0


@dataclass(frozen=True, kw_only=True)
class ContactFit:
    """Fitted contacts.

    Attributes
    ----------
    states : list of ContactState
        The contacts.
    each_px : list of (2n,) float
        Shifts of each, its part of their interactions included.
    pressed_px, predicted_px : (2n,) float
        Their sum, without and with motion of the cameras.
    inverse : (2n,) float
        Weights: the inverse variance of each shift, reduced for outliers, 0 where a marker was not
        found.
    slope : (8c + q, 2n) float
        Derivatives of the shifts by all unknowns, those of the cameras' motion last.
    joint_covariance : (8c + q, 8c + q) float
        Covariance of all unknowns.
    cost : float
        Robust sum of squared residuals and of deviations from the prior.
    reduced_chi2 : float
        The first part per degree of freedom: 1 where noise is as expected.
    residual_cost : float
        The first part.
    motion, motion_sd : (q,) float
        Motion of the cameras since the rest frame, and its standard deviations; part of the
        predicted shifts. See :class:`phytac_decoder.camera.camera_motion.CameraMotion`.
    """

    states: list[ContactState]
    each_px: list[FloatArray]
    pressed_px: FloatArray
    predicted_px: FloatArray
    inverse: FloatArray
    slope: FloatArray
    joint_covariance: FloatArray
    cost: float
    reduced_chi2: float
    residual_cost: float
    motion: FloatArray = field(default_factory=lambda: np.zeros(0))
    motion_sd: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def covariance(self) -> FloatArray:
        """Covariance (8c, 8c) of the contacts' unknowns."""
        split = UNKNOWNS * len(self.states)
        return self.joint_covariance[:split, :split]

    def gain_by(self, rows_px: FloatArray, shift_px: FloatArray, force_sd_N: float) -> float:
        """Return the drop of χ² by forces of any sign with shifts (k, 2n) px per newton.

        By linear theory, with all other unknowns fitted again: Rao's score test.
        """
        weighted = rows_px * self.inverse
        cross = weighted @ self.slope.T
        inner = weighted @ rows_px.T - cross @ self.joint_covariance @ cross.T
        inner[np.diag_indices(len(inner))] += force_sd_N**-2.0
        pull = weighted @ (shift_px - self.predicted_px)
        return float(pull @ np.linalg.solve(inner, pull))


def contact_signal_px(state: ContactState) -> float:
    """Return the shift of all markers together by the first newton, px."""
    t = np.zeros(10)
    x, y = state.x[1:3]
    t[:6] = (1.0, x, y, x * x / 2.0, x * y, y * y / 2.0)
    return float(np.linalg.norm(t.astype(np.float32) @ state.tables[:, 0]))


def initial_state(
    places: ResponseTable,
    prior: ContactPrior,
    point_mm: FloatArray,
    force_N: float,
    *,
    markers: IntArray | None = None,
    place_sd_mm: float | None = None,
) -> ContactState:
    """Return a contact at a point (3,) with a force, to start a fit from."""
    place = int(places.nearest(point_mm[None])[0])
    xy = places.tangent_coordinates([place], point_mm[None])[0]
    tables, shear = places.cubics(place)
    return ContactState(
        place=place,
        x=np.array([force_N, *xy, *prior.moments_mm2, 0.0, 0.0]),
        start_mm=point_mm,
        place_sd_mm=place_sd_mm or prior.place_mm,
        tables=tables,
        shear=shear,
        markers=np.zeros(0, dtype=np.int64) if markers is None else markers,
    )


def fit_contacts(
    places: ResponseTable,
    states: list[ContactState],
    seen: ShiftObservation,
    *,
    prior: ContactPrior,
    noise: ShiftNoise,
    before: ContactFit | None = None,
    unweighted: int = SETTINGS.unweighted_iterations,
    iterations: int = SETTINGS.iterations_max,
) -> ContactFit:
    """Move contacts, of which there may be none, to where they are most likely; changes ``states``.

    All markers count fully in the first ``unweighted`` iterations. A warm start from the frame
    before needs none.

    Parameters
    ----------
    before : ContactFit, optional
        Fit of the same contacts to other shifts, where this one starts.
    """
    camera_motion = seen.camera_motion
    b = before.motion.copy() if before else np.zeros(camera_motion.count if camera_motion else 0)
    split = UNKNOWNS * len(states)
    weight = np.zeros((split + len(b), split + len(b)))
    if camera_motion:
        weight[split:, split:] = camera_motion.prior
    cache = InteractionCache(pairs=places.pairs) if places.pairs else None
    change, robust, parts = np.inf, False, before.each_px if before else []
    for number in range(iterations + 1):
        if before and number == 0:
            pressed, total, slope = before.pressed_px, before.predicted_px, before.slope
        else:
            both = predicted_shifts(places, states, cache)
            parts, slopes = [part for part, _ in both], [each for _, each in both]
            pressed = sum(parts, start=np.zeros(len(seen.shift_px)))
            total = pressed
            if camera_motion:
                total = pressed + camera_motion.shift_px(b)
                slopes.append(camera_motion.first)
            slope = np.concatenate(slopes) if slopes else np.zeros((0, len(total)))
        inverse = inverse_variance(noise, seen, total, pressed)
        residual = seen.shift_px - total
        own = prior_residual(places, states, prior)
        weight[range(split), range(split)] = prior_weight(states, own, prior)
        off = np.concatenate([own, b])
        square, settled = float(residual @ (inverse * residual)), False
        if robust or number >= unweighted or change < SETTINGS.step_tolerance:
            square, share = robust_cost(residual, inverse)
            inverse = inverse * share
            settled = change < SETTINGS.step_tolerance and (robust or bool((share == 1.0).all()))
            robust = True
        # The product of a matrix with its own transpose takes half the time.
        rooted = slope * np.sqrt(inverse)
        hessian = rooted @ rooted.T + weight
        # Ends where everything that is returned has been computed.
        if settled or number == iterations or not len(weight):
            break
        step = np.linalg.solve(hessian, slope @ (inverse * residual) - weight @ off)
        b += step[split:]
        change = take_step(places, states, step[:split])
    covariance = np.asarray(np.linalg.inv(hessian), dtype=np.float64)
    return ContactFit(
        states=states,
        each_px=parts,
        pressed_px=pressed,
        predicted_px=total,
        inverse=inverse,
        slope=slope,
        joint_covariance=covariance,
        cost=square + float(off @ (weight @ off)),
        residual_cost=square,
        reduced_chi2=noise.alike**2 * square / max(int(seen.found.sum()) - split, 1),
        motion=b,
        motion_sd=np.sqrt(covariance.diagonal()[split:]),
    )


def _may_be_far() -> tuple[tuple[slice, float], ...]:
    """Return unknowns that may be far off the prior, and the standard deviations from which."""
    return (
        (slice(1, 3), SETTINGS.place_sds),
        (slice(3, SHEAR_START), SETTINGS.moments_sds),
    )


def _prior_sd(states: Sequence[ContactState], prior: ContactPrior) -> FloatArray:
    """Return the standard deviations (c, 8) of contacts' unknowns."""
    return np.array(
        [
            [
                prior.force_N,
                state.place_sd_mm,
                state.place_sd_mm,
                *prior.moments_sd_mm2,
                prior.shear_sd,
                prior.shear_sd,
            ]
            for state in states
        ]
    ).reshape(-1, UNKNOWNS)


def prior_weight(
    states: Sequence[ContactState], off: FloatArray, prior: ContactPrior
) -> FloatArray:
    """Return the inverse variance (8c,) of contacts' unknowns that are ``off`` (8c,) the prior.

    Hands touch where and with what a prior does not foresee: a rig presses on receptors, with its
    own indenters. Of contacts with a switch, places and moments far off it count less, by Cauchy's
    law (Holland and Welsch 1977).
    """
    weight = _prior_sd(states, prior) ** -2.0
    square = off.reshape(weight.shape) ** 2 * weight
    switched = np.reshape([float(len(state.markers) > 0) for state in states], (-1, 1))
    for own, sds in _may_be_far():
        far = square[:, own].sum(axis=1, keepdims=True) / sds**2
        weight[:, own] /= 1.0 + switched * np.minimum(far, SETTINGS.prior_growth_max)
    return np.asarray(weight.ravel())


def prior_cost(states: Sequence[ContactState], off: FloatArray, prior: ContactPrior) -> FloatArray:
    """Return the robust sum of squared deviations (…, 8c) of contacts from priors, (…, c).

    Its derivative is that with the weights of a fit.
    """
    square = (off.reshape(*off.shape[:-1], -1, UNKNOWNS) / _prior_sd(states, prior)) ** 2
    growth = np.where([len(state.markers) for state in states], SETTINGS.prior_growth_max, 0.0)
    out = square[..., 0] + square[..., SHEAR_START:].sum(axis=-1)
    for own, sds in _may_be_far():
        total = square[..., own].sum(axis=-1)
        near = np.minimum(total / sds**2, growth)
        out += sds**2 * np.log1p(near) + (total - near * sds**2) / (1.0 + near)
    return np.asarray(out)


def inverse_variance(
    noise: ShiftNoise, seen: ShiftObservation, shift_px: FloatArray, pressed_px: FloatArray
) -> FloatArray:
    """Return the inverse variance (2n,) of shifts; 0 where a marker was not found."""
    variance = noise.variance(shift_px, pressed_px, seen.noise_scale)
    variance[np.concatenate([2 * seen.koi, 2 * seen.koi + 1])] += noise.switched_px**2
    return np.where(seen.found, 1.0 / variance, 0.0)


def robust_cost(residual_px: FloatArray, inverse: FloatArray) -> tuple[float, FloatArray]:
    """Return the robust sum of squares, and the share (2n,) of its weight that a marker keeps.

    Parameters
    ----------
    residual_px : (2n,) float
        Residuals.
    inverse : (2n,) float
        Inverse variances; 0 for a marker that was not found.
    """
    square = (inverse * residual_px**2).reshape(-1, 2).sum(axis=1)
    usual = median(square[inverse[::2] > 0.0]) if np.any(inverse) else 0.0
    # 2: the expected sum over two coordinates.
    limit = SETTINGS.robust_threshold**2 * max(usual, 2.0)
    over = np.maximum(square / limit, 1.0)
    total = float(np.sum(np.minimum(square, limit) + limit * np.log(over)))
    return total, np.repeat(1.0 / over, 2)


def prior_residual(
    places: ResponseTable, states: Sequence[ContactState], prior: ContactPrior
) -> FloatArray:
    """Return the deviation of contacts from their priors, (8c,)."""
    if not states:
        return np.zeros(0)
    x = np.array([state.x for state in states])
    starts = np.array([state.start_mm for state in states])
    own = [state.place for state in states]
    off = x.copy()
    off[:, 1:3] = x[:, 1:3] - places.tangent_coordinates(own, starts)
    off[:, 3:SHEAR_START] -= np.array(prior.moments_mm2)
    return off.reshape(-1)


@cache
def _longest_step() -> FloatArray:
    """Return the longest step (8,) of a contact's unknowns."""
    return np.repeat([np.inf, SETTINGS.step_mm, SETTINGS.step_mm2, np.inf], (1, 2, 3, 2))


def take_step(places: ResponseTable, states: Sequence[ContactState], step: FloatArray) -> float:
    """Take a bounded step; return its size, see ``step_tolerance``."""
    if not states:
        return 0.0
    longest = _longest_step()
    old = np.array([state.x for state in states])
    new = old + np.minimum(np.maximum(step.reshape(-1, UNKNOWNS), -longest), longest)
    force = old[:, 0]
    force_min = np.maximum(0.3 * force, SETTINGS.force_min_N)
    new[:, 0] = np.minimum(np.maximum(new[:, 0], force_min), 3.0 * force + 1.0)
    moved_cm = np.abs(new[:, 1:3] - old[:, 1:3]).max(axis=1) / 10.0
    changed = np.abs(new[:, 0] - force) / np.maximum(force, 0.5)
    own = [state.place for state in states]
    points = places.point_mm[own] + new[:, 1:2] * places.along[own]
    points += new[:, 2:3] * places.around[own]
    nearest = places.nearest(points)
    for state, place, point, x in zip(states, nearest.tolist(), points, new, strict=True):
        if place != state.place:
            x[SHEAR_START:] = (
                axes_turn(places.axes[place], places.axes[state.place]) @ x[SHEAR_START:]
            )
            state.place, (state.tables, state.shear) = place, places.cubics(place)
            x[1:3] = places.tangent_coordinates([place], point[None])[0]
        # Farther from a place there is no surface: the contact would lie beyond a rim.
        far = float(np.hypot(*x[1:3])) / (SETTINGS.place_distance_max * places.spacing_mm)
        if far > 1.0:
            x[1:3] /= far
        state.x = x
    return float(max(moved_cm.max(), changed.max()))
