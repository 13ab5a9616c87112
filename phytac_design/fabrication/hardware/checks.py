"""Checks of an assembly: collisions, both sides of joints, ways of light, view."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.parts import HardwareAssembly
from phytac_design.fabrication.hardware.screws import SCREWS, Joint
from phytac_design.geometry.envelope import bar_mesh, shell_mesh
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.geometry.triangles import TriangleMesh, merged
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.render_scene import FIRST_MARKER, build_scene
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray


def meets(solids: Mapping[str, Any]) -> dict[str, float]:
    """Common volume (mm³) of every pair of solids that share any, by ``"one / other"``."""
    none_mm3 = 1e-6  # a smaller common volume is rounding
    boxes = {name: solid.bounding_box() for name, solid in solids.items()}
    found = {}
    for one, other in combinations(solids, 2):
        a, b = boxes[one], boxes[other]
        if any(a[i] >= b[i + 3] or b[i] >= a[i + 3] for i in range(3)):
            continue
        volume = float((solids[one] ^ solids[other]).volume())
        if volume > none_mm3:
            found[f"{one} / {other}"] = volume
    return found


@dataclass(frozen=True, kw_only=True)
class JointHoles:
    """Screw of each hole on both sides of a joint, as measured in the parts' meshes.

    ``""`` where no standard hole fits, ``"M2.5 M3"`` where one hole serves two screws.
    """

    joint: str
    passing: tuple[str, ...]
    holding: tuple[str, ...]

    @property
    def agree(self) -> bool:
        """Whether one screw fits all holes of both sides."""
        fits = [set(names.split()) for names in self.passing + self.holding]
        return bool(fits) and bool(set.intersection(*fits))


def sides_of_joint(joint: Joint, meshes: Mapping[str, TriangleMesh]) -> JointHoles:
    """Measure the holes of a joint in its parts' meshes and name the screw that each is for."""
    passing, holding = joint.probes()
    names = {screw.name: screw for screw in SCREWS.values()}
    clear = {name: screw.clearance_mm for name, screw in names.items()}
    melted = joint.thread == "heat-set"
    hold = {name: screw.insert_mm if melted else screw.tap_mm for name, screw in names.items()}
    ways = np.array(joint.directions)
    return JointHoles(
        joint=joint.name,
        passing=_sizes(meshes.get(joint.head_part), np.array(passing), ways, clear),
        holding=_sizes(meshes.get(joint.thread_part), np.array(holding), ways, hold),
    )


def _sizes(
    mesh: TriangleMesh | None, places: FloatArray, ways: FloatArray, table: dict[str, float]
) -> tuple[str, ...]:
    """Sizes of the table that the hole around each place is for."""
    hole_mm = 0.15  # a measured hole is a standard one within this
    spokes = 24  # rays around an axis that measure a hole
    if len(places) == 0 or mesh is None:
        return ()
    tree = RayTree(mesh)
    out = []
    for place, way in zip(places, ways, strict=True):
        first = np.cross(way, np.eye(3)[np.abs(way).argmin()])
        first /= np.linalg.norm(first)
        turn = 2.0 * np.pi * (np.arange(spokes) + 0.5) / spokes
        around = np.outer(np.cos(turn), first) + np.outer(np.sin(turn), np.cross(way, first))
        hits = tree.cast(np.tile(place, (spokes, 1)), around, 20.0)
        diameter = 2.0 * float(np.where(hits.triangle >= 0, hits.distance_mm, 20.0).mean())
        out.append(" ".join(key for key in table if abs(table[key] - diameter) <= hole_mm))
    return tuple(out)


def sphere(count: int) -> FloatArray:
    """Unit vectors (count, 3) spread evenly, on a golden spiral."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * index
    level = np.sqrt(1.0 - z**2)
    return np.column_stack([level * np.cos(turn), level * np.sin(turn), z])


def light_leaks(
    walls: TriangleMesh, places_mm: FloatArray, directions: int = 1500
) -> tuple[int, int]:
    """Number of rays from places (n, 3) inside that meet no wall, and number of all rays.

    Parameters
    ----------
    walls : TriangleMesh
        The shell with its holes closed (by switches) and all hardware.
    """
    way = np.tile(sphere(directions), (len(places_mm), 1))
    start = np.repeat(places_mm, directions, axis=0)
    return int((RayTree(walls).cast(start, way).triangle < 0).sum()), len(start)


def inside_places(
    design: Design, surface: Surface, kit: HardwareAssembly, cameras: list[Camera]
) -> FloatArray:
    """Places (n, 3) inside the sensor from which the light check starts.

    Before each camera, along the axis beside the bar, all around every edge of the sensing wall,
    and in every opening between parts.
    """
    low, high = surface.bounds_mm()
    aside = max(design.light.bar_radius_mm, 0.0) + 1.0
    axis = np.linspace(low[2] + 1.0, high[2] - design.wall.thickness_mm - 1.0, 6)
    places = [np.column_stack([np.full(6, aside), np.zeros(6), axis])] if np.ptp(axis) > 6.0 else []
    for camera in cameras:
        forward = 1.0 if camera.rotation[2, 2] > 0.0 else -1.0
        front = camera.position_mm + np.array(
            [0.0, 0.0, forward * (design.hardware.lens_pupil_mm + 0.5)]
        )
        places.append(front[None])
    for way, end in surface.edges():
        uv = np.full((16, 2), surface.domain[way, end])
        first, last = surface.domain[1 - way]
        uv[:, 1 - way] = np.linspace(first, last, 18)[1:-1]
        places.append(surface.point(uv, -design.wall.thickness_mm - 0.02))
    if kit.openings_mm:
        places.append(np.array(kit.openings_mm))
    return np.concatenate(places)


def hidden_rays(sensor: Sensor, cameras: list[Camera], hardware: TriangleMesh) -> tuple[int, int]:
    """Lines from cameras to the markers' painted faces that hardware cuts, and all of them.

    Lines that the scene's own wall or light bar cuts are known to it and do not count.
    """
    design, surface = sensor.design, sensor.surface
    scene_mm = 0.005  # accuracy of the scene's fixed parts
    coarse = 0.2 * design.receptor.diameter_outer_mm
    scene = build_scene(sensor, tolerance_mm=coarse)
    target = scene.vertices[np.unique(scene.triangles[scene.part >= FIRST_MARKER])]
    tree = RayTree(hardware)
    known = RayTree(
        merged(
            [
                shell_mesh(design, surface, tolerance_mm=scene_mm),
                bar_mesh(design, surface, tolerance_mm=scene_mm),
            ]
        )
    )
    cut = 0
    for camera in cameras:
        line = target - camera.position_mm
        length = np.linalg.norm(line, axis=1)
        way = line / length[:, None]
        start = np.broadcast_to(camera.position_mm, target.shape)
        blocked = tree.cast(start, way, length - 1e-3).triangle >= 0
        if blocked.any():
            blocked[blocked] = (
                known.cast(start[blocked], way[blocked], length[blocked] - 1e-3).triangle < 0
            )
        cut += int(blocked.sum())
    return cut, len(target) * len(cameras)
