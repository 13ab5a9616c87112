"""Dots of one colour, told from the wall by brightness: white on dark, or black on light.

Such a frame is turned into one whose dots are pure blue, in proportion to how far they stand out
from the wall around them. Everything that reads paint by its chroma then works on it unchanged.
"""

import cv2
import numpy as np

from phytac_shapes.arrays import ImageArray

DOTS = {"white": cv2.MORPH_TOPHAT, "black": cv2.MORPH_BLACKHAT}
"""Paints that differ from the wall by brightness alone, and the transform that shows them."""


def dots_as_paint(image_bgr: ImageArray, paint: str, *, width_share: float = 0.1) -> ImageArray:
    """Frame (h, w, 3) whose blue is the contrast of dots in grey levels, green and red 0.

    The wall's brightness under a dot is that of its surroundings: the morphological opening (for
    black dots the closing) by a square (Serra 1982, top-hat transform).

    Parameters
    ----------
    image_bgr : (h, w, 3) uint8
        Camera frame.
    paint : str
        A key of ``DOTS``.
    width_share : float
        Side of the square over the width of the image. Dots must be narrower than this in one
        direction, and the wall must show within every such square.
    """
    grey = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY)
    side = 2 * int(width_share * grey.shape[1] / 2.0) + 1
    contrast = cv2.morphologyEx(grey, DOTS[paint], np.ones((side, side), dtype=np.uint8))
    nothing = np.zeros_like(contrast)
    return np.asarray(cv2.merge([contrast, nothing, nothing]))
