"""One camera of a virtual sensor: its scene in any pose, lens and light."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import bar_span_mm
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import LensBlur, light_on_chip
from phytac_design.optics.light import Strip, triangle_light
from phytac_design.optics.render_scene import RenderScene, build_scene
from phytac_design.simulation.imaging.carried_wall import WallMotion
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray


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
        follow: bool,
    ) -> None:
        self.camera, self.blur, self.strip, self.samples = camera, blur, strip, samples
        self.paint, self.pivots_mm = unit.paint, unit.markers.mid_mm
        tolerance = tolerance_mm(camera, unit.markers)
        self.rest, self.on = (
            build_scene(
                Sensor.of(design, surface, unit.markers),
                tolerance_mm=tolerance,
                switch_on=np.full(unit.markers.count, state),
            )
            for state in (False, True)
        )
        self.wall = WallMotion(design, surface, unit.markers, self.rest) if follow else None

    def scene(self, motion: FloatArray, bits: BoolArray, *, follow: bool = True) -> RenderScene:
        """Scene of one sample; its wall stands still unless it is to ``follow``."""
        out = np.append(bits, False)[self.rest.vertex_owner]  # the last is that of owner -1
        vertices = np.where(out[:, None], self.on.vertices, self.rest.vertices)
        scene = replace(self.rest, vertices=vertices)
        if follow and self.wall is not None:
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
