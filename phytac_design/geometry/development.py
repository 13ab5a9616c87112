"""Distances along a surface between near points, and small nets of points laid flat."""

from dataclasses import dataclass

import numpy as np

from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import NumericalError

STEPS = 8
"""Pieces of a way between two points; each is taken as an arc of a circle."""


@dataclass(frozen=True, kw_only=True)
class Ways:
    """Shortest ways along a surface.

    Attributes
    ----------
    length_mm : (n,) float
        Lengths.
    curvature_per_mm : (n,) float
        Largest normal curvature on the way, without sign.
    """

    length_mm: FloatArray
    curvature_per_mm: FloatArray


def ways(surface: Surface, uv: FloatArray, pairs: IntArray, offset_mm: float = 0.0) -> Ways:
    """Ways between pairs (n, 2) of chart positions ``uv`` (m, 2), on an offset face.

    The chord, laid on the surface along its normals: exact on planes and spheres, elsewhere too
    long in the fourth order of the angle between the ends' normals. Only for ends so near that the
    chord's normals are unique.
    """
    if not len(pairs):
        return Ways(length_mm=np.zeros(0), curvature_per_mm=np.zeros(0))
    ends = surface.point(uv)
    share = np.linspace(0.0, 1.0, STEPS + 1)[:, None, None]
    chord = (1.0 - share) * ends[pairs[:, 0]] + share * ends[pairs[:, 1]]
    inner = surface.chart(chord[1:-1].reshape(-1, 3))
    points = chord.copy()
    points[0], points[-1] = (surface.point(uv, offset_mm)[pairs[:, side]] for side in (0, 1))
    points[1:-1] = surface.point(inner, offset_mm).reshape(STEPS - 1, -1, 3)
    at_ends = surface.normal(uv)
    normals = np.stack(
        [at_ends[pairs[:, 0]], *np.zeros((STEPS - 1, *points[0].shape)), at_ends[pairs[:, 1]]]
    )
    normals[1:-1] = surface.normal(inner).reshape(STEPS - 1, -1, 3)
    piece = np.diff(points, axis=0)
    size = np.linalg.norm(piece, axis=2)
    turn = np.einsum("knx,knx->kn", np.diff(normals, axis=0), piece / size[..., None])
    half = np.arcsin(np.clip(0.5 * np.abs(turn), 0.0, 1.0))
    arc = size / np.sinc(half / np.pi)
    return Ways(length_mm=arc.sum(axis=0), curvature_per_mm=(2.0 * half / arc).max(axis=0))


def relative_neighbours(points_mm: FloatArray) -> IntArray:
    """Pairs (n, 2) of points (m, d) that no third point is nearer to than they to each other.

    The relative neighbourhood graph: it joins all points, and crosses none. Ties count as far.
    """
    tie = 1e-6
    away = np.linalg.norm(points_mm[:, None] - points_mm[None], axis=2)
    first, second = np.triu_indices(len(points_mm), 1)
    between = np.maximum(away[first], away[second]).min(axis=1, initial=np.inf)
    # A point's distance to itself makes the maximum that of the pair: never less than it.
    near = between >= away[first, second] * (1.0 - tie)
    return np.column_stack([first[near], second[near]]).astype(np.int64)


def laid_flat(
    surface: Surface, uv: FloatArray, net: IntArray, *, offset_mm: float = 0.0
) -> tuple[FloatArray, Ways]:
    """Lay a net of points flat, as true to lengths as it goes.

    Lengths of the net and between points two steps apart are met in the least squares: exactly on
    a surface that develops, and by a path on any surface.

    Parameters
    ----------
    uv : (m, 2) float
        Chart positions.
    net : (n, 2) int
        Pairs that are joined; they connect all points.

    Returns
    -------
    flat_mm : (m, 2) float
        Places in the plane seen from outside; point 0 is the origin.
    ways : Ways
        Ways along the net.

    Raises
    ------
    NumericalError
        If the net does not connect its points.
    """
    count = len(uv)
    if count == 1:
        return np.zeros((1, 2)), ways(surface, uv, net, offset_mm)
    joined = np.zeros((count, count), dtype=np.bool_)
    joined[net[:, 0], net[:, 1]] = joined[net[:, 1], net[:, 0]] = True
    twice = (joined.astype(np.int64) @ joined) > 0
    further = np.argwhere(np.triu(twice & ~joined, 1))
    pairs = np.concatenate([net, further]).astype(np.int64)
    found = ways(surface, uv, pairs, offset_mm)
    flat = _unfolded(surface, uv, joined, found, pairs)
    for _ in range(30):
        off = flat[pairs[:, 0]] - flat[pairs[:, 1]]
        size = np.linalg.norm(off, axis=1)
        jacobian = np.zeros((len(pairs), count, 2))
        each = np.arange(len(pairs))
        jacobian[each, pairs[:, 0]] = off / size[:, None]
        jacobian[each, pairs[:, 1]] = -off / size[:, None]
        slopes = jacobian.reshape(len(pairs), -1)
        # Moves and turns of the whole net change no length: a little damping leaves them out.
        normal = slopes.T @ slopes + 1e-9 * np.eye(2 * count)
        step = np.linalg.solve(normal, slopes.T @ (found.length_mm - size)).reshape(count, 2)
        flat = flat + step
        if np.abs(step).max(initial=0.0) < 1e-9:
            break
    own = len(net)
    return flat - flat[:1], Ways(
        length_mm=found.length_mm[:own], curvature_per_mm=found.curvature_per_mm[:own]
    )


def _unfolded(
    surface: Surface, uv: FloatArray, joined: BoolArray, found: Ways, pairs: IntArray
) -> FloatArray:
    """First places: from point to point, directions carried along without turning."""
    count = len(uv)
    length = np.zeros((count, count))
    length[pairs[:, 0], pairs[:, 1]] = length[pairs[:, 1], pairs[:, 0]] = found.length_mm
    points, normals = surface.point(uv), surface.normal(uv)
    flat = np.zeros((count, 2))
    axes = np.zeros((count, 2, 3))
    helper = np.eye(3)[int(np.abs(normals[0]).argmin())]
    first = np.cross(helper, normals[0])
    first /= np.linalg.norm(first)
    axes[0] = first, np.cross(normals[0], first)
    known, queue = {0}, [0]
    while queue:
        here = queue.pop(0)
        for other in np.flatnonzero(joined[here]).tolist():
            if other in known:
                continue
            way = axes[here] @ (points[other] - points[here])
            flat[other] = flat[here] + length[here, other] * way / np.hypot(*way)
            axes[other] = _carried(axes[here], normals[here], normals[other])
            known.add(other)
            queue.append(other)
    if len(known) < count:
        raise NumericalError(
            "net-not-connected",
            f"a net of {count} points joins only {len(known)} of them; please report this design",
        )
    return flat


def _carried(axes: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Axes (2, 3) turned by the least rotation that brings one unit normal onto another."""
    cross = np.cross(start, end)
    skew = np.array(
        [[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]]
    )
    rotation = np.eye(3) + skew + skew @ skew / (1.0 + float(start @ end))
    return np.asarray(axes @ rotation.T)
