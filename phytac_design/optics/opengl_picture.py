"""A scene drawn by OpenGL (pyrender on EGL): what the project's own frames are checked against.

The light is that of ``optics.light``; OpenGL itself projects the geometry and hides surfaces. Only
this module uses OpenGL. Each picture has its own context; do not call it from several threads.
"""

import os
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Pinhole
from phytac_design.optics.light import triangle_light
from phytac_design.optics.paint import BACKGROUND
from phytac_design.optics.render_scene import RenderScene
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import MissingPartError

GL_FIX = (
    "install the system libraries (Debian, Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri) "
    "and the Python extra (pip install 'phytac-design[design]')"
)


def render_picture(scene: RenderScene, camera: Camera) -> ImageArray:
    """Anti-aliased 8-bit picture (h, w, 3), BGR, in the camera's own pixels.

    Raises
    ------
    MissingPartError
        If pyrender or an EGL driver is missing (the message names the packages), or the lens is
        not a pinhole, the only one that OpenGL can draw.
    """
    if not isinstance(camera.lens, Pinhole):
        raise MissingPartError(
            "lens-not-drawable",
            f"no OpenGL picture: OpenGL draws pinholes only (got a {camera.lens.model} lens)",
        )
    pyrender = _pyrender()
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
    try:
        renderer = pyrender.OffscreenRenderer(camera.width_px, camera.height_px)
    except Exception as error:  # PyOpenGL raises its own kinds, by driver
        raise MissingPartError(
            "graphics-missing", f"no OpenGL picture: EGL gave no context ({error}); {GL_FIX}"
        ) from error
    try:
        colour, _ = renderer.render(stage)
    finally:
        renderer.delete()
    return np.ascontiguousarray(colour[:, :, ::-1])


def _pyrender() -> Any:
    """Import pyrender on EGL."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    try:
        import pyrender
    except Exception as error:  # PyOpenGL fails with ImportError, AttributeError, ... by platform
        raise MissingPartError(
            "graphics-missing", f"no OpenGL picture: pyrender failed ({error}); {GL_FIX}"
        ) from error
    return pyrender


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
