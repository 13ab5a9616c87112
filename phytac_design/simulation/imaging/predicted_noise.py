"""Noise of markers' positions by design: in a few rendered frames of the sensor without forces."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.optics.frame_renderer import add_noise, quick_samples, render_frame
from phytac_design.optics.render_scene import RenderScene
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """Settings of the prediction, chosen on ``handle`` and ``hemisphere``."""

    frames: int = 3
    """Frames at rest, and through a turned camera."""
    turn_px: float = 0.5
    """Largest shift of the image's middle by a turn: a marker then lies anywhere on the pixels."""
    neighbours_weight: float = 8.0
    """Weight of the mean variance of neighbouring markers, in frames of a marker's own."""
    least_px: float = 2e-3


SETTINGS = NoiseSettings()


def predict_noise(
    scene: RenderScene,
    camera: Camera,
    detect: Callable[[ImageArray], FloatArray],
    *,
    clean: ImageArray,
    point_mm: FloatArray,
    neighbours: IntArray,
    noise_std: float,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Return standard deviations (n, 2) px of shifts that are zero, and what motion adds.

    See :class:`phytac_decoder.estimation.contact_fit.PredictedNoise`; NaN for markers that are not
    found.

    Parameters
    ----------
    detect : callable
        Positions (n, 2) px of markers in a frame; NaN where not found.
    clean : (h, w, 3) uint8
        Noise-free frame of the scene in the camera.
    point_mm : (n, 3) float
        Points whose images the positions are.
    noise_std : float
        Noise of a pixel, grey levels.
    """

    def noisy(frame: ImageArray) -> FloatArray:
        return detect(add_noise(frame, noise_std, rng))

    still = np.stack([noisy(clean) for _ in range(SETTINGS.frames)])
    turned, samples = [], quick_samples(camera)  # as frames that are decoded
    for _ in range(SETTINGS.frames):
        angles = rng.uniform(-1.0, 1.0, 3) * SETTINGS.turn_px / camera.lens.fx_px
        other = replace(camera, rotation=camera.rotation @ cv2.Rodrigues(angles)[0].T)
        moved = other.project(point_mm) - camera.project(point_mm)
        turned.append(
            noisy(render_frame(scene, other, samples=samples)) - still.mean(axis=0) - moved
        )
    single = _smooth(still.var(axis=0, ddof=1), neighbours)
    both = _smooth(np.mean(np.square(turned), axis=0), neighbours)
    added = np.maximum(both - (1.0 + 1.0 / SETTINGS.frames) * single, 0.0)
    # A shift is the difference of two positions.
    least = SETTINGS.least_px**2
    return np.sqrt(2.0 * single + least), np.sqrt(added + least)


def _smooth(variance: FloatArray, neighbours: IntArray) -> FloatArray:
    """Return variances (n, 2) of few frames, pooled with those of neighbours."""
    each = variance.mean(axis=1)
    near = np.where(neighbours >= 0, each[neighbours], np.nan)
    own, weight = SETTINGS.frames, SETTINGS.neighbours_weight
    known = np.isfinite(near)
    mean = np.where(known, near, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    mean = np.where(known.any(axis=1), mean, each)
    return np.asarray((own * variance + weight * mean[:, None]) / (own + weight))
