"""A camera: a lens and a pose, shared by the design tool and the decoder."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from phytac_decoder.camera.lens import Lens, Pinhole
from phytac_shapes.arrays import BoolArray, FloatArray


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A lens with a pose; pixel centres have integer coordinates (as in OpenCV).

    Attributes
    ----------
    lens : Lens
        Image size and the map from directions to pixels.
    position_mm : (3,) float
        Centre of projection in the sensor frame.
    rotation : (3, 3) float
        Rows are the camera's x, y, z axes in the sensor frame: ``p_cam = R (p - position)``.
    """

    lens: Lens
    position_mm: FloatArray
    rotation: FloatArray

    @classmethod
    def at(cls, lens: Lens, *, z_mm: float, backward: bool = False) -> "Camera":
        """Camera on the sensor axis at ``z_mm``, looking along +z, or -z if ``backward``."""
        turn = np.diag([-1.0, 1.0, -1.0]) if backward else np.eye(3)
        return cls(lens=lens, position_mm=np.array([0.0, 0.0, z_mm]), rotation=turn)

    @classmethod
    def on_axis(
        cls, *, width_px: int, height_px: int, focal_px: float, stand_off_mm: float
    ) -> "Camera":
        """Pinhole camera on the sensor axis at z = -stand_off, looking along +z."""
        return cls.at(
            pinhole(width_px=width_px, height_px=height_px, focal_px=focal_px), z_mm=-stand_off_mm
        )

    @property
    def width_px(self) -> int:
        """Image width."""
        return self.lens.width_px

    @property
    def height_px(self) -> int:
        """Image height."""
        return self.lens.height_px

    @property
    def focal_px(self) -> float:
        """Focal length on the axis, along x."""
        return self.lens.fx_px

    @property
    def centre_px(self) -> FloatArray:
        """Principal point (2,)."""
        return self.lens.centre_px

    def shifted(self, offset_px: FloatArray) -> "Camera":
        """Camera with its principal point moved by (2,) px."""
        cx, cy = np.asarray(offset_px, dtype=np.float64) + self.centre_px
        return replace(self, lens=replace(self.lens, cx_px=float(cx), cy_px=float(cy)))

    def to_camera(self, points_mm: FloatArray) -> FloatArray:
        """Sensor frame to camera frame, (n, 3) mm."""
        return np.asarray((np.asarray(points_mm) - self.position_mm) @ self.rotation.T)

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Pixels (n, 2) of points (n, 3) in the sensor frame; NaN outside of the lens's field."""
        return self.lens.project(self.to_camera(points_mm))

    def jacobian(self, points_mm: FloatArray) -> FloatArray:
        """Derivative of :meth:`project` by the point, (n, 2, 3) px/mm, sensor frame."""
        return np.asarray(self.lens.jacobian(self.to_camera(points_mm)) @ self.rotation)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Unit directions (n, 3), sensor frame, through pixels (n, 2); NaN outside of the field."""
        return np.asarray(self.lens.unproject(pixels) @ self.rotation)

    def sees(self, points_mm: FloatArray) -> BoolArray:
        """Whether points (n, 3) lie in the field and project onto the image, hidden or not."""
        pixels = self.project(points_mm)
        last = np.array([self.width_px, self.height_px]) - 0.5
        return np.asarray(np.all((pixels >= -0.5) & (pixels <= last), axis=1))


def pinhole(*, width_px: int, height_px: int, focal_px: float) -> Pinhole:
    """Pinhole lens with square pixels and its principal point in the middle of the image."""
    return Pinhole(
        width_px=width_px,
        height_px=height_px,
        fx_px=focal_px,
        fy_px=focal_px,
        cx_px=(width_px - 1) / 2.0,
        cy_px=(height_px - 1) / 2.0,
    )


def stack_views(cameras: Sequence[Camera], points_mm: FloatArray) -> FloatArray:
    """Jacobians of all cameras over the same points, (n, 2 cameras, 3) px/mm."""
    return np.concatenate([camera.jacobian(points_mm) for camera in cameras], axis=1)
