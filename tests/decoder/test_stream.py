"""The sensor's loop: frames to messages, unreadable frames, progress."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.io.frame import Frame, Source
from phytac_decoder.io.frame_sources import open_source
from phytac_decoder.io.imu import Imu
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.serving.sensor_loop import Progress, Stream, follow_decoder, frame_decoder
from phytac_decoder.serving.wire_protocol import Message, MessageBuilder
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import InputError
from tests.decoder.test_marker_detection import lattice
from tests.decoder.test_two_views import pair
from tests.decoder.toy_sensor import toy_bundle, toy_frame, toy_recording
from tests.refusals import refused


class Frames(Source):
    """Given frames."""

    description, clock = "a test", "its own"

    def __init__(self, images: list[ImageArray]) -> None:
        self.images = images

    def __iter__(self) -> Iterator[Frame]:
        for number, image in enumerate(self.images):
            yield Frame(
                number=number,
                timestamp_s=0.1 * number,
                images=(image,),
                ready_s=time.monotonic(),
            )

    def close(self) -> None:
        pass


def run(images: list[ImageArray], **more: Any) -> tuple[list[Message], Stream]:
    bundle, sent = toy_bundle(), []
    settings: dict[str, Any] = {
        "source": Frames(images),
        "decode": frame_decoder(bundle),
        "messages": MessageBuilder(bundle=bundle, estimator="koi_inverse"),
        "publish": sent.append,
        "report": lambda _: None,
    }
    stream = Stream(**(settings | more))
    stream.run()
    return sent, stream


def test_frames_become_forces(tmp_path: Path) -> None:
    path = tmp_path / "imu"
    path.write_text('{"t": 0.1, "gyro": [1, 2, 3]}\n')
    imu = Imu(path, clock=lambda: 0.0, report=print)
    idle, pressed, two = (toy_frame(f) for f in ({}, {14: 3.0}, {14: 3.0, 15: 1.5, 29: 2.0}))
    sent, stream = run([idle, pressed, two], imu=imu)
    imu.close()
    assert [message["koi"] for message in sent] == [[], [14], [14, 15, 29]]
    # A centroid of a drawn disc is good to a tenth of a pixel, a newton is a pixel.
    np.testing.assert_allclose(sent[1]["forces_N"], [3.0], atol=0.15)
    np.testing.assert_allclose(sent[2]["forces_N"], [3.0, 1.5, 2.0], atol=0.15)
    assert [contact["markers"] for contact in sent[2]["contacts"]] == [[14, 15], [29]]
    assert [message.get("imu", {}).get("t") for message in sent] == [None, 0.1, 0.1]
    assert all(message["latency_ms"] > 0.0 for message in sent)
    assert stream.progress.frames == 3
    assert stream.progress.unread == 0


def test_frames_that_cannot_be_decoded_are_reported_not_fatal() -> None:
    black = np.zeros((120, 160, 3), dtype=np.uint8)
    small = np.zeros((3, 3, 3), dtype=np.uint8)
    reported: list[str] = []
    sent, stream = run(
        [toy_frame({7: 2.0}), black, small, toy_frame({7: 2.0})], report=reported.append
    )
    assert [message["valid"] for message in sent] == [True, False, False, True]
    assert "the frame cannot be decoded: found 0 of 30 markers" in sent[1]["warnings"][0]
    assert sent[1]["contacts"] == []
    assert sent[3]["koi"] == [7]
    assert stream.progress.unread == 2
    assert len(reported) == 1


def test_two_cameras_are_decoded_together() -> None:
    rest, _, _ = lattice()
    bundle, (near, far) = pair(np.full_like(rest, np.nan))
    decode = frame_decoder(bundle)

    def frame(*images: ImageArray) -> Frame:
        return Frame(number=0, timestamp_s=0.0, images=images, ready_s=0.0)

    moved = np.roll(far, (0, 2), axis=(0, 1))
    assert decode(frame(near, far)).warnings == []
    (warning,) = decode(frame(near, moved)).warnings
    assert "the far camera has " in warning
    assert "since the rest frame" in warning
    with refused("camera-count"):
        decode(frame(near))


def test_another_decoder_can_be_plugged_in() -> None:
    def follower(frame: Frame) -> Reading:
        forces = np.zeros(30)
        forces[3] = float(frame.images[0][0, 0, 0])
        return Reading(koi=np.array([3]), forces_N=forces, warnings=["made up"])

    sent, _ = run([np.full((2, 2, 3), 9, dtype=np.uint8)], decode=follower)
    assert sent[0]["total_N"] == 9.0
    assert sent[0]["warnings"] == ["made up"]
    with refused("estimator-unknown"):
        frame_decoder(toy_bundle(), estimator="best")
    # It is known, but this decoder has no tables for it: reported before the first frame.
    with refused("estimator-unknown"):
        frame_decoder(toy_bundle(), estimator="auto")


def test_progress_is_reported_each_second(tmp_path: Path) -> None:
    _, frames = toy_recording(tmp_path, [{}])
    texts: list[str] = []

    def each_second(now: Progress) -> None:
        texts.append(now.text(clients=1, dropped=4))
        if len(texts) == 2:
            raise KeyboardInterrupt

    source = open_source([str(frames)], fps=100.0, loop=True)
    with pytest.raises(KeyboardInterrupt):
        run([], source=source, each_second=each_second)
    assert "fps  latency p50 " in texts[1]
    assert "1 client, 4 dropped" in texts[1]
    seconds, _, fps, *_ = texts[0].split()
    assert 1.0 <= float(seconds) < 4.0
    assert float(fps) > 20.0


def test_following_gives_the_same_forces_in_the_order_of_frames() -> None:
    bundle = toy_bundle()
    # Frames 4 and 5 are missed, number 7 is black.
    pressed = [{14: 0.4 * k, 15: 0.2 * k} if k else {} for k in range(10)]
    images = {k: toy_frame(forces) for k, forces in enumerate(pressed) if k not in {4, 5}}
    follow, alone = follow_decoder(bundle, [images[0]]), frame_decoder(bundle)
    images[7] = np.zeros_like(images[0])
    for number, image in images.items():
        frame = Frame(number=number, timestamp_s=0.0, images=(image,), ready_s=0.0)
        if number == 7:
            with pytest.raises(InputError):
                follow(frame)
            continue
        found, wanted = follow(frame), alone(frame)
        assert found.koi.tolist() == wanted.koi.tolist()
        np.testing.assert_allclose(found.forces_N, wanted.forces_N, atol=0.1)
    assert wanted.forces_N[14] == pytest.approx(3.6, abs=0.2)
    with refused("estimator-unknown"):
        follow_decoder(bundle, [images[0]], estimator="magic")


def test_following_knows_how_long_frames_were_missed_and_the_estimator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bundle = toy_bundle()
    stiff = replace(bundle, model=replace(bundle.model, stiffness=2.0 * np.eye(len(bundle.colour))))
    elapsed: list[float] = []
    whole = Follower.follow

    def noted(self: Follower, frames: Any, **how: float) -> Any:
        elapsed.append(how["elapsed"])
        return whole(self, frames, **how)

    monkeypatch.setattr(Follower, "follow", noted)
    follow = follow_decoder(stiff, [toy_frame()], estimator="fem")
    for number in (0, 1, 4, 5, 0, 1):  # a recording that begins again
        image = toy_frame({14: 0.5})
        found = follow(Frame(number=number, timestamp_s=0.0, images=(image,), ready_s=0.0))
    assert elapsed == [1.0, 1.0, 3.0, 1.0, 1.0, 1.0]
    assert found.forces_N[14] == pytest.approx(1.0, abs=0.2)


class Busy(Frames):
    """A camera that loses a frame while another is decoded."""

    def __iter__(self) -> Iterator[Frame]:
        for frame in super().__iter__():
            yield frame
            self.skipped += 1


def test_missed_frames_are_those_before() -> None:
    source = Busy([toy_frame()] * 3)

    def decode(frame: Frame) -> Reading:
        source.missed += 2
        return Reading.none(f"frame {frame.number}")

    sent, stream = run([], source=source, decode=decode)
    assert [message["missed"] for message in sent] == [0, 3, 6]
    assert (stream.progress.missed, stream.progress.skipped) == (6, 3)
