"""Triangles fit for a file in single precision: no corner twice, no needle without a direction."""

import numpy as np

from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import FloatArray, IntArray

NEEDLE_mm = 2e-5
"""Triangles lower than this turn about when their corners are rounded."""
DIGITS = 5
"""Of corners, mm."""
ROUNDS = 20


def clean(mesh: TriangleMesh) -> TriangleMesh:
    """Return the same closed surface with corners as they are stored, and no needles.

    Corners that single precision cannot tell apart become one. Of a triangle whose third corner
    lies on its longest side, that side is turned to the opposite corner of its neighbour; nothing
    moves by more than the triangle's height.
    """
    # Near zero single precision tells apart what is nothing in millimetres.
    stored = np.round(mesh.vertices_mm, DIGITS).astype(np.float32) + np.float32(0.0)
    points, onto = np.unique(stored, axis=0, return_inverse=True)
    triangles = _proper(onto.reshape(-1)[mesh.triangles])
    places = points.astype(np.float64)
    for _ in range(ROUNDS):
        needles = np.flatnonzero(_height(places, triangles) < NEEDLE_mm)
        if len(needles) == 0 or not _turn_sides(places, triangles, needles):
            break
        triangles = _proper(triangles)
    return TriangleMesh(vertices_mm=places, triangles=triangles)


def _proper(triangles: IntArray) -> IntArray:
    a, b, c = triangles.T
    return np.asarray(triangles[(a != b) & (b != c) & (c != a)])


def _height(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Least height of each triangle, mm."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    longest = np.max([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / longest)


def _turn_sides(points: FloatArray, triangles: IntArray, needles: IntArray) -> bool:
    """Turn the longest side of each needle, in place; whether any was."""
    size = len(points)
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    keys = sides[:, 0] * size + sides[:, 1]
    owner = dict(zip(keys.tolist(), np.tile(np.arange(len(triangles)), 3).tolist(), strict=True))
    touched: set[int] = set()
    for k in needles.tolist():
        ends = points[triangles[k]]
        lengths = np.linalg.norm(ends - np.roll(ends, -1, axis=0), axis=1)
        a, b, c = np.roll(triangles[k], -int(lengths.argmax())).tolist()
        other = owner.get(b * size + a, k)
        if {k, other} & touched or other == k:
            continue
        d = next(int(p) for p in triangles[other] if p not in (a, b))
        if c == d:  # two triangles back to back enclose nothing
            triangles[k] = triangles[other] = a
            touched |= {k, other}
            continue
        if c * size + d in owner or d * size + c in owner:
            continue
        triangles[k], triangles[other] = (a, d, c), (d, b, c)
        touched |= {k, other}
    return bool(touched)
