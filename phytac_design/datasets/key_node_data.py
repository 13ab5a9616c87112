"""What the force network learns from: one row per key node of interest."""

from dataclasses import dataclass, fields

import numpy as np

from phytac_decoder.estimation.cascade_network import CascadeNetwork
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class KeyNodeData:
    """One row per key node of interest (a marker whose switch is on).

    Attributes
    ----------
    features : (m, 10) float
        u of the node and its eight neighbours (mm), z (mm); see ``network_features``.
    apparent_mm : (m,) float
        u of the node itself.
    stiffness_force_N : (m,) float
        (K·U) at the node.
    force_N : (m,) float
        True force carried by the node.
    sample : (m,) int
        Sample the row belongs to.
    """

    features: FloatArray
    apparent_mm: FloatArray
    stiffness_force_N: FloatArray
    force_N: FloatArray
    sample: IntArray

    def take(self, samples: IntArray) -> "KeyNodeData":
        """Return the rows of some samples."""
        keep = np.isin(self.sample, samples)
        return KeyNodeData(
            **{field.name: getattr(self, field.name)[keep] for field in fields(self)}
        )

    def rmse_N(self, network: CascadeNetwork) -> float:
        """Return the force error (root mean square) of a network; NaN without rows."""
        stiffness = network(self.features)
        error = self.stiffness_force_N + stiffness * self.apparent_mm - self.force_N
        return float(np.sqrt((error**2).mean())) if len(error) else float("nan")
