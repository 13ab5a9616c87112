"""The light that each triangle sends to the camera: one light field for pictures and frames.

A simple field, derived here: an even part, a part from the camera's side and a part from the bar
on the axis, each Lambertian (``albedo · |cos|``), without cast shadows or gloss. It keeps the
chroma of the paints up in the far rows, as the diffuse light inside a pale tube does.

The bar's part may fall off as the light of a strip of finite length does: its points shine with the
sine of the angle to it, so that from z_0 to z_1 a point at distance r from it, facing it, gets ::

    E ~ ∫ r² dz' / (r² + (z' - z)²)²  =  (G(t_1) - G(t_0)) / r     t_i = (z_i - z) / r
    G(t) = (t / (1 + t²) + atan t) / 2
"""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.optics.paint import BAR, FIXTURE, paints_of, resin_of, to_linear
from phytac_design.optics.render_scene import BAR as BAR_CODE
from phytac_design.optics.render_scene import (
    FIRST_FIXTURE,
    FIRST_MARKER,
    RenderScene,
    paint_owner,
    red_owner,
)
from phytac_shapes.arrays import FloatArray

EVEN, FROM_CAMERA, FROM_AXIS = 0.4, 0.35, 0.25
"""Shares of the light: from everywhere, from the camera's side, from the bar."""


@dataclass(frozen=True, kw_only=True)
class Strip:
    """A light bar as a shining line on the axis.

    Attributes
    ----------
    near_mm, far_mm : float
        Z of its ends.
    unit_mm : float
        ``fall_off`` is this times (G(t_1) - G(t_0)) / r: what makes a median marker's 1.
    """

    near_mm: float
    far_mm: float
    unit_mm: float

    @classmethod
    def lighting(cls, points_mm: FloatArray, *, near_mm: float, far_mm: float) -> "Strip":
        """Strip whose light is 1 at the median of points (n, 3)."""
        plain = cls(near_mm=near_mm, far_mm=far_mm, unit_mm=1.0)
        median = float(np.median(plain.at(points_mm)))
        return cls(near_mm=near_mm, far_mm=far_mm, unit_mm=1.0 / median)

    def at(self, points_mm: FloatArray) -> FloatArray:
        """Light (n,) at points (n, 3) that face the strip, over that at a median marker."""
        distance = np.maximum(np.linalg.norm(points_mm[:, :2], axis=1), 1e-6)
        total = np.zeros(len(points_mm))
        for end, sign in ((self.far_mm, 1.0), (self.near_mm, -1.0)):
            t = (end - points_mm[:, 2]) / distance
            total += sign * 0.5 * (t / (1.0 + t**2) + np.arctan(t))
        return np.asarray(self.unit_mm * total / distance)


def albedo(scene: RenderScene, paint: FloatArray | None = None) -> FloatArray:
    """Linear RGB (T, 3) of each triangle's paint.

    ``paint`` (colours + 1, 3), if given, multiplies that of the scene's paints and of red (last).
    """
    shown = paints_of(scene.paints, scene.table)
    resin = resin_of(scene.paints, scene.table)
    colours = to_linear(np.array([resin, shown["red"], *(shown[name] for name in scene.paints)]))
    if paint is not None:
        colours[1:] = np.clip(colours[1:] * np.roll(paint, 1, axis=0), 0.0, 1.0)
    marker, tip = paint_owner(scene.part), red_owner(scene.part)
    index = np.zeros(len(scene.part), dtype=np.int64)
    index[tip >= 0] = 1
    index[marker >= 0] = 2 + scene.colour[marker[marker >= 0]]
    index[scene.part < 0] = 2
    out: FloatArray = colours[index]
    fixture = (scene.part >= FIRST_FIXTURE) & (scene.part < FIRST_MARKER)
    out[fixture] = to_linear(np.array(FIXTURE))
    out[scene.part == BAR_CODE] = to_linear(np.array(BAR))
    return out


def triangle_light(
    scene: RenderScene,
    camera: Camera,
    *,
    strip: Strip | None = None,
    paint: FloatArray | None = None,
) -> FloatArray:
    """Linear RGB (T, 3) that each triangle sends to the camera, both sides alike.

    Parameters
    ----------
    strip : Strip, optional
        The bar's part of the light falls off; uniform without.
    paint : (colours + 1, 3) float, optional
        See :func:`albedo`.
    """
    fall_off_max = 4.0  # maximum light of a part near the bar, relative to that of a median marker
    corners = scene.vertices[scene.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centre = corners.mean(axis=1)
    back = camera.position_mm - centre
    inward = -centre * np.array([1.0, 1.0, 0.0])
    bar = FROM_AXIS * _cosine(normal, inward)
    if strip is not None:
        bar *= np.minimum(strip.at(centre), fall_off_max)
    shade = EVEN + FROM_CAMERA * _cosine(normal, back) + bar
    shade[scene.part == BAR_CODE] = 1.0
    return albedo(scene, paint) * shade[:, None]


def _cosine(a: FloatArray, b: FloatArray) -> FloatArray:
    """Absolute cosine between vectors (n, 3); 0 where one of them is zero."""
    size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return np.asarray(np.abs(np.sum(a * b, axis=1)) / np.maximum(size, 1e-30))
