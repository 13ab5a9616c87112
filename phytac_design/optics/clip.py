"""Cutting triangles at the camera's near plane."""

import numpy as np
from numpy.typing import NDArray

from phytac_shapes.arrays import FloatArray

NEAR_MM = 1e-3
"""Camera z below which nothing is drawn."""


def clip_near(
    points: FloatArray, triangles: NDArray[np.int32]
) -> tuple[FloatArray, NDArray[np.int32], NDArray[np.int32]]:
    """Cut triangles at camera z = ``NEAR_MM``.

    Parameters
    ----------
    points : (V, 3) float
        Vertices in the camera frame, mm.
    triangles : (T, 3) int32
        Vertex indices.

    Returns
    -------
    points, triangles, source
        Vertices with the new ones appended, triangles in front of the plane (none has a vertex
        behind it), and the index of the triangle that each came from, in rising order.
    """
    front = points[:, 2] >= NEAR_MM
    source = np.arange(len(triangles), dtype=np.int32)
    if bool(front.all()):
        return points, triangles, source
    count = front[triangles].sum(axis=1)
    cut = np.flatnonzero((count == 1) | (count == 2))
    # Turn each cut triangle so that the vertex alone on its side comes first.
    side = front[triangles[cut]]
    alone = np.where(count[cut] == 1, side.argmax(axis=1), side.argmin(axis=1))
    turned = triangles[cut][np.arange(len(cut))[:, None], (alone[:, None] + np.arange(3)) % 3]
    p = points[turned]
    share = (NEAR_MM - p[:, :1, 2]) / (p[:, 1:, 2] - p[:, :1, 2])
    crossing = p[:, :1] + share[:, :, None] * (p[:, 1:] - p[:, :1])
    crossing[:, :, 2] = NEAR_MM
    at = len(points) + 2 * np.arange(len(cut))
    one = count[cut] == 1
    tips = np.column_stack([turned[:, 0], at, at + 1])[one]
    first = np.column_stack([at, turned[:, 1], turned[:, 2]])[~one]
    second = np.column_stack([at, turned[:, 2], at + 1])[~one]
    whole = count == 3
    faces = np.concatenate([triangles[whole], tips, first, second]).astype(np.int32)
    origin = np.concatenate([source[whole], cut[one], cut[~one], cut[~one]]).astype(np.int32)
    order = np.argsort(origin, kind="stable")
    return np.concatenate([points, crossing.reshape(-1, 3)]), faces[order], origin[order]
