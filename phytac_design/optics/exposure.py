"""A physical camera behind the linear light of a scene: lens, vignetting, electrons, 8 bits, JPEG.

Blur needs no filter: each of a pixel's samples looks through another point of the aperture
(Haeberli and Akeley 1990), so that occlusion is exact for every point of the lens.
Diffraction is a Gaussian of the Airy disc's core.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_design.core.kernels import in_bands
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import (
    BAND_ROWS,
    render_light,
    sample_offsets,
)
from phytac_design.optics.paint import to_linear, to_srgb
from phytac_design.optics.render_scene import RenderScene
from phytac_design.optics.sharpness import sharpness
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """How light becomes a frame.

    Attributes
    ----------
    lens_blur : bool
        Defocus by depth, and diffraction, of the design's lens; sharp everywhere if not.
    fall_off : bool
        The bar's light falls off along it and with the distance from it.
    vignetting : float
        Share of the light that is missing in the image's farthest corner.
    full_well_e : float
        Electrons of a white pixel, in each colour.
    read_noise_e : float
        Standard deviation of the read noise, electrons.
    noise_pixel : float or None
        Noise of a mid-grey pixel, grey levels, that shot and read noise are scaled to; None leaves
        them as the electrons have it.
    jpeg_quality : int
        Quality of JPEG compression (4:2:2, as cameras send it); 0 for none.
    """

    lens_blur: bool = True
    fall_off: bool = True
    vignetting: float = 0.1
    full_well_e: float = 10000.0
    read_noise_e: float = 3.0
    noise_pixel: float | None = None
    jpeg_quality: int = 0

    @property
    def noise_gain(self) -> float:
        """Factor on the noise of the electrons."""
        mid_grey = 128.0  # grey level whose noise ``noise_pixel`` is
        if self.noise_pixel is None:
            return 1.0
        light = float(to_linear(np.array(mid_grey)))
        step = float(np.diff(to_linear(np.array([mid_grey - 0.5, mid_grey + 0.5])))[0])
        noise_e = float(np.sqrt(light * self.full_well_e + self.read_noise_e**2))
        return self.noise_pixel * step * self.full_well_e / noise_e


CLEAN = Exposure(lens_blur=False, fall_off=False, vignetting=0.0, noise_pixel=0.0)
"""A camera without faults."""


@dataclass(frozen=True, kw_only=True)
class LensBlur:
    """Blur parameters of a lens.

    Attributes
    ----------
    aperture_mm : float
        Diameter.
    focus_mm : float
        Distance of sharp focus.
    diffraction_px : float
        Standard deviation of the diffraction's Gaussian.
    """

    aperture_mm: float
    focus_mm: float
    diffraction_px: float

    def points_mm(self, count: int) -> FloatArray:
        """Points (count, 2) of the aperture, spread evenly; as far out, on average, as a disc."""
        return self.aperture_mm / 2.0 * disc_points(count)


@cache
def disc_points(count: int) -> FloatArray:
    """Points (count, 2) of the unit disc on Vogel's spiral, with a disc's mean and variance.

    Each belongs to a sample of ``sample_offsets``; see :func:`_pair_evenly`.
    """
    if count == 1:
        return np.zeros((1, 2))
    if count == 2:  # Two cannot be spread alike in all directions, but in two.
        return np.array([[0.5, 0.5], [-0.5, -0.5]])
    return _pair_evenly(sample_offsets(count), _spiral(count))


def _spiral(count: int) -> FloatArray:
    """Points (count, 2) of the unit disc, spread evenly."""
    index = np.arange(count)
    turn = np.pi * (3.0 - np.sqrt(5.0)) * index
    radius = np.sqrt((index + 0.5) / count)
    points = radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    points -= points.mean(axis=0)
    # A uniform disc of radius 1 has variance 1/4 each way: whiten to exactly that.
    spread = np.linalg.cholesky(points.T @ points / count)
    return np.asarray(0.5 * np.linalg.solve(spread, points.T).T)


def _pair_evenly(offsets: FloatArray, points: FloatArray) -> FloatArray:
    """Points (n, 2) in the order in which they blur edges best.

    A sample meets an edge where its offset in the pixel and its point of the lens, times the blur,
    add up to. Across edges of eight directions, blurred by up to 3 px, the sums are to lie where
    those of many samples do: pairs are exchanged as long as that brings them closer.
    """
    blurs_px, directions, many = np.array([-3.0, -1.0, 1.0, 3.0]), 8, 1500
    rng = np.random.default_rng(0)
    angle = np.pi * np.arange(directions) / directions
    across = np.array([np.cos(angle), np.sin(angle)])

    def sums(offsets: FloatArray, points: FloatArray) -> FloatArray:
        return np.asarray(offsets @ across + blurs_px[:, None, None] * (points @ across))

    count = len(points)
    exact = sums(sample_offsets(many), rng.permutation(_spiral(many)))
    wanted = np.moveaxis(np.quantile(exact, (np.arange(count) + 0.5) / count, axis=1), 0, 1)

    def off(order: IntArray) -> float:
        return float(((np.sort(sums(offsets, points[order]), axis=1) - wanted) ** 2).sum())

    order = rng.permutation(count)
    least = off(order)
    for pair in rng.integers(0, count, (60 * min(count, 100), 2)):
        order[pair] = order[pair[::-1]]
        now = off(order)
        if now < least:
            least = now
        else:
            order[pair] = order[pair[::-1]]
    return points[order]


def lens_blur(sensor: Sensor, camera: Camera) -> LensBlur:
    """Blur of a design's lens, focused by ``sharpness`` for the nominal ``camera``.

    Raises
    ------
    DesignError
        If nothing is sharp.
    """
    # Standard deviation of the Gaussian nearest an Airy disc, over wavelength times f-number.
    airy = 0.42
    wavelength_um = 0.55  # green light, the middle of what colour cameras see
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    section = design.camera
    found = sharpness(section, camera, surface, markers)
    # At the near end of the depth of field a point is one pixel wide.
    wide = 1.0 / (1.0 / found.depth_near_mm - 1.0 / found.focus_mm)
    return LensBlur(
        aperture_mm=wide / section.focal_px,
        focus_mm=found.focus_mm,
        diffraction_px=airy * wavelength_um * section.f_number / section.pixel_um,
    )


def light_on_chip(
    scene: RenderScene,
    camera: Camera,
    *,
    light: FloatArray,
    blur: LensBlur | None,
    samples: int = 8,
) -> NDArray[np.float32]:
    """Linear light (h, w, 3), BGR, on the pixels behind the lens.

    Parameters
    ----------
    light : (T, 3) float
        Linear RGB of each triangle, of ``triangle_light``.
    blur : LensBlur or None
        None for a lens that is sharp everywhere.
    samples : int
        Samples per pixel, each through its own point of the lens.
    """
    if blur is None:
        return render_light(scene, camera, light=light, samples=samples)
    out = render_light(
        scene,
        camera,
        light=light,
        lens_mm=blur.points_mm(samples),
        focus_mm=blur.focus_mm,
        samples=samples,
    )
    if blur.diffraction_px > 0.0:
        cv2.GaussianBlur(out, (0, 0), blur.diffraction_px, dst=out)
    return out


def expose(
    light: NDArray[np.float32],
    camera: Camera,
    exposure: Exposure,
    *,
    brightness: float = 1.0,
    rng: np.random.Generator | None = None,
) -> ImageArray:
    """8-bit frame (h, w, 3), BGR, of the light on the chip.

    Noise is independent in every pixel and colour; a pixel holds ``full_well_e`` at white and no
    more.

    Parameters
    ----------
    light : (h, w, 3) float32
        See :func:`light_on_chip`; BGR.
    brightness : float
        Of the light, over that of the scene.
    rng : Generator, optional
        Draws the noise; none without.
    """
    darkest = 1e-4  # least light of vignetting, so that its law stays finite
    # Steps of the table that encodes linear light: a quarter of a grey level in the dark.
    levels = 1 << 14
    height, width = light.shape[:2]
    gain = exposure.noise_gain if rng is not None else 0.0
    table = np.rint(to_srgb(np.arange(levels) / (levels - 1.0))).astype(np.uint8)
    frame = np.zeros(light.shape, dtype=np.uint8)
    x, y = camera.centre_px
    corner = max(x, width - 1.0 - x) ** 2 + max(y, height - 1.0 - y) ** 2
    left = max(1.0 - exposure.vignetting, darkest)
    bend = (left**-0.5 - 1.0) / corner
    noise = None
    if rng is not None and gain > 0.0:
        noise = rng.standard_normal(light.shape, dtype=np.float32)
    share = gain / exposure.full_well_e
    # Variance of the light: shot noise is its own square, over the full well.
    shot, read = np.float32(share * gain), np.float32((share * exposure.read_noise_e) ** 2)
    across = (np.arange(width) - x) ** 2

    def band(first: int, last: int) -> None:
        down = (np.arange(last - first) - (y - first)) ** 2
        fall = 1.0 + bend * (across + down[:, None])
        value = light[first:last] * (brightness / (fall * fall)).astype(np.float32)[..., None]
        if noise is not None:
            value += np.sqrt(value * shot + read) * noise[first:last]
        np.clip(value, 0.0, 1.0, out=value)
        frame[first:last] = table[(value * np.float32(levels - 1) + np.float32(0.5)).astype(int)]

    in_bands(band, height, band_rows=BAND_ROWS)
    return compressed(frame, exposure.jpeg_quality) if exposure.jpeg_quality else frame


def compressed(frame: ImageArray, quality: int) -> ImageArray:
    """Frame after a JPEG round trip."""
    settings = [
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422,
    ]
    _, data = cv2.imencode(".jpg", frame, settings)
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
