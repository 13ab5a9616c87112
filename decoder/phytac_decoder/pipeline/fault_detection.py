"""Fault detection: motion that no switch explains, and switches without motion.

Motion is compared with the compliance of the key nodes and, with any sign, of their neighbours.
Where in its cell a contact presses, how wide it is, and large displacements are then not mistaken
for a fault. If only a few markers seem pressed, as near a rim, the contacts of the estimator
``auto`` are considered too, as its tables include large displacements.
"""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.contact_grouping import group_key_nodes
from phytac_decoder.estimation.locator import SETTINGS as LOCATOR_SETTINGS
from phytac_decoder.io.bundle import Bundle
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.discs import disc_overlap_share


@dataclass(frozen=True, kw_only=True)
class FaultSettings:
    """Settings, chosen on simulated faults of sensors of all shapes."""

    ridge: float = 1e-3
    """Penalty of a neighbour's force, over its gain: neighbours respond much alike."""
    pressed_thresholds: float = 5.0
    pressed_share: float = 0.06
    pressed_noises: float = 4.0
    """A marker seems pressed above the sum of so many thresholds of its switch, this share of all
    force, and the force of so many standard deviations of centroid noise, …"""
    beside_share: float = 0.25
    """… and next to switches that are on, this share of their force."""
    blind_thresholds: float = 4.0
    blind_share: float = 0.3
    """A marker with an unreadable switch is pressed beyond the shift by so many thresholds, and
    this share of its predicted shift."""
    release_share: float = 0.7
    """Share of its threshold that a switch that is on carries at least: it releases below."""
    force_sds: float = 2.0
    """Standard deviations by which the markers around a switch must contradict an estimator that
    gives it that force: beside a rim they show 1.7 N as 0 ± 1.5 N."""
    strong_thresholds: float = 10.0
    """A group of switches with so many times its threshold is trusted."""
    many_share: float = 0.3
    """Share of the switches from which on those that are on are compared with the contacts."""
    all_share: float = 0.95
    """Share of the readable switches that no contacts turn on together: red light does."""
    unreached_share: float = 0.1
    """Largest share of the switches that are on which no contact needs to reach. In 28 sound frames
    of a ø28 mm dome, with 13 to 25 of its 41 switches on, it was 0 in all but one."""
    excused_max: int = 2
    """Largest number of pressed markers that ``auto`` may explain; around a dead switch more
    markers seem pressed, nearly always."""


SETTINGS = FaultSettings()


def unreached_switches(bundle: Bundle, koi: IntArray, found: ContactDetection) -> IntArray:
    """Return switches (k,) of those on (m,) that none of the contacts can have turned on.

    A contact's pressure is taken as a disc of any extent from the one that was found to
    ``reach_radii`` times that, and thresholds scatter. A switch stays on down to its release.
    """
    locator = bundle.model.locator
    if locator is None:
        return koi[:0]
    wider = np.array([1.0, np.sqrt(LOCATOR_SETTINGS.reach_radii), LOCATOR_SETTINGS.reach_radii])
    least_N = SETTINGS.release_share * bundle.threshold_N[koi]
    least_N = least_N / LOCATOR_SETTINGS.threshold_excess_max
    reached = np.zeros(len(koi), dtype=np.bool_)
    for contact in found.contacts:
        gap_mm = np.linalg.norm(bundle.position_mm[koi] - contact.point_mm, axis=1)
        radii_mm = contact.radius_mm * wider[:, None]
        share = disc_overlap_share(gap_mm, radii_mm, locator.footprint_mm).max(axis=0)
        reached |= contact.force_N * share >= least_N
    return koi[~reached]


class FaultDetector:
    """Motion of one frame, compared with its switches.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    shift_px : (n, 2) float
        Shift of each marker less motion of the cameras; NaN where not found.
    koi : (m,) int
        Switches that are on.
    found : ContactDetection, optional
        Result of ``auto`` for this frame, if it is known.
    """

    def __init__(
        self,
        bundle: Bundle,
        shift_px: FloatArray,
        koi: IntArray,
        found: ContactDetection | None = None,
    ) -> None:
        self.bundle, self.koi, self._found, model = bundle, koi, found, bundle.model
        self._rows, self._gram = model.patterns
        self.inverse_N = model.forces("koi_inverse", shift_px, koi)
        self._predicted = (self.inverse_N[koi] @ self._rows[koi]).reshape(-1, 2)
        self._seen = np.asarray(shift_px, dtype=np.float64)
        # All that follows is linear in the forces.
        linear = self._seen - model.beyond_linear_px(self.inverse_N[koi], koi).reshape(-1, 2)
        # A marker that was not found has no residual.
        self._shift = np.where(np.isfinite(linear), linear, self._predicted)
        self._right = self._rows @ self._shift.reshape(-1)
        neighbours = model.neighbours
        self._near = np.where(neighbours >= 0, neighbours, np.arange(len(neighbours))[:, None])

    def around(self, markers: IntArray) -> IntArray:
        """Return markers and their neighbours."""
        return np.union1d(markers, self._near[markers].ravel())

    def groups(self) -> list[IntArray]:
        """Return key nodes in groups of neighbours."""
        return [self.koi[rows] for rows in group_key_nodes(self.koi, self.bundle.model.neighbours)]

    def forces_on(self, markers: IntArray) -> FloatArray:
        """Return forces (k,) N of any sign on ``markers`` (k,) that explain the motion best."""
        return np.asarray(np.linalg.solve(self._damped(markers), self._right[markers]))

    def _damped(self, markers: IntArray) -> FloatArray:
        """Return the normal matrix (k, k) of forces on markers (k,)."""
        gram = self._gram[np.ix_(markers, markers)]
        own = gram.diagonal()
        return np.asarray(
            gram + np.diag(SETTINGS.ridge * own + 1e-12 * own.max(initial=0.0) + 1e-300)
        )

    def _sum_sd_N(self, markers: IntArray, count: int) -> float:
        """Return the standard deviation of the sum of the first ``count`` of :meth:`forces_on`."""
        first = np.arange(len(markers)) < count
        weight = np.linalg.solve(self._damped(markers), first.astype(np.float64))
        variance = weight @ self._gram[np.ix_(markers, markers)] @ weight
        return self.bundle.model.noise_px * float(np.sqrt(variance))

    def switches_without_force(self, forces_N: FloatArray) -> IntArray:
        """Return switches (k,) that are on without force, by any estimator's forces (n,) N."""
        threshold, out = self.bundle.threshold_N, [self.koi[:0]]
        for group in self.groups():
            release = SETTINGS.release_share * threshold[group].min()
            force = float(forces_N[group].sum())
            if force > SETTINGS.strong_thresholds * release:
                continue
            others = np.setdiff1d(self.koi, group)
            rest = np.setdiff1d(self.around(others), self.around(group)) if len(others) else others
            both = np.concatenate([group, np.union1d(rest, others)])
            alone = float(self.forces_on(both)[: len(group)].sum())
            if force >= release > alone:
                alone += SETTINGS.force_sds * self._sum_sd_N(both, len(group))
            if min(force, alone) < release:
                out.append(group)
        return np.concatenate(out)

    def unexplained(self) -> tuple[IntArray, IntArray]:
        """Return markers (j,) that moved as if pressed, and outliers (k,)."""
        bundle, model = self.bundle, self.bundle.model
        allowed = self.around(self.koi) if len(self.koi) else self.koi
        forces = self.forces_on(allowed)
        motion = (forces @ self._rows[allowed]).reshape(-1, 2)
        outlier = model.unexplained(self._shift - motion, motion)
        noise = bundle.noise_centroid_px
        own = np.maximum(self._gram.diagonal(), 1e-300)
        as_force = (self._right - forces @ self._gram[allowed]) / own
        limit = (
            SETTINGS.pressed_thresholds * bundle.threshold_N
            + SETTINGS.pressed_share * self.inverse_N.sum()
            + SETTINGS.pressed_noises * noise * model.inverse_noise_N_px
        )
        as_force[allowed] = forces
        for group in self.groups():
            limit[self.around(group)] += SETTINGS.beside_share * float(self.inverse_N[group].sum())
        pressed = (as_force > limit) & bundle.force_readable
        pressed[self.koi] = False
        suspects = np.flatnonzero(pressed | self._blind_pressed())
        if self._explained_by_contacts(suspects, limit[suspects]):
            suspects = suspects[:0]
        return suspects, np.flatnonzero(outlier)

    def _explained_by_contacts(self, markers: IntArray, limit_N: FloatArray) -> bool:
        """Return whether contacts with switches explain all motion, without these markers (k,)."""
        model = self.bundle.model
        few = 1 <= len(markers) <= SETTINGS.excused_max
        if model.locator is None or not len(self.koi) or not few:
            return False
        found = self._found or model.contacts(self._seen, self.koi)
        unswitched = any(len(contact.markers) == 0 for contact in found.contacts)
        if unswitched or found.reduced_chi2 > LOCATOR_SETTINGS.chi2_unexplained:
            return False
        predicted = found.shift_px.reshape(-1, 2)
        if self._found:
            # Those contacts explain motion of the cameras too, which is not in these shifts.
            predicted = model.without_motion(predicted, found.motion)
        residual = np.nan_to_num(self._seen - predicted).reshape(-1)
        own = np.maximum(self._gram.diagonal()[markers], 1e-300)
        as_force = (self._rows[markers] @ residual) / own
        return bool((as_force <= limit_N).all())

    def _blind_pressed(self) -> BoolArray:
        """Return markers (n,) with an unreadable switch that moved as if pressed.

        They may be pressed by a contact whose other switch is on, where :meth:`unexplained`
        allows any force.
        """
        bundle = self.bundle
        blind = ~bundle.tips.readable
        blind[self.koi] = False
        if not blind.any():
            return blind
        own = np.arange(len(blind))
        unit = np.linalg.norm(self._rows.reshape(len(blind), -1, 2)[own, own], axis=1)
        off = np.linalg.norm(self._shift - self._predicted, axis=1)
        limit = SETTINGS.blind_thresholds * (bundle.threshold_N * unit + bundle.noise_centroid_px)
        limit += SETTINGS.blind_share * np.linalg.norm(self._predicted, axis=1)
        return np.asarray(blind & (off > limit))
