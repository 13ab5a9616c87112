"""Large displacements by forces on receptors themselves, each solved for the disc that presses it.

The tables of ``auto`` hold those of one disc at any place. A smaller disc dents a thin wall more:
shifts beyond linear ones are a third larger on ``cylinder60`` under a switch's footprint. And
interactions of known receptors need no interpolation.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.mechanics.response_table import softening_of
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class ReceptorTable:
    """Shifts of n markers beyond linear ones, by forces on m of them.

    Attributes
    ----------
    marker : (m,) int
        Markers whose receptors are pressed.
    shift_px : (m, k, 2n) float32
        Of powers of the force from the second on, px/N², px/N³, …
    pair : (2, q) int
        Pairs of them, the larger number first.
    pair_px : (q, 2n) float32
        Interactions of second order of these, px/N².
    top_N : float
        Largest force.
    """

    marker: IntArray
    shift_px: NDArray[np.float32]
    pair: IntArray
    pair_px: NDArray[np.float32]
    top_N: float

    def scaled(self, stiffness: float) -> "ReceptorTable":
        """Return the table of a sensor stiffer by a factor."""
        powers = stiffness ** -np.arange(2.0, self.shift_px.shape[1] + 2.0)
        return replace(
            self,
            shift_px=self.shift_px * powers.astype(np.float32)[:, None],
            pair_px=self.pair_px * np.float32(stiffness**-2.0),
            top_N=stiffness * self.top_N,
        )

    @cached_property
    def rows(self) -> dict[int, NDArray[np.float32]]:
        """``shift_px`` (k, 2n) by marker."""
        return dict(zip(self.marker.tolist(), self.shift_px, strict=True))

    @cached_property
    def pairs(self) -> dict[tuple[int, int], NDArray[np.float32]]:
        """``pair_px`` (2n,) by both markers, the larger number first."""
        one, other = self.pair.tolist()
        return dict(zip(zip(one, other, strict=True), self.pair_px, strict=True))

    @cached_property
    def softening(self) -> FloatArray:
        """Share (m,) of the stiffness that each newton on a receptor takes away, 1/N."""
        return softening_of(self.shift_px, self.top_N)
