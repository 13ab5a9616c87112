"""Videos with damaged places, gone through to their ends and in step."""

import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from phytac_decoder.io.frame import Frame
from phytac_decoder.io.frame_sources import first_frames, open_source
from phytac_shapes.arrays import ImageArray

FPS = 25.0
COUNT = 60


def picture(number: int, rng: np.random.Generator) -> ImageArray:
    """Its level is its number, also where a codec blurs it."""
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
    reported: list[str] = []
    source = open_source([str(video)], report=reported.append)
    frames = list(source)
    assert frames[-1].number == COUNT - 1
    assert 0 < source.skipped == COUNT - len(frames) < 10
    # Numbers continue as if none were lost, as times do.
    np.testing.assert_allclose(
        [frame.timestamp_s for frame in frames], [frame.number / FPS for frame in frames]
    )
    whole = [frame for frame in frames if not 20 <= frame.number <= 40]
    np.testing.assert_allclose([level(f) for f in whole], [f.number for f in whole], atol=2.0)
    (line,) = reported
    assert line.endswith(f"skipped: {video} is damaged there")


def test_the_other_camera_continues_past_a_damaged_place(tmp_path: Path) -> None:
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
def test_a_truncated_video_is_reported_once(tmp_path: Path, suffix: str) -> None:
    video = video_of(tmp_path / f"v.{suffix}", "MJPG")
    data = video.read_bytes()
    video.write_bytes(data[: len(data) * 2 // 3])
    reported: list[str] = []
    source = iter(open_source([str(video)], loop=True, report=reported.append))
    numbers = [next(source).number for _ in range(COUNT + 30)]
    assert numbers == list(range(COUNT + 30))
    (line,) = reported
    assert "ends after 40 frames, and its header promises 60: it may be cut off" in line


def stamped_folder(where: Path, times_s: list[float]) -> Path:
    where.mkdir()
    for number, time_s in enumerate(times_s):
        image = np.full((24, 32, 3), number, dtype=np.uint8)
        cv2.imwrite(str(where / f"{time_s:.4f}.png"), image)
    return where


def pairs_of(near: list[float], far: list[float], frames: list[Frame]) -> list[tuple[float, float]]:
    return [(near[int(a[0, 0, 0])], far[int(b[0, 0, 0])]) for a, b in (f.images for f in frames)]


def test_pictures_of_one_instant_are_paired(tmp_path: Path) -> None:
    times = [10.0 + 0.1 * k for k in range(30)]
    near = [t for k, t in enumerate(times) if k not in {3, 12, 13}]
    # Its own phase, jitter, and other gaps.
    jitter = np.random.default_rng(0).uniform(-0.01, 0.01, 30)
    far = [t + 0.02 + jitter[k] for k, t in enumerate(times) if k not in {0, 17}]
    reported: list[str] = []
    wheres = [
        str(stamped_folder(tmp_path / name, each)) for name, each in (("near", near), ("far", far))
    ]
    source = open_source(wheres, report=reported.append)
    frames = list(source)
    pairs = pairs_of(near, far, frames)
    assert max(abs(b - a) for a, b in pairs) < 0.04
    gone = {0, 3, 12, 13, 17}
    assert [frame.number for frame in frames] == [k for k in range(30) if k not in gone]
    assert source.skipped == len(gone)
    assert [text.split(":")[0] for text in reported] == [
        "frame 0 skipped",
        "frame 3 skipped",
        "frames 12 to 13 skipped",
        "frame 17 skipped",
    ]
    assert reported[0].endswith("far has none of that time")
    assert reported[1].endswith("near has none of that time")


@pytest.mark.parametrize("phase", [0.0501, 0.05, 0.0499])
def test_cameras_that_take_turns_lose_nothing_to_jitter(tmp_path: Path, phase: float) -> None:
    jitter = np.random.default_rng(0).uniform(-0.002, 0.002, 40)
    near = [0.1 * k for k in range(40)]
    far = [0.1 * k + phase + jitter[k] for k in range(40)]
    wheres = [
        str(stamped_folder(tmp_path / name, each)) for name, each in (("near", near), ("far", far))
    ]
    assert len(list(open_source(wheres, report=lambda _: None))) >= 39


@pytest.mark.parametrize("begin", [1e9, 3.0])
def test_times_of_two_clocks_pair_in_order(tmp_path: Path, begin: float) -> None:
    near = [0.1 * k for k in range(20)]
    far = [begin + 0.1 * k for k in range(20)]
    wheres = [
        str(stamped_folder(tmp_path / name, each)) for name, each in (("near", near), ("far", far))
    ]
    reported: list[str] = []
    assert len(list(open_source(wheres, report=reported.append))) == 20
    (line,) = reported
    assert line.endswith("cannot be compared; their frames are paired in order")


def test_a_video_that_lost_pictures_without_a_word_stays_in_step(tmp_path: Path) -> None:
    """A codec that finds its way by itself: times jump, and no picture fails."""
    near, far = video_of(tmp_path / "near.mkv", "FFV1"), video_of(tmp_path / "far.mkv", "FFV1")
    data = bytearray(far.read_bytes())
    half = len(data) // 2
    data[half : half + 3000] = bytes(3000)
    far.write_bytes(data)
    reported: list[str] = []
    source = open_source([str(near), str(far)], report=reported.append)
    frames = list(source)
    assert frames[-1].number == COUNT - 1
    assert 0 < source.skipped == COUNT - len(frames)
    for frame in frames:
        if not 20 <= frame.number <= 40:
            np.testing.assert_array_equal(frame.images[0], frame.images[1])
    assert "far.mkv has none of that time" in reported[0]


def test_companions_of_macos_are_no_frames(tmp_path: Path) -> None:
    folder = stamped_folder(tmp_path / "f", [1.0, 1.5, 2.0])
    (folder / "._1.0000.png").write_bytes(b"\0\5\x16\7" + bytes(100))
    source = open_source([str(folder)], report=pytest.fail)
    assert [frame.timestamp_s for frame in source] == [1.0, 1.5, 2.0]


def test_first_frames_are_not_all_held(tmp_path: Path) -> None:
    folder = tmp_path / "f"
    folder.mkdir()
    image = np.zeros((480, 640, 3), dtype=np.uint8)
    for number in range(60):
        cv2.imwrite(str(folder / f"{number}.jpg"), image + np.uint8(number % 2))
    tracemalloc.start()
    try:
        (mean,) = first_frames(open_source([str(folder)]), 60).mean
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert mean.shape == image.shape
    assert peak < 40 * image.nbytes
