"""The design's camera, and the refusal of one that cannot work."""

import numpy as np

from decoder.camera import PinholeCamera, fit_stand_off_mm
from phytac_design.layout import Markers
from phytac_design.optics.envelope import bar_span_mm, edge_mm
from phytac_design.spec import Design
from shapes import Surface
from shapes.arrays import FloatArray
from shapes.errors import DesignError

TOLERANCE_PX = 0.1
"""Polygons stay this close to the circles they stand for, in pixels."""


def camera_of(design: Design, surface: Surface) -> PinholeCamera:
    """Return the design's camera on the sensor axis, at the stand-off of the design or its `fit`.

    Raises
    ------
    DesignError
        If the camera stands inside the sensor, its wall or its light bar, or cannot see the
        whole near rim.
    """
    section = design.camera
    rim = edge_mm(surface, 0, -design.wall.thickness_mm)
    radius = float(np.linalg.norm(rim[:, :2], axis=1).max())
    size = min(section.width_px, section.height_px)

    def fit(fill: float) -> float:
        return fit_stand_off_mm(
            radius_mm=radius, focal_px=section.focal_px, size_px=size, fill=fill
        )

    stand_off = fit(section.fill) if section.stand_off_mm == "fit" else section.stand_off_mm
    camera = PinholeCamera.on_axis(
        width_px=section.width_px,
        height_px=section.height_px,
        focal_px=section.focal_px,
        stand_off_mm=float(stand_off),
    )
    fix = f'set camera.stand_off_mm = "fit" ({fit(section.fill):.2f} mm here)'
    z, plane = -float(stand_off), float(rim[:, 2].min())
    if z >= plane:
        raise DesignError(
            f"the camera stands inside the sensor: its centre is at z = {z:.2f} mm, at or beyond "
            f"the near rim's plane at z = {plane:.2f} mm (got stand_off_mm = {stand_off:g}); {fix}"
        )
    _refuse_wall(design, surface, camera, fix)
    near = bar_span_mm(design, surface)[0]
    if design.light.bar_radius_mm > 0.0 and near <= z:
        raise DesignError(
            f"the camera stands inside the light bar: the bar starts at z = {near:.2f} mm, the "
            f"camera's centre is at z = {z:.2f} mm; raise light.bar_start_mm above {z:.2f}"
        )
    _refuse_blind(camera, rim, fit(1.0), fix)
    return camera


def _refuse_wall(design: Design, surface: Surface, camera: PinholeCamera, fix: str) -> None:
    """Raise if the camera's centre lies in the wall of the sensing surface."""
    centre = camera.position_mm[None]
    foot = surface.chart(centre)
    within = (foot >= surface.domain[:, 0]) & (foot <= surface.domain[:, 1])
    height = float(np.sum((centre - surface.point(foot)) * surface.normal(foot)))
    if bool(within.all()) and -design.wall.thickness_mm <= height <= 0.0:
        raise DesignError(
            f"the camera stands inside the shell wall ({-height:.2f} mm below the outer face, the "
            f"wall is {design.wall.thickness_mm:g} mm thick); {fix}"
        )


def _refuse_blind(camera: PinholeCamera, rim: FloatArray, least_mm: float, fix: str) -> None:
    """Raise if any point of the near rim projects outside of the image."""
    pixels = camera.project(rim)
    last = np.array([camera.width_px, camera.height_px]) - 0.5
    if bool(np.all((pixels >= -0.5) & (pixels <= last))):
        return
    reach = np.abs(pixels - camera.centre_px).max(axis=0)
    stand_off = -float(camera.position_mm[2])
    raise DesignError(
        f"the camera cannot see the near rim: it projects {reach[0]:.0f} x {reach[1]:.0f} px from "
        f"the image centre, the image ends at {camera.width_px / 2:.0f} x "
        f"{camera.height_px / 2:.0f} px (stand-off {stand_off:.2f} mm, focal length "
        f"{camera.focal_px:g} px); move it back to at least {least_mm:.2f} mm or {fix}"
    )


def refuse_swallowed(design: Design, surface: Surface, markers: Markers) -> None:
    """Raise a ``DesignError`` if the light bar reaches a receptor's end face or its red tip."""
    radius = design.light.bar_radius_mm
    near, far = bar_span_mm(design, surface)
    if radius <= 0.0 or near >= far:
        return
    axis = (markers.tip_mm - markers.foot_mm) / markers.height_mm[:, None]
    out = max(design.switch.stroke_mm - design.switch.tip_recess_mm, 0.0)
    reach = markers.tip_mm + np.linspace(0.0, out, 5)[:, None, None] * axis
    beside = (reach[..., 2] > near) & (reach[..., 2] < far)
    distance = np.where(beside, np.linalg.norm(reach[..., :2], axis=-1), np.inf)
    least = float(distance.min())
    if least <= radius:
        row = int(markers.row[distance.min(axis=0).argmin()])
        raise DesignError(
            f"the light bar swallows receptor tips: in row {row} a tip with its switch on comes "
            f"within {least:.2f} mm of the axis, the bar's radius is {radius:g} mm; lower "
            f"light.bar_radius_mm below {least:.2f} or layout.height_far_mm"
        )


def tolerance_mm(camera: PinholeCamera, markers: Markers) -> FloatArray:
    """Tessellation tolerance of each receptor: ``TOLERANCE_PX`` pixels at its end face, (n,) mm."""
    depth = camera.to_camera(markers.tip_mm)[:, 2]
    return np.asarray(TOLERANCE_PX * np.maximum(depth, 1e-3) / camera.focal_px)
