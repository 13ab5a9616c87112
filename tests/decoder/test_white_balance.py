"""Exposure and white balance that change after the rest frame move no marker."""

from collections.abc import Sequence
from dataclasses import replace
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline import decode, light_response, tracker
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.vision.segmentation import ColourModel
from phytac_decoder.vision.white_balance import WhiteBalance
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.decoder.test_calibrate_colours import LIGHTS, lit, plain_bundle, rms
from tests.decoder.test_follow import COUNT, GREY, MODEL, OFF, REST, dent, draw
from tests.refusals import refused

PLACE = dent(np.array([140.0, 110.0]), np.array([5.0, 4.0]))
BITS = np.isin(np.arange(COUNT), (45, 58, 70))


def blended(frame: ImageArray) -> ImageArray:
    """Frame in which many pixels show paint and wall together, as those of small markers do."""
    return np.asarray(cv2.GaussianBlur(frame, (0, 0), 1.5))


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return calibrate_rest(plain_bundle(), draw(REST))


def without(bundle: Bundle) -> Bundle:
    return replace(bundle, white_balance=())


def images_for_edges(monkeypatch: pytest.MonkeyPatch, module: ModuleType) -> list[ImageArray]:
    """Images in which a module reads edges from now on."""
    seen: list[ImageArray] = []
    with_edges = decode.with_edges

    def spied(of: Bundle, images: Sequence[ImageArray], *given: Any) -> FloatArray:
        seen.extend(images)
        return with_edges(of, images, *given)

    monkeypatch.setattr(module, "with_edges", spied)
    return seen


@pytest.mark.parametrize("light", [*LIGHTS, "much warmer"])
def test_markers_and_switches_survive_a_change_after_the_rest_frame(
    bundle: Bundle, light: str
) -> None:
    gains = LIGHTS.get(light, (0.55, 0.9, 1.3))
    frame = draw(PLACE, BITS, seed=2)
    usual, seen = measure_frame(bundle, frame), measure_frame(bundle, lit(frame, gains))
    assert seen.found.all()
    assert seen.koi.tolist() == np.flatnonzero(BITS).tolist()
    # The noise of the frame is the same.
    assert rms(seen.shift_px - usual.shift_px) < 0.012


def test_markers_whose_edges_mix_with_the_wall_move_less() -> None:
    bundle = calibrate_rest(plain_bundle(), blended(draw(REST)))
    bundle = replace(bundle, edges=())
    frame = blended(draw(PLACE, seed=2))
    warm = lit(frame, (1.0, 1.0, 0.85))
    usual = measure_frame(bundle, frame).shift_px
    error = rms(measure_frame(bundle, warm).shift_px - usual)
    plain = without(bundle)
    assert error < 0.5 * rms(measure_frame(plain, warm).shift_px - usual)


def test_a_followed_frame_is_brought_back_too(
    bundle: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    edges_seen = images_for_edges(monkeypatch, tracker)
    warm = lit(draw(PLACE, BITS, seed=2), LIGHTS["a stop down and warm"])
    shifts = []
    for frame in (draw(PLACE, BITS, seed=2), warm):
        follower = Follower(bundle, draw(REST))
        for _ in range(3):
            seen = follower.follow(frame)
        assert seen.koi.tolist() == np.flatnonzero(BITS).tolist()
        shifts.append(seen.shift_px)
    assert rms(shifts[1] - shifts[0]) < 0.012
    for image in edges_seen:
        wall = np.median(image.reshape(-1, 3), axis=0)
        assert wall == pytest.approx(np.array(GREY), abs=2.0)


def test_frames_of_the_same_light_are_left_as_they_are(bundle: Bundle) -> None:
    (balance,) = bundle.white_balance
    assert balance is not None
    frame = draw(PLACE, BITS, seed=2)
    assert balance.change(frame) == pytest.approx(np.ones(3), abs=0.01)
    assert balance.as_at_rest(frame) is frame
    # A change that markers do not notice, one of which too little is left, and a clipped wall.
    for gain in (1.01, 0.4, 1.6):
        same = lit(frame, (gain, gain, gain))
        assert balance.as_at_rest(same) is same


def test_changes_are_measured_by_channel_on_the_wall(bundle: Bundle) -> None:
    (balance,) = bundle.white_balance
    assert balance is not None
    frame = lit(draw(PLACE, BITS, seed=2), (0.8, 0.9, 1.1))
    assert balance.change(frame) == pytest.approx([0.8, 0.9, 1.1], abs=0.01)
    back = balance.as_at_rest(frame)
    wall = back.reshape(-1, 3)[balance.pixel]
    assert np.median(wall, axis=0) == pytest.approx(np.array(GREY), abs=1.0)
    # A third of the picture in a hand's shade is no change of the whole.
    shaded = draw(PLACE, BITS, seed=2).astype(np.float64)
    shaded[:, : shaded.shape[1] // 3] *= 0.6
    assert balance.change(shaded.astype(np.uint8)) == pytest.approx(np.ones(3), abs=0.02)


def test_clipped_markers_are_seen_in_the_frame_as_it_is(bundle: Bundle) -> None:
    """A wall that is not clipped makes the frame darker, and the markers' paint with it."""
    (light,) = measure_frame(bundle, lit(draw(PLACE, seed=2), (1.25, 1.25, 1.25))).light
    assert light is not None
    assert light.beyond_range == pytest.approx(1.05, abs=0.03)


def test_the_response_to_light_is_measured_as_frames_are_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = images_for_edges(monkeypatch, light_response)
    calibrate_rest(plain_bundle().with_mount("bench"), draw(REST))
    assert len(seen) == 2
    for image in seen:
        wall = np.median(image.reshape(-1, 3), axis=0)
        assert wall == pytest.approx(np.array(GREY), abs=2.0)


def test_without_a_wall_nothing_is_measured() -> None:
    everywhere = np.full((240, 320, 3), (214, 72, 28), dtype=np.uint8)
    for frame in (everywhere, np.zeros_like(everywhere), np.full_like(everywhere, 255)):
        assert WhiteBalance.at_rest(frame, MODEL, REST) is None
    assert WhiteBalance.at_rest(draw(REST), MODEL, np.full_like(REST, np.nan)) is None
    dots = ColourModel.from_rgb({"white": (250, 250, 250), "red": (214, 30, 34)}, wall=(60, 60, 60))
    assert WhiteBalance.at_rest(draw(REST), dots, REST) is None


def test_a_new_rest_frame_in_another_light_starts_anew(bundle: Bundle) -> None:
    gains = LIGHTS["cold"]
    again = calibrate_rest(bundle, lit(draw(REST), gains))
    seen = measure_frame(again, lit(draw(REST, OFF, seed=3), gains))
    assert rms(seen.shift_px) < 0.03
    (balance,) = again.white_balance
    assert balance is not None
    assert np.median(balance.level, axis=0) == pytest.approx(np.array(GREY) * gains, abs=1.0)


def test_a_frame_of_another_size_is_refused(bundle: Bundle) -> None:
    with refused("frame-size"):
        measure_frame(bundle, draw(REST)[:200])
