"""Volumes of walls and rims by quadrature of the surface itself, apart from any mesh."""

import numpy as np

from phytac_design.design.spec import WallSection
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

GAUSS = (30, 6)
"""Cells of an edge and points in each."""
MIDPOINTS = (2_000, 1)
"""The same around a tube, whose curvature may jump."""
OFFSETS = 3
STEP = 1e-4


def steiner_mm3(surface: Surface, thickness: float) -> float:
    """Volume between the outer face and the inner one: offset areas, integrated exactly."""
    x, w = np.polynomial.legendre.leggauss(3)
    return float(
        thickness
        / 2.0
        * sum(
            weight * surface.area_mm2(-thickness * (node + 1.0) / 2.0)
            for node, weight in zip(x, w, strict=True)
        )
    )


def out_of(surface: Surface, uv: FloatArray, axis: int, end: int) -> FloatArray:
    """Conormals as normal × edge, turned outward."""
    tangents = surface.tangents(uv)
    out = np.cross(surface.normal(uv), tangents[:, 1 - axis])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    ahead = np.sign(np.sum(out * tangents[:, axis], axis=1, keepdims=True))
    return np.asarray(out * ahead * (1.0 if end == 1 else -1.0))


def rims_mm3(surface: Surface, wall: WallSection) -> float:
    """Volume of the rims along all open edges, flat mitres at the corners of a sheet."""
    cells, points = MIDPOINTS if surface.periodic[1] else GAUSS
    x, w = np.polynomial.legendre.leggauss(points)
    deep, flange, rim = wall.thickness_mm, wall.rim_flange_mm, wall.rim_length_mm
    total = 0.0
    for axis, end in surface.edges():
        low, high = surface.domain[1 - axis]
        cell = (high - low) / cells
        t = (low + cell * (np.arange(cells)[:, None] + (x + 1.0) / 2.0)).ravel()
        weight = np.tile(w, cells) * cell / 2.0

        def at(
            t: FloatArray, offset: float, extension: float, axis: int = axis, end: int = end
        ) -> tuple[FloatArray, FloatArray, FloatArray]:
            uv = np.full((len(t), 2), surface.domain[axis, end])
            uv[:, 1 - axis] = t
            out = out_of(surface, uv, axis, end)
            return surface.point(uv, offset) + extension * out, surface.normal(uv), out

        h = STEP * (high - low)
        for a, wa in zip(*np.polynomial.legendre.leggauss(OFFSETS), strict=True):
            offset = (flange - deep) / 2.0 + (flange + deep) / 2.0 * a
            # The Jacobian is linear in the extension: its middle is its mean.
            slope = (at(t + h, offset, rim / 2.0)[0] - at(t - h, offset, rim / 2.0)[0]) / (2.0 * h)
            _, normal, out = at(t, offset, rim / 2.0)
            box = np.abs(np.sum(slope * np.cross(normal, out), axis=1))
            total += float(wa * (flange + deep) / 2.0 * rim * np.sum(weight * box))
    if not surface.periodic[1]:
        for eu in (0, 1):
            for ev in (0, 1):
                corner = np.array([[surface.domain[0, eu], surface.domain[1, ev]]])
                cosine = out_of(surface, corner, 0, eu)[0] @ out_of(surface, corner, 1, ev)[0]
                kite = rim**2 * np.tan(np.arccos(cosine) / 2.0)
                total += float(kite * (deep + flange))
    return total
