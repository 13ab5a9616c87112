"""What contacts at once do to the markers' images, beyond the sum of what each does alone.

Koiter's second term of several forces holds, besides each one's own f²·S₂, a mixed term for each
two of them, ::

    d ⊃ f₁·f₂·M(place₁, place₂)

since one contact's stress and turn stiffen or soften the wall for the other. Images M of all places
lie, but for a few hundredths, in a space of some dozen dimensions: tabulated are that space's
axes, and M's coordinates over pairs of places.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decoder.places import Places
from shapes.arrays import FloatArray

MOST = 0.3
"""Largest mixed term over what each of the two does alone: contacts that all but cover each other
are no pair."""


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Mixed terms over each two of p places.

    Attributes
    ----------
    grid : Places
        The places; their rows (p, p, r) are coordinates of M.
    axes_px : (r, 2n) float32
        Images, px/N², that these count.
    """

    grid: Places
    axes_px: NDArray[np.float32]

    def scaled(self, stiffness: float) -> "Pairs":
        """Those of a sensor that is stiffer by a factor."""
        return replace(self, axes_px=self.axes_px / np.float32(stiffness**2))

    def between(self, points_mm: FloatArray) -> NDArray[np.float32]:
        """M (k, 2n) px/N² of each two of points (c, 3), in the order of ``numpy.tril_indices``."""
        own = [self.grid.shares(point) for point in points_mm]
        rows = [
            np.outer(own[i][1], own[k][1]).astype(np.float32).ravel()
            @ self.grid.shift_px[own[i][0][:, None], own[k][0]].reshape(-1, len(self.axes_px))
            for i, k in _each_two(len(points_mm))
        ]
        return np.asarray(np.stack(rows) @ self.axes_px)


def with_mixed(
    pairs: Pairs,
    points_mm: FloatArray,
    force_N: FloatArray,
    parts: Sequence[tuple[FloatArray, FloatArray]],
) -> list[tuple[FloatArray, FloatArray]]:
    """Add mixed terms of c contacts to what each does alone.

    Parameters
    ----------
    pairs : Pairs
        Tables.
    points_mm, force_N : (c, 3) float, (c,) float
        The contacts.
    parts : sequence of ((2n,), (u, 2n)) float
        Shifts of each, and their slopes by its unknowns, of which the first is the force. How M
        goes with the places is left out of these: it goes little.
    """
    out = [(total.copy(), slope.copy()) for total, slope in parts]
    size = [float(np.linalg.norm(total)) for total, _ in parts]
    for (i, k), image in zip(_each_two(len(parts)), pairs.between(points_mm), strict=True):
        both = float(force_N[i] * force_N[k])
        much = both * float(np.linalg.norm(image))
        bound = MOST * min(size[i], size[k])
        mixed = (min(1.0, bound / much) if much > 0.0 else 1.0) * image
        for j in (i, k):
            out[j][0][:] += 0.5 * both * mixed
        out[i][1][0] += force_N[k] * mixed
        out[k][1][0] += force_N[i] * mixed
    return out


def _each_two(count: int) -> list[tuple[int, int]]:
    return [(i, k) for i in range(count) for k in range(i)]
