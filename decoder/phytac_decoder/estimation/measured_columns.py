"""What known contacts have measured of one print, beside what its design says."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class MeasuredColumns:
    """Shifts of all markers under forces on markers, of one print.

    Attributes
    ----------
    marker : (m,) int
        Markers that were pressed.
    shift_px : (2n, m) float
        Columns of C in place of the design's: shifts per newton on each, px/N.
    square_px : (2n, m) float
        Added to the shifts times the square of each force, px/N²; empty where the shell is linear.
    pair : (2, k) int
        Pairs of markers that were pressed together, the larger number first.
    pair_px : (2n, k) float
        Added to their interactions of second order, px/N².
    """

    marker: IntArray
    shift_px: FloatArray
    square_px: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    pair: IntArray = field(default_factory=lambda: np.zeros((2, 0), dtype=np.int64))
    pair_px: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @cached_property
    def squares(self) -> dict[int, FloatArray]:
        """Rows (2n,) of ``square_px`` by marker."""
        if not self.square_px.size:
            return {}
        return dict(zip(self.marker.tolist(), self.square_px.T, strict=True))

    @cached_property
    def pairs(self) -> dict[tuple[int, int], FloatArray]:
        """Rows (2n,) of ``pair_px`` by both markers, the larger number first."""
        both = zip(self.pair.max(axis=0).tolist(), self.pair.min(axis=0).tolist(), strict=True)
        return dict(zip(both, self.pair_px.T, strict=True)) if self.pair_px.size else {}
