"""Marker density, and the class of surface within which densities are comparable."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from phytac_design.layout import Markers
from phytac_design.layout.arc import area_elements
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Density:
    """Markers per area of the outer face.

    Attributes
    ----------
    count : int
        Markers.
    area_cm2 : float
        Area of the outer face that senses, between the open edges.
    per_cm2 : float
        Their ratio.
    surface_class : str
        ``parallel``, ``perpendicular`` or ``oblique`` to the optical axis (+z).
    local_min_per_cm2, local_max_per_cm2 : float
        Minimum and maximum local density of :func:`density_map`.
    times_paper : float or None
        ``per_cm2`` over the paper's 1.63; None for a surface of another class, for which
        the figure is not comparable.
    """

    count: int
    area_cm2: float
    per_cm2: float
    surface_class: str
    local_min_per_cm2: float
    local_max_per_cm2: float
    times_paper: float | None


@dataclass(frozen=True, kw_only=True)
class DensityMap:
    """Local density: each piece of the surface belongs to the marker that is nearest to it.

    Attributes
    ----------
    uv : (m, 2) float
        Middles of the pieces that sense, chart coordinates.
    area_mm2 : (m,) float
        Area of each piece.
    owner : (m,) int
        Nearest marker.
    cell_cm2 : (n,) float
        Area that belongs to each marker; pieces on the line between two are shared.
    per_cm2 : (n,) float
        Local density at each marker: the markers of it and of its neighbours over their area.
    """

    uv: FloatArray
    area_mm2: FloatArray
    owner: IntArray
    cell_cm2: FloatArray
    per_cm2: FloatArray


def surface_class(markers: Markers) -> str:
    """Return how the surface under the markers lies to the optical axis."""
    aligned = 0.05  # sine of the angle (about 3 degrees) within which a surface counts as parallel
    lean = np.abs(markers.normal[:, 2])
    if bool(np.all(lean <= aligned)):
        return "parallel"
    return "perpendicular" if bool(np.all(lean >= np.sqrt(1.0 - aligned**2))) else "oblique"


MAP_CELLS = 20_000
"""Cells that the surface is cut into to share its area among markers, at least."""
CELLS_PER_MARKER = 40
"""Cells per marker, at least, in the mean of the whole chart.

On 90 cylinders, cones and domes the least density was then within 1 % of that by 400 a marker.
"""


def density_map(
    surface: Surface,
    markers: Markers,
    *,
    cells: int = MAP_CELLS,
    per_marker: int = CELLS_PER_MARKER,
) -> DensityMap:
    """Share the sensing area among the markers, by distance in space between outer points.

    The surface is cut into at least ``cells``, and ``per_marker`` times the markers.
    """
    cells = max(cells, per_marker * markers.count)
    (u0, u1), (v0, v1) = surface.domain
    middle = surface.metric(np.array([[(u0 + u1) / 2.0, (v0 + v1) / 2.0]]))[0]
    long, wide = (u1 - u0) * np.sqrt(middle[0, 0]), (v1 - v0) * np.sqrt(middle[1, 1])
    rows = int(np.clip(np.sqrt(cells * long / wide), 8, cells / 8))
    columns = int(np.ceil(cells / rows))
    edges_u, edges_v = np.linspace(u0, u1, rows + 1), np.linspace(v0, v1, columns + 1)
    u, v = (edges_u[:-1] + edges_u[1:]) / 2.0, (edges_v[:-1] + edges_v[1:]) / 2.0
    area = area_elements(surface, u, v) * (edges_u[1] - edges_u[0]) * (edges_v[1] - edges_v[0])
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    # The midpoint sum is scaled to the exact total area.
    area = area.ravel() * (surface.area_mm2(0.0) / area.sum())
    keep = surface.sensing(uv)
    uv, area = uv[keep], area[keep]
    sides = surface.tangents(uv) * [[edges_u[1] - edges_u[0]], [edges_v[1] - edges_v[0]]]
    owner, second, share = _shares(surface.point(markers.uv), surface.point(uv), sides)
    cell = np.zeros(markers.count)
    for own, part in ((owner, 1.0 - share), (second, share)):
        cell += np.bincount(own, weights=area * part, minlength=markers.count) / 100.0
    group = np.concatenate([np.arange(markers.count)[:, None], markers.neighbours], axis=1)
    known = group >= 0
    around = np.where(known, cell[group], 0.0).sum(axis=1)
    return DensityMap(
        uv=uv,
        area_mm2=area,
        owner=owner,
        cell_cm2=cell,
        per_cm2=known.sum(axis=1) / np.maximum(around, 1e-12),
    )


def _shares(
    outer: FloatArray, points: FloatArray, sides: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Nearest and second marker (m,) of each piece, and the second's share (m,) of its area.

    A piece counts as a bar along the line through the two markers, as long as the piece is in that
    direction; the plane half way between them cuts the bar. ``sides`` (m, 2, 3) mm are the pieces'.
    """
    if len(outer) == 1:
        alone = np.zeros(len(points), dtype=np.int64)
        return alone, alone, np.zeros(len(points))
    away, ids = cKDTree(outer).query(points, k=2)
    owner, second = ids.T.astype(np.int64)
    way = outer[second] - outer[owner]
    # Both are lengths times the distance between the two markers, which cancels.
    beyond = (away[:, 1] ** 2 - away[:, 0] ** 2) / 2.0
    wide = np.sqrt(sum(np.sum(sides[:, k] * way, axis=1) ** 2 for k in range(2)))
    return owner, second, np.clip(0.5 - beyond / np.maximum(wide, 1e-12), 0.0, 0.5)


def density_of(
    surface: Surface,
    markers: Markers,
    *,
    cells: int = MAP_CELLS,
    per_marker: int = CELLS_PER_MARKER,
) -> Density:
    """Marker density of the outer face (paper: 368 on ø60 x 120, 1.63 per cm²)."""
    # The published sensor's, a record for surfaces *parallel* to the optical axis.
    paper_per_cm2 = 1.63
    local = density_map(surface, markers, cells=cells, per_marker=per_marker)
    area = float(local.area_mm2.sum()) / 100.0
    kind, per_cm2 = surface_class(markers), markers.count / area
    return Density(
        count=markers.count,
        area_cm2=area,
        per_cm2=per_cm2,
        surface_class=kind,
        local_min_per_cm2=float(local.per_cm2.min()),
        local_max_per_cm2=float(local.per_cm2.max()),
        times_paper=per_cm2 / paper_per_cm2 if kind == "parallel" else None,
    )
