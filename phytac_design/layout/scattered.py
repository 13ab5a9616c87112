"""Layouts without rows: phyllotaxis or explicit positions; colours and neighbours."""

import numpy as np
from scipy.spatial import cKDTree

from phytac_design.design.spec import Design
from phytac_design.layout.arc import by_area
from phytac_design.layout.markers import NEIGHBOUR_STEPS
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError


def phyllotaxis(surface: Surface, count: int, *, inset_mm: float) -> FloatArray:
    """Chart places (count, 2), ordered along u: one after the other turned by the golden angle.

    A margin of ``inset_mm`` at open edges stays free. Of the remaining area marker k holds the
    k-th of ``count`` equal areas, counted from the pole where there is one, and lies at (k · golden
    angle) of the area around. On a sheet, where v does not close, the same rule is a Fibonacci
    lattice.
    """
    golden = (3.0 - np.sqrt(5.0)) / 2.0  # the golden angle as a share of a full turn (137.5°)
    k = np.arange(count)
    shares = np.column_stack([(k + 0.5) / count, np.mod(k * golden + 0.5, 1.0)])
    if surface.poles[1]:
        shares = np.column_stack([1.0 - shares[::-1, 0], shares[::-1, 1]])
    return by_area(surface, shares, inset_mm=inset_mm)


def explicit(design: Design, surface: Surface) -> tuple[FloatArray, IntArray]:
    """Chart places (n, 2) of the design's positions and their order along u, (n,).

    Raises
    ------
    DesignError
        If a position lies outside the surface.
    """
    # Positions given in space may lie this far from the outer face; they are moved onto it.
    off_face_mm = 1.0
    given = np.array(design.layout.positions, dtype=np.float64)
    uv = given if given.shape[1] == 2 else surface.chart(given)
    if given.shape[1] == 3:
        off = np.linalg.norm(surface.point(uv) - given, axis=1)
        worst = int(np.argmax(off))
        if not off[worst] <= off_face_mm:
            raise DesignError(
                "position-off-surface",
                f"layout.positions: position {worst + 1} lies {off[worst]:.2f} mm from the outer "
                f"face of the {surface.name} (at most {off_face_mm:g} mm); correct it",
            )
    low, high = surface.domain.T
    tol = 1e-9 * (high - low)
    periodic = np.array(surface.periodic)
    out = ~(periodic | ((uv >= low - tol) & (uv <= high + tol)))
    bad = np.flatnonzero(out.any(axis=1))
    if bad.size:
        worst = int(bad[0])
        raise DesignError(
            "position-off-surface",
            f"layout.positions: position {worst + 1} lies off the surface (u = {uv[worst, 0]:g}, v "
            f"= {uv[worst, 1]:g}; u goes from {low[0]:g} to {high[0]:g}, v from {low[1]:g} to "
            f"{high[1]:g}); correct it",
        )
    inside = np.where(periodic, low + np.mod(uv - low, high - low), np.clip(uv, low, high))
    order = np.argsort(inside[:, 0], kind="stable")
    return inside[order], order


def spread_colours(points_mm: FloatArray, colours: int) -> IntArray:
    """Colours (n,) such that near markers differ where they can.

    Each marker in turn takes the colour whose nearest marker so far is farthest; ties go to the
    colour used least.
    """
    n = len(points_mm)
    out = np.full(n, -1, dtype=np.int64)
    if colours == 1 or n <= 1:
        return np.zeros(n, dtype=np.int64)
    distance, near = cKDTree(points_mm).query(points_mm, k=min(n, 24))
    used = np.zeros(colours, dtype=np.int64)
    for marker in range(n):
        gap = np.full(colours, np.inf)
        # Farthest first, so that the nearest of each colour is written last.
        known = out[near[marker, ::-1]]
        seen = known >= 0
        gap[known[seen]] = distance[marker, ::-1][seen]
        best = np.flatnonzero(gap >= gap.max() * (1.0 - 1e-9))
        out[marker] = best[np.argmin(used[best])]
        used[out[marker]] += 1
    return out


def sector_neighbours(surface: Surface, uv: FloatArray, normal: FloatArray) -> IntArray:
    """Nearest marker in each of eight sectors around each marker, (n, 8), -1 where there is none.

    Sectors are 45° wide in the tangent plane and centred on the directions of ``NEIGHBOUR_STEPS``,
    rows along u and columns along v.
    """
    # A neighbour is at most this multiple of the median distance of the nearest six away.
    reach = 2.0
    nearest = 32  # markers around one among which its eight neighbours are found
    n = len(uv)
    out = np.full((n, 8), -1, dtype=np.int64)
    if n < 2:
        return out
    points = surface.point(uv)
    distance, near = cKDTree(points).query(points, k=min(n, nearest + 1))
    along, across = _frames(surface, uv, normal)
    arm = points[near] - points[:, None]
    x, y = np.einsum("nki,ni->nk", arm, across), np.einsum("nki,ni->nk", arm, along)
    # A thin sensor's far side is near in space only: its normals point the other way.
    facing = np.einsum("nki,ni->nk", normal[near], normal) > 0.0
    typical = np.median(distance[:, 1:7], axis=1)
    valid: BoolArray = (near != np.arange(n)[:, None]) & facing
    valid &= distance <= reach * typical[:, None]
    sector = np.mod(np.rint(np.arctan2(y, x) / (np.pi / 4.0)), 8).astype(np.int64)
    for slot, (row, column) in enumerate(NEIGHBOUR_STEPS):
        wanted = int(np.rint(np.arctan2(row, column) / (np.pi / 4.0))) % 8
        fits = valid & (sector == wanted)
        first = np.argmax(fits, axis=1)  # sorted by distance: the first is the nearest
        out[:, slot] = np.where(fits.any(axis=1), near[np.arange(n), first], -1)
    return out


def _frames(surface: Surface, uv: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit tangents along u, and across it, (n, 3) each."""
    along = surface.tangents(uv)[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, normal)
    around = surface.tangents(uv)[:, 1]
    # Across points the way of growing v (either hand of the chart is allowed).
    flip = np.where(np.sum(across * around, axis=1) < 0.0, -1.0, 1.0)
    return along, across * flip[:, None]
