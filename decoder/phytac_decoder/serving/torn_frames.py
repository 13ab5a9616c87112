"""Torn and repeated frames: partly or wholly the frame before, by a fault of cable or camera.

A camera's noise changes nearly every row of an image. Rows that used to change and are now equal to
the last bit were not taken again.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from phytac_decoder.io.frame import Frame
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.sensor_loop import Decode
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray


class TornFrameDetector:
    """Compares each frame of a sequence with the one before.

    Rows without noise, as in drawings, black borders and still parts of compressed videos, are not
    evaluated.
    """

    rows_compared, band_px = 32, 640
    """Rows of an image that are compared, evenly spaced, and the pixels of each."""
    changed_share_min = 0.2
    """Least share of a row's bytes that noise changes from frame to frame."""
    frames_changed_min = 3
    """Only rows that have changed in so many sound frames in a row are evaluated."""

    def __init__(self) -> None:
        self._last: list[ImageArray] = []
        self._streak: list[IntArray] = []

    def check(self, images: Sequence[ImageArray]) -> list[str]:
        """Reasons to distrust the next frame, of each camera (h, w, 3); empty for a sound one."""
        rows = [_rows_of(image) for image in images]
        if [part.shape for part in rows] != [part.shape for part in self._last]:
            self._last, self._streak = rows, [np.zeros(len(part), dtype=np.int64) for part in rows]
            return []
        out = []
        for number, (now, before) in enumerate(zip(rows, self._last, strict=True)):
            share, streak = _changed(now, before), self._streak[number]
            text = _verdict(share[streak >= self.frames_changed_min])
            if text:
                out.append(text)
            else:
                self._streak[number] = np.where(share >= self.changed_share_min, streak + 1, 0)
        self._last = rows
        return out


def with_torn_frame_check(decode: Decode) -> Decode:
    """Decode frames in their order, with a warning on those that are torn."""
    detector = TornFrameDetector()

    def watching(frame: Frame) -> Reading:
        torn = detector.check(frame.images)
        reading = decode(frame)
        return replace(reading, warnings=[*reading.warnings, *torn]) if torn else reading

    return watching


def _rows_of(image: ImageArray) -> ImageArray:
    """Parts of some of an image's rows, copied because cameras may reuse their buffers."""
    rows, band_px = TornFrameDetector.rows_compared, TornFrameDetector.band_px
    index = np.unique(np.linspace(0, len(image) - 1, rows).astype(np.int64))
    first = max(image.shape[1] - band_px, 0) // 4
    return np.asarray(image[index, first : first + band_px])


def _changed(rows: ImageArray, before: ImageArray) -> FloatArray:
    """Share (r,) of each row's bytes that differ."""
    flat = rows.reshape(len(rows), -1)
    differ = np.count_nonzero(flat != before.reshape(len(rows), -1), axis=1)
    return np.asarray(differ / flat.shape[1])


def _verdict(share: FloatArray) -> str:
    """Fault by the changed share (r,) of rows that used to change; "" for none."""
    old, new = share == 0.0, share >= TornFrameDetector.changed_share_min
    if not old.any():
        return ""
    if old.all():
        return (
            "the frame is the one before to the last bit: its forces are old; has the camera "
            "stopped?"
        )
    # Old above and new below, or the other way round; the cut may go through a row.
    cuts = np.flatnonzero(old[1:] != old[:-1])
    if len(cuts) != 1 or np.count_nonzero(~old & ~new) > 1 or not new.any():
        return ""
    part = "upper" if old[0] else "lower"
    return (
        f"the {part} {100.0 * float(old.mean()):.0f} % of the frame are those of the one before: "
        "it is torn, and its forces are of two moments; check the cable and the camera's rate"
    )
