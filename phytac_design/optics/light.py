"""The light that each triangle sends to the camera: one light field for pictures and frames.

A simple field, derived here: an even part, a part from the camera's side and a part from the bar
on the axis, each Lambertian (``albedo · |cos|``), without cast shadows or gloss. It keeps the
chroma of the paints up in the far rows, as the diffuse light inside a pale tube does.
"""

import numpy as np

from decoder.camera import Camera
from phytac_design.optics.paint import BAR, FIXTURE, PAINTS, RESIN, to_linear
from phytac_design.optics.scene import BAR as BAR_CODE
from phytac_design.optics.scene import FIRST_FIXTURE, FIRST_MARKER, Scene, paint_owner, red_owner
from shapes.arrays import FloatArray

EVEN, FROM_CAMERA, FROM_AXIS = 0.4, 0.35, 0.25
"""Shares of the light: from everywhere, from the camera's side, from the bar."""


def albedo(scene: Scene) -> FloatArray:
    """Linear RGB (T, 3) of each triangle's paint."""
    colours = to_linear(np.array([RESIN, PAINTS["red"], *(PAINTS[name] for name in scene.paints)]))
    marker, tip = paint_owner(scene.part), red_owner(scene.part)
    index = np.zeros(len(scene.part), dtype=np.int64)
    index[tip >= 0] = 1
    index[marker >= 0] = 2 + scene.colour[marker[marker >= 0]]
    out: FloatArray = colours[index]
    fixture = (scene.part >= FIRST_FIXTURE) & (scene.part < FIRST_MARKER)
    out[fixture] = to_linear(np.array(FIXTURE))
    out[scene.part == BAR_CODE] = to_linear(np.array(BAR))
    return out


def triangle_light(scene: Scene, camera: Camera) -> FloatArray:
    """Linear RGB (T, 3) that each triangle sends to the camera, both sides alike."""
    corners = scene.vertices[scene.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centre = corners.mean(axis=1)
    back = camera.position_mm - centre
    inward = -centre * np.array([1.0, 1.0, 0.0])
    shade = EVEN + FROM_CAMERA * _cosine(normal, back) + FROM_AXIS * _cosine(normal, inward)
    shade[scene.part == BAR_CODE] = 1.0
    return albedo(scene) * shade[:, None]


def _cosine(a: FloatArray, b: FloatArray) -> FloatArray:
    """Absolute cosine between vectors (n, 3); 0 where one of them is zero."""
    size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return np.asarray(np.abs(np.sum(a * b, axis=1)) / np.maximum(size, 1e-30))
