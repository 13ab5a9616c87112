"""The focus of a frame: blur against the kernel that made it, and the warning of every frame."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import FrameMeasurement, measure_frame
from phytac_decoder.pipeline.frame_reading import read
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.serving.camera_check import CameraCheck
from phytac_decoder.vision.matching import Matched, areas_px
from phytac_decoder.vision.picture_quality import FocusCheck
from phytac_decoder.vision.segmentation import Blobs
from phytac_shapes.arrays import ImageArray
from tests.decoder.test_camera_check import checked, discs
from tests.decoder.toy_sensor import toy_bundle, toy_frame

REST = toy_frame()


@pytest.fixture(scope="module")
def toy() -> Bundle:
    return calibrate_rest(toy_bundle(), REST)


def blurred(image: ImageArray, sigma_px: float) -> ImageArray:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), dtype=np.uint8)


@pytest.mark.parametrize("blur_px", [0.7, 1.5, 3.0])
def test_blur_of_large_and_small_discs(blur_px: float) -> None:
    image, place = discs(12.0, blur_px)
    check = FocusCheck.at_rest(image, place, np.full(9, np.pi * 12.0**2))
    assert check is not None
    assert check.blur_px(image, place) == pytest.approx(blur_px, rel=0.1)


@pytest.mark.parametrize("kernel", [np.ones((1, 9)), np.ones((9, 1))])
def test_motion_blur_counts_in_either_direction(kernel: np.ndarray) -> None:
    image, place = discs(12.0, 0.5)
    check = FocusCheck.at_rest(image, place, np.full(9, np.pi * 12.0**2))
    assert check is not None
    smeared = np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), dtype=np.uint8)
    # Standard deviation of nine pixels in a row; a box is no Gaussian.
    assert check.blur_px(smeared, place) == pytest.approx(np.sqrt((9**2 - 1) / 12.0), rel=0.25)


def test_the_limit_is_that_of_small_markers() -> None:
    radius = np.concatenate([np.full(6, 3.0), np.full(26, 9.0), np.full(8, 20.0)])
    rng = np.random.default_rng(1)
    place = rng.uniform(150, 350, (40, 2))
    noise = rng.integers(0, 255, (500, 500, 3), dtype=np.uint8)
    area = np.pi * radius**2
    area[3], place[8] = np.nan, np.nan
    check = FocusCheck.at_rest(noise, place, area)
    assert check is not None
    assert check.limit_px == pytest.approx(np.hypot(0.5, 3.0 / 3.0))
    assert set(check.ids) < set(range(6, 32)) - {8}
    assert check.half_px == 14
    large = FocusCheck.at_rest(noise, place, 100.0 * area)
    assert large is not None
    assert large.limit_px == FocusCheck.most_px
    assert FocusCheck.at_rest(noise, place, np.full(40, np.nan)) is None
    # Markers as bright as the wall show no edge.
    assert FocusCheck.at_rest(np.full_like(noise, 90), place, area) is None


def test_markers_at_the_border_or_not_found_do_not_count() -> None:
    image, place = discs(12.0, 1.0)
    check = FocusCheck.at_rest(image, place, np.full(9, np.pi * 12.0**2))
    assert check is not None
    gone = place.copy()
    gone[:4] = np.nan
    gone[4] = 1.0
    assert check.blur_px(image, gone) == pytest.approx(check.blur_px(image, place), abs=0.05)
    assert np.isnan(check.blur_px(image, np.full((9, 2), np.nan)))


def warned(bundle: Bundle, measured: FrameMeasurement) -> bool:
    return any(
        "edges are blurred" in text for text in read(bundle, measured, "koi_inverse").warnings
    )


def test_every_frame_is_checked(toy: Bundle) -> None:
    follower, pressed = Follower(toy, REST), toy_frame({8: 3.0})
    for sigma, doubtful in ((0.0, False), (0.7, False), (1.6, True)):
        frame = blurred(pressed, sigma) if sigma else pressed
        seen, followed = measure_frame(toy, frame), follower.follow(frame)
        assert seen.blur_px == pytest.approx(followed.blur_px, abs=0.05)
        assert warned(toy, seen) == warned(toy, followed) == doubtful


def test_a_blurred_rest_frame_does_not_hide_it() -> None:
    lit = calibrate_rest(toy_bundle(), blurred(REST, 1.6))
    assert warned(lit, measure_frame(lit, blurred(toy_frame({8: 3.0}), 1.6)))


def test_without_a_rest_frame_nothing_is_measured() -> None:
    bundle = toy_bundle()
    assert measure_frame(bundle, REST).blur_px == ()


def test_the_camera_check_uses_the_same_limit(toy: Bundle) -> None:
    (focus,) = toy.focus
    assert focus is not None
    assert focus.limit_px < CameraCheck(toy).limits.blur_px
    soft = blurred(REST, 1.6)
    (text,) = [text for text in checked(lambda _: soft).problems() if "focus" in text]
    assert f"at most {focus.limit_px:.1f}" in text


def test_a_frame_without_an_edge_is_doubtful(toy: Bundle) -> None:
    measured = replace(measure_frame(toy, REST), blur_px=(np.nan,))
    (text,) = [text for text in measured.warnings(toy, np.zeros(30)) if "edge" in text]
    assert "no marker's edge" in text


def test_it_names_the_camera(toy: Bundle) -> None:
    two = replace(toy, cameras=toy.cameras * 2, focus=toy.focus * 2)
    measured = replace(measure_frame(toy, REST), blur_px=(0.5, 3.0))
    (text,) = [text for text in measured.warnings(two, np.zeros(30)) if "edges" in text]
    assert "of the far camera" in text


def test_the_area_of_a_marker_is_that_of_its_own_paint_alone() -> None:
    blobs = Blobs(
        colour=np.array([0, 1, 0, 0]),
        centroid_px=np.array([[10.0, 10.0], [11.0, 10.0], [30.0, 10.0], [50.0, 10.0]]),
        area_px=np.array([30, 40, 50, 60]),
        weight=np.array([3.0, 4.0, 5.0, 6.0]),
        box_px=np.zeros((4, 4), dtype=np.int64),
    )
    place = np.array([[11.2, 10.0], [10.0, 10.0], [30.0, 10.0], [50.0, 10.0], [np.nan, np.nan]])
    matched = Matched(
        position_px=place,
        found=np.isfinite(place[:, 0]),
        merged=np.array([False, False, False, True, False]),
    )
    area = areas_px(matched, blobs, np.array([0, 1, 0, 0, 1]))
    np.testing.assert_array_equal(area, [3.0, 4.0, 5.0, np.nan, np.nan])
