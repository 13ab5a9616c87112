"""A camera frame of any lens, without OpenGL: the exact z-buffer, lit, alike on every machine.

Light is linear until the last step: sub-pixels are averaged as a sensor does, then encoded to
sRGB.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decoder.camera import Camera
from decoder.lens import Perspective
from phytac_design.kernels import in_bands, kernel
from phytac_design.optics.fill import View, fill
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
    light = render_light(scene, camera, samples=samples)
    encode = to_srgb(np.arange(LEVELS) / (LEVELS - 1.0)).astype(np.float32)
    frame = np.zeros(light.shape, dtype=np.uint8)

    def band(first: int, last: int) -> None:
        _encode(light[first:last], encode, frame[first:last])

    in_bands(band, camera.height_px, band_rows=BAND_ROWS)
    if noise_std > 0.0:
        if rng is None:
            raise ValueError("render_frame: noise_std > 0 needs a random generator; pass rng=...")
        frame = add_noise(frame, noise_std, rng)
    return frame


def render_light(
    scene: Scene,
    camera: Camera,
    *,
    light: FloatArray | None = None,
    lens_mm: FloatArray | None = None,
    focus_mm: float = np.inf,
    samples: int = 8,
) -> NDArray[np.float32]:
    """Linear light (h, w, 3) on the pixels, BGR: the mean over each pixel's area and the lens.

    Parameters
    ----------
    light : (T, 3) float, optional
        Linear RGB that each triangle sends to the camera; ``triangle_light`` by default.
    lens_mm : (samples, 2) float, optional
        Points of the aperture, camera x and y, that the samples look through; its centre (a lens
        that is sharp everywhere) by default.
    focus_mm : float
        Distance of sharp focus: camera z for lenses that image planes sharply, distance from the
        camera's centre for wide ones.
    samples : int
        Samples per pixel, see ``sample_offsets``.
    """
    sent = triangle_light(scene, camera) if light is None else light
    # The last row is the background's.
    rows: NDArray[np.float32] = np.concatenate([sent, to_linear(np.array([BACKGROUND]))])[
        :, ::-1
    ].astype(np.float32)
    total = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.float32)
    points = np.zeros((samples, 2)) if lens_mm is None else lens_mm
    view = None
    for offset, point in zip(sample_offsets(samples), points, strict=True):
        if view is None or lens_mm is not None:
            view = project_scene(through_lens(scene, camera, point, focus_mm), camera)
            chosen = all_pieces(view)
        _look(view, chosen, camera, offset, rows, total)
    total /= np.float32(samples)
    return total


def through_lens(scene: Scene, camera: Camera, point_mm: FloatArray, focus_mm: float) -> Scene:
    """Scene as it appears through one point (2,) of the aperture, focused at ``focus_mm``.

    The ray from a lens point o to P meets the surface of sharp focus where the camera's centre
    sees ``P + o (z / focus - 1)``: a shear of space, which keeps planes and depths, and so all that
    hides what. For a lens that does not image planes sharply z is the distance, and the shear is
    that of the vertices.
    """
    if not np.any(point_mm):
        return scene
    seen = camera.to_camera(scene.vertices)
    flat = isinstance(camera.lens, Perspective)
    distance = seen[:, 2] if flat else np.linalg.norm(seen, axis=1)
    across = np.array([*point_mm, 0.0]) @ camera.rotation
    return replace(
        scene, vertices=scene.vertices + (distance / focus_mm - 1.0)[:, None] * across[None]
    )


def _look(
    view: View,
    chosen: NDArray[np.int32],
    camera: Camera,
    offset: FloatArray,
    light: NDArray[np.float32],
    total: NDArray[np.float32],
) -> None:
    """Add what one sample of every pixel sees to ``total``."""
    x, y = float(offset[0]), float(offset[1])
    bent = view.rays.shape[0] > 0

    def band(first: int, last: int) -> None:
        owner = np.full((last - first, camera.width_px), -1, dtype=np.int32)
        here = view
        if bent:
            rays = ray_grid(camera.lens).rows(first, last, offset)
            here = view._replace(rays=rays, origin=np.array([0, first]))
        fill(here, chosen, (0, first, 1, x, y), owner, np.zeros(owner.shape))
        _add(owner, light, total[first:last])

    in_bands(band, camera.height_px, band_rows=BAND_ROWS)


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
def _encode(light: NDArray[np.float32], encode: NDArray[np.float32], frame: ImageArray) -> None:
    """Write linear light as 8-bit sRGB."""
    scale = np.float32(len(encode) - 1)
    for row in range(frame.shape[0]):
        for column in range(frame.shape[1]):
            for channel in range(3):
                level = int(light[row, column, channel] * scale + np.float32(0.5))
                frame[row, column, channel] = np.uint8(encode[level] + np.float32(0.5))
