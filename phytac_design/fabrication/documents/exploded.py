"""Pictures of bodies pulled apart, drawn by the project's own rasteriser."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from phytac_decoder.camera.camera import Camera, pinhole
from phytac_design.fabrication.hardware.bodies import switch_frames
from phytac_design.fabrication.switch_set import SwitchSet, revolve
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout import Markers
from phytac_design.optics.raster import rasterise
from phytac_design.optics.scene import Scene
from phytac_design.solids.mesh_export import DISPLAY_COLOURS
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, ImageArray

SIZE_px = (1100, 800)
FINER = 2
"""Pixels each way behind one of the picture."""
VIEW = np.array([1.0, -0.55, -0.6])
"""From the sensor's middle towards the viewer: from the side and a little from the camera's end."""
DISTANCE = 4.0
"""Of the viewer, in radii of all bodies."""
FILL = 0.95
AMBIENT = 0.35
COARSE_mm = 0.15
"""Accuracy of switches in pictures."""
RUBBER = (236, 222, 176)
PART_COLOURS = {
    "": (150, 175, 205),
    "shell": DISPLAY_COLOURS["resin"][:3],
    "camera": (60, 120, 80),
    "light": (250, 225, 110),
    "ring": (250, 225, 110),
    "screw": (120, 122, 128),
}
TIP_mm = 1.0
"""Painted end of a stem."""


@dataclass(frozen=True, kw_only=True)
class Body:
    """A solid where the picture shows it, with its colour (red, green, blue)."""

    mesh: TriangleMesh
    colour: tuple[int, int, int]


def moved(mesh: TriangleMesh, shift: FloatArray) -> TriangleMesh:
    """Return a mesh elsewhere."""
    return TriangleMesh(vertices_mm=mesh.vertices_mm + shift, triangles=mesh.triangles)


def part_colour(name: str) -> tuple[int, int, int]:
    """Colour of a part of the hardware, by the first word of its name."""
    return PART_COLOURS.get(name.partition("_")[0], PART_COLOURS[""])


def switch_bodies(
    surface: Surface, markers: Markers, switches: SwitchSet, pull_mm: float
) -> list[Body]:
    """All switches, pulled out along their receptors' axes by ``pull_mm``; red tips apart."""
    foot, turn = switch_frames(surface, markers, switches)
    foot = foot - pull_mm * markers.direction
    rubber, tips = [], []
    for kind in switches.kinds:
        mesh = revolve(switches.profile(kind, COARSE_mm), COARSE_mm)
        own = switches.markers_of(kind)
        depth = float(switches.lengths_mm[kind[1]])
        points = np.einsum("nij,vj->nvi", turn[own], mesh.vertices_mm) + foot[own, None]
        rubber.append(_many(points, mesh.triangles))
        tip = _rod(0.5 * switches.tip_diameter_mm + 0.03, -depth - 0.03, TIP_mm)
        points = np.einsum("nij,vj->nvi", turn[own], tip.vertices_mm) + foot[own, None]
        tips.append(_many(points, tip.triangles))
    red = DISPLAY_COLOURS["red"][:3]
    return [
        *(Body(mesh=m, colour=RUBBER) for m in rubber),
        *(Body(mesh=m, colour=red) for m in tips),
    ]


def _rod(radius: float, low: float, length: float) -> TriangleMesh:
    high = low + length
    profile = np.array([[0.0, high], [radius, high], [radius, low], [0.0, low]])
    return revolve(profile, COARSE_mm)


def _many(points: FloatArray, triangles: np.ndarray) -> TriangleMesh:
    """Copies (n, v, 3) of one mesh as one."""
    offset = points.shape[1] * np.arange(len(points))[:, None, None]
    return TriangleMesh(
        vertices_mm=points.reshape(-1, 3), triangles=(triangles[None] + offset).reshape(-1, 3)
    )


def picture(bodies: Sequence[Body], *, view: FloatArray = VIEW) -> ImageArray:
    """Shaded picture (h, w, 3), BGR, of bodies seen from direction ``view``; +z upwards."""
    vertices = np.concatenate([body.mesh.vertices_mm for body in bodies])
    starts = np.cumsum([0, *(len(body.mesh.vertices_mm) for body in bodies)])
    triangles = np.concatenate(
        [body.mesh.triangles + start for body, start in zip(bodies, starts, strict=False)]
    ).astype(np.int32)
    colour = np.concatenate(
        [np.tile(body.colour, (len(body.mesh.triangles), 1)) for body in bodies]
    ).astype(np.float64)
    camera = _camera(vertices, view)
    scene = Scene(
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
    light = AMBIENT + (1.0 - AMBIENT) * (0.5 * facing + 0.5 * slant)
    shaded = np.concatenate([colour * light[:, None], [[255.0, 255.0, 255.0]]])
    image = shaded[owner][:, :, ::-1]
    size = (camera.width_px // FINER, camera.height_px // FINER)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(np.clip(np.rint(small), 0, 255).astype(np.uint8))


def _camera(vertices: FloatArray, view: FloatArray) -> Camera:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = (low + high) / 2.0
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    away = view / np.linalg.norm(view)
    right = np.cross(-away, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-away, right), -away])
    seen = (vertices - centre) @ rotation.T
    place = seen / (DISTANCE * radius + seen[:, 2:])
    reach = np.abs(place[:, :2]).max(axis=0)
    # Upright or lying, whichever shows it larger.
    ways = [FINER * np.array(SIZE_px), FINER * np.array(SIZE_px[::-1])]
    size = max(ways, key=lambda way: float((way / reach).min()))
    return Camera(
        lens=pinhole(
            width_px=int(size[0]),
            height_px=int(size[1]),
            focal_px=float(FILL * (size / 2.0 / reach).min()),
        ),
        position_mm=centre + DISTANCE * radius * away,
        rotation=rotation,
    )


def png_bytes(image: ImageArray) -> bytes:
    """PNG of a picture."""
    return bytes(cv2.imencode(".png", image)[1])
