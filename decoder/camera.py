"""Camera models, shared by the design tool and the decoder. Frame: x right, y down, z forward."""

from dataclasses import dataclass

import numpy as np

from shapes.arrays import FloatArray
from shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class PinholeCamera:
    """A pinhole camera with pose; pixel centres have integer coordinates (as in OpenCV).

    Attributes
    ----------
    width_px, height_px : int
        Image size.
    focal_px : float
        Focal length (square pixels).
    centre_px : (2,) float
        Principal point.
    position_mm : (3,) float
        Centre of projection in the sensor frame.
    rotation : (3, 3) float
        Rows are the camera's x, y, z axes in the sensor frame: ``p_cam = R (p - position)``.
    """

    width_px: int
    height_px: int
    focal_px: float
    centre_px: FloatArray
    position_mm: FloatArray
    rotation: FloatArray

    @classmethod
    def on_axis(
        cls, *, width_px: int, height_px: int, focal_px: float, stand_off_mm: float
    ) -> "PinholeCamera":
        """Camera on the sensor axis at z = -stand_off, looking along +z."""
        return cls(
            width_px=width_px,
            height_px=height_px,
            focal_px=focal_px,
            centre_px=np.array([(width_px - 1) / 2.0, (height_px - 1) / 2.0]),
            position_mm=np.array([0.0, 0.0, -stand_off_mm]),
            rotation=np.eye(3),
        )

    def to_camera(self, points_mm: FloatArray) -> FloatArray:
        """Sensor frame to camera frame, (n, 3) mm."""
        return np.asarray((np.asarray(points_mm) - self.position_mm) @ self.rotation.T)

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3) in the sensor frame; NaN at or behind the image plane."""
        p = self.to_camera(points_mm)
        z = np.where(p[:, 2] > 0.0, p[:, 2], np.nan)
        return np.asarray(self.focal_px * p[:, :2] / z[:, None] + self.centre_px)

    def jacobian(self, points_mm: FloatArray) -> FloatArray:
        """Derivative of :meth:`project` by the point, (n, 2, 3) px/mm, sensor frame."""
        p = self.to_camera(points_mm)
        z = np.where(p[:, 2] > 0.0, p[:, 2], np.nan)
        out = np.zeros((len(p), 2, 3))
        out[:, 0, 0] = out[:, 1, 1] = self.focal_px / z
        out[:, :, 2] = -self.focal_px * p[:, :2] / (z**2)[:, None]
        return np.asarray(out @ self.rotation)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Unit directions (n, 3), sensor frame, through pixels (n, 2)."""
        xy = (np.asarray(pixels, dtype=np.float64) - self.centre_px) / self.focal_px
        d = np.column_stack([xy, np.ones(len(xy))])
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        return np.asarray(d @ self.rotation)


def fit_stand_off_mm(*, radius_mm: float, focal_px: float, size_px: int, fill: float) -> float:
    """Distance at which a circle of ``radius_mm`` fills ``fill`` of half the smaller image side.

    Raises
    ------
    DesignError
        If no positive distance does.
    """
    half = size_px / 2.0 * fill
    if not (radius_mm > 0.0 and focal_px > 0.0 and half > 0.0):
        raise DesignError(
            f"camera fit needs positive sizes (got radius {radius_mm} mm, focal {focal_px} px, "
            f"image {size_px} px)"
        )
    return focal_px * radius_mm / half
