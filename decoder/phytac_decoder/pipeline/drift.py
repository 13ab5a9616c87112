"""Slow motion of cameras while nothing is pressed: later frames are decoded relative to it.

A bracket that creeps, or a camera that warms up, leaves the mount's tolerance within minutes. In
idle frames the whole shift of the markers is motion of the cameras; its exponential moving average
is the reference about which the prior of later frames lies.
"""

from dataclasses import dataclass, replace

import numpy as np

from phytac_decoder.camera.camera_motion import MARKED, MOTION_UNKNOWNS
from phytac_decoder.estimation.locator import SETTINGS as LOCATOR_SETTINGS
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_decoder.pipeline.frame_reading import Reading, read
from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class DriftSettings:
    """When a frame is idle, and how fast the reference follows."""

    time_constant_s: float = 60.0
    """Lags a drift of 0.02 mm a minute by a fifth of the tolerance of a bench; cameras take some
    20 minutes to warm up. ``inf`` never follows."""
    chi2_max: float = 1.5
    """Largest reduced χ² of an idle frame less motion of the cameras."""
    pull_max: float = LOCATOR_SETTINGS.tentative_chi2_drop
    """Largest drop of χ² by a force of any sign on any one marker of an idle frame: so small a
    force is not fitted as a contact either."""


class DriftReference:
    """Decodes measured frames of one sensor relative to the slow motion of its cameras.

    Where reference marks show the motion of each frame, there is nothing to follow.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    settings : DriftSettings, optional
        When to follow, and how fast.

    Attributes
    ----------
    motion : (q,) float
        The reference: motion of the cameras since the rest frame, without light, at most as far as
        its shifts are exact (``MARKED``).
    """

    def __init__(self, bundle: Bundle, settings: DriftSettings | None = None) -> None:
        self.settings = settings or DriftSettings()
        camera = bundle.model.camera_motion
        self.motion = np.zeros(camera.motions if camera else 0)
        self._bundle, self._last_s = bundle, np.inf

    def read(
        self,
        measured: FrameMeasurement,
        estimator: str,
        timestamp_s: float,
        *,
        before: Reading | None = None,
    ) -> Reading:
        """Decode a measured frame, see :func:`phytac_decoder.pipeline.frame_reading.read`."""
        if measured.marked is None and self.motion.any():
            shift = self._bundle.model.without_motion(measured.shift_px, self.motion)
            measured = replace(measured, shift_px=shift)
        reading = read(self._bundle, measured, estimator, before=before)
        elapsed = max(timestamp_s - self._last_s, 0.0)
        self._last_s = timestamp_s
        share = -np.expm1(-elapsed / self.settings.time_constant_s)
        if share > 0.0 and measured.marked is None:
            self._follow(measured, reading, share)
        return reading

    def _follow(self, measured: FrameMeasurement, reading: Reading, share: float) -> None:
        """Move the reference by a share of the motion of this frame, if nothing is pressed."""
        model, found = self._bundle.model, reading.found
        pressed = len(reading.koi) or (found is not None and found.contacts)
        if not reading.valid or pressed or not len(self.motion):
            return
        motion = found.motion if found else model.motion(measured.shift_px, reading.koi)
        if self._unexplained(model.without_motion(measured.shift_px, motion)):
            return
        limit = np.tile(MARKED.sd, len(self.motion) // MOTION_UNKNOWNS)
        moved = self.motion + share * motion[: len(self.motion)]
        self.motion = np.clip(moved, -limit, limit)

    def _unexplained(self, left_px: FloatArray) -> bool:
        """Return whether shifts (n, 2) px, less motion of the cameras, are more than noise."""
        model = self._bundle.model
        left = left_px.reshape(-1)
        sd = model.locator.noise.each_px if model.locator else model.noise_px
        inverse = np.isfinite(left) / np.square(sd)
        weighted = inverse * np.nan_to_num(left)
        chi2 = float(weighted @ np.nan_to_num(left)) / max(int(np.count_nonzero(inverse)), 1)
        rows = model.patterns[0]
        pull = np.square(rows @ weighted) / np.maximum(np.square(rows) @ inverse, 1e-300)
        return chi2 > self.settings.chi2_max or float(pull.max()) > self.settings.pull_max
