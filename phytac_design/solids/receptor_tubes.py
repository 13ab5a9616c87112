"""Axes of the receptor tubes, their painted bands and their holes, from markers and surface."""

from dataclasses import dataclass

import numpy as np

from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class ReceptorAxes:
    """Rods along the receptors' axes; arrays are (n, 3) mm over markers.

    Attributes
    ----------
    root_mm : (n, 3) float
        Where the tube begins, inside the wall.
    tip_mm : (n, 3) float
        Centre of the end face.
    band_mm : (n, 3) float
        Where the painted band begins; the root if the whole tube is painted.
    outer_mm : (n, 3) float
        Where the axis meets the outer face.
    hole_start_mm, hole_end_mm : (n, 3) float
        Axis of the hole's cutter, from outside the outer face to beyond the end face.
    painted : (n,) bool
        Whether the whole tube is painted (the band is not shorter than the receptor).
    """

    root_mm: FloatArray
    tip_mm: FloatArray
    band_mm: FloatArray
    outer_mm: FloatArray
    hole_start_mm: FloatArray
    hole_end_mm: FloatArray
    painted: BoolArray


def _outer_mm(sensor: Sensor) -> FloatArray:
    """Where the receptors' axes meet the outer face, (n, 3) mm (its tangent plane if leaning)."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    if design.receptor.direction == "normal":
        return surface.point(markers.uv)
    cosine = -np.sum(markers.direction * markers.normal, axis=1)
    back = (design.wall.thickness_mm / 2.0 / cosine)[:, None] * markers.direction
    return np.asarray(markers.mid_mm - back)


def rim_sag_mm(
    surface: Surface, markers: Markers, centre_mm: FloatArray, radius_mm: float
) -> tuple[FloatArray, ...]:
    """Highest and lowest point of a disc's edge above the outer face, (n,) mm each.

    A disc of ``radius_mm`` around ``centre_mm`` (n, 3), square to each receptor's axis: positive
    where its edge stands out of the surface (convex, or leaning), negative where it dips under it.
    """
    along = surface.tangents(markers.uv)[:, 0]
    along = along - np.sum(along * markers.direction, axis=1)[:, None] * markers.direction
    first = along / np.linalg.norm(along, axis=1, keepdims=True)
    second = np.cross(markers.direction, first)
    angle = np.pi / 4.0 * np.arange(8)
    ring = first[:, None] * np.cos(angle)[:, None] + second[:, None] * np.sin(angle)[:, None]
    points = (centre_mm[:, None] + radius_mm * ring).reshape(-1, 3)
    foot = _nearest_uv(surface, np.repeat(markers.uv, 8, axis=0), points)
    height = np.einsum("ni,ni->n", points - surface.point(foot), surface.normal(foot))
    height = height.reshape(-1, 8)
    return height.max(axis=1), height.min(axis=1)


def _nearest_uv(surface: Surface, uv: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Chart positions (n, 2) of the nearest surface points, by Gauss-Newton from known ones.

    Cheaper than ``surface.chart``, which searches for its start; poles need that one.
    """
    # Steps to the foot of a point one tube radius away; the height's error is of fourth order.
    foot_steps = 1
    if any(surface.poles):
        return surface.chart(points_mm)
    foot = uv
    for _ in range(foot_steps):
        tangents = surface.tangents(foot)
        (e, f), (_, g) = np.moveaxis(np.einsum("nai,nbi->nab", tangents, tangents), 0, -1)
        a, b = np.moveaxis(np.einsum("nai,ni->na", tangents, points_mm - surface.point(foot)), 1, 0)
        det = e * g - f * f
        foot = foot + np.stack([g * a - f * b, e * b - f * a], axis=1) / det[:, None]
    return foot


def root_depth_mm(sensor: Sensor) -> FloatArray:
    """Way along the axis from the outer face to where a flat root lies in the wall, (n,) mm.

    Raises
    ------
    DesignError
        If the wall curves away so much under a tube, or the tube leans so much, that no flat root
        stays inside the wall.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    thickness, radius = design.wall.thickness_mm, design.receptor.diameter_tube_mm / 2.0
    outer = _outer_mm(sensor)
    high, low = rim_sag_mm(surface, markers, outer, radius)
    least, most = np.maximum(high, 0.0), thickness + np.minimum(low, 0.0)
    bad = np.flatnonzero(most - least <= 0.05 * thickness)
    if bad.size:
        worst = int(bad[np.argmin((most - least)[bad])])
        lean = "" if design.receptor.direction == "normal" else "the lean of the receptors, "
        raise DesignError(
            "receptor-exceeds-curvature",
            f"a receptor of {markers.place(worst)} does not fit the curved wall: under its "
            f"{design.receptor.diameter_tube_mm:g} mm tube the surface falls by "
            f"{high[worst]:.2f} mm in a wall of {thickness:g} mm; lower {lean}"
            "receptor.diameter_outer_mm or raise wall.thickness_mm",
        )
    cosine = -np.sum(markers.direction * markers.normal, axis=1)
    return np.asarray((least + most) / 2.0 / cosine)


def receptor_axes(sensor: Sensor) -> ReceptorAxes:
    """Axes of all tubes, bands and holes."""
    design, markers = sensor.design, sensor.markers
    # How far a hole's cutter runs past the end face, so that the faces never coincide.
    overshoot_mm = 0.05
    receptor = design.receptor
    depth = root_depth_mm(sensor)
    outer = _outer_mm(sensor)
    root = outer + depth[:, None] * markers.direction
    painted = receptor.band_marker_mm >= markers.height_mm - 1e-9
    band = markers.tip_mm - receptor.band_marker_mm * markers.direction
    # Half a tube diameter outside, the whole disc of the cutter is clear of any sane surface.
    outside = outer - receptor.diameter_outer_mm / 2.0 * markers.direction
    return ReceptorAxes(
        root_mm=root,
        tip_mm=markers.tip_mm,
        band_mm=np.where(painted[:, None], root, band),
        outer_mm=outer,
        hole_start_mm=outside,
        hole_end_mm=markers.tip_mm + overshoot_mm * markers.direction,
        painted=painted,
    )
