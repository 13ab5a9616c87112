"""Cameras that misbehave, from the driver to the stream's messages."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_decoder.io import camera_device
from phytac_decoder.io.camera_device import CameraDevice, CaptureSettings, parse_controls
from phytac_decoder.io.frame_sources import first_frames, open_source
from phytac_decoder.pipeline.rest_frames import take_rest_frames
from phytac_decoder.serving.exposure_monitor import ExposureMonitor, with_exposure_check
from phytac_decoder.serving.sensor_loop import Stream, frame_decoder
from phytac_decoder.serving.wire_protocol import Message, MessageBuilder
from phytac_shapes.arrays import ImageArray
from tests.decoder.toy_sensor import toy_bundle, toy_frame
from tests.decoder.virtual_camera import AUTO, MANUAL, MJPG, YUYV, VirtualWorld, install
from tests.refusals import refused

SIZE = (160, 120)
IDLE, PRESSED = toy_frame(), toy_frame({14: 3.0})


def idle(_number: int) -> ImageArray:
    return IDLE


def opened(patch: pytest.MonkeyPatch, world: VirtualWorld, **request: Any) -> CameraDevice:
    install(patch, world)
    settings = CaptureSettings(warm_up_s=1.0, warm_up_least_s=0.0)
    request = {"size_px": SIZE, "settings": settings, "report": lambda _: None} | request
    device = CameraDevice(device=0, **request)
    device.open()
    return device


def test_settings_are_locked_where_automatic_control_has_settled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said: list[str] = []
    device = opened(monkeypatch, VirtualWorld(picture=idle, dark_frames=4.0), report=said.append)
    driver = device._camera.held
    assert driver[cv2.CAP_PROP_AUTO_EXPOSURE] == MANUAL
    assert (driver[cv2.CAP_PROP_AUTO_WB], driver[cv2.CAP_PROP_AUTOFOCUS]) == (0.0, 0.0)
    assert device.locked == {"exposure": 156, "gain": 4, "white_balance": 4600, "focus": 30}
    assert (device.refused, device.absent) == ([], [])
    values = "exposure=156, gain=4, white_balance=4600, focus=30"
    assert said == [f"camera 0: 160x120 px, YUYV, 30 fps; locked {values}"]
    # Pictures of the warm-up are dark, and none of them is given.
    assert device.grab()
    image = device.retrieve()
    assert image is not None
    assert image.mean() == pytest.approx(IDLE.mean(), rel=0.03)


def test_values_are_locked_as_requested(monkeypatch: pytest.MonkeyPatch) -> None:
    controls = parse_controls(["exposure=78", "focus=auto", "format=mjpg"])
    said: list[str] = []
    world = VirtualWorld(picture=idle)
    device = opened(monkeypatch, world, controls=controls, report=said.append)
    driver = device._camera.held
    assert driver[cv2.CAP_PROP_EXPOSURE] == 78.0
    assert cv2.CAP_PROP_AUTO_EXPOSURE not in [k for k, value in world.last.asked if value == AUTO]
    assert driver[cv2.CAP_PROP_AUTOFOCUS] == 1.0
    assert driver[cv2.CAP_PROP_FOURCC] == MJPG
    assert "left automatic focus" in said[0]
    assert device.grab()
    image = device.retrieve()
    assert image is not None
    assert image.mean() == pytest.approx(0.5 * IDLE.mean(), rel=0.02)


def test_the_light_of_today_counts_and_not_the_lock_of_yesterday(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = VirtualWorld(picture=idle)
    opened(monkeypatch, world).release()
    world.last.held[cv2.CAP_PROP_FOCUS] = 12.0
    world.exposure = 200.0
    device = opened(monkeypatch, world)
    assert (device.locked["exposure"], device.locked["focus"]) == (200.0, 12.0)
    assert world.last.held[cv2.CAP_PROP_AUTO_EXPOSURE] == MANUAL
    # What is to stay automatic is so again; focus is not started unless it is requested.
    controls = parse_controls(["exposure=78", "white_balance=auto"])
    opened(monkeypatch, world, controls=controls)
    assert world.last.held[cv2.CAP_PROP_AUTO_WB] == 1.0
    modes = {key: value for key, value in world.last.asked if key == cv2.CAP_PROP_AUTOFOCUS}
    assert modes == {cv2.CAP_PROP_AUTOFOCUS: 0.0}


@pytest.mark.parametrize("text", ["exposure", "exposure=", "zoom=3", "gain=x", "format=h264"])
def test_unknown_settings_are_rejected(text: str) -> None:
    with refused("camera-control-unknown"):
        parse_controls([text])


def test_what_the_driver_lacks_refuses_or_lies_about_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = VirtualWorld(
        picture=idle,
        lack={cv2.CAP_PROP_FOCUS, cv2.CAP_PROP_AUTOFOCUS},
        refuse={cv2.CAP_PROP_AUTO_WB},
        lie={cv2.CAP_PROP_AUTO_EXPOSURE: AUTO, cv2.CAP_PROP_GAIN: 90.0},
    )
    said: list[str] = []
    device = opened(monkeypatch, world, report=said.append, controls={"gain": 10.0})
    assert device.absent == ["focus"]
    assert device.refused == [
        "exposure (stays automatic: requested mode 1, it reports 3)",
        "gain=10 (accepted, and it reports 90)",
        "white_balance (stays automatic: requested mode 0, it reports 1)",
    ]
    assert "has no focus; REFUSED exposure" in said[0]
    assert "v4l2-ctl" in said[0]
    # Only what the driver holds counts as locked.
    assert device.locked == {"gain": 90.0}
    # Its range ends below.
    world = VirtualWorld(picture=idle, refuse={cv2.CAP_PROP_EXPOSURE})
    device = opened(monkeypatch, world, controls={"exposure": 900.0})
    assert device.refused == ["exposure=900 (rejected, and it reports 156)"]


def test_a_picture_that_changes_when_locked_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some cameras report another exposure than the one that their automatic control has."""
    world = VirtualWorld(picture=idle, lie={cv2.CAP_PROP_EXPOSURE: 60.0})
    (text,) = [t for t in opened(monkeypatch, world).refused if "brightness" in t]
    assert "factor of 0.3" in text


def test_automatic_control_that_begins_late_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty steady frames, and only then white balance moves, at constant brightness."""

    def late(number: int) -> ImageArray:
        blue = 100 + 3 * min(max(number - 20, 0), 20)
        return np.full((120, 160, 3), (blue, 130, 260 - blue), dtype=np.uint8)

    settings = CaptureSettings(warm_up_least_s=0.15)
    world = VirtualWorld(picture=late)
    # A clock that counts pictures: a busy machine would skip those before the change.
    clock = SimpleNamespace(monotonic=lambda: world.period_s * world.last.number, sleep=time.sleep)
    monkeypatch.setattr(camera_device, "time", clock)
    opened(monkeypatch, world, settings=settings)
    # Frames 40 to 49 are the first ten that are steady, within 2 %; ten more follow the lock.
    assert world.last.number >= 55


def test_brightness_that_does_not_settle_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def brighter(number: int) -> ImageArray:
        return np.full((120, 160, 3), 20 + 3 * max(number, 0) % 200, dtype=np.uint8)

    settings = CaptureSettings(warm_up_s=0.2, warm_up_least_s=0.0)
    device = opened(monkeypatch, VirtualWorld(picture=brighter), settings=settings)
    assert device.refused[0] == "to settle (its brightness still changes after 0.2 s)"


@pytest.mark.parametrize(
    ("size", "fps", "modes", "wanted"),
    [
        ((640, 480), 30.0, {}, YUYV),  # 18.4 MB/s
        ((640, 480), 60.0, {}, MJPG),  # 36.9 MB/s
        ((1280, 720), None, {}, MJPG),
        ((1280, 720), 10.0, {}, YUYV),
        # The driver knows better.
        ((640, 480), 30.0, {YUYV: 15.0, MJPG: 60.0}, MJPG),
        ((640, 480), 60.0, {YUYV: 60.0, MJPG: 30.0}, YUYV),
    ],
)
def test_the_pixel_format_follows_from_size_and_rate(
    monkeypatch: pytest.MonkeyPatch,
    size: tuple[int, int],
    fps: float | None,
    modes: dict[float, float],
    wanted: float,
) -> None:
    image = np.zeros((size[1], size[0], 3), dtype=np.uint8)
    world = VirtualWorld(picture=lambda _: image, modes=modes)
    device = opened(monkeypatch, world, size_px=size, fps=fps)
    assert world.last.held[cv2.CAP_PROP_FOURCC] == wanted
    assert not [text for text in device.refused if "fps" in text or "format" in text]


def test_a_rate_that_no_format_gives_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    world = VirtualWorld(picture=idle, modes={YUYV: 30.0, MJPG: 30.0})
    device = opened(monkeypatch, world, fps=480.0)
    assert device.refused == ["fps 480 (it reports 30)"]
    # OpenCV says that it took a format, and uses another.
    lying = VirtualWorld(picture=idle, lie={cv2.CAP_PROP_FOURCC: YUYV})
    device = opened(monkeypatch, lying, controls={"format": "mjpg"})
    assert device.refused == ["format MJPG"]


def test_another_size_is_refused_on_opening(monkeypatch: pytest.MonkeyPatch) -> None:
    big = np.zeros((480, 640, 3), dtype=np.uint8)
    world = install(monkeypatch, VirtualWorld(picture=lambda _: big, size_px=(640, 480)))
    with refused("camera-size") as caught:
        open_source(["0"], sizes_px=[SIZE], report=lambda _: None)
    caught.match("640x480.*160x120.*rebuild the design")
    assert world.last.released


def test_a_camera_that_gives_no_picture_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    world = install(monkeypatch, VirtualWorld(picture=idle, frames=0), warm_up_s=0.1)
    with refused("camera-no-picture"):
        open_source(["0"], sizes_px=[SIZE], report=lambda _: None)
    assert world.last.released


def test_rest_frames_and_stream_are_of_one_opened_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    world = install(monkeypatch, VirtualWorld(picture=idle, dark_frames=5.0))
    source = open_source(["0"], sizes_px=[SIZE], report=lambda _: None)
    (rest,) = first_frames(source, 4).mean
    source.restart()
    frame = next(iter(source))
    source.close()
    assert len(world.opened) == 1
    assert frame.number < 3
    assert rest.mean() == pytest.approx(IDLE.mean(), rel=0.03)
    np.testing.assert_array_equal(rest, frame.images[0])


def streamed(
    world: VirtualWorld,
    events: Callable[[Message, int], None],
    reported: list[str] | None = None,
    check: Callable[..., Any] = lambda decode: decode,
) -> list[Message]:
    """Messages of a stream until ``events`` (called with each and its number) stops it."""
    source = open_source(
        ["0"], sizes_px=[SIZE], report=reported.append if reported is not None else lambda _: None
    )
    bundle, sent = toy_bundle(), list[Message]()

    def publish(message: Message) -> None:
        sent.append(message)
        events(message, len(sent) - 1)

    stream = Stream(
        source=source,
        decode=check(frame_decoder(bundle)),
        messages=MessageBuilder(bundle=bundle, estimator="koi_inverse"),
        publish=publish,
        report=lambda _: None,
    )
    try:
        stream.run()
    except StopIteration:
        pass
    finally:
        source.close()
    assert world.opened
    return sent


def test_an_unplugged_camera_is_reported_and_comes_back_with_its_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = VirtualWorld(picture=lambda _: PRESSED, period_s=0.02)
    install(monkeypatch, world, lost_s=0.5, give_up_s=30.0)
    reported: list[str] = []
    away = 1.6

    def events(message: Message, number: int) -> None:
        if number == 10:
            # Automatic exposure would settle elsewhere.
            world.plugged, world.exposure = False, 300.0
            world.drivers.clear()
            threading.Timer(away, lambda: setattr(world, "plugged", True)).start()
        if len(world.opened) > 1 and message["valid"] and number > 14:
            raise StopIteration

    sent = streamed(world, events, reported)
    lost = [message for message in sent if not message["valid"]]
    assert len(lost) >= 2
    for message in lost:
        # No repeated last value.
        assert (message["code"], message["contacts"], message["koi"]) == ("camera-lost", [], [])
        assert message["total_N"] == 0.0
        assert message["gap_s"] >= 0.5
    back = next(m for m in sent if m["valid"] and "gap_s" in m)
    assert away <= back["gap_s"] < away + 2.0
    assert "take a new rest frame" in back["warnings"][-1]
    assert back["total_N"] == pytest.approx(3.0, abs=0.15)
    numbers = [message["sequence"] for message in sent]
    assert numbers == sorted(set(numbers))
    # So many frames would have come.
    assert numbers[sent.index(back)] - 10 > 0.5 * away / world.period_s
    assert world.last.held[cv2.CAP_PROP_AUTO_EXPOSURE] == MANUAL
    assert world.last.held[cv2.CAP_PROP_EXPOSURE] == 156.0
    assert any("is opened again" in text for text in reported)
    assert any("is back after" in text for text in reported)
    # Before it was lost, and from the second frame after, nothing is said of a gap.
    assert all("gap_s" not in message for message in sent[:10])


def test_a_camera_that_stays_away_ends_the_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    world = install(monkeypatch, VirtualWorld(picture=idle))

    def events(_message: Message, number: int) -> None:
        world.plugged = world.plugged and number < 3

    with refused("camera-silent"):
        streamed(world, events)
    assert all(camera.released for camera in world.opened)


def test_rest_frames_of_a_camera_that_is_lost_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, VirtualWorld(picture=idle, frames=30), give_up_s=5.0)
    source = open_source(["0"], sizes_px=[SIZE], report=lambda _: None)
    with refused("rest-frames-interrupted"):
        first_frames(source, 100)
    source.close()


@pytest.mark.parametrize(
    ("last", "steady"),
    [
        (lambda: IDLE, True),
        (lambda: toy_frame({14: 0.6}), False),  # one switch is on
        (lambda: np.roll(IDLE, 1, axis=0), False),  # the camera moved
        # Pressed below the switches' threshold: some markers moved, which have no red tip.
        (lambda: np.vstack([np.roll(IDLE[:40], 1, axis=1), IDLE[40:]]), False),
    ],
)
def test_rest_frames_are_those_of_a_sensor_at_rest(
    tmp_path: Path, last: Callable[[], ImageArray], *, steady: bool
) -> None:
    rng = np.random.default_rng(0)
    for number in range(6):
        image = IDLE if number < 3 else last()
        noisy = np.clip(image + rng.normal(0.0, 4.0, image.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(tmp_path / f"{number}.png"), noisy)
    if steady:
        (mean,) = take_rest_frames(toy_bundle(), open_source([str(tmp_path)]), 6)
        assert np.abs(mean.astype(float) - IDLE).mean() < 2.0
    else:
        with refused("rest-frames-unsteady"):
            take_rest_frames(toy_bundle(), open_source([str(tmp_path)]), 6)


@pytest.mark.parametrize("count", [1, 3])
def test_rest_frames_of_a_pressed_sensor_are_refused(tmp_path: Path, count: int) -> None:
    for number in range(count):
        cv2.imwrite(str(tmp_path / f"{number}.png"), toy_frame({14: 3.0}))
    with refused("rest-frame-pressed"):
        take_rest_frames(toy_bundle(), open_source([str(tmp_path)]), count)


def test_single_damaged_pictures_are_skipped_without_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    world = install(monkeypatch, VirtualWorld(picture=idle, torn=lambda n: n % 5 == 4), lost_s=5.0)

    def events(_message: Message, number: int) -> None:
        if number == 20:
            raise StopIteration

    sent = streamed(world, events)
    assert all(message["valid"] and "gap_s" not in message for message in sent)
    assert sent[-1]["missed"] >= 3
    assert len(world.opened) == 1


def test_a_size_that_changes_in_mid_stream_makes_frames_invalid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    half = np.ascontiguousarray(PRESSED[::2, ::2])
    world = install(
        monkeypatch, VirtualWorld(picture=lambda n: PRESSED if n < 40 else half), lost_s=5.0
    )

    def events(message: Message, _number: int) -> None:
        if not message["valid"]:
            raise StopIteration

    *good, last = streamed(world, events)
    assert good
    assert all(message["valid"] for message in good)
    assert (last["code"], last["total_N"]) == ("frame-size", 0.0)
    assert "80x60" in last["warnings"][0]


@pytest.mark.parametrize(
    ("pump", "always", "warned"),
    [
        (0.2, True, True),  # a driver that says manual, and pumps
        (0.02, True, False),
        (0.2, False, False),  # locked, it no longer pumps
    ],
)
def test_pumping_exposure_is_found_on_frames(
    monkeypatch: pytest.MonkeyPatch, *, pump: float, always: bool, warned: bool
) -> None:
    world = VirtualWorld(picture=idle, pump=pump, pump_always=always)
    install(monkeypatch, world, warm_up_s=0.2, lost_s=5.0)

    def events(_message: Message, number: int) -> None:
        if number == 60:
            raise StopIteration

    sent = streamed(world, events, check=with_exposure_check)
    texts = [text for message in sent for text in message["warnings"] if "brightness" in text]
    assert bool(texts) == warned
    assert all("lock them" in text for text in texts)


def test_a_driver_that_refuses_to_lock_pumps_and_both_are_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = VirtualWorld(picture=idle, pump=0.2, refuse={cv2.CAP_PROP_AUTO_EXPOSURE})
    install(monkeypatch, world, warm_up_s=0.2, lost_s=5.0)
    reported: list[str] = []

    def events(message: Message, number: int) -> None:
        if number == 60 or message["warnings"]:
            raise StopIteration

    sent = streamed(world, events, reported, check=with_exposure_check)
    assert "exposure (stays automatic" in reported[0]
    assert "brightness has changed by" in sent[-1]["warnings"][-1]


def test_contacts_shadows_and_slow_light_are_no_pumping() -> None:
    monitor = ExposureMonitor()
    shaded = IDLE.copy()
    shaded[:, :70] //= 2
    noise = np.random.default_rng(0)
    for number in range(120):
        image = (IDLE, PRESSED, shaded)[number % 3]
        # The light grows by 30 % in ten seconds.
        noisy = image * (1.0 + 0.0025 * number) + noise.normal(0.0, 3.0, image.shape)
        frame = np.clip(noisy, 0, 255).astype(np.uint8)
        assert monitor.check([frame], number / 12.0) == []
    # The same in a second is.
    text = [
        monitor.check([np.clip(IDLE * (1.0 + 0.025 * k), 0, 255).astype(np.uint8)], 10.0 + k / 12.0)
        for k in range(12)
    ][-1]
    assert text
    # A recording that begins again, and frames of another size, are compared with nothing.
    assert monitor.check([IDLE], 0.0) == []
    assert monitor.check([IDLE[::2, ::2]], 0.1) == []


@pytest.mark.parametrize("fps", [30.0, 40.0, 60.0, 480.0])
def test_light_that_alternates_from_frame_to_frame_is_noticed(fps: float) -> None:
    monitor = ExposureMonitor()
    dim = (IDLE * 0.75).astype(np.uint8)
    texts = [monitor.check([(IDLE, dim)[k % 2]], k / fps) for k in range(int(fps))]
    assert "brightness has changed by 3" in texts[-1][0]
