"""Reference marks: dots on the clamped rims, found in frames as markers are.

They do not move with the wall. Arrays of markers and marks together have the n markers first.
"""

from dataclasses import dataclass, field

import numpy as np

from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class ReferenceMarks:
    """Reference marks of one sensor, r in all; none by default.

    Attributes
    ----------
    point_mm : (r, 3) float
        Centres, sensor frame.
    colour : (r,) int
        Class of the paint.
    rest_px : (r, 2) float
        Positions at rest, in the image of the camera that reads each; NaN if none does.
    read_by : (r,) int
        That camera.
    neighbours : (r, 8) int
        Next marks on either side; -1 for no more.
    """

    point_mm: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    colour: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    rest_px: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    read_by: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    neighbours: IntArray = field(default_factory=lambda: np.zeros((0, 8), dtype=np.int64))

    @property
    def count(self) -> int:
        """Number of marks."""
        return len(self.colour)


def with_marks(neighbours: IntArray, of_marks: IntArray) -> IntArray:
    """Return neighbours (n + r, 8) of markers (n, 8) and of marks (r, 8); -1 for none."""
    return np.concatenate([neighbours, np.where(of_marks < 0, -1, of_marks + len(neighbours))])
