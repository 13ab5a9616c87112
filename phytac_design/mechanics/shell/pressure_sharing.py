"""Pairs of contacts and places near them, and the share of a disc that is on the shell.

Distances are chords through space between points of the outer face: they need no chart, wrap by
themselves around closed surfaces, and differ from the length along the face by (d/R)²/24 (0.2 % for
a fingertip on the ø60 cylinder).
"""

import numpy as np

from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.discs import segment


def near_pairs(
    centres: FloatArray, reach: FloatArray, places: FloatArray, sizes: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Pairs (i, j) nearer than reach_i + sizes_j, and their distances, (p,) each.

    In order of i, then j: a pair does not depend on the other centres.

    Parameters
    ----------
    centres, places : (m, 3), (n, 3) float
        Points, mm.
    reach, sizes : (m,), (n,) float
        Distances, mm.
    """
    from scipy.spatial import cKDTree

    found = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
    # Apart by size, or one that reaches far would pair everything with everything.
    size = np.ceil(np.log2(np.maximum(reach, 1e-3)))
    for group in np.unique(size):
        mine = np.flatnonzero(size == group)
        limit = float(reach[mine].max() + sizes.max(initial=0.0))
        pairs = cKDTree(centres[mine]).sparse_distance_matrix(
            cKDTree(places), limit, output_type="ndarray"
        )
        i, j = mine[pairs["i"]], pairs["j"].astype(np.int64)
        near = pairs["v"] <= reach[i] + sizes[j]
        found.append((i[near], j[near], pairs["v"][near]))
    i, j, gap = (np.concatenate(part) for part in zip(*found, strict=True))
    order = np.lexsort((j, i))
    return i[order], j[order], gap[order]


def on_shell_share(surface: Surface, uv: FloatArray, radius_mm: FloatArray | float) -> FloatArray:
    """Share of each disc's area between the open edges of the surface, (m,).

    An edge is taken as straight across the disc, its distance as the length square to it at the
    disc's centre, and edges of different chart axes as square to each other; a pole is no edge.
    """
    uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
    radius = np.broadcast_to(np.asarray(radius_mm, dtype=np.float64), len(uv))
    metric, domain = surface.metric(uv), surface.domain
    sizes = np.sqrt(metric[:, [0, 1], [0, 1]])
    # At a pole, where all v meet, u still is a length, square to nothing in particular.
    lean = metric[:, 0, 1] / np.maximum(sizes.prod(axis=1), 1e-300)
    sine = np.sqrt(np.maximum(1.0 - lean**2, 0.0))
    beyond: tuple[list[FloatArray], list[FloatArray]] = ([], [])
    for axis, end in surface.edges():
        gap = np.abs(uv[:, axis] - domain[axis, end]) * sizes[:, axis] * sine
        beyond[axis].append(np.minimum(gap / np.maximum(radius, 1e-300), 1.0))
    share = np.ones(len(uv))
    for distance in (*beyond[0], *beyond[1]):
        share -= segment(np.arccos(distance)) / np.pi
    for a in beyond[0]:
        for b in beyond[1]:
            share += _corner(a, b) / np.pi
    return np.clip(share, 0.0, 1.0)


def _corner(a: FloatArray, b: FloatArray) -> FloatArray:
    """Area of a unit disc where x > a and y > b, for a and b in [0, 1] (derived here)."""
    quarter = np.pi / 2.0 - np.arcsin(a) - np.arcsin(b)
    sides = a * np.sqrt(1.0 - a * a) + b * np.sqrt(1.0 - b * b)
    return np.where(a * a + b * b < 1.0, 0.5 * (quarter - sides) + a * b, 0.0)
