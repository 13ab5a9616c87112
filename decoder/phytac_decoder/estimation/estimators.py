"""Forces from marker displacements: the paper's two estimators and the compliance inverse."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from phytac_decoder.camera.camera_motion import CameraMotion, MarkedMotion
from phytac_decoder.estimation.cascade_network import Base, CascadeNetwork, network_features
from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.large_displacements import LargeDisplacements
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.estimation.measured_columns import MeasuredColumns
from phytac_decoder.estimation.nonnegative import nonnegative_least_squares
from phytac_decoder.mechanics.receptor_table import ReceptorTable
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import InputError

ESTIMATORS = ("fem", "fem_nn", "fem_nn_identity", "koi_inverse", "auto")
"""Names, in the order of every table."""

TIP_SD_px = 0.17
"""Standard deviation of a key node's own shift, beside the noise, where no data determine it: its
tip covers paint, by 0.13 px more or less on another print than is predicted, and the wall dents
under the contact itself."""
NOISE_LEAST_px = 0.01
"""Noise of shifts against which that is weighed, at least."""
MODEL_SHARE = 0.03
"""Standard deviation of a marker's shift about the model's, as a share of it: markers near strong
contacts count less. 0.02 to 0.06 read the paper's protocol alike; with 0 errors are 1.1 times as
large after training, and 1.4 times by design."""
MISREAD_NOISES, MISREAD_SHARE = 10.7, 0.2
"""A marker's shift is not explained beyond so many standard deviations of its noise (15 of a
centroid's), and this share of the predicted shift around it."""
BEYOND_LINEAR_SHARE = 0.4
"""Added to that share where the prediction is of linear shifts alone."""
MISREAD_MAX = 3
"""Number of such markers up to which they are taken as misread, and left out: another marker, or a
highlight, was taken for them. More are something that is not modelled."""
KEPT_RESULTS = 6
"""Latest results that are kept: forces and motion of the cameras in one frame are asked for several
times, with the shifts as measured and without that motion."""


@dataclass(frozen=True, kw_only=True)
class ForceModel:
    """Matrices, networks and tables of one sensor's estimators; arrays run over n markers.

    Attributes
    ----------
    shift_to_mm : (n, 2) float
        Row vectors a_i: apparent inward displacement u_i = a_i · (pixel shift of marker i); 0 where
        the camera looks along the normal, so that u_i cannot be observed.
    stiffness : (n, n) float
        K, N/mm: condensed to u, all other motions load-free (inverse of the compliance in u).
    compliance_px : (2n, n) float
        C, px/N: pixel shifts (x0, y0, x1, y1, …) per newton pressed inward on each marker's cell.
    height_z_mm : (n,) float
        z of each marker, the network's tenth input.
    neighbours : (n, 8) int
        Neighbour ids, -1 beyond a rim.
    networks : dict
        Trained networks by estimator name.
    locator : ContactLocator, optional
        Finds contacts, for the estimator ``auto``.
    camera_motion : CameraMotion, optional
        Shifts by motion of the cameras since the rest frame, which is estimated in every frame.
    noise_px : float
        Standard deviation of a coordinate of a shift, against which that motion is weighed.
    tip_sd_px : float
        Standard deviation of a key node's own shift, beside the noise, in the forces that networks
        with the base ``key_nodes`` add to.
    modulus : float or None
        Modulus over that of the design, as K and C have it. None: networks and columns were learnt
        without large displacements, which are left out.
    receptors : ReceptorTable, optional
        Large displacements by forces on receptors, of the design's modulus; ``auto`` has tables of
        its own.
    measured : MeasuredColumns, optional
        What known contacts have measured; ``auto`` has corrections of its own.
    footprint_px : (2n, n) float, optional
        C of forces on the switches' footprints in place of the cells; for training, not saved.
    """

    shift_to_mm: FloatArray
    stiffness: FloatArray
    compliance_px: FloatArray
    height_z_mm: FloatArray
    neighbours: IntArray
    networks: dict[str, CascadeNetwork]
    locator: ContactLocator | None = None
    camera_motion: CameraMotion | None = None
    noise_px: float = 0.06
    tip_sd_px: float = TIP_SD_px
    modulus: float | None = 1.0
    receptors: ReceptorTable | None = None
    measured: MeasuredColumns | None = None
    footprint_px: FloatArray | None = None

    @property
    def estimators(self) -> tuple[str, ...]:
        """Names of the available estimators, in the order of tables."""
        if self.without_switches:
            return ("auto",)
        ready = {"fem", "koi_inverse", *self.networks}
        if self.locator is not None:
            ready.add("auto")
        return tuple(name for name in ESTIMATORS if name in ready)

    @property
    def by_stiffness(self) -> tuple[str, ...]:
        """Names of the estimators that take K·u, whose noise is large."""
        add_to_it = {name for name, each in self.networks.items() if each.base == "stiffness"}
        return tuple(name for name in ESTIMATORS if name == "fem" or name in add_to_it)

    @property
    def without_switches(self) -> bool:
        """Whether no switch can be read: contacts are found by the markers' motion alone."""
        return self.locator is not None and len(self.locator.blind) == len(self.height_z_mm)

    def with_camera_motion(
        self, camera_motion: CameraMotion, noise_centroid_px: float
    ) -> "ForceModel":
        """Return the same with motion of the cameras as unknowns of its estimators."""
        locator = self.locator and replace(self.locator, camera_motion=camera_motion)
        # A shift is the difference of two centroids.
        noise_px = 1.4 * noise_centroid_px
        return replace(self, locator=locator, camera_motion=camera_motion, noise_px=noise_px)

    @property
    def linear(self) -> "ForceModel":
        """The same for data of a linear shell: ``auto`` with its linear tables."""
        return self if self.locator is None else replace(self, locator=self.locator.linear)

    @property
    def best(self) -> str:
        """The default estimator."""
        return "koi_inverse" if self.locator is None else "auto"

    def contacts(
        self,
        shift_px: FloatArray,
        koi: IntArray,
        *,
        before: ContactDetection | None = None,
        marked: MarkedMotion | None = None,
    ) -> ContactDetection:
        """Return the contacts behind shifts (n, 2) px: place, size, force, standard deviation.

        ``before`` is the result of the frame before, for a warm start, which is much faster.
        ``marked`` is the motion that was taken off the shifts, of which its spread remains.

        Raises
        ------
        InputError
            If the bundle has no tables.
        """
        if self.locator is None:
            raise InputError(
                "response-tables-missing",
                "this bundle has no tables to find contacts with (estimator auto); build the "
                "design again",
            )
        motion = self.camera_motion
        if motion and marked:
            motion = motion.given_marks(marked)

        def too_far(b: FloatArray) -> bool:
            return self.camera_motion is not None and bool(self.camera_motion.excess(b, marked))

        return self.locator.find(
            shift_px, koi, before=before, camera_motion=motion, too_far=too_far
        )

    def apparent_mm(self, shift_px: FloatArray) -> FloatArray:
        """Return the apparent u (n,) mm, positive inward, of pixel shifts (n, 2)."""
        return np.asarray(np.einsum("ni,ni->n", self.shift_to_mm, shift_px))

    @property
    def stiffness_size_N_mm(self) -> float:
        """Norm of K: identifies the mechanics behind K·u."""
        return float(np.linalg.norm(self.stiffness))

    @cached_property
    def stiffness_noise_N_px(self) -> FloatArray:
        """Noise of (K·u)_i per pixel of centroid noise, (n,) N/px: the root of Σ (K_ij·|a_j|)².

        Independent noise σ of every coordinate gives u_j the noise |a_j|·σ. |a_j| diverges where
        the camera looks along the normal; the noise is infinite where u cannot be observed.
        """
        spread = np.sum(self.shift_to_mm**2, axis=1)
        return np.where(spread > 0.0, np.sqrt(self.stiffness**2 @ spread), np.inf)

    @cached_property
    def inverse_noise_N_px(self) -> FloatArray:
        """Noise of the compliance inverse per pixel of centroid noise, (n,) N/px: 1 / |C_i|.

        For a weak force on marker i alone; no estimator without bias does better. A strong one has
        more, as markers that move far count less.
        """
        signal = np.linalg.norm(self.response_px, axis=0)
        return np.asarray(1.0 / np.maximum(signal, 1e-300))

    def forces(self, estimator: str, shift_px: FloatArray, koi: IntArray) -> FloatArray:
        """Return the inward force (n,) N on every marker; zero off the key nodes of interest.

        ``auto`` also locates forces on switches that the camera cannot read.

        Parameters
        ----------
        estimator : str
            One of ``ESTIMATORS``.
        shift_px : (n, 2) float
            Marker positions minus rest positions; NaN for a marker that was not found.
        koi : (m,) int
            Markers whose switch is on.
        """
        out = np.zeros(len(shift_px))
        if estimator == "auto" and (len(koi) or (self.locator and len(self.locator.blind))):
            return self.contacts(shift_px, koi).receptor_forces_N(len(shift_px))
        if len(koi) == 0:
            return out
        if estimator == "koi_inverse":
            out[koi] = self._inverse(shift_px, koi)
            return out
        u = self.pressed_mm(shift_px, koi)
        if estimator == "fem":
            out[koi] = self.stiffness[koi] @ u
            return out
        network = self.networks[estimator]
        features = network_features(u, self.neighbours, self.height_z_mm, koi)
        base = self.base_forces(network.base, shift_px, u, koi)
        out[koi] = base + network(features) * u[koi]
        return out

    def beyond_range(self, estimator: str, shift_px: FloatArray, koi: IntArray) -> IntArray:
        """Key nodes (b,) at which a network counts by less than half: it learnt no such motion."""
        network = self.networks.get(estimator)
        if network is None or not len(koi):
            return koi[:0]
        u = self.pressed_mm(shift_px, koi)
        features = network_features(u, self.neighbours, self.height_z_mm, koi)
        return np.asarray(koi[network.learnt(features) < 0.5])

    def base_forces(
        self, base: Base, shift_px: FloatArray, u_mm: FloatArray, koi: IntArray
    ) -> FloatArray:
        """Return the forces (m,) N on key nodes that a network adds to, of apparent u (n,) mm."""
        if base == "key_nodes":
            return self.key_node_forces(shift_px, koi)
        return np.asarray(self.stiffness[koi] @ u_mm)

    def key_node_forces(self, shift_px: FloatArray, koi: IntArray) -> FloatArray:
        """Return forces (m,) N on key nodes, whose own shifts count as ``tip_sd_px`` says."""
        return self._inverse(shift_px, koi, tip_sd_px=self.tip_sd_px)

    @cached_property
    def response_px(self) -> FloatArray:
        """C (2n, n), px/N, with the columns that were measured."""
        if self.measured is None:
            return self.compliance_px
        out = self.compliance_px.copy()
        out[:, self.measured.marker] = self.measured.shift_px
        return out

    @cached_property
    def patterns(self) -> tuple[FloatArray, FloatArray]:
        """Shifts (n, 2n) px/N, one row per force, and their products (n, n)."""
        rows = np.ascontiguousarray(self.response_px.T)
        return rows, rows @ rows.T

    def motion(self, shift_px: FloatArray, koi: IntArray) -> FloatArray:
        """Return the motion (q,) of the cameras since the rest frame, as ``koi_inverse`` has it."""
        if self.camera_motion is None:
            return np.zeros(0)

        def estimated() -> FloatArray:
            d, force = shift_px.reshape(-1), self._inverse(shift_px, koi)
            pressed = force @ self.patterns[0][koi] + self.beyond_linear_px(force, koi)
            return self._motion_behind(d - pressed)

        return self._once("motion", shift_px, koi, estimated)

    def _motion_behind(self, off_px: FloatArray) -> FloatArray:
        """Return the motion (q,) of the cameras behind shifts (2n,) that forces do not explain."""
        if self.camera_motion is None:
            return np.zeros(0)
        free = self.camera_motion.masked(np.isfinite(off_px))
        return free.estimate(np.nan_to_num(off_px), self.noise_px)

    def _once(
        self, name: str, shift_px: FloatArray, koi: IntArray, work: Callable[[], FloatArray]
    ) -> FloatArray:
        """Return the result of ``work`` for these inputs, computed once; see ``KEPT_RESULTS``."""
        key = name, shift_px.tobytes(), koi.tobytes()
        found = self._kept.get(key)
        if found is None:
            while len(self._kept) >= KEPT_RESULTS:
                self._kept.pop(next(iter(self._kept)), None)
            found = self._kept[key] = work()
        return found.copy()

    @cached_property
    def _kept(self) -> dict[tuple[str, bytes, bytes], FloatArray]:
        return {}

    def beyond_linear_px(self, force_N: FloatArray, koi: IntArray) -> FloatArray:
        """Return the shifts (2n,) of forces (m,) N on key nodes that C·f does not have."""
        if self.large_displacements is None:
            return np.zeros(len(self.compliance_px))
        return self.large_displacements.shifts(koi, force_N)[0]

    def pressed_mm(self, shift_px: FloatArray, koi: IntArray) -> FloatArray:
        """Return the apparent u (n,) mm of shifts (n, 2) px less motion of the cameras."""
        pressed_px = self.without_motion(shift_px, self.motion(shift_px, koi))
        return self.apparent_mm(np.nan_to_num(pressed_px))

    def without_motion(self, shift_px: FloatArray, motion: FloatArray) -> FloatArray:
        """Return shifts (n, 2) px less those by a motion (q,) of the cameras."""
        if self.camera_motion is None or not len(motion):
            return shift_px
        return np.asarray(shift_px - self.camera_motion.shift_px(motion).reshape(-1, 2))

    @cached_property
    def large_displacements(self) -> LargeDisplacements | None:
        """Shifts beyond C·f, by the tables of ``auto``; None without any."""
        locator = self.locator
        if self.modulus is None or locator is None or locator.places.orders < 2:
            return None
        stiffness = locator.correction.stiffness if locator.correction else 1.0
        return LargeDisplacements(
            places=locator.places,
            position_mm=locator.position_mm,
            softness=stiffness / self.modulus,
            receptors=self.receptors and self.receptors.scaled(stiffness),
            measured=self.measured,
        )

    def _inverse(
        self, shift_px: FloatArray, koi: IntArray, *, tip_sd_px: float = 0.0
    ) -> FloatArray:
        """Return the least-squares solution f >= 0 of d = C(:, KOI)·f over all found markers.

        Large displacements are added to C·f. Motion of the cameras is left free, within its prior.
        Markers count by their noise and by :data:`MODEL_SHARE` of their motion; key nodes' own
        shifts may have another standard deviation beside these. Few markers that the forces do not
        explain are left out.
        """
        return self._once(
            f"inverse {tip_sd_px}", shift_px, koi, lambda: self._solved(shift_px, koi, tip_sd_px)
        )

    def unexplained(self, off_px: FloatArray, motion_px: FloatArray) -> BoolArray:
        """Return markers (n,) that are off predicted shifts (n, 2) by more than is usual."""
        # A marker that was not found is not off.
        return np.asarray(np.hypot(*off_px.T) > self._usual_px(motion_px, MISREAD_SHARE))

    def _usual_px(self, motion_px: FloatArray, share: float) -> FloatArray:
        """Return how far markers (n,) may be off, by the predicted shifts (n, 2) around them."""
        around = np.hypot(*motion_px.T)[self._near].max(axis=0)
        return np.asarray(MISREAD_NOISES * self.noise_px + share * around)

    @cached_property
    def _near(self) -> IntArray:
        """Neighbours (9, n) of each marker, and itself."""
        own = np.arange(len(self.neighbours))
        near = np.where(self.neighbours >= 0, self.neighbours, own[:, None])
        return np.ascontiguousarray(np.column_stack([own, near]).T)

    def misread(self, shift_px: FloatArray, koi: IntArray, force_N: FloatArray) -> BoolArray:
        """Return markers (n,) other than key nodes that forces on these do not explain, if few."""
        out = self._excess(shift_px, koi, force_N) > 1.0
        return out & (np.count_nonzero(out) <= MISREAD_MAX)

    def _excess(self, shift_px: FloatArray, koi: IntArray, force_N: FloatArray) -> FloatArray:
        """Return how far markers (n,) other than key nodes are off, over what is usual."""
        motion_px = (force_N @ self.patterns[0][koi]).reshape(-1, 2)
        # In most frames linear shifts explain all markers well enough.
        share = MISREAD_SHARE + BEYOND_LINEAR_SHARE
        out = np.hypot(*(shift_px - motion_px).T) / self._usual_px(motion_px, share)
        if np.any(out > 1.0):
            motion_px = motion_px + self.beyond_linear_px(force_N, koi).reshape(-1, 2)
            off_px = shift_px - motion_px
            off_px = self.without_motion(off_px, self._motion_behind(off_px.reshape(-1)))
            out = np.hypot(*off_px.T) / self._usual_px(motion_px, MISREAD_SHARE)
        out[koi] = 0.0
        # A marker that was not found is not off.
        return np.asarray(np.nan_to_num(out))

    def _solved(self, shift_px: FloatArray, koi: IntArray, tip_sd_px: float) -> FloatArray:
        first = force = self._least_squares(shift_px, koi, tip_sd_px)
        without = shift_px.copy()
        # One misread marker pulls forces until many others seem to be off: the farthest goes first.
        for _ in range(MISREAD_MAX):
            excess = self._excess(without, koi, force)
            if not np.any(excess > 1.0):
                break
            without[excess.argmax()] = np.nan
            force = self._least_squares(without, koi, tip_sd_px)
        if force is first:
            return first
        misread = self.misread(shift_px, koi, force)
        if not misread.any():
            return first
        return self._least_squares(np.where(misread[:, None], np.nan, shift_px), koi, tip_sd_px)

    def _least_squares(self, shift_px: FloatArray, koi: IntArray, tip_sd_px: float) -> FloatArray:
        """Return forces (m,) that explain all found markers, however far some are off."""
        rows, d = self.patterns[0][koi], shift_px.reshape(-1)
        sd_px = np.full(len(shift_px), max(self.noise_px, NOISE_LEAST_px))
        sd_px[koi] = np.hypot(sd_px[koi], tip_sd_px)
        # Not by what is seen alone: a misread marker that seems to stay would count most.
        linear_px = self._weighted(d, sd_px)(rows, d) @ rows
        moved_px = np.fmax(*(np.hypot(*px.reshape(-1, 2).T) for px in (d, linear_px)))
        solved = self._weighted(d, np.hypot(sd_px, MODEL_SHARE * moved_px))
        if self.large_displacements is None or not len(koi):
            return solved(rows, d)
        return self.large_displacements.solve(solved, rows, d, koi)

    def _weighted(
        self, d: FloatArray, sd_px: FloatArray
    ) -> Callable[[FloatArray, FloatArray], FloatArray]:
        """Return the solver of least squares where markers have standard deviations (n,).

        It gives forces (m,) by shifts (m, 2n) per newton, and shifts (2n,) that are seen where
        those of ``d`` (2n,) are not NaN.
        """
        noise_px = max(self.noise_px, NOISE_LEAST_px)
        root = np.isfinite(d) * np.repeat(noise_px / sd_px, 2)
        motion = self.camera_motion.weighted(root) if self.camera_motion else None

        def solved(rows: FloatArray, d: FloatArray) -> FloatArray:
            c, seen = rows * root, root * np.nan_to_num(d)
            equations = c @ c.T, c @ seen
            if motion:
                equations = motion.normal_equations(c, seen, self.noise_px)
            return nonnegative_least_squares(*equations)

        return solved
