"""Sampling of a wall: the fewest chart stations that keep its facets within a tolerance."""

import numpy as np

from phytac_design.design.spec import WallSection
from phytac_design.geometry.boundary_loops import check_topology, conormals
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray

PROBE = 64
"""Cells in which each direction is first sampled."""
ROUNDS = 24


def chart_stations(
    surface: Surface, wall: WallSection, tolerance_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Stations along u and around v; where v is periodic its end is left out.

    A corner of the mesh stands out of a curved face by two thirds of its chords' sag (see
    :func:`phytac_design.solids.wall_mesh.wall_mesh`): that is what stays within
    ``tolerance_mm``, both directions together.
    """
    check_topology(surface)
    demands = [_demand(surface, wall, axis, tolerance_mm) for axis in (0, 1)]
    limit = tolerance_mm
    if all(demand.any() for demand in demands):
        # Curved both ways: each direction has half of the tolerance.
        limit, demands = tolerance_mm / 2.0, [np.sqrt(2.0) * item for item in demands]
    u, v = (_stations(surface, wall, axis, demands[axis], limit) for axis in (0, 1))
    u, v = untwisted(surface, u, v, tolerance_mm)
    if not surface.periodic[1]:
        u, v = (_unturned(surface, wall, axis, t, tolerance_mm) for axis, t in ((0, u), (1, v)))
    return u, (v[:-1] if surface.periodic[1] else v)


def _rails(surface: Surface, wall: WallSection, axis: int, t: FloatArray) -> FloatArray:
    """Lines of the wall along chart direction ``axis`` at stations ``t``, (lines, t, 3) mm."""
    across = 9  # lines of a face that are sampled
    low, high = surface.domain[1 - axis]
    others = np.linspace(low, high, across, endpoint=not surface.periodic[1 - axis])
    offsets = np.array([0.0, -wall.thickness_mm])
    lines = [surface.point(_line(axis, t, others, 2), np.tile(np.repeat(offsets, len(t)), across))]
    rim = wall.rim_length_mm
    for edge, end in surface.edges():
        if edge == axis or rim == 0.0:
            continue
        uv = _line(axis, t, surface.domain[1 - axis, end : end + 1], 2)
        offsets = np.array([wall.rim_flange_mm, -wall.thickness_mm])
        out = rim * conormals(surface, uv, 1 - axis, end)
        lines.append(surface.point(uv, np.repeat(offsets, len(t))) + out)
    return np.concatenate(lines).reshape(-1, len(t), 3)


def _line(axis: int, t: FloatArray, others: FloatArray, times: int) -> FloatArray:
    """Chart points of lines along ``axis``, each ``times`` in a row, (others · times · t, 2)."""
    uv = np.zeros((len(others), times, len(t), 2))
    uv[..., axis], uv[..., 1 - axis] = t, others[:, None, None]
    return uv.reshape(-1, 2)


def _sag(surface: Surface, wall: WallSection, axis: int, t: FloatArray) -> FloatArray:
    """Greatest distance of the wall's lines from their chords between stations, (t - 1,) mm."""
    shares = np.array([0.25, 0.5, 0.75])
    inner = t[:-1, None] + np.diff(t)[:, None] * shares
    ends = _rails(surface, wall, axis, t)
    points = _rails(surface, wall, axis, inner.ravel()).reshape(len(ends), len(t) - 1, 3, 3)
    chord = np.diff(ends, axis=1)
    length = np.maximum(np.linalg.norm(chord, axis=2, keepdims=True), 1e-300)
    along = (chord / length)[:, :, None]
    arm = points - ends[:, :-1, None]
    off = arm - np.sum(arm * along, axis=3, keepdims=True) * along
    return np.asarray(np.linalg.norm(off, axis=3).max(axis=(0, 2)))


def _demand(surface: Surface, wall: WallSection, axis: int, limit_mm: float) -> FloatArray:
    """Stations that each of ``PROBE`` equal cells of a direction needs, (PROBE,)."""
    straight = 1e-12  # sag, as a fraction of the sensor's size, that is rounding
    low, high = surface.domain[axis]
    sag = _sag(surface, wall, axis, np.linspace(low, high, PROBE + 1))
    scale = float(np.abs(surface.bounds_mm()).max())
    return np.where(sag > straight * scale, np.sqrt(2.0 / 3.0 * sag / limit_mm), 0.0)


def _stations(
    surface: Surface, wall: WallSection, axis: int, demand: FloatArray, limit_mm: float
) -> FloatArray:
    """Stations of one direction, both ends included."""
    even = 0.02  # relative scatter of a curvature below which stations are spaced evenly
    low, high = surface.domain[axis]
    if np.ptp(demand) <= even * demand.max():
        return np.linspace(low, high, _number(surface, axis, PROBE * demand.max()) + 1)
    total = np.concatenate([[0.0], np.cumsum(demand + 1e-3 * demand.mean())])
    number = _number(surface, axis, total[-1])
    places = np.interp(np.linspace(0.0, total[-1], number + 1), total, np.arange(PROBE + 1.0))
    t = low + (high - low) * places / PROBE
    t[[0, -1]] = low, high
    for _ in range(ROUNDS):
        coarse = 2.0 / 3.0 * _sag(surface, wall, axis, t) > limit_mm
        if not coarse.any():
            break
        t = _split(t, coarse)
    return np.asarray(t)


def _number(surface: Surface, axis: int, demand: float) -> int:
    """Intervals: a multiple of 4 around a closed direction, for its symmetry."""
    stations_min = 24  # least stations of a closed direction
    if surface.periodic[axis]:
        return max(stations_min, 4 * int(np.ceil(demand / 4.0)))
    return max(1, int(np.ceil(demand - 1e-6)))


def _split(t: FloatArray, where: BoolArray) -> FloatArray:
    middles = (t[:-1] + t[1:]) / 2.0
    return np.sort(np.concatenate([t, middles[where]]))


def untwisted(
    surface: Surface, u: FloatArray, v: FloatArray, tolerance_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Split the cells whose triangles leave the surface though their sides do not (saddles)."""
    for _ in range(ROUNDS):
        uu, vv = np.meshgrid(u, v, indexing="ij")
        grid = surface.point(np.column_stack([uu.ravel(), vv.ravel()])).reshape(*uu.shape, 3)
        twist = grid[1:, 1:] - grid[1:, :-1] - grid[:-1, 1:] + grid[:-1, :-1]
        middle = np.stack(
            np.meshgrid((u[1:] + u[:-1]) / 2.0, (v[1:] + v[:-1]) / 2.0, indexing="ij"), axis=-1
        ).reshape(-1, 2)
        normal = surface.normal(middle).reshape(twist.shape)
        bad = np.abs(np.einsum("uvi,uvi->uv", twist, normal)) / 4.0 > tolerance_mm
        if not bad.any():
            break
        u, v = _split(u, bad.any(axis=1)), _split(v, bad.any(axis=0))
    return u, v


def _unturned(
    surface: Surface, wall: WallSection, axis: int, t: FloatArray, tolerance_mm: float
) -> FloatArray:
    """Split intervals along which a rim turns so much that its triangles leave the tolerance."""
    depth = wall.thickness_mm + wall.rim_flange_mm
    for _ in range(ROUNDS):
        bad = np.zeros(len(t) - 1, dtype=np.bool_)
        for end in (0, 1):
            uv = np.full((len(t), 2), surface.domain[1 - axis, end])
            uv[:, axis] = t
            out, normal = conormals(surface, uv, 1 - axis, end), surface.normal(uv)
            rise = np.sum(np.diff(out, axis=0) * (normal[1:] + normal[:-1]) / 2.0, axis=1)
            # Conormal and normal turn together: the end face leans as much as the rim rises.
            bad |= np.abs(rise) * max(wall.rim_length_mm, depth) / 4.0 > tolerance_mm
        if wall.rim_length_mm == 0.0 or not bad.any():
            break
        t = _split(t, bad)
    return t
