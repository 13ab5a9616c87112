"""Red light on some of the markers, and overexposure: what is measured, and the warnings."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import FrameMeasurement, measure_frame
from phytac_decoder.pipeline.frame_reading import read
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.vision.picture_quality import LightChange, LightCheck
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray
from tests.decoder.toy_sensor import toy_bundle, toy_frame

REST = toy_frame()
PLACES: FloatArray = np.stack(np.meshgrid(np.arange(10, 160, 15), np.arange(10, 120, 15)), -1)
PLACES = PLACES.reshape(-1, 2).astype(np.float64)
NONE = np.zeros(len(PLACES), dtype=np.bool_)


@pytest.fixture(scope="module")
def toy() -> Bundle:
    return calibrate_rest(toy_bundle(), REST)


def dots() -> ImageArray:
    """Markers of two paints, whose red varies."""
    image = np.full((120, 160, 3), 90, dtype=np.uint8)
    for number, (x, y) in enumerate(PLACES.astype(int).tolist()):
        paint = (200, 60, 20 + number % 7) if number % 2 else (50, 150, 40 + number % 5)
        cv2.circle(image, (x, y), 4, paint, -1)
    return image


def glow(image: ImageArray, height: float, channel: int = 2) -> ImageArray:
    """Light of one colour around a place on the right."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    light = np.zeros(image.shape)
    light[:, :, channel] = height * np.exp(-((x - 120.0) ** 2 + (y - 60.0) ** 2) / 30.0**2)
    return np.clip(image + light, 0, 255).astype(np.uint8)


def change(image: ImageArray, places: FloatArray = PLACES, red: BoolArray = NONE) -> LightChange:
    check = LightCheck.at_rest(dots(), PLACES)
    assert check is not None
    found = check.change(image, places, red)
    assert found is not None
    return found


def share(image: ImageArray) -> float:
    return change(image).red_share


def test_red_on_some_markers_is_seen() -> None:
    image = dots()
    assert share(image) == 0.0
    gap = np.hypot(*(PLACES - [120.0, 60.0]).T)
    top = np.where(np.arange(len(PLACES)) % 2, 200.0, 150.0)
    wanted = float(np.mean(60.0 * np.exp(-((gap / 30.0) ** 2)) > 0.06 * top))
    assert share(glow(image, 60.0)) == pytest.approx(wanted, abs=0.05)
    assert wanted > LightCheck.share_max
    # Less red than that on a marker is none.
    assert share(glow(image, 6.0)) == 0.0


@pytest.mark.parametrize(
    "altered",
    [
        lambda image: image * 0.6,
        lambda image: image * np.array([1.0, 1.0, 1.3]),
        lambda image: image * 0.8 + 40.0,
        lambda image: glow(image, 60.0, channel=0),
    ],
    ids=["exposure", "white balance", "stray light", "blue"],
)
def test_what_changes_the_red_of_all_alike_is_no_red_light(
    altered: Callable[[ImageArray], FloatArray],
) -> None:
    assert share(np.clip(altered(dots()), 0, 255).astype(np.uint8)) == 0.0


def test_of_many_markers_evenly_many_are_taken() -> None:
    many = np.stack(np.meshgrid(np.arange(5, 155, 5), np.arange(5, 115, 5)), -1).reshape(-1, 2)
    check = LightCheck.at_rest(dots(), many.astype(np.float64))
    assert check is not None
    assert len(check.ids) == LightCheck.markers_max
    assert (check.ids[0], check.ids[-1]) == (0, len(many) - 1)
    assert np.diff(check.ids).max() == np.ceil(len(many) / len(check.ids))


def test_shade_on_a_part_is_no_red_light() -> None:
    dark = dots()
    dark[:, :60] //= 2
    assert share(dark) == 0.0


def test_markers_with_red_tips_or_not_found_do_not_count() -> None:
    image, red = dots(), NONE.copy()
    red[::4] = True
    for x, y in PLACES[red].astype(int).tolist():
        cv2.circle(image, (x, y), 4, (40, 40, 220), -1)
    assert share(image) == pytest.approx(0.25, abs=0.02)
    assert change(image, red=red).red_share == 0.0
    gone = np.where(red[:, None], np.nan, PLACES)
    assert change(image, gone).red_share == 0.0
    gone[PLACES[:, 0] > 30.0] = [158.9, 60.0]
    check = LightCheck.at_rest(dots(), PLACES)
    assert check is not None
    assert check.change(image, gone, NONE) is None
    assert LightCheck.at_rest(image, gone) is None


@pytest.mark.parametrize(("exposure", "factor"), [(1.4, 0.0), (1.8, 1.8), (2.0, 2.0)])
def test_overexposure_is_how_far_markers_are_beyond_the_range(
    exposure: float, factor: float
) -> None:
    # The brightest channel is 200 on one half of the markers, 150 on the other.
    def lit(image: ImageArray) -> ImageArray:
        return np.clip(exposure * image, 0, 255).astype(np.uint8)

    wanted = factor * 175.0 / 255.0
    assert change(lit(dots())).beyond_range == pytest.approx(wanted, rel=0.02)
    # Of paints with two bright channels, the dim one alone shows the exposure.
    cyan = dots()
    cyan[:, :, :2] = cyan[:, :, :2].max(axis=2, keepdims=True)
    check = LightCheck.at_rest(cyan, PLACES)
    assert check is not None
    np.testing.assert_allclose(check.level[:2], [[150.0, 150.0, 40.0], [200.0, 200.0, 21.0]])
    found = check.change(lit(cyan), PLACES, NONE)
    assert found is not None
    assert found.beyond_range == pytest.approx(wanted, rel=0.03)


def test_a_picture_of_less_contrast_is_not_overexposed() -> None:
    veiled = (0.5 * dots() + 120.0).astype(np.uint8)
    assert change(veiled).beyond_range == 0.0


def warned(bundle: Bundle, measured: FrameMeasurement) -> bool:
    return any("have more red" in text for text in read(bundle, measured, "koi_inverse").warnings)


def test_every_frame_is_checked(toy: Bundle) -> None:
    follower, pressed = Follower(toy, REST), toy_frame({8: 3.0})
    lit = pressed.copy()
    # On markers alone, beside the tips.
    for x, y in np.rint(toy.rest_px[18:]).astype(int).tolist():
        lit[y - 1 : y + 2, x - 1 : x + 2, 2] += 60
    for frame, wanted in ((pressed, 0.0), (lit, 12.0 / 29.0)):
        seen, followed = measure_frame(toy, frame), follower.follow(frame)
        assert seen.light == followed.light
        assert seen.light[0] is not None
        assert seen.light[0].red_share == pytest.approx(wanted)
        assert warned(toy, seen) == warned(toy, followed) == (wanted > 0.0)
    assert measure_frame(toy_bundle(), REST).light == ()


def test_it_names_the_camera(toy: Bundle) -> None:
    two = replace(toy, cameras=toy.cameras * 2)
    light = (None, LightChange(red_share=0.4, beyond_range=1.44))
    measured = replace(measure_frame(toy, REST), light=light)
    texts = measured.warnings(two, np.zeros(30))
    (text,) = [text for text in texts if "more red" in text]
    assert "40 % of the markers of the far camera have" in text
    (text,) = [text for text in texts if "overexposed" in text]
    assert "most markers of the far camera are clipped" in text
    assert "1.4 times as bright" in text
