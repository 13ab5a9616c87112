"""Exploded pictures, drawn by the project's own rasteriser."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from phytac_decoder.camera.camera import Camera, pinhole
from phytac_design.fabrication.hardware.sensor_solids import switch_frames
from phytac_design.fabrication.inserts.insert_solids import insert_manifold
from phytac_design.fabrication.inserts.sprues import insert_lengths_mm
from phytac_design.fabrication.switch_set import SwitchSet, revolve
from phytac_design.geometry.triangles import TriangleMesh, copies, frames_along, merged
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import RenderScene
from phytac_design.solids.mesh_export import DISPLAY_COLOURS
from phytac_design.solids.solid_mesh import to_triangles
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

RUBBER = (236, 222, 176)
"""Colour of the switches."""


@dataclass(frozen=True, kw_only=True)
class Body:
    """A solid where the picture shows it, with its colour (red, green, blue)."""

    mesh: TriangleMesh
    colour: tuple[int, int, int]


def part_colour(name: str) -> tuple[int, int, int]:
    """Colour of a part of the hardware, by the first word of its name."""
    colours = {
        "shell": DISPLAY_COLOURS["resin"][:3],
        "camera": (60, 120, 80),
        "light": (250, 225, 110),
        "ring": (250, 225, 110),
        "screw": (120, 122, 128),
    }
    return colours.get(name.partition("_")[0], (150, 175, 205))


def switch_bodies(
    surface: Surface, markers: Markers, switches: SwitchSet, pull_mm: float
) -> list[Body]:
    """All switches, moved out along their receptors' axes by ``pull_mm``; red tips are separate."""
    tip_mm = 1.0  # painted end of a stem
    coarse_mm = 0.15  # accuracy of switches in pictures
    origin, turn = switch_frames(surface, markers, switches)
    origin = origin - pull_mm * markers.direction
    red = DISPLAY_COLOURS["red"][:3]
    bodies = []
    for kind in switches.kinds:
        own = switches.markers_of(kind)
        mesh = revolve(switches.profile(kind, coarse_mm), coarse_mm)
        bodies.append(Body(mesh=copies(mesh, origin[own], turn[own]), colour=RUBBER))
        # The painted end is drawn a little larger than the stem.
        radius = 0.5 * switches.tip_diameter_mm + 0.03
        low = -float(switches.lengths_mm[kind[1]]) - 0.03
        profile = [[0.0, low + tip_mm], [radius, low + tip_mm], [radius, low], [0.0, low]]
        tip = revolve(np.array(profile), coarse_mm)
        bodies.append(Body(mesh=copies(tip, origin[own], turn[own]), colour=red))
    return bodies


def insert_bodies(sensor: Sensor, pull_mm: float) -> list[Body]:
    """All inserts in their colours, moved out along their receptors' axes by ``pull_mm``."""
    coarse_mm = 0.1  # accuracy of inserts in pictures
    design, markers = sensor.design, sensor.markers
    origin = sensor.surface.point(markers.uv) - pull_mm * markers.direction
    turn, lengths = frames_along(markers.direction), insert_lengths_mm(design, markers)
    bodies = []
    for length, colour in sorted(set(zip(lengths.tolist(), markers.colour.tolist(), strict=True))):
        own = np.flatnonzero((lengths == length) & (markers.colour == colour))
        mesh = to_triangles(insert_manifold(design.receptor, length, tolerance_mm=coarse_mm))
        paint = getattr(design.paints, design.layout.colours[colour])
        bodies.append(Body(mesh=copies(mesh, origin[own], turn[own]), colour=tuple(paint)))
    return bodies


def picture(bodies: Sequence[Body], *, finer: int = 2) -> bytes:
    """PNG of bodies, shaded, +z upwards, averaged over ``finer`` pixels each way."""
    # From the side and a little from the camera's end.
    view = np.array([1.0, -0.55, -0.6])
    ambient = 0.35
    mesh = merged([body.mesh for body in bodies])
    vertices, triangles = mesh.vertices_mm, mesh.triangles.astype(np.int32)
    colour = np.concatenate(
        [np.tile(body.colour, (len(body.mesh.triangles), 1)) for body in bodies]
    ).astype(np.float64)
    camera = _camera(vertices, view, finer)
    scene = RenderScene(
        vertices=vertices,
        triangles=triangles,
        part=np.zeros(len(triangles), dtype=np.int32),
        vertex_owner=np.full(len(vertices), -1, dtype=np.int32),
        colour=np.zeros(0, dtype=np.int64),
        paints=(),
    )
    owner = rasterise(scene, camera).triangle
    corners = vertices[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    facing = np.abs(normal @ camera.rotation[2]) / size
    slant = np.abs(normal @ (camera.rotation[2] + 0.6 * camera.rotation[1])) / size / 1.166
    light = ambient + (1.0 - ambient) * (0.5 * facing + 0.5 * slant)
    shaded = np.concatenate([colour * light[:, None], [[255.0, 255.0, 255.0]]])
    image = shaded[owner][:, :, ::-1]
    size = (camera.width_px // finer, camera.height_px // finer)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".png", np.clip(np.rint(small), 0, 255).astype(np.uint8))[1])


def _camera(vertices: FloatArray, view: FloatArray, finer: int) -> Camera:
    fill = 0.95
    distance = 4.0  # of the viewer, in radii of all bodies
    size_px = (1100, 800)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = (low + high) / 2.0
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    away = view / np.linalg.norm(view)
    right = np.cross(-away, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-away, right), -away])
    seen = (vertices - centre) @ rotation.T
    place = seen / (distance * radius + seen[:, 2:])
    reach = np.abs(place[:, :2]).max(axis=0)
    # Upright or lying, whichever shows it larger.
    ways = [finer * np.array(size_px), finer * np.array(size_px[::-1])]
    size = max(ways, key=lambda way: float((way / reach).min()))
    return Camera(
        lens=pinhole(
            width_px=int(size[0]),
            height_px=int(size[1]),
            focal_px=float(fill * (size / 2.0 / reach).min()),
        ),
        position_mm=centre + distance * radius * away,
        rotation=rotation,
    )
