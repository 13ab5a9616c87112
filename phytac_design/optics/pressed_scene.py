"""The scene of a pressed sensor: receptors, their tips and the wall, as forces move them."""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from phytac_decoder.camera.camera import Camera
from phytac_design.geometry.envelope import boundary_mm
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.render_scene import SHELL, RenderScene, build_scene
from phytac_shapes.arrays import BoolArray, FloatArray


class WallMotion:
    """Motion of the inner face between markers, whose wall's motion is known.

    Each point follows its nearest markers as rigid bodies, weighted by modified Shepard weights
    (Franke and Nielson 1980); open edges are clamped.

    Parameters
    ----------
    scene : Scene
        At rest.
    """

    def __init__(self, sensor: Sensor, scene: RenderScene) -> None:
        nearest = 8  # markers (and points of the fixed edges) that a point of the wall follows
        shell = scene.triangles[scene.part == SHELL]
        self.vertices = np.unique(shell)
        fixed = boundary_mm(sensor.surface, -sensor.design.wall.thickness_mm / 2.0)
        anchors = np.concatenate([sensor.markers.mid_mm, fixed])
        points = scene.vertices[self.vertices]
        count = min(nearest + 1, len(anchors))
        distance, index = cKDTree(anchors).query(points, k=count)
        # A receptor's foot belongs to the wall, which follows it up to the tube's outer edge and
        # half of the free width around it: cells of the wall have a size.
        radius = sensor.design.receptor.diameter_tube_mm / 2.0
        free = cKDTree(fixed).query(sensor.markers.mid_mm)[0] - radius
        if sensor.markers.count > 1:
            nearest_mm = cKDTree(sensor.markers.mid_mm).query(sensor.markers.mid_mm, k=2)[0][:, 1]
            free = np.minimum(free, nearest_mm - 2.0 * radius)
        foot = np.append(radius + np.clip(0.5 * free, 0.0, radius), np.zeros(len(fixed)))
        distance = np.maximum(distance - foot[index], 1e-9)
        reach = distance.max(axis=1, keepdims=True)
        weight = (reach - distance) ** 2 / (reach * distance) ** 2
        weight[:, 0] += 1e-300
        self.weight = weight / weight.sum(axis=1, keepdims=True)
        self.index, self.fixed = index, len(fixed)
        self.arm = points[:, None] - anchors[self.index]

    def moved(self, scene: RenderScene, motion: FloatArray) -> RenderScene:
        """Scene with its wall moved; receptors stay.

        Parameters
        ----------
        motion : (n, 6) float
            Translation (mm) and rotation vector (rad) of the wall under each marker.
        """
        every = np.concatenate([motion, np.zeros((self.fixed, 6))])[self.index]
        change = every[..., :3] + np.cross(every[..., 3:], self.arm)
        vertices = scene.vertices.copy()
        vertices[self.vertices] += np.einsum("vk,vki->vi", self.weight, change)
        return replace(scene, vertices=vertices)


def with_tips(rest: RenderScene, on: RenderScene, out: BoolArray | FloatArray) -> RenderScene:
    """Scene of tips that are out, (n,) bool, or by a share of the stroke, (n,) float.

    Parameters
    ----------
    rest, on : RenderScene
        The same scene with all tips in, and out.
    """
    share = np.append(out, 0)[rest.vertex_owner][:, None]  # the last is of owner -1
    if out.dtype == np.bool_:
        return replace(rest, vertices=np.where(share, on.vertices, rest.vertices))
    return replace(rest, vertices=rest.vertices + share * (on.vertices - rest.vertices))


class PressedScene:
    """Scenes of one sensor before one camera, in any pose and with any switches on.

    Parameters
    ----------
    sensor : Sensor
        Design, surface and markers.
    camera : Camera
        Determines how finely circles are drawn, see ``tolerance_mm``.
    marks : bool
        Whether reference marks are painted.

    Attributes
    ----------
    rest, on : RenderScene
        Without forces, with all tips in, and out.
    """

    def __init__(self, sensor: Sensor, camera: Camera, *, marks: bool = True) -> None:
        tolerance = tolerance_mm(camera, sensor.markers)
        # Cells smaller than receptors, but not more than some 100,000 of them.
        third = sensor.design.receptor.diameter_outer_mm / 3.0
        cell = max(third, float(np.sqrt(sensor.surface.area_mm2() / 1e5)))
        self.rest, self.on = (
            build_scene(
                sensor,
                tolerance_mm=tolerance,
                switch_on=np.full(sensor.markers.count, state),
                wall_cell_mm=cell,
                marks=marks,
            )
            for state in (False, True)
        )
        self.wall = WallMotion(sensor, self.rest)
        self.pivots_mm = sensor.markers.mid_mm

    def scene(
        self, motion: FloatArray, out: BoolArray | FloatArray, *, wall_follows: bool = True
    ) -> RenderScene:
        """Return the scene of one pose.

        A wall that did not follow would cover and uncover the paint of short receptors.

        Parameters
        ----------
        motion : (n, 6) float
            Translation (mm) and rotation vector (rad) of the wall under each marker.
        out : (n,) bool or float
            Tips that are out, or how far each is, as a share of the stroke.
        wall_follows : bool
            Whether the wall between the receptors moves with them.
        """
        scene = with_tips(self.rest, self.on, out)
        if wall_follows:
            scene = self.wall.moved(scene, motion)
        return scene.moved(motion[:, :3], motion[:, 3:], self.pivots_mm)
