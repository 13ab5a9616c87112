"""A camera frame without OpenGL: the exact z-buffer, lit, the same on every machine.

Light is linear until the last step: sub-pixels are averaged as a sensor does, then encoded to
sRGB.
"""

import numpy as np
from numpy.typing import NDArray

from decoder.camera import PinholeCamera
from phytac_design.optics.light import triangle_light
from phytac_design.optics.paint import BACKGROUND, to_linear, to_srgb
from phytac_design.optics.raster import Projected, fill, in_bands, kernel, project_scene
from phytac_design.optics.scene import Scene
from shapes.arrays import ImageArray

BAND_ROWS = 128
LEVELS = 4096
"""Steps of the table that encodes linear light."""


def render_frame(
    scene: Scene,
    camera: PinholeCamera,
    *,
    noise_std: float = 0.0,
    rng: np.random.Generator | None = None,
    supersample: int = 2,
) -> ImageArray:
    """Anti-aliased 8-bit frame (h, w, 3), BGR.

    Parameters
    ----------
    noise_std : float
        Standard deviation of the sensor noise, grey levels; needs ``rng`` if not 0.
    supersample : int
        Samples per pixel along each side.
    """
    view = project_scene(scene, finer(camera, supersample))
    light = np.concatenate([triangle_light(scene, camera), to_linear(np.array([BACKGROUND]))])
    light = light[:, ::-1].astype(np.float32)
    encode = to_srgb(np.arange(LEVELS) / (LEVELS - 1.0)).astype(np.float32)
    frame = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.uint8)

    def band(first: int, last: int) -> None:
        _shade(view, light, encode, (supersample, first), frame[first:last])

    in_bands(band, camera.height_px, band_rows=BAND_ROWS)
    if noise_std > 0.0:
        if rng is None:
            raise ValueError("render_frame: noise_std > 0 needs a random generator; pass rng=...")
        frame = add_noise(frame, noise_std, rng)
    return frame


def add_noise(image: ImageArray, std: float, rng: np.random.Generator) -> ImageArray:
    """Image with independent Gaussian noise of ``std`` grey levels on every channel, rounded."""
    noise = rng.standard_normal(image.shape, dtype=np.float32)
    noise *= np.float32(std)
    noise += image
    np.rint(noise, out=noise)
    np.clip(noise, 0.0, 255.0, out=noise)
    return noise.astype(np.uint8)


def finer(camera: PinholeCamera, factor: int) -> PinholeCamera:
    """Camera whose pixels are the ``factor`` x ``factor`` parts of this camera's pixels."""
    return PinholeCamera(
        width_px=camera.width_px * factor,
        height_px=camera.height_px * factor,
        focal_px=camera.focal_px * factor,
        centre_px=camera.centre_px * factor + (factor - 1) / 2.0,
        position_mm=camera.position_mm,
        rotation=camera.rotation,
    )


@kernel
def _shade(
    view: Projected,
    light: NDArray[np.float32],
    encode: NDArray[np.float32],
    place: tuple[int, int],
    frame: ImageArray,
) -> None:
    """Fill one band of rows at a multiple of the resolution; average and encode into ``frame``.

    ``place`` is that multiple and the band's first row.
    The last entry of ``light`` is the background, which index -1 finds.
    """
    factor, top = place
    rows, columns = frame.shape[:2]
    owner = np.full((rows * factor, columns * factor), -1, dtype=np.int32)
    fill(view, 0, top * factor, owner, np.zeros(owner.shape))
    scale = np.float32((len(encode) - 1) / factor**2)
    for row in range(rows):
        for column in range(columns):
            blue, green, red = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for i in range(factor):
                for j in range(factor):
                    t = owner[row * factor + i, column * factor + j]
                    blue += light[t, 0]
                    green += light[t, 1]
                    red += light[t, 2]
            frame[row, column, 0] = np.uint8(encode[int(blue * scale + 0.5)] + 0.5)
            frame[row, column, 1] = np.uint8(encode[int(green * scale + 0.5)] + 0.5)
            frame[row, column, 2] = np.uint8(encode[int(red * scale + 0.5)] + 0.5)
