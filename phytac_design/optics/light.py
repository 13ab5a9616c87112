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
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_design.core.kernels import kernel
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
Vector = tuple[float, float, float]


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
        x, y = points_mm[:, :2].T
        distance = np.maximum(np.sqrt(x * x + y * y), 1e-6)
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
    fall_off = np.ones(len(scene.triangles))
    if strip is not None:
        a, b, c = (scene.vertices[corner] for corner in scene.triangles.T)
        centre = (a + b + c) / 3.0
        fall_off = np.minimum(strip.at(centre), fall_off_max)
    shade = np.empty(len(scene.triangles))
    _shades(scene.vertices, scene.triangles, camera.position_mm, fall_off, shade)
    shade[scene.part == BAR_CODE] = 1.0
    return albedo(scene, paint) * shade[:, None]


@kernel
def _shades(
    vertices: FloatArray,
    triangles: NDArray[np.int32],
    position_mm: FloatArray,
    fall_off: FloatArray,
    shade: FloatArray,
) -> None:
    """Write the light (T,) on each triangle; ``fall_off`` (T,) multiplies the bar's part."""
    px, py, pz = position_mm
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay, az = vertices[a]
        bx, by, bz = vertices[b]
        cx, cy, cz = vertices[c]
        ux, uy, uz = bx - ax, by - ay, bz - az
        vx, vy, vz = cx - ax, cy - ay, cz - az
        normal = (uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)
        x, y, z = (ax + bx + cx) / 3.0, (ay + by + cy) / 3.0, (az + bz + cz) / 3.0
        bar = FROM_AXIS * _cosine(normal, (-x, -y, 0.0)) * fall_off[t]
        shade[t] = EVEN + FROM_CAMERA * _cosine(normal, (px - x, py - y, pz - z)) + bar


@kernel
def _cosine(a: Vector, b: Vector) -> float:
    """Absolute cosine between two vectors; 0 where one of them is zero."""
    size = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    size *= np.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
    return float(abs(a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) / max(size, 1e-30))
