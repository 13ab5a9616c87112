r"""Gaps between painted outlines in the picture, without pixels: they change smoothly.

The outline of a marker is the convex hull of the images of the two circles that bound its paint.
Two hulls are as far apart as the widest strip between them,

    gap = max over directions e of  min over A of x·e  -  max over B of x·e

taken over ``DIRECTIONS`` directions; negative where they overlap. What hides a part of a marker is
not known here; where markers are whole, the least distance of their pixels is this plus about 1.
"""

import numpy as np
from scipy.spatial import cKDTree

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_shapes.arrays import FloatArray, IntArray

RING = 16
"""Points of a circle."""
DIRECTIONS = 64
NEAREST = 12
"""Markers of one colour among which the nearest outline is looked for."""


def ring_points(design: Design, markers: Markers) -> FloatArray:
    """Points (n, 2 RING, 3) mm of the circles that bound each marker's paint."""
    receptor, axis = design.receptor, markers.direction
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axis, first)
    turn = 2.0 * np.pi * np.arange(RING) / RING
    ring = np.cos(turn)[:, None] * first[:, None] + np.sin(turn)[:, None] * second[:, None]
    ring *= receptor.diameter_outer_mm / 2.0
    band = np.minimum(receptor.band_marker_mm, markers.height_mm)
    back = markers.tip_mm - band[:, None] * axis
    return np.concatenate([markers.tip_mm[:, None] + ring, back[:, None] + ring], axis=1)


def gaps_px(camera: Camera, points_mm: FloatArray, colour: IntArray) -> FloatArray:
    """Least gap (n,) of each marker's outline to another of its colour, px; inf where none is.

    Parameters
    ----------
    points_mm : (n, k, 3) float
        Points whose images span each outline.
    colour : (n,) int
        Colours.
    """
    pixels = camera.project(points_mm.reshape(-1, 3)).reshape(*points_mm.shape[:2], 2)
    out = np.full(len(points_mm), np.inf)
    known = np.isfinite(pixels).all(axis=(1, 2))
    turn = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    # Half of the directions are minus the other half: low(e) = -high(-e).
    reach = pixels[known] @ np.stack([np.cos(turn), np.sin(turn)])
    high, low = reach.max(axis=1), reach.min(axis=1)
    for paint in np.unique(colour):
        same = np.flatnonzero(colour[known] == paint)
        if len(same) < 2:
            continue
        centre = pixels[known][same].mean(axis=1)
        near = cKDTree(centre).query(centre, k=min(NEAREST, len(same)))[1][:, 1:]
        strips = low[same][near] - high[same][:, None]  # (m, k, directions)
        out[np.flatnonzero(known)[same]] = strips.max(axis=2).min(axis=1)
    return out
