"""The design's cameras, and checks that they can work."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NoReturn

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Lens, Pinhole
from phytac_design.design.safe_rounding import at_least
from phytac_design.design.spec import Design
from phytac_design.geometry.boundary_loops import conormals
from phytac_design.geometry.envelope import bar_span_mm, edge_mm, open_far
from phytac_design.layout.markers import Markers
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class Readers:
    """A sensor's cameras together: each marker in the image of the camera that reads it.

    Attributes
    ----------
    cameras : tuple of Camera
        One or two.
    read_by : (n,) int
        Camera of each marker.
    """

    cameras: tuple[Camera, ...]
    read_by: IntArray

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Pixels (..., n, 2) of points (..., n, 3), one or many for each marker."""
        flat = points_mm.reshape(-1, 3)
        shape = (*points_mm.shape[:-1], 2)
        return self._own([camera.project(flat).reshape(shape) for camera in self.cameras])

    def jacobian(self, points_mm: FloatArray) -> FloatArray:
        """Derivative of :meth:`project` by the points, (n, 2, 3) px/mm."""
        each = [camera.jacobian(points_mm) for camera in self.cameras]
        return np.asarray(np.stack(each)[self.read_by, np.arange(len(self.read_by))])

    def _own(self, each: list[FloatArray]) -> FloatArray:
        """Select from pixels (..., n, 2) of every image those of each marker's own camera."""
        out = each[0]
        for number, other in enumerate(each[1:], start=1):
            out = np.where((self.read_by == number)[:, None], other, out)
        return out


def camera_of(design: Design, surface: Surface) -> Camera:
    """Return the design's one camera, see :func:`cameras_of`.

    Raises
    ------
    DesignError
        If the camera cannot work, or the design has two.
    """
    cameras = cameras_of(design, surface)
    if len(cameras) > 1:
        raise DesignError(
            "one-camera-only",
            'this step works with one camera (got camera.ends = "both"); set camera.ends = "near" '
            'or "far"',
        )
    return cameras[0]


def cameras_of(design: Design, surface: Surface) -> tuple[Camera, ...]:
    """Cameras on the sensor axis, at the stand-off of the design or its `fit`; the near one first.

    Raises
    ------
    DesignError
        If a camera stands inside the sensor, its wall or its light bar, or cannot see the whole
        edge before it.
    """
    return tuple(_camera_at(design, surface, end) for end in design.camera.end_numbers)


def stand_off_mm(design: Design, surface: Surface, camera: Camera) -> float:
    """Distance from a camera's centre to its own rim, as the design file counts it."""
    end = 1 if camera.rotation[2, 2] < 0.0 else 0
    start = _start_mm(edge_mm(surface, end, -design.wall.thickness_mm), end)
    z = float(camera.position_mm[2])
    return z - start if end else start - z


def _start_mm(rim: FloatArray, end: int) -> float:
    """Z from which a stand-off counts: 0 at the near end, the edge's plane at the far one."""
    return float(rim[:, 2].max()) if end else 0.0


def _camera_at(design: Design, surface: Surface, end: int) -> Camera:
    """Camera before the near end (0), or beyond the far one (1) looking back."""
    section = design.camera
    lens = section.lens()
    if end == 1 and not open_far(surface):
        raise DesignError(
            "camera-end-closed",
            f"no camera can look in from the far end: the {surface.name} is not open there (got "
            f'camera.ends = "{section.ends}"); set camera.ends = "near"',
        )
    rim = edge_mm(surface, end, -design.wall.thickness_mm)
    if end in design.reference_marks.end_numbers:
        rim = _with_marks(design, surface, end, rim)
    sign = 1.0 if end == 0 else -1.0
    start = _start_mm(rim, end)

    @cache
    def fit(fill: float) -> float:
        return fit_stand_off_mm(lens, rim, end=end, start_mm=start, fill=fill)

    given = section.stand_off_mm
    stand_off = fit(section.fill) if given == "fit" else float(given)
    z = start - sign * stand_off
    camera = Camera.at(lens, z_mm=z, backward=end == 1)
    fix = f'set camera.stand_off_mm = "fit" ({at_least(fit(section.fill))} mm here)'
    side = "near" if end == 0 else "far"
    plane = float((sign * rim[:, 2]).min() * sign)
    if sign * z >= sign * plane:
        raise DesignError(
            "camera-inside-sensor",
            f"the camera stands inside the sensor: its centre is at z = {z:.2f} mm, at or beyond "
            f"the {side} rim's plane at z = {plane:.2f} mm (got stand_off_mm = {stand_off:g}); "
            f"{fix}",
        )
    _check_wall(design, surface, camera, fix)
    # The span is not needed without a bar.
    near, far = bar_span_mm(design, surface) if design.light.bar_radius_mm > 0.0 else (0.0, 0.0)
    if near < far and near <= z <= far:
        raise DesignError(
            "camera-inside-light-bar",
            f"the camera stands inside the light bar: the bar starts at z = "
            f"{far if end else near:.2f} mm, the camera's centre is at z = {z:.2f} mm; raise "
            f"light.bar_start_mm above {at_least(-stand_off)}",
        )
    where = f"stand-off {stand_off:.2f} mm, focal length {camera.focal_px:g} px"
    if not camera.sees(rim).all():
        fix_rim = f"move it back to at least {at_least(fit(1.0))} mm or {fix}"
        _raise_rim_hidden(camera, rim, side, where, fix_rim)
    return camera


def _with_marks(design: Design, surface: Surface, end: int, rim: FloatArray) -> FloatArray:
    """Points of a rim and of the strips that carry reference marks, all around a sheet."""
    strips, offset = [rim], -design.wall.thickness_mm
    for axis, side in [(0, end)] if surface.periodic[1] else surface.edges():
        low, high = surface.domain[1 - axis]
        uv = np.full((len(rim), 2), surface.domain[axis, side])
        uv[:, 1 - axis] = np.linspace(low, high, len(rim), endpoint=not surface.periodic[1 - axis])
        out = conormals(surface, uv, axis, side)
        strips.append(surface.point(uv, offset) + design.reference_marks.reach_mm * out)
    return np.concatenate(strips)


def fit_stand_off_mm(
    lens: Lens, rim: FloatArray, *, end: int, start_mm: float, fill: float
) -> float:
    """Smallest stand-off at which a rim stays within ``fill`` of half the smaller image side.

    Where it does so at any distance, as in a lens that looks back, a twentieth of its radius.

    Parameters
    ----------
    rim : (n, 3) float
        Points of the edge nearest the camera, inner face.
    end : int
        0 for a camera before the near end, 1 for one beyond the far end.
    start_mm : float
        Z from which the stand-off counts.

    Raises
    ------
    DesignError
        If no distance does.
    """
    return _fitted(lens, np.asarray(rim, dtype=np.float64).tobytes(), end, start_mm, fill)


def fit_distance_mm(
    lens: Lens, reach: Callable[[float], FloatArray], *, fill: float, least_mm: float
) -> float:
    """Least camera distance at which all points project within ``fill`` of half the smaller side.

    Parameters
    ----------
    reach : callable
        Points (n, 3) in the camera frame, given the distance of the camera.
    fill : float
        Largest distance of a point's image from the principal point, as a share of half the
        smaller image side.
    least_mm : float
        Smallest distance to try; the result if the points fit even there.

    Raises
    ------
    DesignError
        If no distance up to a million times ``least_mm`` does.
    """
    from scipy.optimize import brentq

    half = min(lens.width_px, lens.height_px) / 2.0 * fill
    if not (least_mm > 0.0 and half > 0.0):
        raise DesignError(
            "camera-fit-size-invalid",
            f"camera fit needs positive sizes (got a least distance of {least_mm} mm, an image of "
            f"{lens.width_px} x {lens.height_px} px, fill {fill})",
        )

    def beyond(distance: float) -> float:
        away = np.linalg.norm(lens.project(reach(distance)) - lens.centre_px, axis=1)
        return float(np.nan_to_num(away, nan=100.0 * half).max()) - half

    low, high, farthest = least_mm, least_mm, 1e6 * least_mm
    while beyond(high) > 0.0:
        low, high = high, min(4.0 * high, farthest)
        if low == high:
            raise DesignError(
                "camera-fit-unreachable",
                f"no camera distance up to {high:.3g} mm brings the near edge into {fill:g} of the "
                "image; check the lens's focal length and distortion",
            )
    if low == high:
        return least_mm
    # Far enough beyond the root that the points fit, whichever side of it was found.
    return (1.0 + 1e-12) * float(brentq(beyond, low, high, xtol=1e-13 * high, maxiter=1000))


@lru_cache(maxsize=32)
def _fitted(lens: Lens, rim_bytes: bytes, end: int, start_mm: float, fill: float) -> float:
    """:func:`fit_stand_off_mm`, cached: several checks need a design's cameras."""
    # A lens that fits its rim at this stand-off sees more than 89.99° from its axis.
    nearest_share = 1e-4
    rim = np.frombuffer(rim_bytes).reshape(-1, 3)
    frame = Camera.at(lens, z_mm=start_mm, backward=end == 1)
    points = frame.to_camera(rim)
    nearest = float(points[:, 2].min())
    widest = float(np.linalg.norm(points[:, :2], axis=1).max())

    def reach(distance: float) -> FloatArray:
        return np.asarray(points + np.array([0.0, 0.0, distance - nearest]))

    found = fit_distance_mm(lens, reach, fill=fill, least_mm=nearest_share * widest)
    return (found if found > nearest_share * widest else 0.05 * widest) - nearest


def _check_wall(design: Design, surface: Surface, camera: Camera, fix: str) -> None:
    """Raise if the camera's centre lies in the wall of the sensing surface."""
    centre = camera.position_mm[None]
    foot = surface.chart(centre)
    within = (foot >= surface.domain[:, 0]) & (foot <= surface.domain[:, 1])
    height = float(np.sum((centre - surface.point(foot)) * surface.normal(foot)))
    if bool(within.all()) and -design.wall.thickness_mm <= height <= 0.0:
        raise DesignError(
            "camera-inside-wall",
            f"the camera stands inside the shell wall ({-height:.2f} mm below the outer face, the "
            f"wall is {design.wall.thickness_mm:g} mm thick); {fix}",
        )


def _raise_rim_hidden(camera: Camera, rim: FloatArray, side: str, where: str, fix: str) -> NoReturn:
    """Raise the error for a rim that is not completely in the image."""
    pixels = camera.project(rim)
    if np.isnan(pixels).any():
        raise DesignError(
            "rim-outside-view",
            f"the camera cannot see the {side} rim: part of it lies beyond the lens's field of "
            f"{np.rad2deg(camera.lens.field_rad):.1f}° from the axis ({where}); {fix}",
        )
    reach = np.abs(pixels - camera.centre_px).max(axis=0)
    raise DesignError(
        "rim-outside-view",
        f"the camera cannot see the {side} rim: it projects {reach[0]:.0f} x {reach[1]:.0f} px "
        f"from the image centre, the image ends at {camera.width_px / 2:.0f} x "
        f"{camera.height_px / 2:.0f} px ({where}); {fix}",
    )


def tolerance_mm(camera: Camera, markers: Markers) -> FloatArray:
    """Tessellation tolerance of each receptor: a tenth of a pixel at its end face, (n,) mm."""
    tolerance_px = 0.1  # distance between polygons and the circles that they approximate, in pixels
    if isinstance(camera.lens, Pinhole):
        depth = camera.to_camera(markers.tip_mm)[:, 2]
        return np.asarray(tolerance_px * np.maximum(depth, 1e-3) / camera.focal_px)
    slope = camera.jacobian(markers.tip_mm)
    known = np.isfinite(slope).all(axis=(1, 2))
    scale = np.full(markers.count, np.nan)
    scale[known] = np.linalg.norm(slope[known], ord=2, axis=(1, 2))
    # Receptors beyond the lens's field show nothing; they are made as coarse as the coarsest.
    least = float(np.nanmin(scale, initial=camera.focal_px / 1e3))
    return np.asarray(tolerance_px / np.where(np.isfinite(scale), scale, least))
