"""Forces from marker displacements: the paper's two estimators and the compliance inverse."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from phytac_decoder.estimation.cascade_network import CascadeNetwork, network_features
from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.estimation.nonnegative import nonnegative_least_squares
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError

ESTIMATORS = ("fem", "fem_nn", "fem_nn_identity", "koi_inverse", "auto")
"""Names, in the order of every table."""
HIDDEN_MOST = 0.99
"""Share of a force's shifts, squared, that may be hidden before products are summed anew."""


@dataclass(frozen=True, kw_only=True)
class ForceModel:
    """Everything the estimators need to know of one sensor; arrays run over n markers.

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
    locator : Locator, optional
        Finds contacts, for the estimator ``auto``.
    """

    shift_to_mm: FloatArray
    stiffness: FloatArray
    compliance_px: FloatArray
    height_z_mm: FloatArray
    neighbours: IntArray
    networks: dict[str, CascadeNetwork]
    locator: ContactLocator | None = None

    @property
    def estimators(self) -> tuple[str, ...]:
        """Names of the estimators that this model has all it needs for, in the order of tables."""
        ready = {"fem", "koi_inverse", *self.networks}
        if self.locator is not None:
            ready.add("auto")
        return tuple(name for name in ESTIMATORS if name in ready)

    @property
    def linear(self) -> "ForceModel":
        """The same for data of a shell that is linear: ``auto`` by its linear tables."""
        return self if self.locator is None else replace(self, locator=self.locator.linear)

    @property
    def best(self) -> str:
        """The estimator to use where none is asked for."""
        return "koi_inverse" if self.locator is None else "auto"

    def contacts(
        self, shift_px: FloatArray, koi: IntArray, *, before: ContactDetection | None = None
    ) -> ContactDetection:
        """Contacts behind shifts (n, 2) px: place, size, force and its standard deviation.

        ``before`` is what the frame before showed, if there was one: then it is much faster.

        Raises
        ------
        InputError
            If the bundle has no tables for it.
        """
        if self.locator is None:
            raise InputError(
                "this bundle has no tables to find contacts with (estimator auto); build the "
                "design again"
            )
        return self.locator.find(shift_px, koi, before=before)

    def apparent_mm(self, shift_px: FloatArray) -> FloatArray:
        """Apparent u (n,) mm, positive inward, of pixel shifts (n, 2)."""
        return np.asarray(np.einsum("ni,ni->n", self.shift_to_mm, shift_px))

    @property
    def stiffness_size_N_mm(self) -> float:
        """Norm of K: one number by which the mechanics behind K·u are known."""
        return float(np.linalg.norm(self.stiffness))

    @cached_property
    def stiffness_noise_N_px(self) -> FloatArray:
        """Noise of (K·u)_i per pixel of centroid noise, (n,) N/px: the root of Σ (K_ij·|a_j|)².

        Independent noise σ on every coordinate gives u_j the noise |a_j|·σ. K is as good as its
        inverse allows, and |a_j| grows without bound where the camera looks along the normal;
        infinite where u cannot be observed at all.
        """
        spread = np.sum(self.shift_to_mm**2, axis=1)
        return np.where(spread > 0.0, np.sqrt(self.stiffness**2 @ spread), np.inf)

    @cached_property
    def inverse_noise_N_px(self) -> FloatArray:
        """Noise of the compliance inverse per pixel of centroid noise, (n,) N/px: 1 / |C_i|.

        For a force on marker i alone; no estimator without bias does better.
        """
        signal = np.linalg.norm(self.compliance_px, axis=0)
        return np.asarray(1.0 / np.maximum(signal, 1e-300))

    def forces(self, estimator: str, shift_px: FloatArray, koi: IntArray) -> FloatArray:
        """Inward force (n,) N on every marker; zero off the key nodes of interest.

        ``auto`` also finds forces on switches that the camera cannot read.

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
        u = self.apparent_mm(np.nan_to_num(shift_px))
        force = self.stiffness[koi] @ u
        if estimator != "fem":
            features = network_features(u, self.neighbours, self.height_z_mm, koi)
            force = force + self.networks[estimator](features) * u[koi]
        out[koi] = force
        return out

    @cached_property
    def patterns(self) -> tuple[FloatArray, FloatArray]:
        """Shifts (n, 2n) px/N, one row a force, and their products (n, n): rows side by side."""
        rows = np.ascontiguousarray(self.compliance_px.T)
        return rows, rows @ rows.T

    def _inverse(self, shift_px: FloatArray, koi: IntArray) -> FloatArray:
        """Least squares d = C(:, KOI)·f over all markers that were seen, f >= 0."""
        d = shift_px.reshape(-1)
        rows, products = self.patterns
        c = rows[koi]
        gram = products[koi[:, None], koi]
        unseen = np.flatnonzero(~np.isfinite(d))
        if len(unseen):
            d = d.copy()
            d[unseen] = 0.0
            hidden = c[:, unseen]
            left = np.einsum("ij,ij->i", hidden, hidden) <= HIDDEN_MOST * gram.diagonal()
            if left.all():
                gram -= hidden @ hidden.T
            else:
                # Little is left of a difference: its rounding would count.
                c[:, unseen] = 0.0
                gram = c @ c.T
        return nonnegative_least_squares(gram, c @ d)
