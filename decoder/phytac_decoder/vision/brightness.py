"""Dots of one colour, separated from the wall by brightness: white on dark, or black on light.

Such a frame is turned into one whose dots are pure blue, in proportion to how far they stand out
from the wall around them. Everything that reads paint by its chroma then works on it unchanged.
"""

import cv2
import numpy as np

from phytac_shapes.arrays import ImageArray

DOTS = {"white": cv2.MORPH_OPEN, "black": cv2.MORPH_CLOSE}
"""Paints that differ from the wall by brightness alone, and what takes them off a picture."""


def dots_as_paint(image_bgr: ImageArray, paint: str, *, width_share: float = 0.1) -> ImageArray:
    """Frame (h, w, 3) whose blue is the contrast of dots in grey levels, green and red 0.

    The wall's brightness under a dot is that of its surroundings: the morphological opening (for
    black dots the closing) by a square (Serra 1982, top-hat transform), of the picture made about
    640 px wide: the wall's brightness varies slowly.

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
    height, width = grey.shape
    factor = max(width // 640, 1)
    small = (max(width // factor, 1), max(height // factor, 1))
    coarse = cv2.resize(grey, small, interpolation=cv2.INTER_AREA) if factor > 1 else grey
    side = 2 * int(width_share * coarse.shape[1] / 2.0) + 1
    wall = cv2.morphologyEx(coarse, DOTS[paint], np.ones((side, side), dtype=np.uint8))
    if factor > 1:
        wall = cv2.resize(wall, (width, height), interpolation=cv2.INTER_LINEAR)
    contrast = cv2.subtract(grey, wall) if paint == "white" else cv2.subtract(wall, grey)
    nothing = np.zeros_like(contrast)
    return np.asarray(cv2.merge([contrast, nothing, nothing]))
