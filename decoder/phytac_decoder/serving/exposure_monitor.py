"""Brightness of whole pictures over time: automatic exposure, flicker, and changing light.

Automatic exposure scales all of a picture alike, which contacts and shadows of fingers do not. The
ratio between successive frames is the median over a grid of pixels that are neither dark nor
clipped.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from phytac_decoder.io.frame import Frame
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.sensor_loop import Decode
from phytac_shapes.arrays import FloatArray, ImageArray


@dataclass(frozen=True, kw_only=True)
class ExposureSettings:
    """What counts as a change of exposure.

    Attributes
    ----------
    window_s : float
        Time over which the brightness is compared: automatic exposure settles within it, daylight
        changes more slowly.
    change_max : float
        Largest relative change in that time without a warning.
    step_s : float
        Two successive frames are compared, then none until this time has passed: light that
        alternates from frame to frame is seen as well.
    grid : int
        Pixels along each side of the grid.
    usable : (float, float)
        Grey levels between which a pixel follows the exposure,
    pixels_min : int
        and the least number of such pixels.
    """

    window_s: float = 2.0
    change_max: float = 0.1
    step_s: float = 0.05
    grid: int = 48
    usable: tuple[float, float] = (16.0, 235.0)
    pixels_min: int = 100


class ExposureMonitor:
    """Compares the brightness of the frames of the last seconds.

    Parameters
    ----------
    settings : ExposureSettings, optional
        Limits.
    """

    def __init__(self, settings: ExposureSettings | None = None) -> None:
        self.settings = settings or ExposureSettings()
        self._last: list[FloatArray] = []
        self._past: deque[tuple[float, FloatArray]] = deque()
        self._found: list[str] = []
        self._second = False  # the frame that was compared last followed another at once

    def check(self, images: Sequence[ImageArray], time_s: float) -> list[str]:
        """Sentences on the brightness of the next frame of each camera; empty for a steady one.

        Parameters
        ----------
        images : sequence of (h, w, 3) uint8
            The frame.
        time_s : float
            When it was taken; earlier than the frame before where a recording begins again.
        """
        soon = bool(self._past) and 0.0 < time_s - self._past[-1][0] < self.settings.step_s
        if soon and self._second:
            return self._found
        self._second = soon
        now = [self._sample(image) for image in images]
        again = not self._past or time_s < self._past[-1][0]
        if again or [part.shape for part in now] != [part.shape for part in self._last]:
            self._past.clear()
            gain = np.zeros(len(now))
        else:
            steps = [self._step(*pair) for pair in zip(now, self._last, strict=True)]
            gain = self._past[-1][1] + np.array(steps)
        self._last = now
        self._past.append((time_s, gain))
        while self._past[0][0] < time_s - self.settings.window_s:
            self._past.popleft()
        change = np.expm1(np.ptp([gain for _, gain in self._past], axis=0))
        self._found = [
            f"the whole picture's brightness has changed by {100.0 * part:.0f} % within "
            f"{self.settings.window_s:g} s: exposure or gain is automatic, or the light flickers; "
            "lock them, light the sensor steadily, and take a new rest frame"
            for part in change
            if part > self.settings.change_max
        ]
        return self._found

    def _sample(self, image: ImageArray) -> FloatArray:
        """Levels (r, c) of green, which a grey picture has too, at a grid of pixels."""
        rows, columns = (max(size // self.settings.grid, 1) for size in image.shape[:2])
        return image[::rows, ::columns, 1].astype(np.float64)

    def _step(self, now: FloatArray, before: FloatArray) -> float:
        """Logarithm of the ratio of two frames' brightness; 0 where it cannot be measured."""
        low, high = self.settings.usable
        good = (np.minimum(now, before) >= low) & (np.maximum(now, before) <= high)
        if np.count_nonzero(good) < self.settings.pixels_min:
            return 0.0
        return float(np.median(np.log(now[good] / before[good])))


def with_exposure_check(decode: Decode) -> Decode:
    """Decode frames in their order, with a warning where the whole picture's brightness changes."""
    monitor = ExposureMonitor()

    def watching(frame: Frame) -> Reading:
        changed = monitor.check(frame.images, frame.timestamp_s)
        reading = decode(frame)
        return replace(reading, warnings=[*reading.warnings, *changed]) if changed else reading

    return watching
