"""Whether a thin wall is supported, by walks along it to its edges."""

import numpy as np

from phytac_design.geometry.ray_tree import RayTree
from phytac_design.geometry.triangles import frames_along
from phytac_shapes.arrays import BoolArray, FloatArray


def free_walls(
    tree: RayTree, middle_mm: FloatArray, normal: FloatArray, width_mm: FloatArray
) -> BoolArray:
    """Whether walls (n,) are held at fewer than two of the edges that four walks along them meet.

    Parameters
    ----------
    middle_mm, normal : (n, 3) float
        A point half-way through each wall, and the direction across it.
    width_mm : (n,) float
        Thickness there.
    """
    edges = 2  # edges at which a wall must be held to count as supported
    held = 2.0  # where the body is this many times thicker than the wall, the wall is held
    # A wall longer than so many steps (around a tube, for example) counts as held there.
    steps = 300
    step = 0.5  # steps of a walk over the wall's thickness: it follows bends of that radius
    count = len(middle_mm)
    if count == 0:
        return np.zeros(0, dtype=np.bool_)
    first, second, _ = np.moveaxis(frames_along(normal), 2, 0)
    way = np.concatenate([first, second, -first, -second])
    point, across = np.tile(middle_mm, (4, 1)), np.tile(normal, (4, 1))
    width = np.tile(width_mm, 4)
    ended = np.zeros(4 * count, dtype=np.bool_)
    going = np.arange(4 * count)
    for _ in range(steps):
        ahead = point[going] + step * width[going, None] * way[going]
        up, down = tree.cast(ahead, across[going]), tree.cast(ahead, -across[going])
        inside = up.triangle >= 0
        inside &= np.einsum("ni,ni->n", tree.normal[up.triangle], across[going]) > 0.0
        ended[going[~inside]] = True
        thick = up.distance_mm + down.distance_mm
        on = inside & (thick < held * width[going])
        shift = (up.distance_mm[on] - down.distance_mm[on]) / 2.0
        kept = going[on]
        point[kept] = ahead[on] + shift[:, None] * across[kept]
        turned = tree.normal[up.triangle[on]]
        across[kept] = turned
        flat = way[kept] - np.einsum("ni,ni->n", way[kept], turned)[:, None] * turned
        way[kept] = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)
        going = kept
        if going.size == 0:
            break
    return np.asarray((~ended).reshape(4, count).sum(axis=0) < edges)
