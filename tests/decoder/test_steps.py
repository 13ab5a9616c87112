"""Videos with damaged places, gone through to their ends and in step."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from decoder.frame import Frame
from decoder.sources import open_source
from shapes.arrays import ImageArray

FPS = 25.0
COUNT = 60


def picture(number: int, rng: np.random.Generator) -> ImageArray:
    """Its level tells its number, also where a codec blurs it."""
    noise = rng.integers(0, 50, (120, 160, 3))
    return (noise + 3 * number).astype(np.uint8)


def level(frame: Frame) -> float:
    return float((np.median(frame.images[0]) - 25.0) / 3.0)


def video_of(where: Path, codec: str) -> Path:
    writer = cv2.VideoWriter(str(where), cv2.VideoWriter.fourcc(*codec), FPS, (160, 120))
    assert writer.isOpened()
    rng = np.random.default_rng(0)
    for number in range(COUNT):
        writer.write(picture(number, rng))
    writer.release()
    return where


def damage(video: Path) -> None:
    data = bytearray(video.read_bytes())
    half = len(data) // 2
    data[half : half + 20000] = np.random.default_rng(1).bytes(20000)
    video.write_bytes(data)


@pytest.mark.parametrize(("suffix", "codec"), [("mp4", "mp4v"), ("mkv", "MJPG")])
def test_what_follows_a_damaged_place_is_read(tmp_path: Path, suffix: str, codec: str) -> None:
    video = video_of(tmp_path / f"v.{suffix}", codec)
    damage(video)
    said: list[str] = []
    source = open_source([str(video)], report=said.append)
    frames = list(source)
    assert frames[-1].number == COUNT - 1
    assert 0 < source.skipped == COUNT - len(frames) < 10
    # Numbers go on as if none were lost, as times do.
    np.testing.assert_allclose(
        [frame.timestamp_s for frame in frames], [frame.number / FPS for frame in frames]
    )
    whole = [frame for frame in frames if not 20 <= frame.number <= 40]
    np.testing.assert_allclose([level(f) for f in whole], [f.number for f in whole], atol=2.0)
    (told,) = said
    assert told.endswith(f"skipped: {video} is damaged there")


def test_the_other_camera_goes_on_beside_a_damaged_place(tmp_path: Path) -> None:
    near, far = video_of(tmp_path / "near.mkv", "MJPG"), video_of(tmp_path / "far.mkv", "MJPG")
    damage(far)
    source = open_source([str(near), str(far)], report=lambda _: None)
    frames = list(source)
    assert frames[-1].number == COUNT - 1
    assert len(frames) + source.skipped == COUNT
    for frame in frames:
        if not 20 <= frame.number <= 40:
            np.testing.assert_allclose(np.median(frame.images[1]), np.median(frame.images[0]))


@pytest.mark.parametrize("suffix", ["mkv", "avi"])
def test_a_video_that_is_cut_off_says_so_once(tmp_path: Path, suffix: str) -> None:
    video = video_of(tmp_path / f"v.{suffix}", "MJPG")
    data = video.read_bytes()
    video.write_bytes(data[: len(data) * 2 // 3])
    said: list[str] = []
    source = iter(open_source([str(video)], loop=True, report=said.append))
    numbers = [next(source).number for _ in range(COUNT + 30)]
    assert numbers == list(range(COUNT + 30))
    (told,) = said
    assert "ends after 40 frames, and its header speaks of 60: it may be cut off" in told
