"""Image scale, centroid noise, blur and depth of field of the markers.

Blur is that of a thin lens: a point at distance d, in focus at s, spreads over
``A f |d - s| / (d (s - f))`` on the chip, with f the focal length and A = f / N the aperture.
Distances are camera z for lenses that image planes sharply (pinhole, Brown-Conrady), and from the
camera's centre for wide ones.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Perspective
from phytac_design.design.spec import CameraSection
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError

DIRECTIONS = ("axial", "circumferential", "radial")
"""Along the sensor, around it, along the normal."""


@dataclass(frozen=True, kw_only=True)
class Sharpness:
    """Lens facts, per marker (n,) unless said otherwise.

    Attributes
    ----------
    mm_per_px : (n, 3) float
        Motion of a marker along the sensor, around it, and along its normal that moves its image
        by one pixel; inf for a motion towards the camera, NaN outside of the field.
    noise_mm : (n, 3) float
        Standard deviation of such a motion from the centroid's noise.
    blur_px : float
        Width of the image of a point.
    focus_mm : float
        Distance of sharp focus.
    depth_near_mm, depth_far_mm : float
        Between these distances a point's image is no wider than one pixel; far may be inf.
    """

    mm_per_px: FloatArray
    noise_mm: FloatArray
    blur_px: FloatArray
    focus_mm: float
    depth_near_mm: float
    depth_far_mm: float

    def summary(self) -> dict[str, float]:
        """Figures of the report; the medians are over the markers in the lens's field."""
        scale = {
            f"median_mm_per_px_{name}": float(np.nanmedian(self.mm_per_px[:, i]))
            for i, name in enumerate(DIRECTIONS)
        }
        noise = {
            f"median_noise_{name}_mm": float(np.nanmedian(self.noise_mm[:, i]))
            for i, name in enumerate(DIRECTIONS)
        }
        return (
            scale
            | noise
            | {
                "max_blur_px": float(np.nanmax(self.blur_px)),
                "focus_mm": self.focus_mm,
                "depth_near_mm": self.depth_near_mm,
                "depth_far_mm": self.depth_far_mm,
            }
        )


def sharpness(
    section: CameraSection, camera: Camera, surface: Surface, markers: Markers
) -> Sharpness:
    """Scale, noise and blur of every marker's end face.

    Raises
    ------
    DesignError
        If no marker is in the lens's field, or the focus lies within the focal length, where
        nothing is sharp.
    """
    scale = mm_per_px(camera, surface, markers)
    points = camera.to_camera(markers.tip_mm)
    flat = isinstance(camera.lens, Perspective)
    distance = points[:, 2] if flat else np.linalg.norm(points, axis=1)
    distance = np.where(camera.lens.in_field(points), distance, np.nan)
    if not np.isfinite(distance).any():
        raise DesignError(
            "no-marker-in-view",
            "no marker lies in the lens's field of "
            f"{np.degrees(camera.lens.field_rad):.1f}° from the axis; move the camera back "
            "(camera.stand_off_mm) or use a wider lens",
        )
    near, far = float(np.nanmin(distance)), float(np.nanmax(distance))
    # Blur grows with |1/d - 1/s|: the harmonic mean blurs near and far markers alike.
    focus = section.focus_mm or 2.0 / (1.0 / near + 1.0 / far)
    focal = section.focal_px * section.pixel_um / 1000.0
    if focus <= focal:
        raise DesignError(
            "focus-within-focal-length",
            f"nothing is sharp: camera.focus_mm = {focus:g} mm lies within the focal length of "
            f"{focal:.3g} mm (focal_px · pixel_um); raise focus_mm",
        )
    spread_px = focal**2 / section.f_number / (focus - focal) / (section.pixel_um / 1000.0)
    share = 1.0 / spread_px
    return Sharpness(
        mm_per_px=scale,
        noise_mm=section.noise_centroid_px * scale,
        blur_px=spread_px * np.abs(distance - focus) / distance,
        focus_mm=focus,
        depth_near_mm=focus / (1.0 + share),
        depth_far_mm=focus / (1.0 - share) if share < 1.0 else float("inf"),
    )


def mm_per_px(camera: Camera, surface: Surface, markers: Markers) -> FloatArray:
    """Motion per pixel (n, 3) of each end face along the sensor, around it, and along its normal.

    The direction along the sensor is the normal's cross product with the one around, so that the
    three are at right angles on any chart.
    """
    around = surface.tangents(markers.uv)[:, 1]
    size = np.linalg.norm(around, axis=1, keepdims=True)
    # At a pole nothing is around: any direction across the normal does.
    spare = np.cross(markers.normal, np.eye(3)[np.abs(markers.normal).argmin(axis=1)])
    spare /= np.linalg.norm(spare, axis=1, keepdims=True)
    around = np.where(size > 0.0, around / np.where(size > 0.0, size, 1.0), spare)
    along = np.cross(around, markers.normal)
    axes = np.stack([along, around, markers.normal], axis=2)
    pixels = np.linalg.norm(camera.jacobian(markers.tip_mm) @ axes, axis=1)
    return np.asarray(np.divide(1.0, pixels, out=np.full_like(pixels, np.inf), where=pixels != 0.0))


def lens_facts(sensor: Sensor, camera: Camera) -> dict[str, Any]:
    """Scale, centroid noise, blur and depth of field; ``rows`` holds the medians of each row.

    Raises
    ------
    DesignError
        If nothing is sharp.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    found = sharpness(design.camera, camera, surface, markers)
    group = row_groups(markers)
    rows = []
    for number in np.unique(group):
        own = group == number
        rows.append(
            {
                "row": int(number),
                "markers": int(own.sum()),
                **{
                    f"mm_per_px_{name}": float(np.median(found.mm_per_px[own, i]))
                    for i, name in enumerate(DIRECTIONS)
                },
                **{
                    f"noise_{name}_mm": float(np.median(found.noise_mm[own, i]))
                    for i, name in enumerate(DIRECTIONS)
                },
                "blur_px": float(found.blur_px[own].max()),
            }
        )
    return found.summary() | {"rows": rows}


def row_groups(markers: Markers) -> IntArray:
    """Row of each marker (n,), or one of eight equal groups along u where there are no rows."""
    bands = 8  # groups by number, of markers that are not in rows
    if markers.in_rows:
        return markers.row
    order = np.argsort(np.argsort(markers.uv[:, 0], kind="stable"), kind="stable")
    return np.asarray(order * bands // markers.count)
