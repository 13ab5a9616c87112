"""A still picture of the shell, cut open, for print and for browsers without WebGL."""

from dataclasses import replace

import cv2
import numpy as np

from phytac_decoder.camera.camera import Camera, pinhole
from phytac_design.geometry.flat_map import surface_topology
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.paint import BACKGROUND
from phytac_design.optics.render_scene import SHELL, RenderScene, build_scene
from phytac_design.report.viewer.data import eye_of
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray


def still_picture(sensor: Sensor, size_px: tuple[int, int] = (900, 700)) -> bytes:
    """PNG of the shell as the viewer first shows it; tubes are cut open towards the eye."""
    finer = 2  # how much finer than the picture it is rendered, along both sides
    surface, markers = sensor.surface, sensor.markers
    eye = eye_of(surface, markers)
    scene = cut_open(build_scene(sensor, tolerance_mm=0.1), surface, markers, eye)
    shown = scene.vertices[np.unique(scene.triangles)]
    image = render_frame(
        scene, camera_at(eye, shown, size_px[0] * finer, size_px[1] * finer), samples=1
    )
    # Nothing in the scene is black but the background, which paper should not be.
    image[(image <= max(BACKGROUND)).all(axis=2)] = 255
    small = cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".png", small)[1])


def cut_open(
    scene: RenderScene, surface: Surface, markers: Markers, eye: FloatArray
) -> RenderScene:
    """Scene of a tube without the wall and the receptors whose outer side faces the eye."""
    if surface_topology(surface) != "tube":
        return scene
    middle = scene.vertices[scene.triangles].mean(axis=1)
    keep = np.ones(len(middle), dtype=np.bool_)
    wall = scene.part == SHELL
    keep[wall] = surface.normal(surface.chart(middle[wall])) @ eye <= 0.0
    owner = scene.triangle_owner
    keep[owner >= 0] = (markers.normal @ eye <= 0.0)[owner[owner >= 0]]
    return replace(scene, triangles=scene.triangles[keep], part=scene.part[keep], closed=False)


def camera_at(
    eye: FloatArray,
    points_mm: FloatArray,
    width_px: int,
    height_px: int,
    *,
    field_deg: float = 28.0,
    fill: float = 0.92,
) -> Camera:
    """Camera in direction ``eye`` (3,) from points (n, 3) that sees them all; z points up.

    They fill a share ``fill`` of its picture along the longer side; ``field_deg`` is its upright
    field of view.
    """
    right = np.cross(eye, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([-right, np.cross(eye, right), -eye])
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    middle = (low + high) / 2.0
    focal = height_px / 2.0 / np.tan(np.deg2rad(field_deg) / 2.0)
    local = (points_mm - middle) @ axes.T
    half = np.array([width_px, height_px]) * fill / 2.0
    away = float((focal * np.abs(local[:, :2]) / half - local[:, 2:]).max())
    lens = pinhole(width_px=width_px, height_px=height_px, focal_px=float(focal))
    return Camera(lens=lens, position_mm=middle + away * eye, rotation=axes)
