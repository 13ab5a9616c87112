"""Size of a picture by its header: a file of some kilobytes can be gigabytes when decoded.

OpenCV has a limit of its own, 2^30 pixels, that is read from the environment when it is loaded,
which may be before this package.
"""

import re
import struct

from phytac_shapes.errors import InputError

PIXELS_MAX = 1 << 26
"""Largest picture, 8192 x 8192 px: OpenCV needs 400 MB to decode it."""
_JPEG_MARKER = re.compile(rb"\xff+([^\x00\xff])", re.DOTALL)


def check_pixels(width_px: float, height_px: float, where: object) -> None:
    """Check the size of a picture, or of a video's, against the limit.

    Raises
    ------
    InputError
        If it has too many pixels.
    """
    if width_px * height_px > PIXELS_MAX:
        raise InputError(
            "picture-too-large",
            f"{where} has {width_px:.0f} x {height_px:.0f} px, more than the {PIXELS_MAX} pixels "
            "allowed; scale it down, or crop it",
        )


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height, px, of a PNG, JPEG, BMP or TIFF; None if it is none of them.

    Headers are read as OpenCV's decoders read them. Of a TIFF in tiles that are larger than the
    picture it is the tiles' size, since one of them is decoded whole.
    """
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            return struct.unpack_from(">II", data, 16) if data[12:16] == b"IHDR" else None
        if data.startswith(b"\xff\xd8"):
            return _jpeg_size(data)
        if data.startswith(b"BM"):
            old = struct.unpack_from("<I", data, 14)[0] == 12
            width, height = struct.unpack_from("<HH" if old else "<ii", data, 18)
            return abs(width), abs(height)
        if data.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")):
            return _tiff_size(data)
    except struct.error:  # it ends within its header
        pass
    return None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Size in the first frame header."""
    at = 2
    while found := _JPEG_MARKER.search(data, at):
        at, marker = found.end(), found[1][0]
        if 0xC0 <= marker <= 0xCF and marker not in {0xC4, 0xC8, 0xCC}:
            height, width = struct.unpack_from(">HH", data, at + 3)
            return width, height
        if marker in {0xD9, 0xDA}:  # the image's end, or its data
            break
        if marker != 0x01 and not 0xD0 <= marker <= 0xD7:  # those have no length
            at += struct.unpack_from(">H", data, at)[0]
    return None


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    """Size in the first directory; 64-bit files (``+``) have wider fields."""
    order, wide = "<" if data.startswith(b"II") else ">", b"+" in data[:4]
    (at,) = struct.unpack_from(order + ("Q" if wide else "I"), data, 8 if wide else 4)
    (count,) = struct.unpack_from(order + ("Q" if wide else "H"), data, at)
    at, step, inner = at + (8 if wide else 2), 20 if wide else 12, 12 if wide else 8
    kinds = {1: "B", 3: "H", 4: "I"} | ({16: "Q"} if wide else {})
    sizes = {256: 0, 257: 0, 322: 0, 323: 0}  # width and height of the picture, of a tile
    for entry in range(at, at + step * min(count, 4096), step):
        tag, kind = struct.unpack_from(order + "HH", data, entry)
        if tag in sizes:
            if kind not in kinds:
                return None
            (value,) = struct.unpack_from(order + kinds[kind], data, entry + inner)
            sizes[tag] = max(sizes[tag], value)
    width, height, *tile = sizes.values()
    return (width, height) if width * height >= tile[0] * tile[1] else (tile[0], tile[1])
