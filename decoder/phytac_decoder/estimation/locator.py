"""Contacts from marker shifts: how many there are, and the force, place and extent of each.

Each group of neighbouring switches that are on starts a contact; the unknowns of a contact are its
force, its centre and its second moments (:mod:`places`), and what is known of them beforehand
stands in a prior. What is left is searched for contacts that tripped no switch: the place whose
row explains most of it joins, as long as that is more than noise would. A switch that the camera
cannot read stays silent whatever presses it: it neither starts a contact nor speaks against one,
and where it is all that is pressed, markers' motion alone tells.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.estimation.contact_estimates import ContactDetection, FitState, LocatedContact
from phytac_decoder.estimation.contact_fit import (
    FIRM,
    ROUNDS,
    ContactFit,
    ContactPrior,
    ShiftNoise,
    ShiftObservation,
    contact_signal_px,
    fit_contacts,
    fit_without_contacts,
    initial_state,
)
from phytac_decoder.estimation.contact_grouping import assign_to_contacts, group_key_nodes
from phytac_decoder.estimation.contact_shifts import UNKNOWNS, ContactState, centre_of
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.nonnegative import nonnegative_least_squares
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.discs import disc_overlap_share

SILENT_MAX = 4
"""Contacts without a switch that are looked for at most."""
SILENT_GAIN = 40.0
"""Fall of the weighted sum of squares from which on one is believed: six standard deviations, for
tables are not exact, and what they leave looks like a contact to quiet markers."""
SUSPECTED_GAIN = 20.0
"""The same from which on one is fitted with the others, so that they do not take its force, but
not told: on sensors whose tables know what contacts at once do to each other."""
SILENT_MISFIT = 1.15
"""Weighted sum of squares per number from which on something is left unexplained."""
SILENT_SURE = 5.0
"""Standard deviations, as they are told, that its force is from 0 at least: those learnt from the
sensor's own data know of more than noise."""
SILENT_OVER = 2.0
"""A switch off may carry this many times its threshold: prints scatter, and places are guessed."""
REACH = 1.5
"""Of a contact beyond its centre, in radii of the tables' disc: patches are not all of a size."""
START_N = 0.3
"""Least force that a contact with a switch starts from."""
PRINT_SHARE = 0.11
"""Standard deviation of the stiffness of prints of one design, relative: 5 % of modulus, and 3 % of
thickness as a whole and 3 % from place to place, to the power of 2.3. Forces of a decoder that has
seen no data of its print are no surer."""
WORSE = 1.15
"""Contacts go on until what they leave has grown by so much: of 700 numbers it varies by 5 %."""
WARM = 3
"""Rounds of a fit that goes on from the frame before, at most: the next one goes on from there."""
LOOK = 4
"""Every so many frames that are gone on, what is left is searched for contacts without a switch."""
ANEW = (480, 16)
"""Frames after which contacts are looked for anew all the same, and where one of them tripped no
switch."""
NO_MARKERS: IntArray = np.zeros(0, dtype=np.int64)
SPREAD_LEAST = 0.2
"""Least second moment of a contact over that of the tables' disc."""


@dataclass(frozen=True, kw_only=True)
class ContactLocator:
    """Finds contacts of one sensor.

    Attributes
    ----------
    places : Places
        Tables; scaled to the sensor's stiffness.
    position_mm : (n, 3) float
        Markers on the outer face.
    neighbours : (n, 8) int
        Neighbour ids, -1 beyond a rim.
    footprint_mm : float
        Radius of a switch's footprint.
    threshold_N : (n,) float
        Force on it that turns the switch on.
    prior, noise : Prior, Noise
        What is known beforehand.
    correction : Correction, optional
        What was learnt from the sensor's own data.
    blind : (b,) int
        Switches that the camera cannot read.
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

    @property
    def linear(self) -> "ContactLocator":
        """The same with its tables' first power alone, for a shell that is linear."""
        first = np.ascontiguousarray(self.places.shift_px[:, :1])
        return replace(self, places=replace(self.places, shift_px=first, pairs=None, walls=None))

    @cached_property
    def _columns(self) -> FloatArray:
        """Linear shifts (2n, n) by a newton on each marker."""
        rows = self.places.shift_px[self.places.nearest(self.position_mm), 0]
        return np.asarray(rows.T, dtype=np.float64)

    @cached_property
    def _gram(self) -> FloatArray:
        return np.asarray(self._columns.T @ self._columns)

    @cached_property
    def _first(self) -> NDArray[np.float32]:
        """Linear shifts (p, 2n) by a newton at each place."""
        return np.ascontiguousarray(self.places.shift_px[:, 0])

    @cached_property
    def _squares(self) -> NDArray[np.float32]:
        return np.asarray(self._first**2)

    def find(
        self, shift_px: FloatArray, koi: IntArray, *, before: ContactDetection | None = None
    ) -> ContactDetection:
        """Contacts behind shifts (n, 2) px, NaN where a marker was not found.

        Without a switch that is on there is no contact, and nothing is solved, unless some switch
        cannot be read. Contacts of the frame ``before`` go on as long as each switch that is on is
        one's own or beside one's own, and they explain what is seen as well as they did.
        """
        d = np.asarray(shift_px, dtype=np.float64).reshape(-1)
        found = np.isfinite(d)
        seen = ShiftObservation(shift_px=np.where(found, d, 0.0), found=found, koi=koi)
        stand = self._gone_on(before.stand, seen) if before and before.stand else None
        if stand is None:
            best = self._switched(seen) if len(koi) else fit_without_contacts(seen, self.noise)
            if len(koi) or len(self.blind):
                best = self._searched(best, seen)
            stand = FitState(fit=best, misfit=best.misfit)
        return replace(self._told(stand.fit, koi), stand=stand)

    def _gone_on(self, stand: FitState, seen: ShiftObservation) -> FitState | None:
        """Contacts of the frame before in this one; None where they have to be looked for."""
        states = stand.fit.states
        aside = [state for state in states if not len(state.markers)]
        if not states or stand.age >= ANEW[bool(aside)]:
            return None
        again = self._again(states, seen)
        if again is None:
            return None
        best = self._fit(again, seen, firm=0, rounds=WARM)
        # Below 1 a fit by learnt noise is as good as can be.
        good = 1.0 if self.noise.ratio is not None else 0.0
        if best.misfit > WORSE * max(stand.misfit, good):
            return None
        sd = np.sqrt(np.diagonal(best.covariance)[::UNKNOWNS])
        for state, spread_N in zip(best.states, sd, strict=True):
            least = SUSPECTED_GAIN if state.suspected else SILENT_GAIN
            if not len(state.markers) and state.x[0] ** 2 < least * spread_N**2:
                return None
        age = stand.age + 1
        look = age % LOOK == 0 and len(aside) < SILENT_MAX
        if look and len(self._searched(best, seen).states) > len(best.states):
            return None
        return FitState(fit=best, misfit=stand.misfit, age=age)

    def _again(
        self, states: Sequence[ContactState], seen: ShiftObservation
    ) -> list[ContactState] | None:
        """The same contacts, about where this frame's switches say that they are."""
        rows = assign_to_contacts([state.markers for state in states], seen.koi, self.neighbours)
        if rows is None:
            return None
        force = self._switch_forces(seen)
        out = []
        for state, own in zip(states, rows, strict=True):
            point = self._middle(seen.koi, force, own)[0] if len(own) else state.start_mm
            out.append(replace(state, start_mm=point, markers=seen.koi[own]))
        return out

    def _switched(self, seen: ShiftObservation) -> ContactFit:
        """Contacts that the switches tell."""
        force = self._switch_forces(seen)
        starts = [self._start(seen.koi, force, rows) for rows in self._split(seen.koi, force)]
        best = self._fit(starts, seen)
        # Noise that is only presumed may be far too much: then the misfit says little.
        if self.noise.ratio is not None and best.misfit < SILENT_MISFIT:
            return best
        parts = self._split(seen.koi, force, reach_mm=self._reach_mm)
        if len(parts) > len(starts):
            parted = [self._start(seen.koi, force, rows) for rows in parts]
            more = self._fit(parted, seen)
            if best.cost - more.cost >= SILENT_GAIN * (len(parted) - len(starts)):
                best, starts = more, parted
        for unread in self._unread_starts(seen):
            more = self._fit([*starts, unread], seen)
            if best.cost - more.cost >= SILENT_GAIN and self._could_be_silent(more, seen.koi):
                best, starts = more, [*starts, unread]
        return best

    def _unread_starts(self, seen: ShiftObservation) -> list[ContactState]:
        """Contacts on switches that cannot be read and that motion says are pressed."""
        if len(self.blind) == 0:
            return []
        asked = np.union1d(seen.koi, self.blind)
        force = self._switch_forces(replace(seen, koi=asked))
        pressed = ~np.isin(asked, seen.koi) & (force >= self.threshold_N[asked])
        parts = self._parts(asked, force, np.flatnonzero(pressed), self._reach_mm)
        return [replace(self._start(asked, force, rows), markers=NO_MARKERS) for rows in parts]

    def _searched(self, best: ContactFit, seen: ShiftObservation) -> ContactFit:
        """The same with contacts that no switch tells."""
        koi = seen.koi
        # Without them, what tables err by where contacts are at once looks like contacts.
        suspecting, sure = len(koi) > 0 and self.places.pairs is not None, True
        for _ in range(SILENT_MAX):
            unexplained = not best.states or best.misfit >= SILENT_MISFIT
            if not unexplained and not suspecting:
                break
            least = SUSPECTED_GAIN if suspecting else SILENT_GAIN
            another = self._silent(best, seen, least)
            if another is None:
                break
            more = self._fit([*best.states, another], seen)
            gain = best.cost - more.cost
            if gain < least or not self._could_be_silent(more, koi):
                break
            if not len(koi) and not len(self._unread(more.states[-1])):
                break
            # What only comes to light with one that is suspected is no surer.
            sure = sure and unexplained and gain >= SILENT_GAIN
            more.states[-1].suspected = not sure
            best = more
        return best

    def _fit(
        self,
        states: list[ContactState],
        seen: ShiftObservation,
        *,
        firm: int = FIRM,
        rounds: int = ROUNDS,
    ) -> ContactFit:
        own = [state.copy() for state in states]
        return fit_contacts(
            self.places, own, seen, prior=self.prior, noise=self.noise, firm=firm, rounds=rounds
        )

    @property
    def _reach_mm(self) -> float:
        """Switches farther from a contact's hardest pressed one may be another's."""
        return REACH * self.places.radius_mm + self.footprint_mm

    def _switch_forces(self, seen: ShiftObservation) -> FloatArray:
        """Force (m,) N on each switch that is on, by the compliance inverse."""
        gram = self._gram[np.ix_(seen.koi, seen.koi)]
        if not seen.found.all():
            lost = self._columns[np.ix_(~seen.found, seen.koi)]
            gram = gram - lost.T @ lost
        return nonnegative_least_squares(gram, seen.shift_px @ self._columns[:, seen.koi])

    def _split(
        self, koi: IntArray, force_N: FloatArray, *, reach_mm: float = np.inf
    ) -> list[IntArray]:
        """Rows of each group of neighbouring switches, and of each part that is within reach."""
        return [
            rows
            for group in group_key_nodes(koi, self.neighbours)
            for rows in self._parts(koi, force_N, np.array(group), reach_mm)
        ]

    def _start(self, koi: IntArray, force_N: FloatArray, rows: IntArray) -> ContactState:
        """A contact on switches ``koi[rows]`` by the forces on all."""
        point, most = self._middle(koi, force_N, rows)
        return initial_state(self.places, self.prior, point, max(most, START_N), markers=koi[rows])

    def _middle(
        self, koi: IntArray, force_N: FloatArray, rows: IntArray
    ) -> tuple[FloatArray, float]:
        """Where switches ``koi[rows]`` say that their contact is (3,), and their force."""
        weight = np.maximum(force_N[rows], 1e-3)
        point = weight @ self.position_mm[koi[rows]] / weight.sum()
        return point, float(force_N[rows].sum())

    def _parts(
        self, koi: IntArray, force_N: FloatArray, rows: IntArray, reach_mm: float
    ) -> list[IntArray]:
        """Rows of ``koi`` around the hardest pressed one, then around that of the rest, …."""
        parts = []
        while len(rows):
            top = rows[np.argmax(force_N[rows])]
            gap = self.position_mm[koi[rows]] - self.position_mm[koi[top]]
            mine = np.linalg.norm(gap, axis=1) <= reach_mm
            parts.append(rows[mine])
            rows = rows[~mine]
        return parts

    def _silent(
        self, best: ContactFit, seen: ShiftObservation, least: float
    ) -> ContactState | None:
        """The contact that would explain most of what is left; None if none explains so much."""
        left = best.inverse * (seen.shift_px - best.explained)
        pull = self._first @ left.astype(np.float32)
        size = np.maximum(self._squares @ best.inverse.astype(np.float32), 1e-12)
        gain = np.where(pull > 0.0, pull, 0.0) ** 2 / size
        place = int(np.argmax(gain))
        if gain[place] < least:
            return None
        return initial_state(
            self.places,
            self.prior,
            self.places.point_mm[place],
            float(pull[place] / size[place]),
            place_sd_mm=2.0 * self.places.spacing_mm,
        )

    def _carried(self, state: ContactState) -> FloatArray:
        """Force (n,) N of a contact on each switch."""
        radius = float(self._radii([state])[0])
        gap = np.linalg.norm(centre_of(self.places, state) - self.position_mm, axis=1)
        share = disc_overlap_share(gap, radius, self.footprint_mm)
        return np.asarray(float(state.x[0]) * share)

    def _unread(self, state: ContactState) -> IntArray:
        """Switches (u,) that cannot be read and that a contact must have turned on."""
        on = self._carried(state)[self.blind] >= self.threshold_N[self.blind]
        return self.blind[on]

    def _could_be_silent(self, found: ContactFit, koi: IntArray) -> bool:
        """Whether the last contact would leave off all switches that are off."""
        carried = self._carried(found.states[-1])
        carried[koi] = carried[self.blind] = 0.0
        return bool((carried <= SILENT_OVER * self.threshold_N).all())

    def _radii(self, states: Sequence[ContactState]) -> FloatArray:
        """Radius (c,) mm of the even disc with each contact's mean second moment."""
        disc = self.places.radius_mm**2 / 2.0
        spread = np.array([disc + state.x[3] + state.x[5] for state in states])
        return np.asarray(np.sqrt(2.0 * np.maximum(spread, SPREAD_LEAST * disc)))

    def _told(self, best: ContactFit, koi: IntArray) -> ContactDetection:
        """Contacts in words of the user's: corrected, with their switches."""
        sure = [k for k, state in enumerate(best.states) if not state.suspected]
        if not sure:
            return ContactDetection(contacts=[], misfit=best.misfit, shift_px=best.explained)
        states = [best.states[k] for k in sure]
        sd = np.sqrt(np.diagonal(best.covariance)).reshape(-1, UNKNOWNS)[sure]
        points = np.stack([centre_of(self.places, state) for state in states])
        radius = self._radii(states)
        raw = np.array([state.x[0] for state in states])
        gap, covered = self._covered(points, radius, koi)
        # Where no disc reaches a switch, it belongs to the contact that it started.
        started = np.array([self._among(state.markers, koi) for state in states])
        owner = np.argmax(raw[:, None] * covered + 1e-6 * started - 1e-9 * gap, axis=0)
        signal = np.array([contact_signal_px(state) for state in states])
        if self.correction is None:
            force, spread_N = raw, np.hypot(sd[:, 0], PRINT_SHARE * raw)
        else:
            force = raw * self.correction.factor(points, raw, signal)
            spread_N = self.correction.spread_N(force, sd[:, 0])
        tripped = [koi[owner == k] for k in range(len(points))]
        share = [covered[k, owner == k] for k in range(len(points))]
        silent = np.array([len(on) == 0 for on in tripped])
        told = np.flatnonzero(~silent | (force >= SILENT_SURE * spread_N))
        for k in np.flatnonzero(silent):
            tripped[k] = self._unread(states[k])
            share[k] = self._covered(points[k : k + 1], radius[k : k + 1], tripped[k])[1][0]
        contacts = [
            LocatedContact(
                markers=tripped[k],
                share=(share[k] + 1e-6) / np.sum(share[k] + 1e-6),
                force_N=float(force[k]),
                sd_N=float(spread_N[k]),
                raw_N=float(raw[k]),
                raw_sd_N=float(sd[k, 0]),
                point_mm=points[k],
                radius_mm=float(radius[k]),
                sd_mm=sd[k, 1:3],
                moments_mm2=states[k].x[3:].copy(),
                signal_px=float(signal[k]),
            )
            for k in told
        ]
        contacts.sort(key=lambda contact: len(contact.markers) == 0)
        return ContactDetection(contacts=contacts, misfit=best.misfit, shift_px=best.explained)

    def _covered(
        self, points_mm: FloatArray, radius_mm: FloatArray, markers: IntArray
    ) -> tuple[FloatArray, FloatArray]:
        """Distance (c, m) mm of discs from switches, and the share of each disc on each."""
        gap = np.linalg.norm(points_mm[:, None] - self.position_mm[markers][None], axis=2)
        return gap, disc_overlap_share(gap, radius_mm[:, None], self.footprint_mm)

    def _among(self, markers: IntArray, koi: IntArray) -> BoolArray:
        """Which of switches (m,) are among a contact's."""
        mine = np.zeros(len(self.position_mm), dtype=np.bool_)
        mine[markers] = True
        return mine[koi]
