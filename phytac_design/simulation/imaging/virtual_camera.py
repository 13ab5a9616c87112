"""One camera of a virtual sensor: its scene in any pose, lens and light."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import bar_span_mm, boundary_mm
from phytac_design.layout import Markers
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import LensBlur, light_on_chip
from phytac_design.optics.frame_renderer import sample_offsets
from phytac_design.optics.light import Strip, triangle_light
from phytac_design.optics.raster import paint_alone, project_scene
from phytac_design.optics.render_scene import SHELL, RenderScene, build_scene
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


class SimulatedCamera:
    """One camera of a sensor instance: its scene, lens and light."""

    def __init__(
        self,
        design: Design,
        surface: Surface,
        unit: SensorInstance,
        camera: Camera,
        blur: LensBlur | None,
        *,
        strip: Strip | None,
        samples: int,
    ) -> None:
        self.camera, self.blur, self.strip, self.samples = camera, blur, strip, samples
        self.paint, self.pivots_mm = unit.paint, unit.markers.mid_mm
        tolerance = tolerance_mm(camera, unit.markers)
        self.rest, self.on = (
            build_scene(
                Sensor.of(design, surface, unit.markers),
                tolerance_mm=tolerance,
                switch_on=np.full(unit.markers.count, state),
                # The simulated camera stands still, and the detector expects markers alone.
                marks=False,
            )
            for state in (False, True)
        )
        self.wall = WallMotion(design, surface, unit.markers, self.rest)

    def scene(self, motion: FloatArray, bits: BoolArray, *, follow: bool = True) -> RenderScene:
        """Scene of one sample; its wall stands still unless it is to ``follow``."""
        out = np.append(bits, False)[self.rest.vertex_owner]  # the last is that of owner -1
        vertices = np.where(out[:, None], self.on.vertices, self.rest.vertices)
        scene = replace(self.rest, vertices=vertices)
        if follow:
            scene = self.wall.moved(scene, motion)
        return scene.moved(motion[:, :3], motion[:, 3:], self.pivots_mm)

    def light(
        self, scene: RenderScene, shift_px: tuple[float, float] = (0.0, 0.0)
    ) -> NDArray[np.float32]:
        """Linear light on the chip, which may lie aside."""
        sent = triangle_light(scene, self.camera, strip=self.strip, paint=self.paint)
        camera = self.camera.shifted(np.array(shift_px)) if any(shift_px) else self.camera
        return light_on_chip(scene, camera, light=sent, blur=self.blur, samples=self.samples)


def bar_strip(sensor: Sensor) -> Strip | None:
    """Light bar of a design as a strip; None without one."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    near, far = bar_span_mm(design, surface)
    if design.light.bar_radius_mm <= 0.0 or near >= far:
        return None
    return Strip.lighting(markers.tip_mm, near_mm=near, far_mm=far)


class WallMotion:
    """Motion of the inner face between markers, whose wall's motion is known.

    Each point follows its nearest markers as rigid bodies, weighted by modified Shepard weights
    (Franke and Nielson 1980); open edges are clamped.

    Parameters
    ----------
    scene : Scene
        At rest.
    """

    def __init__(
        self, design: Design, surface: Surface, markers: Markers, scene: RenderScene
    ) -> None:
        nearest = 8  # markers (and points of the fixed edges) that a point of the wall follows
        shell = scene.triangles[scene.part == SHELL]
        self.vertices = np.unique(shell)
        fixed = boundary_mm(surface, -design.wall.thickness_mm / 2.0)
        anchors = np.concatenate([markers.mid_mm, fixed])
        points = scene.vertices[self.vertices]
        count = min(nearest + 1, len(anchors))
        distance, index = cKDTree(anchors).query(points, k=count)
        reach = distance[:, -1:]
        near = np.maximum(distance[:, :-1], 1e-9)
        weight = np.maximum(reach - near, 0.0) ** 2 / (reach * near) ** 2
        weight[:, 0] += 1e-300
        self.weight = weight / weight.sum(axis=1, keepdims=True)
        self.index, self.fixed = index[:, :-1], len(fixed)
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


class TipCover:
    """One camera's view of single receptors, tip in and tip out.

    Parameters
    ----------
    rest, on : Scene
        The same scene with all tips in, and out.
    camera : Camera
        That sees it.
    pivots_mm : (n, 3) float
        Points that motions are of.
    """

    samples = 8
    """Samples per pixel."""

    def __init__(
        self, rest: RenderScene, on: RenderScene, camera: Camera, pivots_mm: FloatArray
    ) -> None:
        self.scenes, self.camera, self.pivots_mm = (rest, on), camera, pivots_mm

    def shift_px(self, motion: FloatArray, bits: BoolArray) -> FloatArray:
        """Shift (n, 2) px of each paint's centroid because its tip is out; 0 where it is not.

        Parameters
        ----------
        motion : (n, 6) float
            Translation (mm) and rotation (rad) of the wall under each marker.
        bits : (n,) bool
            Switches that are on.
        """
        out = np.zeros((len(bits), 2))
        ids = np.flatnonzero(bits)
        if len(ids):
            before, after = (self._centroids(scene, motion, ids) for scene in self.scenes)
            out[ids] = np.nan_to_num(after - before)
        return out

    def _centroids(self, scene: RenderScene, motion: FloatArray, ids: IntArray) -> FloatArray:
        """Centroids (m, 2) px of the paint of receptors ``ids`` (m,), each alone."""
        own = np.flatnonzero(np.isin(scene.triangle_owner, ids))
        some = scene.part_of(own).moved(motion[:, :3], motion[:, 3:], self.pivots_mm)
        view = project_scene(some, self.camera)
        sums = np.zeros((some.count, 3))
        for right, down in sample_offsets(self.samples):
            sums += paint_alone(some, self.camera, view=view, offset_px=(float(right), float(down)))
        return np.asarray(sums[ids, 1:] / np.where(sums[ids, :1] > 0.0, sums[ids, :1], np.nan))
