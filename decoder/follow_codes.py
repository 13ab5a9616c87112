"""Colours of frames as numbers, and how much paint each number is."""

import cv2
import numpy as np
from numpy.typing import NDArray

from decoder.segmentation import COSINE_MIN, ColourModel
from shapes.arrays import ImageArray

Floats32 = NDArray[np.float32]
Codes16 = NDArray[np.uint16]

COUNT = 1 << 16
"""Codes there are."""
BAND_px = 1 << 19
"""Most pixels that are read at once: what is written must still be in the cache when it is read."""


def coverage_tables(model: ColourModel) -> Floats32:
    """Coverage (k, 65536) by each paint of a model, over Cr · 256 + Cb; 0 in other classes."""
    flat = np.arange(COUNT, dtype=np.uint16)
    plane = np.stack([flat >> 8, flat & 255], axis=-1) - 128.0
    full = np.linalg.norm(model.chroma, axis=1)
    along = plane @ (model.chroma / full[:, None]).T
    size = np.linalg.norm(plane, axis=1)
    best = np.argmax(along / np.maximum(size, 1e-9)[:, None], axis=1)
    picked = along[np.arange(COUNT), best]
    painted = (picked >= COSINE_MIN * size) & (picked >= model.floor * full[best])
    shares = [
        np.where(painted & (best == paint), model.coverage(flat, paint), 0.0)
        for paint in range(len(full))
    ]
    return np.asarray(shares, dtype=np.float32)


class Codes:
    """The chroma of frames of one camera, as the numbers that :func:`coverage_tables` go by.

    A whole frame is read at once: in the order of memory, and in four calls. Windows that cover
    half of it would take as long, out of order, and far more calls.

    Parameters
    ----------
    size_px : (int, int)
        Width and height of the frames.

    Attributes
    ----------
    codes : (h, w) uint16
        Of the frame that was read last: Cr · 256 + Cb.
    """

    def __init__(self, size_px: tuple[int, int]) -> None:
        width, height = size_px
        # Long rows: OpenCV's vector instructions leave the end of each row to slower ones.
        count = width * height
        tones = np.zeros((1, count, 3), dtype=np.uint8)
        chroma = np.zeros((1, count, 2), dtype=np.uint8)
        planes = [np.zeros((1, count), dtype=np.uint8) for _ in range(3)]
        step = min(BAND_px, count)
        self._bands: list[tuple[slice, list[ImageArray], ImageArray, ImageArray]] = []
        for start in range(0, count, step):
            part = slice(start, min(start + step, count))
            used = part.stop - start
            self._bands.append(
                (part, [plane[:, :used] for plane in planes], tones[:, :used], chroma[:, part])
            )
        self.codes: Codes16 = chroma.view(np.uint16).reshape(height, width)

    def read(self, frame: ImageArray) -> None:
        """Take the codes of a frame (h, w, 3) uint8, BGR, in one piece of memory."""
        pixels = frame.reshape(1, -1, 3)
        for part, planes, tones, chroma in self._bands:
            cv2.cvtColor(pixels[:, part], cv2.COLOR_BGR2YCrCb, dst=tones)
            cv2.split(tones, planes)
            # Cb first: the low byte.
            cv2.merge([planes[2], planes[1]], chroma)
