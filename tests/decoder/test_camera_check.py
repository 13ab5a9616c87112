"""Figures of a picture against closed forms, and the advice that ``phytac camera`` gives."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from phytac_decoder.io.bundle import Bundle, save_bundle
from phytac_decoder.io.frame import Frame
from phytac_decoder.serving.camera_check import CameraCheck
from phytac_decoder.vision.picture_quality import picture_quality
from phytac_design.cli.app import app
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.decoder.test_marker_detection import lattice
from tests.decoder.test_single_colour import KINDS, drawn, irregular, model_of
from tests.decoder.test_two_views import pair
from tests.decoder.toy_sensor import toy_bundle, toy_frame
from tests.decoder.virtual_camera import VirtualWorld, install

IDLE, TOY = toy_frame(), toy_bundle()
NOISE = np.random.default_rng(0)
FINE = 8


def discs(radius_px: float, blur_px: float) -> tuple[ImageArray, FloatArray]:
    """Nine discs on a light wall, drawn finely, blurred, and averaged over pixels."""
    place = np.array([[x, y] for y in (40.0, 100.0, 160.0) for x in (40.0, 100.0, 160.0)])
    image = np.full((200 * FINE, 200 * FINE, 3), (190, 200, 205), dtype=np.uint8)
    for x, y in np.rint((place + 0.5) * FINE - 0.5).astype(int).tolist():
        cv2.circle(image, (x, y), round(radius_px * FINE), (150, 60, 30), -1)
    if blur_px:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px * FINE), dtype=np.uint8)
    return np.asarray(cv2.resize(image, (200, 200), interpolation=cv2.INTER_AREA)), place


@pytest.mark.parametrize("blur_px", [0.7, 1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("radius_px", [9.0, 15.0])
def test_blur_is_that_of_the_lens(blur_px: float, radius_px: float) -> None:
    image, place = discs(radius_px, blur_px)
    noisy = np.clip(image + NOISE.normal(0.0, 2.0, image.shape), 0, 255).astype(np.uint8)
    squeezed = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])[1], 1)
    for picture in (image, noisy, np.asarray(squeezed, dtype=np.uint8)):
        assert picture_quality(picture, place).blur_px == pytest.approx(blur_px, rel=0.2)


def test_brightness_and_clipping_are_those_around_the_markers() -> None:
    image = np.full((100, 100, 3), 90, dtype=np.uint8)
    image[:, :, 1] = 120
    # Far from the marker nothing counts.
    image[:20] = 255
    place = np.array([[50.0, 60.0], [np.nan, np.nan]])
    quality = picture_quality(image, place)
    assert (quality.brightness, quality.clipped) == (120.0, 0.0)
    assert np.isnan(quality.blur_px)
    # Its window is 49 pixels across.
    image[60:70, 50:60, 2] = 255
    assert picture_quality(image, place).clipped == pytest.approx(100 / 49**2)
    assert np.isnan(picture_quality(image, np.full((2, 2), np.nan)).brightness)


def moved(image: ImageArray, shift_px: float) -> ImageArray:
    matrix = np.array([[1.0, 0.0, shift_px], [0.0, 1.0, 0.0]])
    return np.asarray(
        cv2.warpAffine(image, matrix, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
    )


def checked(
    picture: Callable[[int], ImageArray],
    *,
    rate: float = 20.0,
    fps: float | None = None,
    bundle: Bundle = TOY,
) -> CameraCheck:
    check = CameraCheck(bundle, fps=fps)
    for number in range(round(4.0 * rate)):
        frame = Frame(
            number=number, timestamp_s=number / rate, images=(picture(number),), ready_s=0.0
        )
        check.add(frame)
    return check


def scaled(factor: float) -> ImageArray:
    return np.clip(IDLE * factor, 0, 255).astype(np.uint8)


def test_a_good_picture_is_ready() -> None:
    check = CameraCheck(toy_bundle(), fps=20.0)
    reports = []
    for number in range(61):
        noisy = np.clip(IDLE + NOISE.normal(0.0, 1.0, IDLE.shape), 0, 255).astype(np.uint8)
        frame = Frame(number=number, timestamp_s=0.05 * number, images=(noisy,), ready_s=0.0)
        reports.append(check.add(frame))
    given = [report for report in reports if report]
    assert [report["time_s"] for report in given] == pytest.approx([1.0, 2.0, 3.0])
    (figures,) = given[-1]["cameras"]
    assert (figures["found"], figures["markers"]) == (30, 30)
    assert given[-1]["fps"] == pytest.approx(20.0)
    assert figures["motion_px"] < 0.05
    assert 0.0 < figures["scatter_px"] < 0.1
    assert check.problems() == []


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (lambda _: np.asarray(cv2.GaussianBlur(IDLE, (0, 0), 3.6)), "out of focus"),
        (lambda _: scaled(0.25), "dark"),
        (lambda _: scaled(1.9), "overexposed"),
        (lambda n: moved(IDLE, 0.5 * (n % 2)), "moving: by 0.5"),
        (lambda _: np.where(np.arange(160)[:, None] < 60, 128, IDLE).astype(np.uint8), "markers"),
        (lambda n: IDLE if n < 30 else IDLE[::2, ::2].copy(), "image is 80x60 px"),
        (lambda n: scaled(1.0 + 0.15 * np.sin(0.4 * n)), "brightness has changed"),
        (
            lambda _: np.asarray(cv2.cvtColor(cv2.cvtColor(IDLE, 6), 8)),
            "markers not readable: 0 of ",
        ),
    ],
)
def test_each_fault_is_named(picture: Callable[[int], ImageArray], words: str) -> None:
    problems = checked(picture).problems()
    assert any(words in text for text in problems), problems


def test_noise_is_named() -> None:
    rng = np.random.default_rng(3)

    def noisy(_: int) -> ImageArray:
        return np.clip(IDLE + rng.normal(0.0, 20.0, IDLE.shape), 0, 255).astype(np.uint8)

    fine = replace(TOY, noise_centroid_px=0.015)
    assert any("noisy" in text for text in checked(noisy, bundle=fine).problems())
    assert not any("noisy" in text for text in checked(noisy).problems())


def test_rate_and_damaged_frames_are_named() -> None:
    (text,) = checked(lambda _: IDLE, rate=10.0, fps=30.0).problems()
    assert text.startswith("frame rate low: 10.0 of 30 fps")
    check, report = CameraCheck(toy_bundle()), None
    for number in range(0, 60, 2):
        frame = Frame(number=number, timestamp_s=0.05 * number, images=(IDLE,), ready_s=0.0)
        report = check.add(frame, lost=number // 2) or report
    # Every second one could be read.
    assert report is not None
    assert report["fps"] == pytest.approx(10.0)
    assert check.problems()[0].startswith("frames damaged: 10 of 20")


def test_a_lost_camera_and_too_few_frames_are_no_verdict() -> None:
    check = CameraCheck(toy_bundle())
    assert check.problems() == ["there were too few frames to check"]
    report = check.add(Frame(number=3, timestamp_s=2.0, images=(), ready_s=0.0, gap_s=1.5))
    assert report is not None
    assert "no picture for 1.5 s" in check.problems()[0]


def test_the_camera_of_two_is_named() -> None:
    rest, _, _ = lattice()
    bundle, (near, far) = pair(np.full_like(rest, np.nan))
    check, dark = CameraCheck(bundle), (0.2 * far).astype(np.uint8)
    for number in range(3):
        report = check.add(
            Frame(number=number, timestamp_s=float(number), images=(near, dark), ready_s=0.0)
        )
    assert report is not None
    assert [one["markers"] for one in report["cameras"]] == np.bincount(bundle.read_by).tolist()
    assert any(text.startswith("far camera dark") for text in check.problems())
    assert not any(text.startswith("near camera dark") for text in check.problems())


@pytest.mark.parametrize("good", [True, False])
def test_the_command_reports_and_gives_a_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, good: bool
) -> None:
    decoder = tmp_path / "my decoder"
    save_bundle(toy_bundle(), decoder)
    world = VirtualWorld(picture=lambda _: IDLE if good else scaled(0.25), period_s=0.01)
    if not good:
        world.refuse = {cv2.CAP_PROP_AUTOFOCUS}
    install(monkeypatch, world)
    words = ["camera", str(decoder), "--device", "0", "--seconds", "1.2"]
    done = CliRunner().invoke(app, words)
    *lines, verdict = done.stdout.splitlines()
    assert done.exit_code == (0 if good else 4), done.output
    assert sum("markers" in line and "fps" in line for line in lines) == 1
    if good:
        assert lines[-1].endswith("good")
        assert verdict.startswith(f"ready; next: phytac live '{decoder}' 0")
        assert "--control exposure=156" in verdict
    else:
        assert verdict == "not ready"
        assert any(line.startswith("to change: dark") for line in lines)
        assert any("focus (stays automatic" in line for line in lines)
    assert "locked exposure=156" in done.stderr
    (*_, last) = CliRunner().invoke(app, [*words, "--json"]).stdout.splitlines()
    assert json.loads(last)["ready"] == good


@KINDS
def test_dots_of_one_colour_are_checked_too(paint: str, dot: int, wall: int) -> None:
    place, near = irregular(0)
    base = toy_bundle()
    tips = replace(base.tips, on_px=np.full((30, 2), np.nan), red_on_px=np.zeros(30))
    bundle = replace(
        base,
        colours=model_of(paint),
        colour=np.zeros(30, dtype=np.int64),
        rest_px=place,
        tips=tips,
        model=replace(base.model, neighbours=near),
    )

    def checked_at(gain: float) -> list[str]:
        check = CameraCheck(bundle)
        picture = np.clip(gain * drawn(place, dot, wall), 0, 255).astype(np.uint8)
        for number in range(4):
            check.add(
                Frame(number=number, timestamp_s=float(number), images=(picture,), ready_s=0.0)
            )
        return check.problems()

    assert checked_at(1.0) == []
    assert any("dark" in text for text in checked_at(0.3))


def test_a_recording_that_cannot_be_read_as_fast_says_so(tmp_path: Path) -> None:
    save_bundle(toy_bundle(), tmp_path / "decoder")
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for number in range(20):
        cv2.imwrite(str(pictures / f"{number:03d}.png"), IDLE)
    words = ["camera", str(tmp_path / "decoder"), "--device", str(pictures)]
    done = CliRunner().invoke(app, [*words, "--fps", "100000"])
    assert done.exit_code == 4, done.output
    assert "pictures came too late: they cannot be read at 100000 a second" in done.stdout
    assert "leave out --fps" in done.stdout


def test_a_picture_without_markers_has_no_colour_and_no_focus() -> None:
    check = CameraCheck(TOY)
    blank = np.full_like(IDLE, 90)
    reports = [
        check.add(Frame(number=k, timestamp_s=0.1 * k, images=(blank,), ready_s=0.0))
        for k in range(15)
    ]
    shown = next(report for report in reports if report and report["cameras"])
    assert np.isnan(shown["cameras"][0]["chroma"])
    assert not any("nan" in text for text in check.problems())
    assert check.problems()


def test_a_focus_that_cannot_be_measured_is_no_good_focus() -> None:
    sharp = {"blur_px": 0.8, "blur_max_px": 2.0, "clipped": 0.0, "brightness": 120.0}
    still = {"motion_px": 0.0, "scatter_px": 0.0, "found": 30, "markers": 30}
    check = CameraCheck(TOY)
    assert check._faults(sharp | still, unread=False) == []
    (text,) = check._faults(sharp | still | {"blur_px": np.nan}, unread=False)
    assert text.startswith("focus unknown")
    (text,) = check._faults(sharp | still | {"blur_px": 2.1}, unread=False)
    assert text.startswith("out of focus: edges are blurred by 2.1 px")
