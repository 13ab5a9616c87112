"""Names and encoding of the frames of a data set or a build."""

import cv2

from phytac_shapes.arrays import ImageArray

CAMERA_SUFFIXES = ("", "_far")
"""End of the name of each camera's frame: none for the near or only one."""


def encode_png(image: ImageArray) -> bytes:
    """PNG of a frame (BGR), at low compression because noise hardly compresses."""
    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])
