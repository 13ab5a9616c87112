"""A scene drawn by OpenGL (pyrender on EGL): what the project's own frames are checked against.

The light is that of ``optics.light``; OpenGL itself projects the geometry and hides surfaces.
"""

import os
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.optics.light import triangle_light
from phytac_design.optics.paint import BACKGROUND
from phytac_design.optics.render_scene import RenderScene
from phytac_shapes.arrays import ImageArray


def render_picture(scene: RenderScene, camera: Camera) -> ImageArray:
    """Anti-aliased 8-bit picture (h, w, 3), BGR, in the pixels of a pinhole camera."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    import pyrender

    gl_to_cv = np.diag([1.0, -1.0, -1.0])  # openGL's camera looks along -z with y up
    background = [*(np.array(BACKGROUND) / 255.0), 1.0]
    stage = pyrender.Scene(bg_color=background, ambient_light=np.ones(3))
    stage.add(pyrender.Mesh([_primitive(pyrender, scene, camera)]))
    near, far = _depth_range(scene, camera)
    gl_camera = pyrender.IntrinsicsCamera(
        camera.lens.fx_px,
        camera.lens.fy_px,
        # OpenGL counts pixel edges, our pixel centres are integers.
        *(camera.centre_px + 0.5),
        znear=near,
        zfar=far,
    )
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation.T @ gl_to_cv
    pose[:3, 3] = camera.position_mm
    stage.add(gl_camera, pose=pose)
    renderer = pyrender.OffscreenRenderer(camera.width_px, camera.height_px)
    try:
        colour, _ = renderer.render(stage)
    finally:
        renderer.delete()
    return np.ascontiguousarray(colour[:, :, ::-1])


def _primitive(pyrender: Any, scene: RenderScene, camera: Camera) -> Any:
    """All triangles, with corners of their own each in the light that the triangle sends.

    Under even white light OpenGL's shader passes the corners' linear colour on to its gamma.
    """
    light = np.column_stack([triangle_light(scene, camera), np.ones(len(scene.triangles))])
    return pyrender.Primitive(
        positions=scene.vertices[scene.triangles].reshape(-1, 3).astype(np.float32),
        color_0=np.repeat(light, 3, axis=0).astype(np.float32),
        material=pyrender.MetallicRoughnessMaterial(
            baseColorFactor=[1.0, 1.0, 1.0, 1.0], metallicFactor=0.0, doubleSided=True
        ),
    )


def _depth_range(scene: RenderScene, camera: Camera) -> tuple[float, float]:
    """Near and far plane that hold all that lies in front of the camera, mm."""
    near_least_mm = 0.2
    depth = camera.to_camera(scene.vertices)[:, 2]
    front = depth[depth > near_least_mm]
    return 0.5 * float(front.min(initial=1.0)), 1.1 * float(front.max(initial=2.0))
