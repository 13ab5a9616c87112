"""A camera frame of any lens, without OpenGL: the exact z-buffer, lit, alike on every machine.

Light is linear until the last step: sub-pixels are averaged as a sensor does, then encoded to
sRGB.
"""

import numpy as np
from numpy.typing import NDArray

from decoder.camera import Camera
from phytac_design.optics.fill import fill
from phytac_design.optics.kernels import in_bands, kernel
from phytac_design.optics.light import triangle_light
from phytac_design.optics.paint import BACKGROUND, to_linear, to_srgb
from phytac_design.optics.raster import all_pieces, project_scene
from phytac_design.optics.rays import ray_grid
from phytac_design.optics.scene import Scene
from shapes.arrays import FloatArray, ImageArray

BAND_ROWS = 128
LEVELS = 4096
"""Steps of the table that encodes linear light."""


def render_frame(
    scene: Scene,
    camera: Camera,
    *,
    noise_std: float = 0.0,
    rng: np.random.Generator | None = None,
    samples: int = 8,
) -> ImageArray:
    """Anti-aliased 8-bit frame (h, w, 3), BGR.

    Parameters
    ----------
    noise_std : float
        Standard deviation of the sensor noise, grey levels; needs ``rng`` if not 0.
    samples : int
        Samples per pixel, see ``sample_offsets``.
    """
    view = project_scene(scene, camera)
    chosen, offsets = all_pieces(view), sample_offsets(samples)
    bent = view.rays.shape[0] > 0
    light = np.concatenate([triangle_light(scene, camera), to_linear(np.array([BACKGROUND]))])
    light = light[:, ::-1].astype(np.float32)
    encode = to_srgb(np.arange(LEVELS) / (LEVELS - 1.0)).astype(np.float32)
    frame = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.uint8)

    def band(first: int, last: int) -> None:
        owner = np.zeros((last - first, camera.width_px), dtype=np.int32)
        inverse = np.zeros(owner.shape)
        total = np.zeros((*owner.shape, 3), dtype=np.float32)
        for x, y in offsets:
            owner[:], inverse[:] = -1, 0.0
            here = view
            if bent:
                rays = ray_grid(camera.lens).rows(first, last, np.array([x, y]))
                here = view._replace(rays=rays, origin=np.array([0, first]))
            fill(here, chosen, (0, first, 1, float(x), float(y)), owner, inverse)
            _add(owner, light, total)
        _encode(total, encode, float(samples), frame[first:last])

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


def sample_offsets(count: int) -> FloatArray:
    """Offsets (count, 2) of the samples in a pixel, px, in [-0.5, 0.5].

    Every sample has a column and a row of its own (n rooks, rows in the order of the golden
    ratio's multiples; 4 give the rotated grid): edges along the image's axes, which a square grid
    moves by half a pixel at once, move by 1 / count.
    """
    index = np.arange(count)
    golden = np.mod((index + 1) * (np.sqrt(5.0) - 1.0) / 2.0, 1.0)
    return (np.column_stack([index, golden.argsort().argsort()]) + 0.5) / count - 0.5


@kernel
def _add(owner: NDArray[np.int32], light: NDArray[np.float32], total: NDArray[np.float32]) -> None:
    """Add the light of each pixel's triangle; ``light[-1]`` is the background's, for index -1."""
    for row in range(owner.shape[0]):
        for column in range(owner.shape[1]):
            t = owner[row, column]
            for channel in range(3):
                total[row, column, channel] += light[t, channel]


@kernel
def _encode(
    total: NDArray[np.float32], encode: NDArray[np.float32], samples: float, frame: ImageArray
) -> None:
    """Write the mean of the samples as 8-bit sRGB."""
    scale = np.float32((len(encode) - 1) / samples)
    for row in range(frame.shape[0]):
        for column in range(frame.shape[1]):
            for channel in range(3):
                level = int(total[row, column, channel] * scale + np.float32(0.5))
                frame[row, column, channel] = np.uint8(encode[level] + np.float32(0.5))
