"""Small versions of the published sensor."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Perspective
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import camera_of, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.render_scene import RenderScene, build_scene
from phytac_shapes.arrays import BoolArray, FloatArray

FULL = {"width_px": 2592, "height_px": 1944, "focal_px": 970.0}
"""The paper's large camera."""


def make_design(**sections: Mapping[str, Any]) -> Design:
    """Published sensor before a camera with a quarter of the pixels; ``sections`` replace."""
    data: dict[str, Any] = {
        "name": "small",
        "shape": {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 120.0},
        "camera": {"width_px": 648, "height_px": 486, "focal_px": 242.5},
    }
    return Design.model_validate(data | sections)


class Bench:
    """A design with its surface, markers and camera."""

    def __init__(self, design: Design) -> None:
        self.design = design
        self.surface = design.surface()
        self.markers = make_markers(design, self.surface)
        self.camera = camera_of(design, self.surface)

    def scene(self, switch_on: BoolArray | None = None, *, hollow: bool = True) -> RenderScene:
        """Scene at rest."""
        return build_scene(
            Sensor.of(self.design, self.surface, self.markers),
            tolerance_mm=tolerance_mm(self.camera, self.markers),
            switch_on=switch_on,
            hollow=hollow,
        )


def through_lens(
    scene: RenderScene, camera: Camera, point_mm: FloatArray, focus_mm: float
) -> RenderScene:
    """Scene as it appears through one point (2,) of the aperture, focused at ``focus_mm``."""
    if not np.any(point_mm):
        return scene
    seen = camera.to_camera(scene.vertices)
    flat = isinstance(camera.lens, Perspective)
    distance = seen[:, 2] if flat else np.linalg.norm(seen, axis=1)
    across = np.array([*point_mm, 0.0]) @ camera.rotation
    return replace(
        scene, vertices=scene.vertices + (distance / focus_mm - 1.0)[:, None] * across[None]
    )
