"""One camera of a virtual sensor: its scenes, lens and light."""

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import bar_span_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import LensBlur, light_on_chip
from phytac_design.optics.frame_renderer import sample_offsets
from phytac_design.optics.light import Strip, triangle_light
from phytac_design.optics.pressed_scene import PressedScene, with_tips
from phytac_design.optics.raster import paint_alone, project_scene
from phytac_design.optics.render_scene import RenderScene
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray


class SimulatedCamera(PressedScene):
    """One camera of a sensor instance: its scenes, lens and light."""

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
        # The simulated camera stands still, and the detector expects markers alone.
        super().__init__(Sensor.of(design, surface, unit.markers), camera, marks=False)
        self.camera, self.blur, self.strip, self.samples = camera, blur, strip, samples
        self.paint = unit.paint

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

    def shift_px(self, motion: FloatArray, out: BoolArray | FloatArray) -> FloatArray:
        """Shift (n, 2) px of each paint's centroid because its tip is out; 0 where it is not.

        Parameters
        ----------
        motion : (n, 6) float
            Translation (mm) and rotation (rad) of the wall under each marker.
        out : (n,) bool or float
            Tips that are out, or how far each is, as a share of the stroke.
        """
        shift = np.zeros((len(out), 2))
        ids = np.flatnonzero(out)
        if len(ids):
            rest, on = self.scenes
            before, after = (
                self._centroids(scene, motion, ids) for scene in (rest, with_tips(rest, on, out))
            )
            shift[ids] = np.nan_to_num(after - before)
        return shift

    def _centroids(self, scene: RenderScene, motion: FloatArray, ids: IntArray) -> FloatArray:
        """Centroids (m, 2) px of the paint of receptors ``ids`` (m,), each alone."""
        own = np.flatnonzero(np.isin(scene.triangle_owner, ids))
        some = scene.part_of(own).moved(motion[:, :3], motion[:, 3:], self.pivots_mm)
        view = project_scene(some, self.camera)
        sums = np.zeros((some.count, 3))
        for right, down in sample_offsets(self.samples):
            sums += paint_alone(some, self.camera, view=view, offset_px=(float(right), float(down)))
        return np.asarray(sums[ids, 1:] / np.where(sums[ids, :1] > 0.0, sums[ids, :1], np.nan))
