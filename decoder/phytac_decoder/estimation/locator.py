"""The estimator ``auto``: how many contacts there are, and force, place and extent of each.

Each group of neighbouring switches that are on starts a contact. The unknowns of a contact are its
force, its centre and its second moments (:mod:`contact_shifts`), with a prior. The
residual is then searched for unswitched contacts: the place whose response explains most of it is
added, as long as the fit improves by more than noise would. A switch that the camera cannot read
neither starts a contact nor excludes one; where only such switches are pressed, the motion of the
markers decides alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera_motion import CameraMotion
from phytac_decoder.estimation import contact_fit
from phytac_decoder.estimation.contact_estimates import ContactDetection, FitState, LocatedContact
from phytac_decoder.estimation.contact_fit import (
    ContactFit,
    ContactPrior,
    ShiftNoise,
    ShiftObservation,
    contact_signal_px,
    fit_contacts,
    initial_state,
)
from phytac_decoder.estimation.contact_grouping import assign_to_contacts, group_key_nodes
from phytac_decoder.estimation.contact_shifts import (
    SHEAR_START,
    UNKNOWNS,
    ContactState,
    centre_of,
    changed_by_others,
)
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.friction_prior import SHEAR_SPREAD, average_over_friction
from phytac_decoder.estimation.nonnegative import nonnegative_least_squares
from phytac_decoder.estimation.place_average import INTERVAL_SDS, PlaceAverage
from phytac_decoder.mechanics.response_table import END_POWER_MAX, ResponseTable
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.discs import cut_disc_centroid, disc_overlap_share


@dataclass(frozen=True, kw_only=True)
class LocatorSettings:
    """Settings of the search for contacts, chosen on simulated contacts and virtual prints."""

    separate_max: int = 20
    """Most contacts with switches: twice the fingers of two hands. More groups of switches are an
    error of the picture (in another light than the rest frame's, half of all switches may seem on),
    and 50 contacts take ten seconds: switches of the strongest groups are read. Groups are not
    divided into more, either."""
    unswitched_max: int = 4
    """Largest number of contacts without a switch."""
    chi2_drop: float = 40.0
    """Drop of χ² for which a contact is accepted. That is six standard deviations, because the
    errors of the tables look like contacts to quiet markers."""
    tentative_chi2_drop: float = 20.0
    """Drop of χ² for which a contact is fitted with the others, so that they do not take its
    force, but not reported; on sensors with an interaction table."""
    foreseen_share: float = 0.6
    """Share of the demanded drop of χ² that linear theory must foresee for a fit to be tried. Of
    300 fits that were tried in films, it foresaw 0.7 to 1.5 times the drop of those accepted, and
    0.6 times at least where the drop was a fifth of the demanded one or more. While a part of the
    motion is unexplained, that share is enough for an unswitched one, too."""
    untaken_min: float = 0.1
    """Share of the signal of a contact that others leave, at least, where it is searched for:
    a fit that has not quite settled leaves a residual where they take nearly all."""
    foreseen_places: int = 10
    """Places around the start of a contact on which it is foreseen."""
    chi2_unexplained: float = 1.15
    """Reduced χ² from which on a part of the motion is unexplained."""
    force_sd_min: float = 5.0
    unreadable_sd_min: float = 3.0
    """Standard deviations by which the force of an unswitched contact must exceed 0, and that of a
    contact all of whose switches are unreadable: they seem on in another light."""
    hidden_sd_min: float = 2.0
    """The same for a contact on unreadable switches that may be there, and is not reported."""
    idle_sd_min: float = 3.0
    """Standard deviations by which a marker has moved where a contact may be without any switch."""
    threshold_excess_max: float = 2.0
    """Largest force on a switch that is off, over its threshold: prints scatter."""
    threshold_spread: float = 0.35
    """Standard deviation of the logarithm of thresholds: half of the above."""
    misread_share: float = 0.01
    """Share of switches that are read wrongly, at least."""
    wide_sds: float = 4.0
    """Standard deviations of the prior from which a contact is unusually wide."""
    reach_radii: float = 1.5
    """Extent of a contact beyond its centre, in radii of the tables' disc."""
    start_force_N: float = 0.3
    """Smallest force that a contact with a switch starts from."""
    stiffness_sd: float = 0.11
    """Relative standard deviation of the stiffness of prints of one design: 5 % of modulus, and
    3 % of mean and 3 % of local thickness to the power of 2.3. It limits decoders that were not
    calibrated on their print."""
    noise_growth_min: float = 1.3
    """Squared noise of a frame, over the expected one, from which a frame is taken as noisier."""
    chi2_growth_max: float = 1.15
    """A warm start is kept until χ² has grown by this; of 700 shifts it varies by 5 %."""
    warm_start_iterations: int = 3
    search_every_frames: int = 4
    """Warm-started frames between searches for unswitched contacts."""
    reinitialise_after_frames: tuple[int, int] = (480, 16)
    """Frames after which contacts are searched for again, without and with an unswitched one."""
    extent_error: float = 0.012
    """Error of the force of a contact that is wider than the tables' disc, for each time that its
    largest second moment exceeds that of the disc: its pressure has a shape, which the moments do
    not describe. Discs of 1.75 and twice the radius are read 0.5 to 1.5 % and 2 to 5 % off, strips
    of 16 to 28 mm 2 to 3 %."""
    interaction_error: float = 0.4
    """Error of a force, over the share of the shifts that other contacts change: by nine pads of
    6 to 25 N on ``cylinder60``. Tables hold interactions to second order."""
    rim_power_factor: float = 1.35
    """Power with which shifts fall towards a clamped rim for smaller and nearer discs, over that
    between tabulated ones: at most 1.5 over 1.12 on ``cylinder60``."""
    rim_radii: tuple[float, float] = (0.4, 1.3)
    """Radii of discs that press beside a rim, over that of the tables' disc."""
    moment_min: float = 0.2
    """Smallest second moment of a contact, over that of the tables' disc."""


SETTINGS = LocatorSettings()
INTERVAL_90_SDS = 1.645
"""Half the width of a 90 % interval, in standard deviations."""


class SwitchForces(NamedTuple):
    """Forces (m,) N on switches, and their standard deviations if each may be any force."""

    force_N: FloatArray
    sd_N: FloatArray


def sd_with_factor(force_N: FloatArray, sd_N: FloatArray, factor_sd: float) -> FloatArray:
    """Return the standard deviation (c,) N of forces times a log-normal factor about 1.

    It is such that the 95 % interval about the force reaches the upper end, which is farther away
    than the lower one. The distances of both upper ends are added in squares, as logarithms.

    Parameters
    ----------
    force_N, sd_N : (c,) float
        Forces, and their standard deviations without the factor.
    factor_sd : float
        Standard deviation of the factor's logarithm.
    """
    own = np.log1p(INTERVAL_SDS * sd_N / force_N)
    return np.asarray(force_N * np.expm1(np.hypot(own, INTERVAL_SDS * factor_sd)) / INTERVAL_SDS)


def _change_without_tentative_N(fit: ContactFit, accepted: Sequence[int]) -> FloatArray:
    """Return by how much forces (c,) of accepted contacts change if the tentative ones are absent.

    By linear theory. Errors of a picture may look like a contact, which then takes force from its
    neighbours, or gives them some.
    """
    tentative = [k for k, state in enumerate(fit.states) if state.tentative]
    covariance = fit.covariance[::UNKNOWNS, ::UNKNOWNS]
    force = np.array([fit.states[k].x[0] for k in tentative])
    own = covariance[np.ix_(tentative, tentative)]
    return np.asarray(covariance[np.ix_(accepted, tentative)] @ np.linalg.solve(own, -force))


@dataclass(frozen=True, kw_only=True)
class ContactLocator:
    """Locates the contacts of one sensor.

    Attributes
    ----------
    places : ResponseTable
        Tables; scaled to the sensor's stiffness.
    position_mm : (n, 3) float
        Markers on the outer face.
    neighbours : (n, 8) int
        Neighbour ids, -1 beyond a rim.
    footprint_mm : float
        Radius of a switch's footprint.
    threshold_N : (n,) float
        Force on it that turns the switch on.
    threshold_sd : (n,) float, optional
        Standard deviation of the logarithm of each threshold over the force on it as it is found;
        ``LocatorSettings.threshold_spread`` of all if not given.
    prior, noise : ContactPrior, ShiftNoise
        Prior of contacts, and noise of shifts.
    correction : ForceCorrection, optional
        Correction that was fitted to the sensor's own data.
    blind : (b,) int
        Switches that the camera cannot read.
    camera_motion : CameraMotion, optional
        Shifts by motion of the cameras since the rest frame.
    stiffness_change : float
        Relative standard deviation of the wall's stiffness against that when the correction was
        fitted.
    linear_error : float
        Relative error of linear tables at the design's largest force, over the true one; 0 where
        they are not linear. It grows in proportion to the force.
    """

    places: ResponseTable
    position_mm: FloatArray
    neighbours: IntArray
    footprint_mm: float
    threshold_N: FloatArray
    prior: ContactPrior
    noise: ShiftNoise
    correction: ForceCorrection | None = None
    blind: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    camera_motion: CameraMotion | None = None
    threshold_sd: FloatArray | None = None
    stiffness_change: float = 0.0
    linear_error: float = 0.0

    @property
    def as_if_linear(self) -> bool:
        """Whether forces have the error of linear theory: no data that have it were fitted to."""
        return self.correction is None or self.correction.linear

    @property
    def linear(self) -> "ContactLocator":
        """The same with the first order of its tables alone, for a linear shell."""
        first = np.ascontiguousarray(self.places.shift_px[:, :1])
        places = replace(self.places, shift_px=first, pairs=None, walls=None)
        return replace(self, places=places, linear_error=0.0)

    def for_another_print(self) -> "ContactLocator":
        """The same for a print of unknown stiffness, if it was fitted to one."""
        fitted = self.correction
        if fitted is None:
            return self
        return replace(self, places=self.places.scaled(1.0 / fitted.stiffness), correction=None)

    @cached_property
    def _rows(self) -> FloatArray:
        """Linear shifts (n, 2n) by a newton on each marker."""
        return self._first[self.places.nearest(self.position_mm)].astype(np.float64)

    @cached_property
    def _first(self) -> NDArray[np.float32]:
        """Linear shifts (p, 2n) by a newton at each place."""
        return np.ascontiguousarray(self.places.shift_px[:, 0])

    @cached_property
    def _squares(self) -> NDArray[np.float32]:
        return np.asarray(self._first**2)

    def find(
        self,
        shift_px: FloatArray,
        koi: IntArray,
        *,
        before: ContactDetection | None = None,
        camera_motion: CameraMotion | None = None,
        too_far: Callable[[FloatArray], bool] = lambda _: False,
    ) -> ContactDetection:
        """Return the contacts behind shifts (n, 2) px, NaN where a marker was not found.

        If no switch is on and all can be read, there is no contact and the solver is skipped.
        Contacts of the frame ``before`` are a warm start as long as each switch that is on belongs
        to one of them or is next to one, and the fit is as good.

        Parameters
        ----------
        koi : (m,) int
            Markers whose switch is on.
        camera_motion : CameraMotion, optional
            With the prior of this frame; the sensor's own by default.
        too_far : callable
            Whether the frame is refused for a motion of the cameras (q,): then no contact is
            reported, and the work for that is saved.
        """
        d = np.asarray(shift_px, dtype=np.float64).reshape(-1)
        found = np.isfinite(d)
        seen = ShiftObservation(
            shift_px=np.where(found, d, 0.0),
            found=found,
            koi=koi,
            camera_motion=camera_motion or self.camera_motion,
        )
        seen = self._with_likely_switches(seen)
        last = before.state if before else None
        if last:
            seen = replace(seen, noise_scale=last.noise_scale)
        state = self._warm_start(last, seen) if last else None
        if state is None:
            state = self._search(seen)
        refused = too_far(state.fit.motion)
        report = self._report(state, seen, refused=refused)
        return replace(report, state=state, noise_scale=state.noise_scale)

    def _with_likely_switches(self, seen: ShiftObservation) -> ShiftObservation:
        """Return what is seen, with the switches of the strongest groups if these are too many."""
        groups = group_key_nodes(seen.koi, self.neighbours)
        if len(groups) <= SETTINGS.separate_max:
            return seen
        force = self._switch_forces(seen).force_N
        groups.sort(key=lambda rows: -float(force[rows].sum()))
        rows = np.sort(np.concatenate(groups[: SETTINGS.separate_max]))
        return replace(seen, koi=seen.koi[rows])

    def _search(self, seen: ShiftObservation) -> FitState:
        """Search for the contacts of one frame alone."""
        seen = replace(seen, noise_scale=1.0)
        best = self._fit_shown(seen)
        scale = self._noise_scale(best, seen)
        if scale > 1.0:
            seen = replace(seen, noise_scale=scale)
            best = self._fit_shown(seen)
        if len(seen.koi):
            best = self._add_unswitched(best, seen)
        return FitState(fit=best, reduced_chi2=best.reduced_chi2, noise_scale=scale)

    def _fit_shown(self, seen: ShiftObservation) -> ContactFit:
        """Fit the contacts that switches show, or motion where no switch is on."""
        if len(seen.koi):
            return self._fit_switched(seen)
        best = self._fit([], seen)
        return self._add_unswitched(best, seen) if len(self.blind) else best

    def _noise_scale(self, best: ContactFit, seen: ShiftObservation) -> float:
        """Return this frame's noise over the expected one, where that is exceeded.

        By the quieter markers: what is not explained, as by a contact that is missing, moves some.
        """
        if self.noise.markers is None or not seen.found.any():
            return 1.0
        square = best.inverse * (seen.shift_px - best.predicted_px) ** 2
        each = self.noise.alike**2 * square.reshape(-1, 2).sum(axis=1)[seen.found[::2]]
        # The lower quartile of χ² with two degrees of freedom.
        usual = 2.0 * np.log(4.0 / 3.0)
        found = float(np.partition(each, len(each) // 4)[len(each) // 4]) / usual
        return float(np.sqrt(found)) if found > SETTINGS.noise_growth_min else 1.0

    def _warm_start(self, state: FitState, seen: ShiftObservation) -> FitState | None:
        """Fit the contacts of the frame before; None where they must be searched for."""
        states = state.fit.states
        unswitched = [each for each in states if not len(each.markers)]
        if not states or state.age >= SETTINGS.reinitialise_after_frames[bool(unswitched)]:
            return None
        restarted = self._restarted(states, seen)
        if restarted is None:
            return None
        best = self._fit(restarted, seen, before=state.fit)
        # With fitted noise a value below 1 is as good as 1.
        good = 1.0 if self.noise.known else 0.0
        if best.reduced_chi2 > SETTINGS.chi2_growth_max * max(state.reduced_chi2, good):
            return None
        sd = np.sqrt(np.diagonal(best.covariance)[::UNKNOWNS])
        for each, sd_N in zip(best.states, sd, strict=True):
            drop = SETTINGS.tentative_chi2_drop if each.tentative else SETTINGS.chi2_drop
            if not len(each.markers) and each.x[0] ** 2 < drop * sd_N**2:
                return None
        age = state.age + 1
        search = age % SETTINGS.search_every_frames == 0
        if search and len(unswitched) < SETTINGS.unswitched_max:
            more = self._add_unswitched(best, seen)
            if len(more.states) > len(best.states):
                return replace(state, fit=more, reduced_chi2=more.reduced_chi2, age=0)
        return replace(state, fit=best, age=age)

    def _restarted(
        self, states: Sequence[ContactState], seen: ShiftObservation
    ) -> list[ContactState] | None:
        """Return the contacts with this frame's switches; None if these do not fit to them."""
        rows = assign_to_contacts([state.markers for state in states], seen.koi, self.neighbours)
        if rows is None:
            return None
        force = self._switch_forces(seen)
        out = []
        for state, own in zip(states, rows, strict=True):
            point, sd_mm = state.start_mm, state.place_sd_mm
            if len(own):
                point, sd_mm = self._centroid(seen.koi, force, own)
            out.append(replace(state, start_mm=point, place_sd_mm=sd_mm, markers=seen.koi[own]))
        return out

    def _fit_switched(self, seen: ShiftObservation) -> ContactFit:
        """Fit the contacts whose switches are on."""
        force = self._switch_forces(seen)
        groups = [np.array(group) for group in group_key_nodes(seen.koi, self.neighbours)]
        starts = [self._start(seen.koi, force, rows) for rows in groups]
        best, starts = self._joined(self._fit(starts, seen), starts, force, seen)
        groups = [np.flatnonzero(np.isin(seen.koi, start.markers)) for start in starts]
        apart = self._out_of_reach(best, seen.koi)
        explained = best.reduced_chi2 < SETTINGS.chi2_unexplained and not apart.any()
        # Noise that is not known may be far too large: then χ² is no criterion.
        if self.noise.known and explained and not self._unusually_wide(best.states):
            return best
        for group in groups:
            parts = self._parts(seen.koi, force, group)
            if len(parts) == 1:
                continue
            own = seen.koi[group]
            others = [start for start in starts if not np.isin(start.markers, own).any()]
            new = [self._start(seen.koi, force, rows) for rows in parts]
            separate = [*others, *new]
            if len(separate) > SETTINGS.separate_max:
                continue
            drop = 0.0 if apart[group].any() else SETTINGS.chi2_drop * (len(parts) - 1)
            if not self._may_gain(best, seen, new, drop):
                continue
            more = self._fit(separate, seen)
            if best.cost - more.cost >= drop * max(more.reduced_chi2, 1.0):
                best, starts = more, separate
        for start in self._unreadable_starts(seen):
            if not self._may_gain(best, seen, [start], SETTINGS.chi2_drop):
                continue
            more = self._fit([*starts, start], seen)
            drop = SETTINGS.chi2_drop * max(more.reduced_chi2, 1.0)
            if best.cost - more.cost >= drop and self._could_be_off(more, seen.koi):
                best, starts = more, [*starts, start]
        return best

    def _joined(
        self,
        best: ContactFit,
        starts: list[ContactState],
        force: SwitchForces,
        seen: ShiftObservation,
    ) -> tuple[ContactFit, list[ContactState]]:
        """Join contacts that overlap where one explains as much; return the fit and its starts.

        Switches of one contact need not be neighbours: one between them may need a larger force.
        """
        points = np.stack([centre_of(self.places, state) for state in best.states])
        radius = self._radii(best.states)
        for k in range(len(starts) - 1, 0, -1):
            gap = np.linalg.norm(points[:k] - points[k], axis=1) - radius[:k] - radius[k]
            near = int(np.argmin(gap))
            if gap[near] >= 0.0:
                continue
            own = np.concatenate([starts[near].markers, starts[k].markers])
            both = self._start(seen.koi, force, np.flatnonzero(np.isin(seen.koi, own)))
            fewer = [*starts[:near], both, *starts[near + 1 : k], *starts[k + 1 :]]
            less = self._fit(fewer, seen)
            if less.cost - best.cost < SETTINGS.chi2_drop * max(best.reduced_chi2, 1.0):
                best, starts = less, fewer
        return best, starts

    def _may_gain(
        self,
        best: ContactFit,
        seen: ShiftObservation,
        starts: Sequence[ContactState],
        drop: float,
    ) -> bool:
        """Return whether contacts at these starts may lower χ² by as much as is demanded."""
        near = self.places.fits[0][[state.place for state in starts]]
        rows = self._first[np.unique(near[:, : SETTINGS.foreseen_places])].astype(np.float64)
        gain = best.gain_by(rows, seen.shift_px, self.prior.force_N)
        return gain >= SETTINGS.foreseen_share * drop * max(best.reduced_chi2, 1.0)

    def _out_of_reach(self, fit: ContactFit, koi: IntArray) -> BoolArray:
        """Return which switches (m,) that are on are out of reach of every contact."""
        points = np.stack([centre_of(self.places, state) for state in fit.states])
        gap = np.linalg.norm(points[:, None] - self.position_mm[koi][None], axis=2)
        reach = np.maximum(self._radii(fit.states) + self.footprint_mm, self._reach_mm)
        return np.asarray((gap > reach[:, None]).all(axis=0))

    def _unusually_wide(self, states: Sequence[ContactState]) -> bool:
        """Return whether a contact over several switches is wider than the prior has contacts."""
        mean, sd = self.prior.moments_mm2[::2], self.prior.moments_sd_mm2[::2]
        most = np.add(mean, np.multiply(SETTINGS.wide_sds, sd))
        return any((state.x[3:6:2] > most).any() for state in states if len(state.markers) > 1)

    def _unreadable_starts(self, seen: ShiftObservation) -> list[ContactState]:
        """Return contacts on unreadable switches that the motion shows as pressed."""
        if len(self.blind) == 0:
            return []
        both = np.union1d(seen.koi, self.blind)
        force = self._switch_forces(replace(seen, koi=both))
        pressed = ~np.isin(both, seen.koi) & (force.force_N >= self.threshold_N[both])
        parts = self._parts(both, force, np.flatnonzero(pressed))
        return [replace(self._start(both, force, rows), markers=seen.koi[:0]) for rows in parts]

    def _add_unswitched(self, best: ContactFit, seen: ShiftObservation) -> ContactFit:
        """Add contacts that no switch shows, as long as the fit improves."""
        koi = seen.koi
        # Without an interaction table its errors look like contacts: then none is tentative.
        allow_tentative, accepted = len(koi) > 0 and self.places.pairs is not None, True
        for _ in range(SETTINGS.unswitched_max):
            unexplained = not best.states or best.reduced_chi2 >= SETTINGS.chi2_unexplained
            if not unexplained and not allow_tentative:
                break
            drop = SETTINGS.tentative_chi2_drop if allow_tentative else SETTINGS.chi2_drop
            # Linear theory may foresee less than a fit gains.
            share = SETTINGS.foreseen_share if unexplained else 1.0
            start = self._unswitched_start(best, seen, share * drop)
            if start is None:
                break
            more = self._fit([*best.states, start], seen)
            # Residuals that neither fit explains, as by errors of the tables, say nothing.
            gain = (best.cost - more.cost) / max(more.reduced_chi2, 1.0)
            if gain < drop or not self._could_be_off(more, koi):
                break
            if not len(koi) and not len(self._unreadable_on(more.states[-1])):
                break
            # A contact that is found only with a tentative one is tentative too.
            accepted = accepted and unexplained and gain >= SETTINGS.chi2_drop
            more.states[-1].tentative = not accepted
            best = more
        return best

    def _fit(
        self,
        states: list[ContactState],
        seen: ShiftObservation,
        *,
        before: ContactFit | None = None,
    ) -> ContactFit:
        """Fit contacts; from those of the frame ``before`` a few iterations are enough."""
        cold = contact_fit.SETTINGS
        return fit_contacts(
            self.places,
            [state.copy() for state in states],
            seen,
            prior=self.prior,
            noise=self.noise,
            before=before,
            unweighted=0 if before else cold.unweighted_iterations,
            iterations=SETTINGS.warm_start_iterations if before else cold.iterations_max,
        )

    @property
    def _reach_mm(self) -> float:
        """Switches farther from a contact's most loaded one may belong to another contact."""
        usual = self.places.radius_mm**2 / 4.0 + float(np.mean(self.prior.moments_mm2[::2]))
        return SETTINGS.reach_radii * 2.0 * sqrt(max(usual, 0.0)) + self.footprint_mm

    def _switch_forces(self, seen: ShiftObservation) -> SwitchForces:
        """Return the force on each switch that is on, by the compliance inverse."""
        rows = self._rows[seen.koi] * seen.found
        if seen.camera_motion:
            motion = seen.camera_motion.masked(seen.found)
            gram, right = motion.normal_equations(rows, seen.shift_px, self.noise.median_px)
        else:
            gram, right = rows @ rows.T, rows @ seen.shift_px
        force = nonnegative_least_squares(gram, right)
        # Beside a rim noise alone decides which of two switches seems to carry a force.
        weight = np.eye(len(gram)) / self.prior.force_N**2
        weight += gram / (self.noise.median_px * seen.noise_scale) ** 2
        return SwitchForces(force, np.sqrt(np.linalg.inv(weight).diagonal()))

    def _start(self, koi: IntArray, force: SwitchForces, rows: IntArray) -> ContactState:
        """Return a contact on switches ``koi[rows]``, by the forces on all."""
        point, sd_mm = self._centroid(koi, force, rows)
        total = max(float(force.force_N[rows].sum()), SETTINGS.start_force_N)
        return initial_state(
            self.places, self.prior, point, total, markers=koi[rows], place_sd_mm=sd_mm
        )

    def _centroid(
        self, koi: IntArray, force: SwitchForces, rows: IntArray
    ) -> tuple[FloatArray, float]:
        """Return the prior centre (3,) of a contact on switches ``koi[rows]``, and its spread, mm.

        It is their centroid by force, as far as that is known.
        """
        weight = force.force_N[rows] + force.sd_N[rows]
        total = float(weight.sum())
        point = weight @ self.position_mm[koi[rows]] / total
        arm = np.linalg.norm(self.position_mm[koi[rows]] - point, axis=1)
        spread_mm = float(np.linalg.norm(force.sd_N[rows] * arm)) / total
        return point, float(np.hypot(self.prior.place_mm, spread_mm))

    def _parts(self, koi: IntArray, force: SwitchForces, rows: IntArray) -> list[IntArray]:
        """Return rows of ``koi`` within reach of the most loaded one, then of that of the rest."""
        parts = []
        while len(rows):
            top = rows[np.argmax(force.force_N[rows])]
            gap = self.position_mm[koi[rows]] - self.position_mm[koi[top]]
            mine = np.linalg.norm(gap, axis=1) <= self._reach_mm
            parts.append(rows[mine])
            rows = rows[~mine]
        return parts

    def _unswitched_start(
        self, best: ContactFit, seen: ShiftObservation, drop: float
    ) -> ContactState | None:
        """Return the contact that explains most of the residual; None below a drop of χ²."""
        force, gain = self._by_residual(best, seen, slice(None))
        place = int(np.argmax(gain))
        if gain[place] < drop:
            return None
        return initial_state(
            self.places,
            self.prior,
            self.places.point_mm[place],
            float(force[place]),
            place_sd_mm=2.0 * self.places.spacing_mm,
        )

    def _by_residual(
        self, best: ContactFit, seen: ShiftObservation, places: IntArray | slice
    ) -> tuple[FloatArray, FloatArray]:
        """Return the force (p,) N at each of places that explains most of the residual.

        And by how much it lowers χ² (p,): 0 for a force outwards. While a part of the motion is
        unexplained, contacts may have stretched over one that is missing, so that the residual is
        largest elsewhere: all other unknowns are then fitted again, by linear theory as in
        :meth:`ContactFit.gain_by`.
        """
        first, inverse = self._first[places], best.inverse.astype(np.float32)
        pull = first @ (best.inverse * (seen.shift_px - best.predicted_px)).astype(np.float32)
        size = left = np.maximum(self._squares[places] @ inverse, 1e-12)
        if best.reduced_chi2 >= SETTINGS.chi2_unexplained:
            cross = first @ (best.slope * inverse).T.astype(np.float32)
            taken = np.einsum("pu,pu->p", cross @ best.joint_covariance, cross)
            left = np.maximum(size - taken, SETTINGS.untaken_min * size)
        return pull / left, np.where(pull > 0.0, pull, 0.0) ** 2 / left

    def _carried(self, state: ContactState) -> FloatArray:
        """Return the force (n,) N of a contact on each switch."""
        radius = float(self._radii([state])[0])
        gap = np.linalg.norm(centre_of(self.places, state) - self.position_mm, axis=1)
        share = disc_overlap_share(gap, radius, self.footprint_mm)
        return np.asarray(float(state.x[0]) * share)

    def _unreadable_on(self, state: ContactState) -> IntArray:
        """Return the unreadable switches (u,) that a contact must have turned on."""
        on = self._carried(state)[self.blind] >= self.threshold_N[self.blind]
        return self.blind[on]

    @property
    def _some_readable(self) -> bool:
        return len(self.blind) < len(self.position_mm)

    @cached_property
    def _blind_places(self) -> tuple[IntArray, FloatArray]:
        """Places (b,) on unreadable switches, and the threshold (b,) N of the nearest one."""
        if not len(self.blind) or not self._some_readable:
            return self.blind[:0], self.threshold_N[:0]
        gap = np.linalg.norm(
            self.places.point_mm[:, None] - self.position_mm[self.blind][None], axis=2
        )
        on = np.flatnonzero(gap.min(axis=1) <= self.footprint_mm)
        return on, self.threshold_N[self.blind[gap[on].argmin(axis=1)]]

    def _hidden_N(self, best: ContactFit, seen: ShiftObservation) -> float:
        """Return the force that residuals show, and no contact explains.

        It is that of the place which explains most of them, of places on unreadable switches; 0 if
        none turns a switch on. If no switch is on, it is that of any place.
        """
        if not len(seen.koi) and not best.states:
            idle_N = self._idle_N(best, seen)
            if idle_N:
                return idle_N
        places, threshold_N = self._blind_places
        if not len(places):
            return 0.0
        force, gain = self._by_residual(best, seen, places)
        gain[force < threshold_N] = 0.0
        most = int(np.argmax(gain))
        return float(force[most]) if gain[most] >= SETTINGS.hidden_sd_min**2 else 0.0

    def _idle_N(self, best: ContactFit, seen: ShiftObservation) -> float:
        """Return the force of a contact that moves markers and turns on no switch; 0 for none.

        Between receptors beside a rim these may be many newtons.
        """
        residual = best.inverse * (seen.shift_px - best.predicted_px) ** 2
        if residual.max(initial=0.0) < SETTINGS.idle_sd_min**2:
            return 0.0
        drop = SETTINGS.chi2_drop * max(best.reduced_chi2, 1.0)
        force, gain = self._by_residual(best, seen, slice(None))
        gain[force < SETTINGS.threshold_excess_max * self.threshold_N.min()] = 0.0
        most = int(np.argmax(gain))
        return float(force[most]) if gain[most] >= drop else 0.0

    def _could_be_off(self, found: ContactFit, koi: IntArray) -> bool:
        """Return whether the last contact agrees with every switch that reads off."""
        carried = self._carried(found.states[-1])
        carried[koi] = carried[self.blind] = 0.0
        most_N = SETTINGS.threshold_excess_max * self.threshold_N
        if self.threshold_sd is not None:
            most_N = np.exp(2.0 * self.threshold_sd) * self.threshold_N
        return bool((carried <= most_N).all())

    def _log_switches(self, states: Sequence[ContactState], koi: IntArray) -> FloatArray:
        """Return the logarithm (c,) of how likely it is that switches read so, under each contact.

        How far it extends is poorly known: of likely extents, the one that agrees best with each.
        """
        own = self._radii(states)
        reach = np.full_like(own, SETTINGS.reach_radii * self.places.radius_mm)
        radius = np.stack([own, np.full_like(own, self.footprint_mm), reach])
        points = np.stack([centre_of(self.places, state) for state in states])
        gap = np.linalg.norm(points[:, None] - self.position_mm, axis=2)
        near = np.flatnonzero(
            (gap <= (radius.max(axis=0) + self.footprint_mm)[:, None]).any(axis=0)
        )
        force = np.array([[state.x[0]] for state in states])
        carried = force * disc_overlap_share(gap[:, near], radius[:, :, None], self.footprint_mm)
        on = self._share_on(carried, near)
        reads_on, started = np.zeros((1, len(gap[0])), bool), np.zeros(gap.shape, bool)
        reads_on[0, koi] = True
        for row, state in zip(started, states, strict=True):
            row[state.markers] = True
        started &= self._readable
        log_off, log_on = np.log(
            np.maximum([1.0 - on.min(axis=0), on.max(axis=0)], SETTINGS.misread_share)
        )
        out = np.sum(log_off * (~reads_on & self._readable)[:, near], axis=1)
        out += np.sum(log_on * started[:, near], axis=1)
        started[:, near] = False
        return np.asarray(out + np.log(SETTINGS.misread_share) * started.sum(axis=1))

    @cached_property
    def _readable(self) -> BoolArray:
        """Switches (n,) that the camera can read."""
        out = np.ones(len(self.position_mm), dtype=np.bool_)
        out[self.blind] = False
        return out

    def _share_on(self, carried_N: FloatArray, ids: IntArray) -> FloatArray:
        """Return the share (…, m) of switches that forces (…, m) turn on: thresholds scatter."""
        sd = SETTINGS.threshold_spread if self.threshold_sd is None else self.threshold_sd[ids]
        over = np.log(np.maximum(carried_N, 1e-9) / self.threshold_N[ids]) / sd
        # The logistic function is within 0.01 of the normal distribution's.
        return np.asarray(1.0 / (1.0 + np.exp(-1.702 * np.clip(over, -30.0, 30.0))))

    def _radii(self, states: Sequence[ContactState]) -> FloatArray:
        """Return the radius (c,) mm of the uniform disc with each contact's mean second moment."""
        disc = self.places.radius_mm**2 / 2.0
        moment = np.array([disc + state.x[3] + state.x[5] for state in states])
        return np.asarray(np.sqrt(2.0 * np.maximum(moment, SETTINGS.moment_min * disc)))

    def _report(
        self, found: FitState, seen: ShiftObservation, *, refused: bool
    ) -> ContactDetection:
        """Return accepted contacts, with corrected forces and their switches; none if refused."""
        best, koi = found.fit, seen.koi
        accepted = [k for k, state in enumerate(best.states) if not state.tentative]
        out = ContactDetection(
            contacts=[],
            reduced_chi2=best.reduced_chi2,
            shift_px=best.predicted_px,
            motion=best.motion,
            motion_sd=best.motion_sd,
        )
        if refused:
            return out
        hidden_N = self._hidden_N(best, seen)
        if not accepted:
            return replace(out, hidden_N=hidden_N)
        states, covariances = self._averaged(found, accepted, seen)
        points = np.stack([centre_of(self.places, state) for state in states])
        raw = np.array([state.x[0] for state in states])
        sd = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
        fitted_N = sd[:, 0].copy()
        changed = changed_by_others(self.places, best.states, best.each_px)[accepted]
        errors = self._errors_of_tables(states, points, sd[:, 1:3])
        errors = np.hypot(errors, SETTINGS.interaction_error * changed)
        sd[:, 0] = np.hypot(fitted_N, raw * errors)
        radius = self._radii(states)
        gap, covered = self._covered(points, radius, koi)
        # A switch that no disc reaches belongs to the contact that it started.
        started = np.array([np.isin(koi, state.markers) for state in states])
        owner = np.argmax(raw[:, None] * covered + 1e-6 * started - 1e-9 * gap, axis=0)
        signal = np.array([contact_signal_px(state) for state in states])
        # Errors of the tables do not say whether there is a contact at all.
        spread_N = [sd[:, 0], fitted_N]
        if self.correction is None:
            force, stiffness_sd = raw, SETTINGS.stiffness_sd
        else:
            force = raw * self.correction.factor(points, raw, signal)
            spread_N = [self.correction.spread_N(force, each) for each in spread_N]
            stiffness_sd = self.stiffness_change
        stated_N = sd_with_factor(force, spread_N[0], stiffness_sd)
        stated_N = np.hypot(stated_N, self._linear_sd_N(raw))
        stated_N = np.hypot(stated_N, force / raw * _change_without_tentative_N(best, accepted))
        there_sd_N = np.hypot(spread_N[1], stiffness_sd * force)
        residue_N = self._linear_residue_N(raw)
        for k, state in enumerate(states):
            on, share = koi[owner == k], covered[k, owner == k]
            least = SETTINGS.unreadable_sd_min if len(on) else SETTINGS.force_sd_min
            sure = force[k] >= least * there_sd_N[k]
            # Without any switch nothing says which of several contacts is there.
            residue = len(koi) > 0 and not len(on) and force[k] <= residue_N[k]
            if np.isin(on, self.blind).all() and (residue or not sure):
                on_unreadable = self._some_readable and len(self._unreadable_on(state))
                if on_unreadable or residue or not len(koi):
                    hidden_N = max(hidden_N, float(force[k]))
                continue
            if len(on) == 0:
                on = self._unreadable_on(state)
                share = self._covered(points[k : k + 1], radius[k : k + 1], on)[1][0]
            out.contacts.append(
                LocatedContact(
                    markers=on,
                    share=(share + 1e-6) / np.sum(share + 1e-6),
                    force_N=float(force[k]),
                    sd_N=float(stated_N[k]),
                    raw_N=float(raw[k]),
                    raw_sd_N=float(sd[k, 0]),
                    point_mm=points[k],
                    radius_mm=float(radius[k]),
                    sd_mm=sd[k, 1:3],
                    moments_mm2=state.x[3:SHEAR_START].copy(),
                    signal_px=float(signal[k]),
                    **self._shear(state, covariances[k], errors[k], force[k] / raw[k]),
                )
            )
        out.contacts.sort(key=lambda contact: len(contact.markers) == 0)
        return replace(out, hidden_N=hidden_N)

    def _linear_sd_N(self, force_N: FloatArray) -> FloatArray:
        """Return the error (c,) N of linear tables, so that a 90 % interval holds it."""
        if not self.as_if_linear:
            return np.zeros_like(force_N)
        largest_N = self.prior.force_N
        share = self.linear_error * force_N / largest_N
        # The true force F reads F / (1 + e F / F_max); there is no such F where share >= 1.
        beyond_N = force_N * share / np.maximum(1.0 - share, 1e-9)
        return (
            np.minimum(beyond_N, np.maximum(largest_N - force_N, force_N * share)) / INTERVAL_90_SDS
        )

    def _linear_residue_N(self, force_N: FloatArray) -> FloatArray:
        """Return what linear tables leave of the other contacts (c,) at most: it looks like one."""
        error_N = INTERVAL_90_SDS * self._linear_sd_N(force_N)
        return np.asarray(np.sqrt(np.maximum(np.sum(error_N**2) - error_N**2, 0.0)))

    def _errors_of_tables(
        self, states: Sequence[ContactState], points_mm: FloatArray, sd_mm: FloatArray
    ) -> FloatArray:
        """Return relative errors (c,) of forces by extents that the tables do not describe."""
        xx, xy, yy = np.array([state.x[3:SHEAR_START] for state in states]).T
        longest = (xx + yy) / 2.0 + np.hypot((xx - yy) / 2.0, xy)
        excess = np.maximum(longest, 0.0) / (self.places.radius_mm**2 / 4.0)
        by_rim = self._error_by_rim(points_mm, sd_mm)
        return np.asarray(np.hypot(SETTINGS.extent_error * excess, by_rim))

    def _error_by_rim(self, points_mm: FloatArray, sd_mm: FloatArray) -> FloatArray:
        """Return relative errors (c,) of forces of contacts whose disc a rim may cut off.

        How strongly these move the markers depends on their radius, which the markers hardly show.
        The logarithm of the force scatters; a 90 % interval reaches its upper end, which is farther
        away than the lower one. Places have standard deviations (c, 2).
        """
        radius_mm = self.places.radius_mm * np.linspace(*SETTINGS.rim_radii, 8)
        gap, power = self.places.towards_end(points_mm)
        gap = np.clip(gap - sd_mm.max(axis=1), 0.0, radius_mm.max())
        scatter = np.log(cut_disc_centroid(gap[:, None], radius_mm)).std(axis=1)
        scatter *= np.minimum(SETTINGS.rim_power_factor * power, END_POWER_MAX)
        return np.asarray(np.expm1(INTERVAL_90_SDS * scatter) / INTERVAL_90_SDS)

    def _averaged(
        self, found: FitState, accepted: Sequence[int], seen: ShiftObservation
    ) -> tuple[list[ContactState], FloatArray]:
        """Return the accepted contacts, and their covariances (c, 8, 8), with or without shear."""
        best = found.fit
        # Residuals beyond noise are errors of the model, of any kind: they widen all spreads. Noise
        # beyond the usual one is an error of the picture, often alike for many markers.
        average = PlaceAverage(
            places=self.places,
            prior=self.prior,
            noise=self.noise,
            seen=replace(seen, noise_scale=found.noise_scale),
            fit=best,
            scale=found.noise_scale**2 * max(best.reduced_chi2, 1.0),
            log_switches=partial(self._log_switches, koi=seen.koi),
        )
        states, covariances = [], []
        for k in accepted:
            state, covariance = average.contact(k)
            if self.places.shear is not None:
                x, covariance = average_over_friction(
                    state.x, covariance, shear_sd=self.prior.shear_sd
                )
                state = replace(state, x=x)
            states.append(state)
            covariances.append(covariance)
        return states, np.stack(covariances)

    def _shear(
        self, state: ContactState, covariance: FloatArray, error: float, factor: float
    ) -> dict[str, Any]:
        """Return the force along the surface of a contact, as fields of ``LocatedContact``.

        Parameters
        ----------
        covariance : (8, 8) float
            Covariance of its unknowns.
        error : float
            Relative error of the force by what the tables do not describe.
        factor : float
            Corrected over raw force.
        """
        ratio, force = state.x[SHEAR_START:], float(state.x[0])
        slope = np.zeros((UNKNOWNS, 2))
        slope[0], slope[SHEAR_START], slope[SHEAR_START + 1] = ratio, (force, 0.0), (0.0, force)
        axes = self.places.axes[state.place]
        variance = axes.T @ (slope.T @ covariance @ slope) @ axes
        known = max(float(np.linalg.eigvalsh(covariance[SHEAR_START:, SHEAR_START:])[0]), 0.0)
        shear_N = factor * force * (ratio @ axes)
        variance = (SHEAR_SPREAD * factor) ** 2 * variance
        return {
            "shear_N": shear_N,
            "shear_covariance_N2": variance + error**2 * np.outer(shear_N, shear_N),
            "shear_share": SHEAR_SPREAD * np.sqrt(known) / self.prior.shear_sd,
        }

    def _covered(
        self, points_mm: FloatArray, radius_mm: FloatArray, markers: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return distances (c, m) mm of discs from switches, and shares of each disc on each."""
        gap = np.linalg.norm(points_mm[:, None] - self.position_mm[markers][None], axis=2)
        return gap, disc_overlap_share(gap, radius_mm[:, None], self.footprint_mm)
