r"""Gaps between painted outlines in the image without pixels, smooth in the design.

The outline of a marker is the convex hull of the images of the two circles that bound its paint.
Two hulls are as far apart as the widest strip between them,

    gap = max over directions e of  min over A of x·e  -  max over B of x·e

taken over 64 directions; negative where they overlap. Occlusion is neglected; for wholly visible
markers the least distance of their pixels is this plus about 1.
"""

import numpy as np
from scipy.spatial import cKDTree

from phytac_decoder.camera.camera import Camera
from phytac_shapes.arrays import FloatArray, IntArray


def gaps_px(camera: Camera, points_mm: FloatArray, colour: IntArray) -> FloatArray:
    """Least gap (n,) of each marker's outline to another of its colour, px; inf where none is.

    Parameters
    ----------
    points_mm : (n, k, 3) float
        Points whose images span each outline.
    colour : (n,) int
        Colours.
    """
    directions, neighbours = 64, 12
    pixels = camera.project(points_mm.reshape(-1, 3)).reshape(*points_mm.shape[:2], 2)
    out = np.full(len(points_mm), np.inf)
    known = np.isfinite(pixels).all(axis=(1, 2))
    turn = 2.0 * np.pi * np.arange(directions) / directions
    # Half of the directions are minus the other half: low(e) = -high(-e).
    reach = pixels[known] @ np.stack([np.cos(turn), np.sin(turn)])
    high, low = reach.max(axis=1), reach.min(axis=1)
    for paint in np.unique(colour):
        same = np.flatnonzero(colour[known] == paint)
        if len(same) < 2:
            continue
        centre = pixels[known][same].mean(axis=1)
        near = cKDTree(centre).query(centre, k=min(neighbours, len(same)))[1][:, 1:]
        strips = low[same][near] - high[same][:, None]  # (m, k, directions)
        out[np.flatnonzero(known)[same]] = strips.max(axis=2).min(axis=1)
    return out
