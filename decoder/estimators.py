"""Forces from marker displacements: the paper's two estimators and the compliance inverse."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from decoder.network import CascadeNetwork, network_features
from shapes.arrays import FloatArray, IntArray

ESTIMATORS = ("fem", "fem_nn", "fem_nn_identity", "koi_inverse")
"""Names, in the order of every table."""


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
    """

    shift_to_mm: FloatArray
    stiffness: FloatArray
    compliance_px: FloatArray
    height_z_mm: FloatArray
    neighbours: IntArray
    networks: dict[str, CascadeNetwork]

    def apparent_mm(self, shift_px: FloatArray) -> FloatArray:
        """Apparent u (n,) mm, positive inward, of pixel shifts (n, 2)."""
        return np.asarray(np.einsum("ni,ni->n", self.shift_to_mm, shift_px))

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

    def _inverse(self, shift_px: FloatArray, koi: IntArray) -> FloatArray:
        """Least squares d = C(:, KOI)·f over all markers that were seen, f >= 0."""
        d = shift_px.reshape(-1)
        seen = np.isfinite(d)
        c = self.compliance_px[np.ix_(seen, koi)]
        return nonnegative_least_squares(c.T @ c, c.T @ d[seen])


def nonnegative_least_squares(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Minimise ½ fᵀ G f − rᵀ f over f >= 0 (Lawson and Hanson 1974, on the normal equations).

    Parameters
    ----------
    gram : (m, m) float
        AᵀA, positive definite on every subset.
    right : (m,) float
        Aᵀb.
    """
    size = len(right)
    f = np.zeros(size)
    passive = np.zeros(size, dtype=np.bool_)
    tolerance = 1e-12 * max(float(np.abs(right).max(initial=0.0)), 1e-300)
    for _ in range(10 * size + 10):
        gradient = right - gram @ f
        gradient[passive] = -np.inf
        best = int(np.argmax(gradient))
        if passive.all() or gradient[best] <= tolerance:
            break
        passive[best] = True
        while True:
            trial = np.zeros(size)
            index = np.flatnonzero(passive)
            trial[index] = np.linalg.lstsq(gram[np.ix_(index, index)], right[index], rcond=None)[0]
            if (trial[index] > 0.0).all():
                f = trial
                break
            falling = passive & (trial <= 0.0)
            step = np.min(f[falling] / np.maximum(f[falling] - trial[falling], 1e-300))
            f = f + step * (trial - f)
            passive &= f > tolerance
            f[~passive] = 0.0
    return f
