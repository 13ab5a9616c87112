"""Correction of forces that was fitted to a sensor's own data.

The errors of the physics vary slowly with place and force. Their logarithm is interpolated by
kernel ridge regression, which is the mean of a Gaussian process (Rasmussen and Williams 2006,
eq. 2.25): far from all data it is 0.
"""

from dataclasses import dataclass

import numpy as np

from phytac_shapes.arrays import FloatArray

Lengths = tuple[float, float, float]
"""Length scales of place (over the sensor's size), force (over the largest) and signal."""
LEGACY_LENGTHS: Lengths = (0.33, 0.33, 0.33)
"""Length scales up to schema 1.6, and where a fit starts."""


@dataclass(frozen=True, kw_only=True)
class ForceCorrection:
    """Factor on forces by place, force and signal; arrays run over m contacts of the data.

    Attributes
    ----------
    centre : (m, 5) float
        Features, see :meth:`features`.
    weight : (m,) float
        Weights of the kernels.
    low_mm, size_mm : (3,) float, float
        Corner of the sensor's bounding box, and its largest side.
    force_max_N : float
        Largest force.
    spread : float
        Factor on standard deviations.
    spread_share : float
        Further standard deviation, as a share of the force.
    lengths : (3,) float
        Length scales of the features.
    stiffness : float
        Stiffness of the print that the tables were scaled to, over that of the design.
    linear : bool
        The data were simulated by linear theory, so that the correction knows nothing of its error.
    """

    centre: FloatArray
    weight: FloatArray
    low_mm: FloatArray
    size_mm: float
    force_max_N: float
    spread: float = 1.0
    spread_share: float = 0.0
    lengths: Lengths = LEGACY_LENGTHS
    stiffness: float = 1.0
    linear: bool = False

    @classmethod
    def plain(cls, *, low_mm: FloatArray, size_mm: float, force_max_N: float) -> "ForceCorrection":
        """Return the correction without data: all factors are 1."""
        return cls(
            centre=np.zeros((0, 5)),
            weight=np.zeros(0),
            low_mm=low_mm,
            size_mm=size_mm,
            force_max_N=force_max_N,
        )

    def features(
        self, point_mm: FloatArray, force_N: FloatArray, signal_px: FloatArray
    ) -> FloatArray:
        """Return features (c, 5) of contacts at points (c, 3).

        They are the place over the size, the force over the largest, and 0.4 times the logarithm
        of the signal (c,) in px per newton over all markers. The signal falls towards the rims,
        where errors change within millimetres.
        """
        place = (point_mm - self.low_mm) / self.size_mm
        signal = 0.4 * np.log(np.maximum(signal_px, 1e-6))
        return np.column_stack([place, force_N / self.force_max_N, signal])

    def factor(
        self, point_mm: FloatArray, force_N: FloatArray, signal_px: FloatArray
    ) -> FloatArray:
        """Return the factor (c,) on forces."""
        if len(self.weight) == 0:
            return np.ones(len(force_N))
        own = self.features(point_mm, force_N, signal_px)
        return np.asarray(np.exp(kernel(own, self.centre, self.lengths) @ self.weight))

    def spread_N(self, force_N: FloatArray, sd_N: FloatArray) -> FloatArray:
        """Return standard deviations (c,) of corrected forces."""
        return np.asarray(np.hypot(self.spread * sd_N, self.spread_share * force_N))


def kernel(a: FloatArray, b: FloatArray, lengths: Lengths) -> FloatArray:
    """Return the squared-exponential correlation (p, q) of features (p, 5) and (q, 5)."""
    place, force, signal = lengths
    scale = np.array([place, place, place, force, signal])
    a, b = a / scale, b / scale
    gap = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * (a @ b.T)
    return np.asarray(np.exp(-0.5 * np.maximum(gap, 0.0)))
