"""A new rest frame while a stream runs, as a scale's tare: what presses then counts as nothing."""

import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.frame import Frame
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.pipeline.rest_frames import check_at_rest
from phytac_decoder.serving.sensor_loop import Decode
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import InputError, PhytacError

FRAMES = 10
"""Frames whose mean is the new rest frame."""


class TareDecoder:
    """Decodes frames, and takes the next ones as those of the unloaded sensor when asked to.

    While they are taken, and if they cannot be used, frames are decoded as before.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder, not calibrated to a rest frame.
    decode : callable
        Decodes until then.
    make : callable
        ``make(calibrated bundle, rest frames)`` gives what decodes from then on.
    """

    def __init__(
        self,
        bundle: Bundle,
        decode: Decode,
        make: Callable[[Bundle, Sequence[ImageArray]], Decode],
    ) -> None:
        self._bundle, self._decode, self._make = bundle, decode, make
        self._asked, self._taken = threading.Event(), list[tuple[ImageArray, ...]]()
        self._sum: list[NDArray[np.uint32]] = []
        self._count = 0
        self._result: dict[str, Any] | None = None

    def tare(self) -> None:
        """Ask for a new rest frame of the next frames; from any thread."""
        self._asked.set()

    def result(self) -> dict[str, Any] | None:
        """How the last tare ended, once: ``done``, else ``reason`` and ``code``; else None."""
        result, self._result = self._result, None
        return result

    def __call__(self, frame: Frame) -> Reading:
        """Decode a frame, see :data:`phytac_decoder.serving.sensor_loop.Decode`."""
        if self._asked.is_set():
            try:
                self._take(frame)
            except PhytacError as error:
                self._end({"done": False, "reason": str(error), "code": error.code})
        return self._decode(frame)

    def _take(self, frame: Frame) -> None:
        """Add a frame to the mean; the last one ends the tare."""
        images = tuple(frame.images)
        shapes = [image.shape for image in images]
        if not images or (self._sum and shapes != [part.shape for part in self._sum]):
            raise InputError(
                "rest-frame-missing",
                "the camera gave no picture while the rest frames were taken; ask again when it "
                "does",
            )
        self._sum = self._sum or [np.zeros(shape, dtype=np.uint32) for shape in shapes]
        self._sum = [part + image for part, image in zip(self._sum, images, strict=True)]
        self._taken = [*self._taken[:1], images]
        self._count += 1
        if self._count < FRAMES:
            return
        mean = [np.round(part / FRAMES).astype(np.uint8) for part in self._sum]
        calibrated = calibrate_rest(self._bundle, mean)
        check_at_rest(calibrated, self._taken[0], self._taken[-1])
        self._decode = self._make(calibrated, mean)
        self._end({"done": True})

    def _end(self, result: dict[str, Any]) -> None:
        self._asked.clear()
        self._taken, self._sum, self._count = [], [], 0
        self._result = result
