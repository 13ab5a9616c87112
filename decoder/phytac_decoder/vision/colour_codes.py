"""Colours of frames as numbers, and how much paint each number is."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_decoder.vision.segmentation import HUE_COSINE_MIN, ColourModel
from phytac_shapes.arrays import ImageArray

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
    painted = (picked >= HUE_COSINE_MIN * size) & (picked >= model.floor * full[best])
    shares = [
        np.where(painted & (best == paint), model.coverage(flat, paint), 0.0)
        for paint in range(len(full))
    ]
    return np.asarray(shares, dtype=np.float32)


class Converter:
    """Codes of as many pixels as it has been made for, and fewer.

    Parameters
    ----------
    most : int
        Most pixels at once.
    """

    def __init__(self, most: int) -> None:
        # Long rows: OpenCV's vector instructions leave the end of each row to slower ones.
        self._tones = np.zeros((1, most, 3), dtype=np.uint8)
        self._planes = [np.zeros((1, most), dtype=np.uint8) for _ in range(3)]
        self._chroma = np.zeros((1, most, 2), dtype=np.uint8)

    def part(self, count: int, out: ImageArray | None = None) -> "Conversion":
        """What converts ``count`` pixels, into ``out`` (1, count, 2) or room of its own."""
        chroma = self._chroma[:, :count] if out is None else out
        return Conversion(
            self._tones[:, :count],
            [plane[:, :count] for plane in self._planes],
            chroma,
            chroma.view(np.uint16)[:, :, 0],
        )


class Conversion(NamedTuple):
    """Room for a number of pixels on their way to codes; ``codes`` (1, count) is the result."""

    tones: ImageArray
    planes: list[ImageArray]
    chroma: ImageArray
    codes: Codes16

    def run(self, pixels: ImageArray) -> Codes16:
        """Codes of pixels (1, count, 3), BGR."""
        cv2.cvtColor(pixels, cv2.COLOR_BGR2YCrCb, dst=self.tones)
        cv2.split(self.tones, self.planes)
        # Cb first: the low byte.
        cv2.merge([self.planes[2], self.planes[1]], self.chroma)
        return self.codes


class Picture:
    """A camera's frame as windows look at it: whole as codes, or as it is.

    Codes of a whole frame are read in the order of memory, and in few calls; where windows cover
    little of it, they turn their own pixels into codes.

    Parameters
    ----------
    size_px : (int, int)
        Width and height of the frames.

    Attributes
    ----------
    whole : bool
        Whether frames are turned into codes as a whole, from the next one on.
    codes : (h, w) uint16
        Of the frame that was read last, if so: Cr · 256 + Cb.
    frame : (h, w, 3) uint8
        That frame.
    """

    def __init__(self, size_px: tuple[int, int]) -> None:
        width, height = size_px
        count = width * height
        chroma = np.zeros((1, count, 2), dtype=np.uint8)
        step = min(BAND_px, count)
        room = Converter(step)
        parts = [slice(start, min(start + step, count)) for start in range(0, count, step)]
        self._bands = [(part, room.part(part.stop - part.start, chroma[:, part])) for part in parts]
        self.whole = True
        self.codes: Codes16 = chroma.view(np.uint16).reshape(height, width)
        self.frame: ImageArray = np.zeros((height, width, 3), dtype=np.uint8)

    def read(self, frame: ImageArray) -> None:
        """Take a frame (h, w, 3) uint8, BGR, in one piece of memory."""
        self.frame = frame
        if self.whole:
            pixels = frame.reshape(1, -1, 3)
            for part, conversion in self._bands:
                conversion.run(pixels[:, part])
