"""Frames of images, folders, videos and cameras: order, times, pace, torn files, pairs."""

import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from phytac_decoder.io.frame import Frame, Source
from phytac_decoder.io.frame_sources import RecordingSource, first_frames, open_source
from phytac_decoder.io.recorded_frames import ImageFolder, read_image
from phytac_shapes.arrays import ImageArray
from tests.decoder.virtual_camera import VirtualCamera, VirtualWorld, install
from tests.refusals import refused

WARM_UP = 20
"""Frames that are discarded: before settings are locked, and after."""


def shade(value: int) -> ImageArray:
    return np.full((24, 32, 3), value, dtype=np.uint8)


def folder_of(where: Path, count: int, name: str = "frame_{}.png") -> Path:
    where.mkdir(parents=True)
    for number in range(count):
        cv2.imwrite(str(where / name.format(number)), shade(number))
    return where


def values(frames: list[Frame]) -> list[int]:
    return [int(np.median(frame.images[0])) for frame in frames]


def tear(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


class Time:
    """A clock that only sleeping and decoding move."""

    def __init__(self) -> None:
        self.now = 100.0

    def clock(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.now += seconds


def test_a_folder_is_sorted_by_the_numbers_in_its_names(tmp_path: Path) -> None:
    (folder_of(tmp_path / "f", 12) / "notes.txt").write_text("no picture")
    frames = list(open_source([str(tmp_path / "f")], fps=1e6, every=True))
    assert values(frames) == list(range(12))
    assert [frame.number for frame in frames] == list(range(12))
    assert [frame.timestamp_s for frame in frames] == [k / 1e6 for k in range(12)]


def test_an_image_is_a_recording_of_one_frame(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), shade(7))
    (frame,) = open_source([str(tmp_path / "a.png")])
    assert values([frame]) == [7]
    assert frame.timestamp_s == 0.0


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["10.250", "9.500", "9.750"], [9.5, 9.75, 10.25]),
        (["1700000000500000000", "1700000000250000000"], [1700000000.25, 1700000000.5]),
    ],
)
def test_names_that_are_times_order_and_stamp(
    tmp_path: Path, names: list[str], times: list[float]
) -> None:
    for number, name in enumerate(names):
        cv2.imwrite(str(tmp_path / f"{name}.png"), shade(number))
    source = open_source([str(tmp_path)])
    frames = list(source)
    assert [frame.timestamp_s for frame in frames] == times
    assert values(frames) == np.argsort([float(name) for name in names]).tolist()
    assert "own" in source.clock


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_torn_frames_are_reported_and_skipped(tmp_path: Path, suffix: str) -> None:
    folder = folder_of(tmp_path / "f", 5, f"frame_{{}}.{suffix}")
    tear(folder / f"frame_0.{suffix}")
    tear(folder / f"frame_2.{suffix}")
    (folder / f"frame_3.{suffix}").write_bytes(b"")
    reported: list[str] = []
    source = open_source([str(folder)], fps=1e6, every=True, report=reported.append)
    frames = list(source)
    assert [frame.number for frame in frames] == [1, 4]
    assert source.skipped == 3
    assert [text.split(":")[0] for text in reported] == [f"frame {n} skipped" for n in (0, 2, 3)]
    assert all("cut off" in text for text in reported)


def test_a_padded_file_is_whole(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "f", 1, "a{}.jpg") / "a0.jpg"
    path.write_bytes(path.read_bytes() + b"\0" * 100)
    assert len(list(open_source([str(path)]))) == 1


@pytest.mark.parametrize("loop", [False, True])
def test_nothing_but_torn_frames_is_an_error(tmp_path: Path, loop: bool) -> None:
    folder = folder_of(tmp_path / "f", 3)
    for path in folder.iterdir():
        tear(path)
    with refused("no-frames-read"):
        list(open_source([str(folder)], loop=loop, report=lambda _: None))


def test_a_pace_is_kept(tmp_path: Path) -> None:
    clock = Time()
    source = RecordingSource(
        [ImageFolder(folder_of(tmp_path / "f", 6))], fps=4.0, clock=clock.clock, sleep=clock.sleep
    )
    taken = []
    for frame in source:
        taken.append(clock.now)
        assert frame.ready_s == clock.now
        clock.now += 0.2
    np.testing.assert_allclose(np.diff(taken), 0.25)
    assert source.missed == 0


@pytest.mark.parametrize("every", [False, True])
def test_a_slow_decoder_misses_frames_as_with_a_camera(tmp_path: Path, every: bool) -> None:
    clock = Time()
    source = RecordingSource(
        [ImageFolder(folder_of(tmp_path / "f", 12))],
        fps=10.0,
        every=every,
        clock=clock.clock,
        sleep=clock.sleep,
    )
    numbers = []
    for frame in source:
        numbers.append(frame.number)
        assert frame.timestamp_s == frame.number / 10.0
        clock.now += 0.25
    assert numbers == (list(range(12)) if every else [0, 2, 5, 7, 10])
    assert source.missed == (0 if every else 7)


def test_time_continues_in_a_loop(tmp_path: Path) -> None:
    for number, name in enumerate(("1.0", "1.5", "2.0")):
        cv2.imwrite(str(tmp_path / f"{name}.png"), shade(number))
    source = iter(open_source([str(tmp_path)], loop=True))
    frames = [next(source) for _ in range(8)]
    assert [frame.timestamp_s for frame in frames] == [1.0 + 0.5 * k for k in range(8)]
    assert [frame.number for frame in frames] == list(range(8))
    assert values(frames) == [0, 1, 2] * 2 + [0, 1]


def test_two_folders_go_in_step_and_lose_a_pair_together(tmp_path: Path) -> None:
    near, far = folder_of(tmp_path / "near", 4), folder_of(tmp_path / "far", 4, "z{}.png")
    tear(far / "z1.png")
    reported: list[str] = []
    frames = list(open_source([str(near), str(far)], fps=1e6, every=True, report=reported.append))
    assert [len(frame.images) for frame in frames] == [2, 2, 2]
    assert [[int(image[0, 0, 0]) for image in frame.images] for frame in frames] == [
        [0, 0],
        [2, 2],
        [3, 3],
    ]
    assert len(reported) == 1
    (far / "z3.png").unlink()
    with refused("camera-count") as caught:
        open_source([str(near), str(far)])
    caught.match("4 in .*near and 3 in .*far")


def video_of(where: Path, count: int, fps: float = 25.0) -> Path:
    writer = cv2.VideoWriter(str(where), cv2.VideoWriter.fourcc(*"MJPG"), fps, (32, 24))
    assert writer.isOpened()
    for number in range(count):
        writer.write(shade(10 * number))
    writer.release()
    return where


def test_a_video_contains_its_times(tmp_path: Path) -> None:
    video = video_of(tmp_path / "v.avi", 6)
    frames = list(open_source([str(video)]))
    np.testing.assert_allclose([frame.timestamp_s for frame in frames], np.arange(6) / 25.0)
    np.testing.assert_allclose(values(frames), 10 * np.arange(6), atol=3)
    again = iter(open_source([str(video)], loop=True))
    stamps = [next(again).timestamp_s for _ in range(13)]
    np.testing.assert_allclose(stamps, np.arange(13) / 25.0)


def test_a_shorter_video_ends_both(tmp_path: Path) -> None:
    pair = [str(video_of(tmp_path / f"{n}.avi", n)) for n in (4, 6)]
    reported: list[str] = []
    assert len(list(open_source(pair, report=reported.append))) == 4
    (line,) = reported
    assert line.endswith("4.avi ends after 4 frames, before the other camera's")


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda _: None, "file-unreadable"),
        (lambda path: path.mkdir(), "folder-without-images"),
        (lambda path: path.write_text("hello"), "file-not-image"),
    ],
)
def test_invalid_sources_are_rejected(
    tmp_path: Path, make: Callable[[Path], None], code: str
) -> None:
    path = tmp_path / "thing"
    make(path)
    with refused(code):
        list(open_source([str(path)]))


def test_sources_that_do_not_go_together_are_rejected(tmp_path: Path) -> None:
    folder = str(folder_of(tmp_path / "f", 1))
    with refused("camera-option-conflict"):
        open_source([folder, "0"])
    with refused("camera-count"):
        open_source([folder] * 3)
    for rate in (0.0, -3.0, float("nan"), float("inf")):
        with refused("frame-rate-invalid"):
            open_source([folder], fps=rate)
    with refused("camera-option-conflict"):
        open_source(["0"], loop=True)
    with refused("camera-option-conflict"):
        open_source([folder], controls={"gain": 3.0})


def test_without_pace_a_rate_only_stamps(tmp_path: Path) -> None:
    folder = str(folder_of(tmp_path / "f", 4))
    source = open_source([folder], fps=0.01, pace=False)
    start = time.monotonic()
    frames = [(frame.number, frame.timestamp_s) for frame in source]
    assert time.monotonic() - start < 5.0
    assert frames == [(0, 0.0), (1, 100.0), (2, 200.0), (3, 300.0)]
    # None is late, however long the one before took.
    slow = open_source([folder], fps=1000.0, pace=False)
    for _ in slow:
        time.sleep(0.005)
    assert slow.missed == 0
    # As a camera would be, it leaves out what is late.
    paced = open_source([folder], fps=1000.0)
    for _ in paced:
        time.sleep(0.005)
    assert paced.missed > 0


def test_a_recording_has_a_length(tmp_path: Path) -> None:
    near, far = folder_of(tmp_path / "near", 3), video_of(tmp_path / "far.avi", 3)
    for wheres, count in (([near], 3), ([far], None), ([near, far], 3)):
        source = open_source([str(where) for where in wheres])
        assert isinstance(source, RecordingSource)
        assert source.count == count
        source.close()


def test_first_frames_are_averaged(tmp_path: Path) -> None:
    near, far = folder_of(tmp_path / "near", 9), folder_of(tmp_path / "far", 9)
    for number, value in enumerate((10, 20, 30, 61)):
        cv2.imwrite(str(near / f"frame_{number}.png"), shade(value))
    tear(near / "frame_1.png")
    reported: list[str] = []
    one, two = first_frames(open_source([str(near), str(far)], report=reported.append), 3).mean
    assert one.dtype == np.uint8
    assert set(one.ravel().tolist()) == {round((10 + 30 + 61) / 3)}
    assert set(two.ravel().tolist()) == {round((0 + 2 + 3) / 3)}
    assert len(reported) == 1
    with refused("rest-frames-too-few"):
        first_frames(open_source([str(near)], report=reported.append), 9)
    cv2.imwrite(str(far / "frame_1.png"), np.zeros((12, 16, 3), dtype=np.uint8))
    with refused("frame-size-varies"):
        first_frames(open_source([str(far)]), 2)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[VirtualWorld]:
    """A camera of 200 frames a second; after its warm-up every fifth is torn, and it ends."""
    world = VirtualWorld(
        picture=lambda number: shade(max(number - WARM_UP, 0)),
        torn=lambda number: number >= WARM_UP and number % 5 == 4,
        frames=WARM_UP + 40,
        lie={cv2.CAP_PROP_FPS: 30.0},
    )
    yield install(monkeypatch, world, lost_s=0.5, give_up_s=0.5)
    assert all(camera.released for camera in world.opened)


def take(source: Source, camera: VirtualCamera, frames: list[Frame]) -> None:
    before = 0
    for frame in source:
        frames.append(frame)
        # None that waited: one may be torn, one on its way.
        assert frame.number >= before - 2
        time.sleep(0.021)
        before = min(camera.number - WARM_UP, 39)


def test_a_slow_decoder_gets_a_cameras_newest_frame(world: VirtualWorld) -> None:
    reported: list[str] = []
    source = open_source(["3"], fps=60.0, sizes_px=[(32, 24)], report=reported.append)
    assert (cv2.CAP_PROP_FRAME_WIDTH, 32) in world.last.asked
    assert "REFUSED fps 60 (it reports 30)" in reported[0]
    frames: list[Frame] = []
    with refused("camera-silent"):
        take(source, world.last, frames)
    numbers = [frame.number for frame in frames]
    assert numbers == values(frames)
    assert numbers == sorted(set(numbers))
    assert all(number % 5 != 4 for number in numbers)
    assert len(frames) + source.missed == 32
    assert source.missed > 10
    assert source.skipped >= 8
    source.close()


def test_two_cameras_are_read_together(world: VirtualWorld) -> None:
    source = open_source(["0", "1"], report=lambda _: None)
    frames = iter(source)
    for _ in range(5):
        first, second = next(frames).images
        assert first[0, 0, 0] == second[0, 0, 0]
    source.close()
    assert len(world.opened) == 2
    # Each has its own size.
    with refused("camera-size"):
        open_source(["0", "1"], sizes_px=[(32, 24), (16, 12)], report=lambda _: None)


def test_a_camera_that_is_not_there_is_rejected(world: VirtualWorld) -> None:
    with refused("camera-not-opened"):
        open_source(["0", "9"], report=lambda _: None)
    assert len(world.opened) == 2


def test_one_image_is_whole_or_rejected(tmp_path: Path) -> None:
    """OpenCV gives half a picture for half a file."""
    noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    for name in ("a.jpg", "a.png"):
        cv2.imwrite(str(tmp_path / name), noise)
        data = (tmp_path / name).read_bytes()
        assert read_image(tmp_path / name).shape == noise.shape
        (tmp_path / name).write_bytes(data[: int(0.7 * len(data))])
        with refused("image-truncated"):
            read_image(tmp_path / name)
        (tmp_path / name).write_text("hello")
        with refused("file-not-image"):
            read_image(tmp_path / name)
    # As wide and high as a header can say.
    head = data[12:16] + (60000).to_bytes(4, "big") * 2 + data[24:29]
    wide = data[:12] + head + zlib.crc32(head).to_bytes(4, "big") + data[33:]
    (tmp_path / "a.png").write_bytes(wide)
    with refused("picture-too-large"):
        read_image(tmp_path / "a.png")
