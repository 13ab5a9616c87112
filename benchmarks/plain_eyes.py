"""What a user would write to find markers with OpenCV: the peer of the decoder's eyes."""

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from phytac_decoder.io.bundle import Bundle
from phytac_shapes.arrays import ImageArray


def plain_opencv(bundle: Bundle, frame: ImageArray) -> None:
    """What a user would write: three masks, labelling, optimal assignment."""
    ycc = cv2.cvtColor(frame, cv2.COLOR_BGR2YCrCb)
    for colour, chroma in enumerate(bundle.colours.chroma):
        low = np.clip(chroma + 128.0 - 45.0, 0, 255)
        high = np.clip(chroma + 128.0 + 45.0, 0, 255)
        mask = cv2.inRange(ycc, np.array([0, *low]), np.array([255, *high]))
        _, _, _, centroids = cv2.connectedComponentsWithStats(mask)
        rest = bundle.rest_px[bundle.colour == colour]
        if len(rest):
            gap = np.linalg.norm(centroids[1:, None] - rest[None], axis=2)
            linear_sum_assignment(gap)
