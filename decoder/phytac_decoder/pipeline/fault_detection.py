"""What speaks against a frame's forces: motion that no switch explains, switches without motion.

Motion is held against the compliance of the key nodes and, with any sign, of their neighbours:
where in its cell a contact presses, how wide it is, and large displacement are then not mistaken
for a fault. Few markers that seem pressed all the same, as beside a rim, are held against the
tables of ``auto`` as well, which know large displacement, where the decoder has them.
"""

import numpy as np

from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.contact_grouping import group_key_nodes
from phytac_decoder.estimation.locator import SILENT_MISFIT
from phytac_decoder.io.bundle import Bundle
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

RIDGE = 1e-3
"""Weight of a neighbour's own force against the motion it explains: neighbours are much alike."""
PRESSED_TIMES, PRESSED_SHARE = 5.0, 0.06
"""Unexplained motion is a press's that is as under so many times a switch's threshold, and this
share of all force."""
BESIDE_SHARE = 0.25
"""Beside switches that are on, this share of their force as well."""
NOISE_TIMES = 4.0
"""And under the force of as many standard deviations of centroid noise."""
STRAY_NOISES, STRAY_SHARE = 15.0, 0.2
"""A marker is astray that is off by so many standard deviations of noise, and this share of the
explained shift around it."""
BLIND_TIMES, BLIND_SHARE = 4.0, 0.3
"""A marker whose switch cannot be read is pressed that is off by what so many times the threshold
makes, and this share of its explained shift."""
RELEASED = 0.7
"""A switch that is on carries this share of its threshold: below it lets go."""
STRONG = 10.0
"""A group of switches with so many times its threshold is not doubted."""


EXCUSED_MOST = 2
"""As many markers as seem pressed may be excused; under a dead switch more do, nearly always."""


class FaultDetector:
    """Motion of one frame, held against its switches.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    shift_px : (n, 2) float
        Shift of each marker; NaN where not found.
    koi : (m,) int
        Switches that are on.
    found : Found, optional
        What ``auto`` has found in it already.
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
        self._plain = (self.inverse_N[koi] @ self._rows[koi]).reshape(-1, 2)
        self._seen = np.asarray(shift_px, dtype=np.float64)
        # A marker that was not found does as it should.
        self._shift = np.where(np.isfinite(shift_px), shift_px, self._plain)
        self._right = self._rows @ self._shift.reshape(-1)
        neighbours = model.neighbours
        self._near = np.where(neighbours >= 0, neighbours, np.arange(len(neighbours))[:, None])

    def around(self, markers: IntArray) -> IntArray:
        """Markers and their neighbours."""
        return np.union1d(markers, self._near[markers].ravel())

    def groups(self) -> list[IntArray]:
        """Key nodes in groups of neighbours."""
        return [self.koi[rows] for rows in group_key_nodes(self.koi, self.bundle.model.neighbours)]

    def forces_on(self, markers: IntArray) -> FloatArray:
        """Forces (k,) N of any sign on ``markers`` (k,) that explain the motion best."""
        gram = self._gram[np.ix_(markers, markers)]
        own = gram.diagonal()
        damped = gram + np.diag(RIDGE * own + 1e-12 * own.max(initial=0.0) + 1e-300)
        return np.asarray(np.linalg.solve(damped, self._right[markers]))

    def switches_without_force(self, forces_N: FloatArray) -> IntArray:
        """Switches (k,) that are on where no force presses, by any estimator's forces (n,) N."""
        threshold, out = self.bundle.threshold_N, [self.koi[:0]]
        for group in self.groups():
            least = RELEASED * threshold[group].min()
            force = float(forces_N[group].sum())
            if force > STRONG * least:
                continue
            others = np.setdiff1d(self.koi, group)
            rest = np.setdiff1d(self.around(others), self.around(group)) if len(others) else others
            both = np.concatenate([group, np.union1d(rest, others)])
            alone = float(self.forces_on(both)[: len(group)].sum())
            if min(force, alone) < least:
                out.append(group)
        return np.concatenate(out)

    def unexplained(self) -> tuple[IntArray, IntArray]:
        """Markers that moved as if pressed, and others that are astray; (j,) and (k,)."""
        bundle, model = self.bundle, self.bundle.model
        allowed = self.around(self.koi) if len(self.koi) else self.koi
        forces = self.forces_on(allowed)
        motion = (forces @ self._rows[allowed]).reshape(-1, 2)
        size = np.linalg.norm(motion, axis=1)
        off = np.linalg.norm(self._shift - motion, axis=1)
        usual = STRAY_SHARE * size[self._near].max(axis=1, initial=0.0)
        noise = bundle.noise_centroid_px
        astray = off > STRAY_NOISES * noise + usual
        own = np.maximum(self._gram.diagonal(), 1e-300)
        as_force = (self._right - forces @ self._gram[allowed]) / own
        limit = (
            PRESSED_TIMES * bundle.threshold_N
            + PRESSED_SHARE * self.inverse_N.sum()
            + NOISE_TIMES * noise * model.inverse_noise_N_px
        )
        as_force[allowed] = forces
        for group in self.groups():
            beside = BESIDE_SHARE * float(self.inverse_N[group].sum())
            limit[self.around(group)] += beside
        pressed = (as_force > limit) & bundle.force_readable
        pressed[self.koi] = False
        suspects = np.flatnonzero(pressed | self._unread())
        if self._excused(suspects, limit[suspects]):
            suspects = suspects[:0]
        return suspects, np.flatnonzero(astray)

    def _excused(self, markers: IntArray, limit_N: FloatArray) -> bool:
        """Whether contacts with switches explain all motion, without these markers (k,)."""
        model = self.bundle.model
        if model.locator is None or not len(self.koi) or not 1 <= len(markers) <= EXCUSED_MOST:
            return False
        found = self._found or model.contacts(self._seen, self.koi)
        silent = any(len(contact.markers) == 0 for contact in found.contacts)
        if silent or found.misfit > SILENT_MISFIT:
            return False
        left = np.nan_to_num(self._seen.reshape(-1) - found.shift_px)
        own = np.maximum(self._gram.diagonal()[markers], 1e-300)
        as_force = (self._rows[markers] @ left) / own
        return bool((as_force <= limit_N).all())

    def _unread(self) -> BoolArray:
        """Markers (n,) that moved as if pressed and whose switches cannot be read.

        Theirs may be pressed beside one that is on, of which the rest is not suspected.
        """
        bundle = self.bundle
        blind = ~bundle.tips.readable
        blind[self.koi] = False
        if not blind.any():
            return blind
        own = np.arange(len(blind))
        unit = np.linalg.norm(self._rows.reshape(len(blind), -1, 2)[own, own], axis=1)
        off = np.linalg.norm(self._shift - self._plain, axis=1)
        limit = BLIND_TIMES * (bundle.threshold_N * unit + bundle.noise_centroid_px)
        limit += BLIND_SHARE * np.linalg.norm(self._plain, axis=1)
        return np.asarray(blind & (off > limit))
