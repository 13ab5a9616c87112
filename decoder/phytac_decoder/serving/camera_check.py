"""What a running camera shows of a sensor, second by second, and what to change."""

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.frame import Frame
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import FOUND_WELL, locate_markers
from phytac_decoder.serving.exposure_monitor import ExposureMonitor
from phytac_decoder.vision.picture_quality import picture_quality
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError


@dataclass(frozen=True, kw_only=True)
class CheckLimits:
    """Limits beyond which something is to be changed.

    Attributes
    ----------
    blur_px : float
        Blur at the markers, unless they are so small that less is too much.
    clipped : float
        Share of clipped pixels around markers.
    dark : float
        Brightness of the pixels around markers, grey levels.
    motion_px : float
        Common motion of all markers between two frames.
    scatter : float
        Scatter of single markers between two frames, over the bundle's noise.
    rate : float
        Least share of the requested rate.
    lost : float
        Share of frames that could not be read.
    """

    blur_px: float = 2.0
    clipped: float = 0.01
    dark: float = 80.0
    motion_px: float = 0.2
    scatter: float = 3.0
    rate: float = 0.9
    lost: float = 0.01


class CameraCheck:
    """Checks the frames of a sensor that nothing presses, once a second.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    fps : float, optional
        Rate that the camera should have.
    limits : CheckLimits, optional
        What is good enough.
    """

    verdict_reports = 3
    """The verdict is on so many of the last reports."""

    def __init__(
        self, bundle: Bundle, *, fps: float | None = None, limits: CheckLimits | None = None
    ) -> None:
        self.bundle, self.fps, self.limits = bundle, fps, limits or CheckLimits()
        self._exposure = ExposureMonitor()
        self._lit: Bundle | None = None
        self._first: tuple[Frame, int] | None = None
        self._before: Frame | None = None
        self._changed: list[str] = []
        self._reports: deque[dict[str, Any]] = deque(maxlen=self.verdict_reports)

    def add(self, frame: Frame, *, lost: int = 0) -> dict[str, Any] | None:
        """Take the next frame; once a second a report on the frames since the one before.

        Parameters
        ----------
        frame : Frame
            Of the sensor without load.
        lost : int
            Frames so far that could not be read.

        Returns
        -------
        dict or None
            ``time_s``, ``fps``, ``cameras`` (of each ``blur_px``, ``blur_max_px``, ``brightness``,
            ``clipped``, ``chroma``, ``found``, ``markers``, ``motion_px``, ``scatter_px``) and
            ``change``: what to change, as sentences. Figures that cannot be measured are NaN.
        """
        if not frame.images:
            self._first = self._before = None
            text = f"no picture for {frame.gap_s:.1f} s: is the camera plugged in?"
            return self._keep({"time_s": frame.timestamp_s, "cameras": [], "change": [text]})
        self._changed += self._exposure.check(frame.images, frame.timestamp_s)
        first, lost_before = self._first or (frame, lost)
        self._first = first, lost_before
        before, self._before = self._before, frame
        elapsed_s = frame.timestamp_s - first.timestamp_s
        if before is None or 0.0 <= elapsed_s < 1.0:
            return None
        self._first = frame, lost
        gone = lost - lost_before
        rate = max(frame.number - first.number - gone, 0) / elapsed_s if elapsed_s > 0 else np.nan
        change = [*self._rate_faults(rate, gone, frame.number - first.number), *self._changed[-1:]]
        self._changed.clear()
        places, unread = self._located([frame.images, before.images])
        change += [f"markers not readable: {unread}"] if unread else []
        cameras = []
        for number, image in enumerate(frame.images):
            figures = self._figures(number, image, *places)
            cameras.append(figures)
            faults = self._faults(figures, unread=bool(unread))
            which = ("near camera ", "far camera ")[number] if len(frame.images) > 1 else ""
            change += [which + text for text in faults]
        return self._keep(
            {"time_s": frame.timestamp_s, "fps": rate, "cameras": cameras, "change": change}
        )

    def problems(self) -> list[str]:
        """What the last reports say is to be changed; empty if the camera is ready.

        Numbers differ from report to report: of each kind the latest sentence counts.
        """
        if not self._reports:
            return ["there were too few frames to check"]
        texts = [text for report in self._reports for text in report["change"]]
        return list({re.sub(r"[\d.]+", "", text): text for text in texts}.values())

    def _keep(self, report: dict[str, Any]) -> dict[str, Any]:
        self._reports.append(report)
        return report

    def _rate_faults(self, rate: float, gone: int, due: int) -> list[str]:
        out = []
        if self.fps and rate < self.limits.rate * self.fps:
            out.append(
                f"frame rate low: {rate:.1f} of {self.fps:g} fps; shorten the exposure, request "
                "MJPG (--control format=mjpg), or give the camera a USB port of its own"
            )
        if gone > self.limits.lost * max(due, 1):
            out.append(
                f"frames damaged: {gone} of {due}; use a shorter or better cable, and no hub"
            )
        return out

    def _located(self, frames: Sequence[Sequence[ImageArray]]) -> tuple[list[FloatArray], str]:
        """Positions (n, 2) px of the markers in each frame, and why there are none.

        Colours are measured again where those of before no longer find the markers.
        """
        try:
            if self._lit is None:
                self._lit = calibrate_rest(self.bundle, frames[0])
            # Reference marks, if any, come after the markers.
            count = len(self.bundle.colour)
            places = [locate_markers(self._lit, images)[0].position_px[:count] for images in frames]
        except InputError as error:
            self._lit = None
            return [np.full((len(self.bundle.colour), 2), np.nan)] * len(frames), str(error)
        if np.isfinite(places[0][:, 0]).mean() < FOUND_WELL:
            self._lit = None
        return places, ""

    def _figures(
        self, number: int, image: ImageArray, place_px: FloatArray, before_px: FloatArray
    ) -> dict[str, Any]:
        """Figures of one camera by the markers (n, 2) px in two frames."""
        own = self.bundle.read_by == number
        found = np.isfinite(place_px).all(axis=1) & own
        expected = self.bundle.shown_by(number).rest_px
        quality = picture_quality(image, np.where(found[:, None], place_px, expected)[own])
        step = (place_px - before_px)[found & np.isfinite(before_px).all(axis=1)]
        # NaN without a marker.
        step = step if len(step) else np.full((1, 2), np.nan)
        common = np.median(step, axis=0)
        paints = np.full((1, 2), np.nan)  # the design's own say nothing of this picture
        if self._lit:
            paints = self._lit.colours.chroma[np.unique(self.bundle.colour[own])]
        return {
            "blur_px": quality.blur_px,
            "blur_max_px": self._blur_max_px(number),
            "brightness": quality.brightness,
            "clipped": quality.clipped,
            "chroma": float(np.linalg.norm(paints, axis=1).min()),
            "found": int(found.sum()),
            "markers": int(own.sum()),
            "motion_px": float(np.hypot(*common)),
            # Median absolute deviation of a difference of two.
            "scatter_px": float(np.median(np.abs(step - common)) / 0.6745 / np.sqrt(2.0)),
        }

    def _blur_max_px(self, number: int) -> float:
        """Limit of the blur of one camera's frames."""
        focus = self._lit.focus[number] if self._lit else None
        return min(self.limits.blur_px, focus.limit_px if focus else np.inf)

    def _faults(self, figures: dict[str, Any], *, unread: bool) -> list[str]:
        limits, out = self.limits, []
        if not unread and figures["found"] < FOUND_WELL * figures["markers"]:
            out.append(
                f"markers missing: {figures['found']} of {figures['markers']} found; check light, "
                "focus and what stands before the camera"
            )
        if np.isnan(figures["blur_px"]) and figures["found"]:
            out.append(
                "focus unknown: no marker shows an edge that is sharp enough to measure; turn the "
                "lens, or set --control focus=N"
            )
        elif figures["blur_px"] > figures["blur_max_px"]:
            out.append(
                f"out of focus: edges are blurred by {figures['blur_px']:.1f} px (at most "
                f"{figures['blur_max_px']:.1f}); turn the lens, or set --control focus=N"
            )
        if figures["clipped"] > limits.clipped:
            out.append(
                f"overexposed: {100.0 * figures['clipped']:.0f} % of the pixels are clipped; "
                "shorten the exposure (--control exposure=N), lower the gain, or dim the light"
            )
        if figures["brightness"] < limits.dark:
            out.append(
                f"dark: grey level {figures['brightness']:.0f} (at least {limits.dark:g}); give "
                "more light, or a longer exposure (--control exposure=N)"
            )
        if figures["motion_px"] > limits.motion_px:
            out.append(
                f"moving: by {figures['motion_px']:.2f} px between two frames (at most "
                f"{limits.motion_px:g}); fasten the camera and the shell, and do not touch them"
            )
        scatter_px = limits.scatter * float(self.bundle.noise_centroid_px)
        if figures["scatter_px"] > scatter_px:
            out.append(
                f"noisy: markers scatter by {figures['scatter_px']:.2f} px (at most "
                f"{scatter_px:.2f}); give more light, less gain, and --control format=raw where "
                "the rate allows it"
            )
        return out
