"""A camera frame of any lens, without OpenGL: the exact z-buffer, lit, alike on every machine.

Light is linear until the last step: sub-pixels are averaged as a sensor does, then encoded to
sRGB.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Lens, Perspective, Pinhole
from phytac_design.core.kernels import in_bands, kernel
from phytac_design.optics.edge_sampling import (
    Aperture,
    fill_edges,
    mark_blurred,
    mark_edges,
    number_edges,
    write_edges,
)
from phytac_design.optics.light import triangle_light
from phytac_design.optics.paint import BACKGROUND, to_linear, to_srgb
from phytac_design.optics.raster import project_scene
from phytac_design.optics.rays import ray_grid
from phytac_design.optics.render_scene import RenderScene
from phytac_design.optics.zbuffer import View, fill
from phytac_shapes.arrays import FloatArray, ImageArray

BAND_ROWS = 128
SAMPLES = 89
"""Of a pixel; of as many as a Fibonacci number the rows and columns are most even."""
EDGE_SAMPLES_MIN = 16
FOUR_FROM = 64
"""Samples from which on edges are searched with four samples a pixel; with one below."""
EDGE_LEVELS = 8.0
"""Difference of two shades, grey levels, from which on there is an edge between them.

With 1 shifts of centroids are 0.001 px closer to the exact ones, in 1.5 times the time. Paint that
a decoder finds differs from what surrounds it by more.
"""


def render_frame(
    scene: RenderScene,
    camera: Camera,
    *,
    noise_std: float = 0.0,
    rng: np.random.Generator | None = None,
    samples: int = SAMPLES,
) -> ImageArray:
    """Anti-aliased 8-bit frame (h, w, 3), BGR.

    Parameters
    ----------
    noise_std : float
        Standard deviation of the sensor noise, grey levels; needs ``rng`` if not 0.
    samples : int
        Samples per pixel, see ``render_light``.
    """
    levels = 4096  # steps of the table that encodes linear light
    light = render_light(scene, camera, samples=samples)
    encode = to_srgb(np.arange(levels) / (levels - 1.0)).astype(np.float32)
    table = (encode + np.float32(0.5)).astype(np.uint8)
    frame = np.empty(light.shape, dtype=np.uint8)

    def band(first: int, last: int) -> None:
        _encode(light[first:last], table, frame[first:last])

    in_bands(band, camera.height_px, band_rows=BAND_ROWS)
    if noise_std > 0.0:
        if rng is None:
            raise ValueError("render_frame: noise_std > 0 needs a random generator; pass rng=...")
        frame = add_noise(frame, noise_std, rng)
    return frame


@kernel
def _encode(light: NDArray[np.float32], table: NDArray[np.uint8], frame: ImageArray) -> None:
    """Write light from 0 to 1 (h, w, 3) by a table of as many steps as it has entries."""
    last = np.float32(len(table) - 1)
    for row in range(light.shape[0]):
        for column in range(light.shape[1]):
            for channel in range(3):
                level = np.float32(light[row, column, channel] * last)
                frame[row, column, channel] = table[int(level + np.float32(0.5))]


def quick_samples(camera: Camera) -> int:
    """Samples per pixel of frames that are rendered only to be decoded.

    Of large images 34 in place of 89: shifts of centroids are off by 0.011 px RMS in place of 0.006
    (``cylinder60``, 5 megapixels), in 0.6 times the time.
    """
    large_px = 2e6
    return 34 if camera.width_px * camera.height_px >= large_px else SAMPLES


def render_light(
    scene: RenderScene,
    camera: Camera,
    *,
    light: FloatArray | None = None,
    lens_mm: FloatArray | None = None,
    focus_mm: float = np.inf,
    samples: int = SAMPLES,
) -> NDArray[np.float32]:
    """Linear light (h, w, 3) on the pixels, BGR: the mean over each pixel's area and the lens.

    ``samples`` are taken where light changes between neighbouring pixels, as far as that is
    blurred, and 4 elsewhere (1 with fewer than 64). A sharp lens with fewer than 16 has them in
    every pixel.

    Parameters
    ----------
    light : (T, 3) float, optional
        Linear RGB that each triangle sends to the camera; ``triangle_light`` by default.
    lens_mm : (samples, 2) float, optional
        Points of the aperture, camera x and y, that the samples of each pixel look through; its
        centre (a lens that is sharp everywhere) by default.
    focus_mm : float
        Distance of sharp focus: camera z for lenses that image planes sharply, distance from the
        camera's centre for wide ones.
    samples : int
        Samples per pixel. Shifts of the markers' centroids on ``cylinder60`` (example ``handle``)
        are off by 0.006 (0.010) px with 89 and by 0.022 (0.033) px with 8.
    """
    sent = triangle_light(scene, camera) if light is None else light
    # The last row is the background's.
    rows: NDArray[np.float32] = np.concatenate([sent, to_linear(np.array([BACKGROUND]))])[
        :, ::-1
    ].astype(np.float32)
    total = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.float32)
    if lens_mm is not None or samples >= EDGE_SAMPLES_MIN:
        points = np.zeros((samples, 2)) if lens_mm is None else lens_mm
        _look_at_edges(scene, camera, rows, points, focus_mm, total)
        return total
    view = project_scene(scene, camera)
    extent = row_extent(view)
    for offset in sample_offsets(samples):
        _look(view, extent, camera, offset, rows, total)
    total /= np.float32(samples)
    return total


def _finer(camera: Camera, side: int) -> Camera:
    """The same with ``side`` by ``side`` pixels in place of each."""
    lens = camera.lens
    return replace(
        camera,
        lens=replace(
            lens,
            width_px=side * lens.width_px,
            height_px=side * lens.height_px,
            fx_px=side * lens.fx_px,
            fy_px=side * lens.fy_px,
            cx_px=side * (lens.cx_px + 0.5) - 0.5,
            cy_px=side * (lens.cy_px + 0.5) - 0.5,
        ),
    )


def row_extent(view: View) -> tuple[FloatArray, FloatArray]:
    """First and last row of the image that each piece may reach, px."""
    a, b, c = view.image[:, :, 1].T
    low = np.minimum(np.minimum(a, b), c) - view.bulge
    return low, np.maximum(np.maximum(a, b), c) + view.bulge


def _look(
    view: View,
    extent: tuple[FloatArray, FloatArray],
    camera: Camera,
    offset: FloatArray,
    light: NDArray[np.float32],
    total: NDArray[np.float32],
) -> None:
    """Add what every pixel sees, moved by ``offset`` (2,) px, to ``total``.

    ``extent`` is that of :func:`row_extent`.
    """

    def band(first: int, last: int) -> None:
        owner, _ = _owners(view, extent, camera, first, last, offset, 1)
        _add(owner, light, 1, total[first:last])

    in_bands(band, len(total), band_rows=BAND_ROWS)


def _owners(
    view: View,
    extent: tuple[FloatArray, FloatArray],
    camera: Camera,
    first: int,
    last: int,
    offset: FloatArray,
    side: int,
) -> tuple[NDArray[np.int32], FloatArray]:
    """Return the triangle of every pixel of a camera that is ``side`` times as fine, -1 for none.

    ``first`` and ``last`` are rows of the image, ``offset`` (2,) in its pixels. The second array
    holds the inverse depths.
    """
    x, y = side * float(offset[0]), side * float(offset[1])
    low, high = extent
    top, bottom = side * first, side * last
    owner = np.full((bottom - top, camera.width_px), -1, dtype=np.int32)
    inverse = np.zeros(owner.shape)
    here = view
    if view.rays.shape[0] > 0:
        rays = ray_grid(camera.lens).rows(first, last, offset)
        here = view._replace(rays=rays, origin=np.array([0, first]))
    met = (high >= top - side) & (low <= bottom + side)
    chosen = np.flatnonzero(met).astype(np.int32)
    fill(here, chosen, (0, top, 1, x, y), owner, inverse)
    if here.rays.shape[0] > 0 and isinstance(camera.lens, Perspective):
        inverse /= here.rays[..., 2]  # of depths, not distances
    return owner, inverse


def _look_at_edges(
    scene: RenderScene,
    camera: Camera,
    light: NDArray[np.float32],
    points_mm: FloatArray,
    focus_mm: float,
    total: NDArray[np.float32],
) -> None:
    """Write the light of all pixels to ``total``: many samples on edges, four or one elsewhere.

    Of each pixel on or near an edge there are as many samples as ``points_mm`` (s, 2) of the lens.
    """
    samples = len(points_mm)
    side = 2 if samples >= FOUR_FROM else 1
    shade = to_srgb(light.astype(np.float64)).astype(np.float32)
    straight = isinstance(camera.lens, Pinhole)
    view = project_scene(scene, camera)
    finer = _finer(camera, side) if straight else camera
    coarse = project_scene(scene, finer) if straight and side > 1 else view
    coarse_extent = row_extent(coarse)
    offsets = np.column_stack([sample_offsets(samples), points_mm]).T.astype(np.float32).copy()
    radius = float(np.linalg.norm(points_mm, axis=1).max())
    aperture = Aperture(1.0 / focus_mm, radius, isinstance(camera.lens, Perspective))
    scale = _px_per_radian(camera.lens)
    blur = _blur_px(view, aperture, scale)
    view = view._replace(bulge=view.bulge + blur)
    blurred_extent = row_extent(view)
    # Edges between a band and the rows around it, and the blur of those, mark pixels in it.
    reach = 1 + int(np.ceil(blur.max(initial=0.0)))

    def owners(first: int, last: int) -> tuple[NDArray[np.int32], FloatArray]:
        if straight:
            return _owners(coarse, coarse_extent, finer, first, last, np.zeros(2), side)
        out = np.empty((side * (last - first), side * camera.width_px), dtype=np.int32)
        inverse = np.empty(out.shape)
        for number, place in enumerate(sample_lattice(side)):
            down, right = number % side, number // side
            own = _owners(coarse, coarse_extent, finer, first, last, place, 1)
            out[down::side, right::side], inverse[down::side, right::side] = own
        return out, inverse

    def band(first: int, last: int) -> None:
        begin, end = max(first - reach, 0), min(last + reach, camera.height_px)
        owner, inverse = owners(begin, end)
        edge = np.zeros((end - begin, camera.width_px), dtype=np.bool_)
        mark_edges(owner, shade, side, EDGE_LEVELS, edge)
        if radius > 0.0:
            sharp = edge.copy()
            mark_blurred(sharp, inverse, aperture, scale, edge)
        inner = slice(first - begin, last - begin)
        _add(owner[side * inner.start : side * inner.stop], light, side, total[first:last])
        total[first:last] /= np.float32(side**2)
        slot = np.empty((last - first, camera.width_px), dtype=np.int32)
        fine = np.full((number_edges(edge[inner], slot), samples), -1, dtype=np.int32)
        here = view
        if not straight:
            rays = ray_grid(camera.lens).rows(begin, end, np.zeros(2))
            here = view._replace(rays=rays, origin=np.array([0, begin]))
        met = (blurred_extent[1] >= first - 1) & (blurred_extent[0] <= last)
        chosen = np.flatnonzero(met).astype(np.int32)
        nearest = np.zeros(fine.shape, dtype=np.float32)
        fill_edges(here, chosen, first, slot, offsets, aperture, fine, nearest)
        write_edges(fine, light, slot, total[first:last])

    in_bands(band, camera.height_px, band_rows=BAND_ROWS // side)


def _px_per_radian(lens: Lens) -> float:
    """Return the largest number of pixels that a turn of a radian moves a point by, from above."""
    if isinstance(lens, Pinhole):  # Depth, not distance, counts here.
        return max(lens.fx_px, lens.fy_px)
    spacing, slack = 16, 1.05  # px between the places tried, and for what lies between them
    x, y = np.meshgrid(np.arange(0, lens.width_px, spacing), np.arange(0, lens.height_px, spacing))
    rays = lens.unproject(np.column_stack([x.ravel(), y.ravel()]).astype(np.float64))
    rays = rays[np.isfinite(rays).all(axis=1)]
    return slack * float(np.linalg.norm(lens.jacobian(rays), ord=2, axis=(1, 2)).max())


def _blur_px(view: View, aperture: Aperture, px_per_radian: float) -> FloatArray:
    """Largest blur (P,) of each piece, px from its sharp outline."""
    if aperture.radius_mm == 0.0:
        return np.zeros(len(view.source))
    corners = view.camera[view.triangles]
    away = corners[..., 2] if aperture.flat else np.linalg.norm(corners, axis=2)
    off = np.abs(1.0 / away - aperture.per_focus).max(axis=1)
    return np.asarray(aperture.radius_mm * px_per_radian * off)


def add_noise(image: ImageArray, std: float, rng: np.random.Generator) -> ImageArray:
    """Image with independent Gaussian noise of ``std`` grey levels on every channel, rounded.

    A grey level is a whole number, so that the noise can be rounded before it is added: it is
    drawn from a table of 65,536 quantiles, in a third of the time, and ends at 4.3 ``std``.
    """
    draws = 2**16
    table = np.rint(std * ndtri((np.arange(draws) + 0.5) / draws)).astype(np.int16)
    noise = table[rng.integers(0, draws, size=image.shape, dtype=np.uint16)]
    noisy: ImageArray = cv2.add(image, noise, dtype=cv2.CV_8U)  # saturated
    return noisy


def sample_offsets(count: int) -> FloatArray:
    """Offsets (count, 2) of single samples in a pixel, px, in [-0.5, 0.5].

    Every sample has a column and a row of its own (n rooks, rows in the order of the golden
    ratio's multiples; 4 give the rotated grid): edges along the image's axes, which a square grid
    moves by half a pixel at once, move by 1 / count.
    """
    index = np.arange(count)
    golden = np.mod((index + 1) * (np.sqrt(5.0) - 1.0) / 2.0, 1.0)
    return (np.column_stack([index, golden.argsort().argsort()]) + 0.5) / count - 0.5


def sample_lattice(side: int) -> FloatArray:
    """Offsets (side², 2) of an even lattice in a pixel, px."""
    line = (np.arange(side) + 0.5) / side - 0.5
    return np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)


@kernel
def _add(
    owner: NDArray[np.int32],
    light: NDArray[np.float32],
    side: int,
    total: NDArray[np.float32],
) -> None:
    """Add the light of each pixel's triangles; ``light[-1]`` is the background's, for index -1."""
    for row in range(total.shape[0]):
        for column in range(total.shape[1]):
            last, times = owner[side * row, side * column], 0
            for down in range(side):
                for right in range(side):
                    t = owner[side * row + down, side * column + right]
                    if t != last:
                        for channel in range(3):
                            total[row, column, channel] += times * light[last, channel]
                        last, times = t, 0
                    times += 1
            for channel in range(3):
                total[row, column, channel] += times * light[last, channel]
