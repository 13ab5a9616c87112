"""Faces of molds as one mesh of shared corners: rings joined by strips, from outside inwards.

Every face of a mold is seen whole along the pull: rings only shrink on their way inwards. So what
is built here releases, and closes without a boolean operation.
"""

import numpy as np

from phytac_design.geometry.triangles import TriangleMesh, widening
from phytac_shapes.arrays import FloatArray, IntArray


class Sheet:
    """A mesh that grows ring by ring.

    Rings run counter-clockwise seen from above; faces look up, or down while ``up`` is false.
    """

    def __init__(self) -> None:
        self.up = True
        self._points: list[FloatArray] = []
        self._triangles: list[IntArray] = []
        self._count = 0

    def points(self, xyz_mm: FloatArray) -> IntArray:
        """Add points (…, 3); their ids, (…)."""
        flat = np.asarray(xyz_mm, dtype=np.float64).reshape(-1, 3)
        ids = np.arange(self._count, self._count + len(flat))
        self._points.append(flat)
        self._count += len(flat)
        return ids.reshape(np.shape(xyz_mm)[:-1])

    def faces(self, triangles: IntArray) -> None:
        """Add triangles (m, 3), counter-clockwise seen from above."""
        self._triangles.append(triangles if self.up else triangles[:, ::-1])

    def strip(self, outer: IntArray, inner: IntArray) -> None:
        """Join rings (…, n) to rings of as many points inside them."""
        a, b = outer, np.roll(outer, -1, axis=-1)
        c, d = np.roll(inner, -1, axis=-1), inner
        self.faces(np.stack([a, b, c], axis=-1).reshape(-1, 3))
        self.faces(np.stack([a, c, d], axis=-1).reshape(-1, 3))

    def turned(self, centre_mm: FloatArray, profile: FloatArray, sides: int) -> IntArray:
        """Surfaces of revolution about vertical axes, joined ring to ring.

        Parameters
        ----------
        centre_mm : (m, 2) float
            Where the axes stand.
        profile : (k, 2) float
            (r, z) from outside inwards; polygons have their circles' area.
        sides : int
            Corners of each ring, a multiple of 4.

        Returns
        -------
        ids : (m, k, sides) int
        """
        angle = 2.0 * np.pi * np.arange(sides) / sides
        unit = widening(sides) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        shape = (len(centre_mm), len(profile), sides)
        xyz = np.empty((*shape, 3))
        xyz[..., :2] = centre_mm[:, None, None] + profile[None, :, None, :1] * unit
        xyz[..., 2] = profile[None, :, None, 1]
        ids = self.points(xyz)
        self.strip(ids[:, :-1], ids[:, 1:])
        return ids

    def collar(self, corners: IntArray, ring: IntArray) -> None:
        """Fill between rectangles (m, 4), first corner to the right and back, and their rings."""
        sides = ring.shape[1]
        quarter = sides // 4
        for k in range(4):
            part = ring[:, (np.arange(quarter + 1) + k * quarter) % sides]
            corner = np.broadcast_to(corners[:, k, None], (len(ring), quarter))
            self.faces(np.stack([corner, part[:, 1:], part[:, :-1]], axis=-1).reshape(-1, 3))
            self.faces(np.stack([corners[:, k], corners[:, (k + 1) % 4], part[:, -1]], axis=-1))

    def disc(self, ring: IntArray, centre_mm: FloatArray) -> None:
        """Close rings (m, n) by fans around points (m, 3) inside them."""
        middle = self.points(centre_mm)
        fan = [np.broadcast_to(middle[:, None], ring.shape), ring, np.roll(ring, -1, axis=1)]
        self.faces(np.stack(fan, axis=-1).reshape(-1, 3))

    def squares(self, corners: IntArray) -> None:
        """Fill rectangles (m, 4)."""
        self.faces(np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]))

    def between_rows(self, lower: IntArray, upper: IntArray) -> None:
        """Fill between two rows (n,) of points, both from left to right, the first in front."""
        self.faces(np.stack([lower[:-1], lower[1:], upper[1:]], axis=-1))
        self.faces(np.stack([lower[:-1], upper[1:], upper[:-1]], axis=-1))

    def mesh(self) -> TriangleMesh:
        """Everything so far; unused points are left out."""
        triangles = np.concatenate(self._triangles)
        used, inverse = np.unique(triangles, return_inverse=True)
        return TriangleMesh(
            vertices_mm=np.concatenate(self._points)[used],
            triangles=inverse.reshape(-1, 3).astype(np.int64),
        )
