"""Sizes of pictures by their headers, and pictures that would fill the memory."""

import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from phytac_decoder.io import picture_size as module
from phytac_decoder.io.picture_size import PIXELS_MAX, picture_size
from phytac_decoder.io.recorded_frames import VideoFile, read_image
from phytac_design.simulation.rig_import.rig_frames import open_source
from tests.refusals import refused

WIDTH, HEIGHT = 41, 23
SIDE = 8193
"""One more than the root of the limit."""


def encoded(suffix: str, *settings: int) -> bytes:
    image = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    return bytes(cv2.imencode(suffix, image, settings)[1])


def tiff(order: str, width: int, height: int, *, wide: bool = False, tile: int = 0) -> bytes:
    """An empty TIFF directory with the sizes as 16 bits if they fit, else as 32."""
    sizes = {256: width, 257: height} | ({322: tile, 323: tile} if tile else {})
    long = "Q" if wide else "I"
    out = (b"II" if order == "<" else b"MM") + struct.pack(order + "H", 43 if wide else 42)
    out += struct.pack(order + "HHQ", 8, 0, 16) if wide else struct.pack(order + "I", 8)
    out += struct.pack(order + ("Q" if wide else "H"), len(sizes))
    for tag, value in sizes.items():
        kind, letter = (3, "H") if value < 1 << 16 else (4, "I")
        field = struct.pack(order + letter, value).ljust(8 if wide else 4, b"\0")
        out += struct.pack(order + "HH" + long, tag, kind, 1) + field
    return out


def png(width: int, height: int, rows: int) -> bytes:
    """A black picture whose data stops after some rows."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(bytes((3 * width + 1) * rows))
    parts = chunk(b"IHDR", head), chunk(b"IDAT", data), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@pytest.mark.parametrize(
    ("suffix", "settings"),
    [
        (".png", ()),
        (".jpg", ()),
        (".jpg", (cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 2)),
        (".bmp", ()),
        (".tiff", ()),
    ],
)
def test_headers_of_opencvs_own_files(
    suffix: str, settings: tuple[int, ...], tmp_path: Path
) -> None:
    data = encoded(suffix, *settings)
    assert picture_size(data) == (WIDTH, HEIGHT)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data)
    assert read_image(path).shape == (HEIGHT, WIDTH, 3)
    # Cut anywhere, it is a size or none, and no other error.
    assert {picture_size(data[:k]) for k in range(200)} <= {None, (WIDTH, HEIGHT)}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("wide", [False, True])
def test_tiffs_of_either_order_and_width(order: str, wide: bool) -> None:
    assert picture_size(tiff(order, 70_000, 300, wide=wide)) == (70_000, 300)
    assert picture_size(tiff(order, 70, 300, wide=wide, tile=64)) == (70, 300)
    # A tile is decoded whole, however small the picture.
    assert picture_size(tiff(order, 70, 30, wide=wide, tile=9000)) == (9000, 9000)


def test_sizes_that_headers_may_hide() -> None:
    jpeg = encoded(".jpg")
    # A thumbnail with a size of its own, and bytes between segments.
    small = b"\xff\xe1" + struct.pack(">H", 2 + 8) + b"\xff\xc0\x00\x11\x08\x00\x01\x00"
    assert picture_size(jpeg[:2] + small + b"\x00\xff\x00\xff\xff" + jpeg[3:]) == (WIDTH, HEIGHT)
    # Rows from the top have a negative height.
    bmp = bytearray(encoded(".bmp"))
    bmp[22:26] = struct.pack("<i", -HEIGHT)
    assert picture_size(bytes(bmp)) == (WIDTH, HEIGHT)
    assert picture_size(b"BM" + bytes(12) + struct.pack("<IHH", 12, 65_000, 60_000)) == (
        65_000,
        60_000,
    )
    # A chunk before the header, and what is no picture of these kinds.
    whole = png(4, 4, 4)
    assert picture_size(whole[:8] + whole[33:]) is None
    assert picture_size(encoded(".webp")) is None
    assert picture_size(b"") is None


@pytest.mark.parametrize(
    ("suffix", "make"),
    [
        (".png", lambda: png(SIDE, SIDE, 40)),
        (".bmp", lambda: b"BM" + struct.pack("<IIIIii", 0, 0, 54, 40, SIDE, -SIDE) + bytes(28)),
        (".tif", lambda: tiff("<", SIDE, SIDE)),
        (".jpg", lambda: jpeg_of(SIDE)),
    ],
)
def test_a_picture_that_would_fill_the_memory_is_not_decoded(
    tmp_path: Path, suffix: str, make: Callable[[], bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(make())
    assert path.stat().st_size < 10_000
    # Decoding itself would be the harm.
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("it was decoded"))
    tracemalloc.start()
    with refused("picture-too-large") as caught:
        read_image(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1_000_000
    for said in ("8193 x 8193 px", str(PIXELS_MAX), "scale it down"):
        assert said in str(caught.value)


def jpeg_of(side: int) -> bytes:
    data = encoded(".jpg")
    at = data.index(b"\xff\xc0") + 5
    return data[:at] + struct.pack(">HH", side, side) + data[at + 4 :]


def test_the_largest_picture_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(encoded(".png"))
    monkeypatch.setattr(module, "PIXELS_MAX", WIDTH * HEIGHT)
    assert read_image(path).shape == (HEIGHT, WIDTH, 3)
    monkeypatch.setattr(module, "PIXELS_MAX", WIDTH * HEIGHT - 1)
    with refused("picture-too-large"):
        read_image(path)


def test_videos_have_the_same_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for _ in range(3):
        video.write(np.zeros((48, 64, 3), dtype=np.uint8))
    video.release()
    assert len(list(VideoFile(path).images())) == 3
    assert len(open_source(path, fps=None).names) == 3
    monkeypatch.setattr(module, "PIXELS_MAX", 64 * 48 - 1)
    with refused("picture-too-large"):
        VideoFile(path)
    with refused("picture-too-large"):
        open_source(path, fps=None)


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    import os

    os.mkfifo(tmp_path / "a.png")
    with refused("file-unreadable"):
        read_image(tmp_path / "a.png")
    with refused("file-unreadable"):
        read_image(Path("/dev/zero"))
