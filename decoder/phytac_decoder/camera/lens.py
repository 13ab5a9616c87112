"""Lens models: directions to pixels and back. Frame: x right, y down, z forward.

All models are a radial map of the angle θ from the optical axis onto a plane, a polynomial
distortion of that plane (Brown-Conrady; none for some), and pixels; formulae are those of
OpenCV's ``calib3d``, ``fisheye`` and ``omnidir``. A lens is used only in the largest cone about the
axis in which its map is one to one.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from phytac_decoder.camera.distortion import distort, distort_jacobian, undistort
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import DesignError

ROUNDING = 1e-12
"""Relative rounding error: of the rim of the field, and of the distance of points on the axis."""


@dataclass(frozen=True, kw_only=True)
class Lens(ABC):
    """Image size, focal lengths, principal point and distortion; pixel centres are integers.

    Attributes
    ----------
    width_px, height_px : int
        Image size.
    fx_px, fy_px : float
        Focal lengths along x and y; they differ where pixels are not square.
    cx_px, cy_px : float
        Principal point.
    distortion : tuple of float
        Coefficients of the model, see each class; empty or all zero for none.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()

    model: ClassVar[str]
    """Name in design files and bundles."""
    counts: ClassVar[tuple[int, ...]]
    """Numbers of distortion coefficients that the model may have."""
    slope_min: ClassVar[float] = 0.02
    """The field ends where a direction's image moves less than this share of its speed on the
    axis."""
    limit_rad: ClassVar[float]
    """No direction farther than this from the axis can be seen, whatever the coefficients."""

    def __post_init__(self) -> None:
        numbers = (self.fx_px, self.fy_px, self.cx_px, self.cy_px, *self.distortion)
        sizes = (self.width_px, self.height_px, self.fx_px, self.fy_px)
        if not (np.isfinite(numbers).all() and min(sizes) > 0):
            raise DesignError(
                "lens-not-finite",
                "camera: every number of the lens must be finite and its sizes positive (got "
                f"{self.width_px} x {self.height_px} px, focal lengths {self.fx_px:g} and "
                f"{self.fy_px:g} px, centre {self.cx_px:g}, {self.cy_px:g} px, distortion "
                f"{self.distortion})",
            )
        if len(self.distortion) not in self.counts:
            wanted = " or ".join(str(n) for n in self.counts)
            raise DesignError(
                "lens-distortion-count",
                f"camera: model {self.model!r} takes {wanted} distortion coefficients (got "
                f"{len(self.distortion)}); see docs/formats.md for their order",
            )
        if self.field_rad <= 0.0:
            raise DesignError(
                "lens-distortion-folds",
                f"camera: the distortion {self.distortion} folds the image over at its very "
                "centre; check the order and the signs of the coefficients",
            )

    @property
    def focal_px(self) -> FloatArray:
        """Focal lengths (2,)."""
        return np.array([self.fx_px, self.fy_px], dtype=np.float64)

    @property
    def centre_px(self) -> FloatArray:
        """Principal point (2,)."""
        return np.array([self.cx_px, self.cy_px], dtype=np.float64)

    @property
    def plane_coefficients(self) -> FloatArray:
        """(8,) coefficients k1 k2 p1 p2 k3 k4 k5 k6 of the plane's distortion."""
        return np.zeros(8)

    @abstractmethod
    def radius(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radius on the undistorted plane at angle θ, and its derivative."""

    @abstractmethod
    def scale(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Factor s (n,) of plane = s·(x, y), and its gradient (n, 3), in the camera frame."""

    @abstractmethod
    def directions(self, plane: FloatArray) -> FloatArray:
        """Unit directions (n, 3) of points (n, 2) on the undistorted plane."""

    @cached_property
    def _profile(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angles (m,) of the field, radius on the plane, and distorted radius, all rising."""
        theta = np.linspace(0.0, self.limit_rad, 4097)
        k = self.plane_coefficients
        radial_k = k * np.array([1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            radius, slope = self.radius(theta)
            radial, stretch = _least_stretch(radius, k)
            bent = distort(np.column_stack([radius, np.zeros_like(radius)]), radial_k)[:, 0]
            good = (slope * radial >= self.slope_min * slope[0]) & (slope > 0.0) & (stretch > 0.0)
            good &= np.isfinite(radius * bent)
            good[1:] &= np.diff(bent) > 0.0
        end = len(theta) if good.all() else int(good.argmin())
        return theta[:end], radius[:end], bent[:end]

    @cached_property
    def field_rad(self) -> float:
        """Half-angle of the cone about the axis in which the lens is used."""
        theta = self._profile[0]
        return float(theta[-1]) if len(theta) else 0.0

    def in_field(self, points: FloatArray) -> BoolArray:
        """Whether the lens can image points (n, 3), camera frame, wherever they land."""
        p = np.asarray(points, dtype=np.float64)
        off = np.hypot(p[:, 0], p[:, 1])
        angle = np.arctan2(off, p[:, 2])
        return np.asarray(
            (angle <= self.field_rad * (1.0 + ROUNDING)) & ((off > 0.0) | (p[:, 2] > 0.0))
        )

    def project(self, points: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3) in the camera frame; NaN outside of the field."""
        p = self._in_field_only(points)
        plane = self.scale(p)[0][:, None] * p[:, :2]
        return np.asarray(self._bend(plane) * self.focal_px + self.centre_px)

    def jacobian(self, points: FloatArray) -> FloatArray:
        """Derivative of :meth:`project` by the point, (n, 2, 3) px/mm, camera frame."""
        p = self._in_field_only(points)
        s, gradient = self.scale(p)
        slope = p[:, :2, None] * gradient[:, None, :]
        slope[:, 0, 0] += s
        slope[:, 1, 1] += s
        k = self.plane_coefficients
        if k.any():
            slope = distort_jacobian(s[:, None] * p[:, :2], k) @ slope
        return np.asarray(slope * self.focal_px[:, None])

    def unproject(self, pixels: FloatArray) -> FloatArray:
        """Unit directions (n, 3), camera frame, of pixels (n, 2); NaN where nothing is imaged."""
        bent = (np.asarray(pixels, dtype=np.float64) - self.centre_px) / self.focal_px
        k = self.plane_coefficients
        plane = bent
        if k.any():
            _, radius, distorted = self._profile
            plane = undistort(bent, k, radius, distorted)
        directions = self.directions(plane)
        directions[~self.in_field(directions)] = np.nan
        return directions

    def _bend(self, plane: FloatArray) -> FloatArray:
        k = self.plane_coefficients
        return distort(plane, k) if k.any() else plane

    def _in_field_only(self, points: FloatArray) -> FloatArray:
        """Points with those outside of the field set to NaN."""
        p = np.asarray(points, dtype=np.float64)
        return np.where(self.in_field(p)[:, None], p, np.nan)


def _least_stretch(radius: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least radial stretch and least area stretch of the plane on circles (m,), each (m,)."""
    if not k.any():
        return np.ones_like(radius), np.ones_like(radius)
    turn = 2.0 * np.pi * np.arange(16) / 16
    around = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    slope = distort_jacobian((radius[:, None, None] * around).reshape(-1, 2), k)
    slope = slope.reshape(len(radius), 16, 2, 2)
    radial = np.einsum("ai,naij,aj->na", around, slope, around)
    return radial.min(axis=1), np.linalg.det(slope).min(axis=1)


class Perspective(Lens):
    """Plane = (x, y) / z."""

    def radius(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tangent."""
        return np.tan(theta), 1.0 / np.cos(theta) ** 2

    def scale(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """1 / z."""
        s = 1.0 / points[:, 2]
        return s, np.column_stack([np.zeros_like(s), np.zeros_like(s), -(s**2)])

    def directions(self, plane: FloatArray) -> FloatArray:
        """(x, y, 1), normalised."""
        d = np.column_stack([plane, np.ones(len(plane))])
        return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


@dataclass(frozen=True, kw_only=True)
class Pinhole(Perspective):
    """No distortion; sees all points with z > 0."""

    model = "pinhole"
    counts = (0,)
    limit_rad = np.pi / 2.0

    @cached_property
    def field_rad(self) -> float:
        """All directions in front of the image plane."""
        return self.limit_rad

    def in_field(self, points: FloatArray) -> BoolArray:
        """Whether points (n, 3) lie in front of the image plane."""
        return np.asarray(np.asarray(points)[:, 2] > 0.0)


@dataclass(frozen=True, kw_only=True)
class BrownConrady(Perspective):
    """Perspective, then k1 k2 p1 p2 [k3 [k4 k5 k6]] in OpenCV's order (ROS: plumb_bob)."""

    model = "brown_conrady"
    counts = (0, 4, 5, 8)
    limit_rad = float(np.deg2rad(89.9))

    @property
    def plane_coefficients(self) -> FloatArray:
        """(8,), the missing ones 0."""
        return np.array([*self.distortion, *[0.0] * (8 - len(self.distortion))])


@dataclass(frozen=True, kw_only=True)
class KannalaBrandt(Lens):
    """Fisheye: radius θ(1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸), valid beyond 90° (Kannala 2006)."""

    model = "kannala_brandt"
    counts = (0, 4)
    limit_rad = float(np.deg2rad(179.5))

    def radius(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The odd polynomial in θ."""
        k = [*self.distortion, *[0.0] * (4 - len(self.distortion))]
        t2 = np.asarray(theta) ** 2
        value = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
        slope = 1.0 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
        return value, slope

    def scale(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radius of the angle over the distance from the axis; 1 / z on the axis."""
        off = np.hypot(points[:, 0], points[:, 1])
        square = np.sum(points**2, axis=1)
        radius, slope = self.radius(np.arctan2(off, points[:, 2]))
        on_axis = off <= ROUNDING * np.sqrt(square)
        safe = np.where(on_axis, 1.0, off)
        s = np.where(on_axis, 1.0 / np.where(on_axis, points[:, 2], 1.0), radius / safe)
        outward = np.where(on_axis, 0.0, (slope * points[:, 2] / square - s) / safe**2)
        return s, np.column_stack([outward[:, None] * points[:, :2], -slope / square])

    def directions(self, plane: FloatArray) -> FloatArray:
        """Newton on θ from a table of the field; NaN beyond it."""
        angles, radii, _ = self._profile
        m = np.hypot(plane[:, 0], plane[:, 1])
        theta = np.interp(m, radii, angles)
        for _ in range(4):
            value, slope = self.radius(theta)
            theta = theta - (value - m) / slope
        theta = np.where(m <= radii[-1], theta, np.nan)
        unit = plane / np.where(m > 0.0, m, 1.0)[:, None]
        return np.column_stack([np.sin(theta)[:, None] * unit, np.cos(theta)])


@dataclass(frozen=True, kw_only=True)
class Omnidirectional(Lens):
    """Unified model of mirrors and fisheyes: distortion ξ [k1 k2 p1 p2] (Mei 2007).

    The unit sphere seen from a point ξ behind its centre, then Brown-Conrady.
    """

    model = "omnidirectional"
    counts = (1, 5)
    limit_rad = float(np.deg2rad(179.5))

    def __post_init__(self) -> None:
        if len(self.distortion) in self.counts and not self.distortion[0] >= 0.0:
            raise DesignError(
                "lens-xi-negative",
                f"camera: the omnidirectional model's first coefficient ξ must be 0 or more (got "
                f"{self.distortion[0]:g})",
            )
        super().__post_init__()

    @property
    def plane_coefficients(self) -> FloatArray:
        """(8,), k1 k2 p1 p2 and zeros."""
        return np.array([*self.distortion[1:], *[0.0] * (9 - len(self.distortion))])

    def radius(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Sin θ / (cos θ + ξ); negative slope where it is not one to one any more."""
        xi = self.distortion[0]
        depth = np.cos(theta) + xi
        slope = (1.0 + xi * np.cos(theta)) / depth**2
        return np.sin(theta) / depth, np.where(depth > 0.0, slope, -1.0)

    def scale(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """1 / (z + ξ r)."""
        xi = self.distortion[0]
        r = np.linalg.norm(points, axis=1)
        s = 1.0 / (points[:, 2] + xi * r)
        gradient = xi * points / r[:, None]
        gradient[:, 2] += 1.0
        return s, -(s**2)[:, None] * gradient

    def directions(self, plane: FloatArray) -> FloatArray:
        """Closed form: the farther crossing of the sphere."""
        xi = self.distortion[0]
        square = np.sum(plane**2, axis=1)
        with np.errstate(invalid="ignore"):
            along = (xi + np.sqrt(1.0 + (1.0 - xi**2) * square)) / (1.0 + square)
        d = np.column_stack([along[:, None] * plane, along - xi])
        return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


LENSES: dict[str, type[Lens]] = {
    lens.model: lens for lens in (Pinhole, BrownConrady, KannalaBrandt, Omnidirectional)
}
"""Every lens model by its name."""
