"""Demoulding check: rays along the pull, and the draft of every face."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phytac_design.core.kernels import kernel
from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import FloatArray, IntArray

RAY_STEP_mm = 0.1
"""Distance between rays: half the thinnest feature of a cavity."""


@dataclass(frozen=True, kw_only=True)
class Release:
    """Rays along the pull, and slopes of the faces, of a part.

    Attributes
    ----------
    rays : int
        Rays that met the part.
    caught : int
        Rays that met it more than twice, or met it above a hole's end: something there cannot
        leave along the pull.
    places_mm : (n, 2) float
        Where the first of these are, at most ten.
    draft_deg : float
        Least slope of any face against the pull.
    """

    rays: int
    caught: int
    places_mm: FloatArray
    draft_deg: float


@kernel
def _side(xyz: FloatArray, start: int, end: int, x: int, y: int) -> float:
    """Twice the area between an edge and a point on its left; -1 where the point is outside.

    A point on the edge belongs to one of the two sides. Neighbours take the edge's ends in one
    order, so that they agree.
    """
    sign = 1.0
    if start > end:
        start, end, sign = end, start, -1.0
    run, rise = xyz[end, 0] - xyz[start, 0], xyz[end, 1] - xyz[start, 1]
    side: float = sign * (run * (y - xyz[start, 1]) - rise * (x - xyz[start, 0]))
    own = sign * rise > 0.0 or (rise == 0.0 and sign * run < 0.0)
    return side if side > 0.0 or (side == 0.0 and own) else -1.0


@kernel
def _count(xyz: FloatArray, triangles: IntArray, counts: IntArray, ceiling_mm: FloatArray) -> None:
    """Add 1 to every grid point in each triangle's projection.

    ``ceiling_mm`` becomes the height of the highest face above each grid point that looks down.
    """
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        area = (xyz[b, 0] - xyz[a, 0]) * (xyz[c, 1] - xyz[a, 1]) - (xyz[b, 1] - xyz[a, 1]) * (
            xyz[c, 0] - xyz[a, 0]
        )
        if area == 0.0:
            continue
        down = area < 0.0
        if down:
            b, c = c, b
        low, high = min(xyz[a, 2], xyz[b, 2], xyz[c, 2]), max(xyz[a, 2], xyz[b, 2], xyz[c, 2])
        first_x = max(0, int(np.ceil(min(xyz[a, 0], xyz[b, 0], xyz[c, 0]))))
        first_y = max(0, int(np.ceil(min(xyz[a, 1], xyz[b, 1], xyz[c, 1]))))
        last_x = min(counts.shape[1] - 1, int(np.floor(max(xyz[a, 0], xyz[b, 0], xyz[c, 0]))))
        last_y = min(counts.shape[0] - 1, int(np.floor(max(xyz[a, 1], xyz[b, 1], xyz[c, 1]))))
        for y in range(first_y, last_y + 1):
            for x in range(first_x, last_x + 1):
                p, q, r = _side(xyz, b, c, x, y), _side(xyz, c, a, x, y), _side(xyz, a, b, x, y)
                if min(p, q, r) < 0.0:
                    continue
                counts[y, x] += 1
                if down:
                    # Steep faces: rounding must not leave the triangle.
                    z = (p * xyz[a, 2] + q * xyz[b, 2] + r * xyz[c, 2]) / abs(area)
                    ceiling_mm[y, x] = max(ceiling_mm[y, x], min(max(z, low), high))


@dataclass(frozen=True, kw_only=True)
class Bottom:
    """Lower end of the rubber: within a rectangle no face above it may look down.

    Attributes
    ----------
    low_mm, high_mm : (2,) float
        Corners of the rectangle.
    z_mm : float
        Height of the stems' ends.
    """

    low_mm: FloatArray
    high_mm: FloatArray
    z_mm: float


def check_release(
    mesh: TriangleMesh, step_mm: float = RAY_STEP_mm, bottoms: Sequence[Bottom] = ()
) -> Release:
    """Shoot rays along z through a closed part, and find its steepest face.

    Parameters
    ----------
    step_mm : float
        Distance between rays; their grid is a little off the part's symmetry planes.
    bottoms : sequence of Bottom
        Ends of cavities that go right through: a hole that widens downwards lets every ray pass,
        but not what was cast in it.
    """
    crossings = 2  # a ray into a part that releases both ways goes in once and out once
    flat_mm = 1e-6  # rounding of a face's height
    low = mesh.vertices_mm[:, :2].min(axis=0) - 0.618 * step_mm
    xyz = np.column_stack([(mesh.vertices_mm[:, :2] - low) / step_mm, mesh.vertices_mm[:, 2]])
    size = np.ceil(xyz[:, :2].max(axis=0)).astype(np.int64) + 1
    counts = np.zeros((size[1], size[0]), dtype=np.int64)
    ceiling = np.full(counts.shape, -np.inf)
    _count(xyz, mesh.triangles, counts, ceiling)
    bad = counts > crossings
    for bottom in bottoms:
        first = np.ceil((bottom.low_mm - low) / step_mm).astype(np.int64)
        last = np.floor((bottom.high_mm - low) / step_mm).astype(np.int64) + 1
        part = np.s_[first[1] : last[1], first[0] : last[0]]
        bad[part] |= ceiling[part] > bottom.z_mm + flat_mm
    caught = np.argwhere(bad)
    a, b, c = np.moveaxis(mesh.corners_mm, 1, 0)
    normal = np.cross(b - a, c - a)
    slope = np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1)
    return Release(
        rays=int((counts > 0).sum()),
        caught=len(caught),
        places_mm=caught[:10, ::-1] * step_mm + low,
        draft_deg=float(np.degrees(np.arcsin(slope.min()))),
    )
