"""Motion of a camera since the rest frame: estimated beside contacts, so that it is no force."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.camera_motion import MOUNTS, CameraMotion, tabulate_camera_motion
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import MARKERS, flat_locator, nearest, shifts

CAMERA = Camera.on_axis(width_px=640, height_px=480, focal_px=400.0, stand_off_mm=55.0)
"""Above the middle of the flat sensor, which lies at z = 0."""
CAMERA = replace(CAMERA, position_mm=np.array([30.0, 30.0, -55.0]))
NOISE_PX = 0.02
MOTIONS = {
    "x 0.1 mm": [0.1, 0, 0, 0, 0, 0, 0],
    "z 0.1 mm": [0, 0, 0.1, 0, 0, 0, 0],
    "tilt 0.1 deg": [0, 0, 0, 0, 1.7e-3, 0, 0],
    "roll 0.1 deg": [0, 0, 0, 0, 0, 1.7e-3, 0],
    "zoom 0.1 %": [0, 0, 0, 0, 0, 0, 1e-3],
    "all": [0.05, -0.08, 0.06, 1e-3, -1.2e-3, 8e-4, -7e-4],
}


def moved(camera: Camera, b: list[float]) -> Camera:
    """The camera after a motion, by OpenCV's rotation and none of the code under test."""
    lens = replace(
        camera.lens, fx_px=camera.lens.fx_px * (1 + b[6]), fy_px=camera.lens.fy_px * (1 + b[6])
    )
    turn = cv2.Rodrigues(np.array(b[3:6], dtype=np.float64))[0]
    return Camera(
        lens=lens,
        position_mm=camera.position_mm + np.array(b[:3]),
        rotation=camera.rotation @ turn.T,
    )


def true_shift(b: list[float], camera: Camera = CAMERA) -> FloatArray:
    return np.asarray((moved(camera, b).project(MARKERS) - camera.project(MARKERS)).ravel())


def motion(mount: str = "bench") -> CameraMotion:
    reader = np.zeros(len(MARKERS), dtype=np.int64)
    return tabulate_camera_motion([CAMERA], reader, MARKERS, MOUNTS[mount])


@pytest.mark.parametrize("name", MOTIONS)
def test_tables_of_second_order_agree_with_the_projection(name: str) -> None:
    b = 3.0 * np.array(MOTIONS[name])
    exact = true_shift(b.tolist())
    np.testing.assert_allclose(motion().shift_px(b), exact, atol=2e-3)
    # First order alone would not do.
    if name == "all":
        assert np.abs(b @ motion().first - exact).max() > 0.01


@pytest.mark.parametrize("name", MOTIONS)
def test_forces_are_those_without_the_motion(name: str) -> None:
    rng = np.random.default_rng(3)
    at = np.array([21.0, 34.0, 0.0])
    noise = NOISE_PX * rng.normal(size=2 * len(MARKERS))
    pressed = shifts(at, 8.0) + noise
    koi = np.array([nearest(at)])
    plain = flat_locator(noise_px=NOISE_PX)
    ready = replace(plain, camera_motion=motion())
    (still,) = ready.find(pressed.reshape(-1, 2), koi).contacts
    seen = (pressed + true_shift(MOTIONS[name])).reshape(-1, 2)
    found = ready.find(seen, koi)
    (contact,) = found.contacts
    assert contact.force_N == pytest.approx(still.force_N, abs=0.02)
    assert contact.force_N == pytest.approx(8.0, abs=4.0 * contact.raw_sd_N)
    assert np.linalg.norm(contact.point_mm - still.point_mm) < 0.02
    error = found.motion - MOTIONS[name]
    assert (np.abs(error) < 4.0 * found.motion_sd).all()
    # Without the unknowns of the camera the force, or the number of contacts, is wrong.
    wrong = plain.find(seen, koi).contacts
    assert len(wrong) != 1 or abs(wrong[0].force_N - 8.0) > 0.3


def test_spread_of_forces_grows_by_what_the_motion_leaves_open() -> None:
    at = np.array([30.0, 30.0, 0.0])
    koi, seen = np.array([nearest(at)]), shifts(at, 8.0).reshape(-1, 2)
    plain = flat_locator(noise_px=NOISE_PX)
    spread = [
        replace(plain, camera_motion=camera).find(seen, koi).contacts[0].raw_sd_N
        for camera in (None, motion("rigid"), motion("handheld"))
    ]
    assert spread[0] < spread[1] < spread[2]


def test_a_motion_beyond_the_mount_is_named() -> None:
    table = motion("rigid")
    assert table.excess(np.array([0.05, 0, 0, 0, 0, 0, 0])) == []
    (text,) = table.excess(np.array([0.3, 0, 0, 0, 0.01, 0, 0]))
    assert "moved by 300 µm" in text
    assert "turned by 0.57°" in text


def test_two_cameras_move_apart() -> None:
    reader = np.arange(len(MARKERS)) % 2
    table = tabulate_camera_motion([CAMERA, CAMERA], reader, MARKERS, MOUNTS["bench"])
    b = np.array([*MOTIONS["all"], *(0.0 for _ in range(7))])
    got = table.shift_px(b).reshape(-1, 2)
    np.testing.assert_allclose(got[reader == 1], 0.0, atol=1e-12)
    want = true_shift(MOTIONS["all"]).reshape(-1, 2)
    np.testing.assert_allclose(got[reader == 0], want[reader == 0], atol=2e-3)


def test_residuals_beyond_noise_widen_the_spread() -> None:
    """Whatever disturbs the markers: forces are no surer than the residuals allow."""
    at, rng = np.array([27.0, 33.0, 0.0]), np.random.default_rng(5)
    koi, ready = np.array([nearest(at)]), flat_locator(noise_px=NOISE_PX)
    ready = replace(ready, camera_motion=motion())
    found = []
    for noise_px in (NOISE_PX, 4.0 * NOISE_PX):
        noisy = shifts(at, 8.0) + noise_px * rng.normal(size=2 * len(MARKERS))
        found.append(ready.find(noisy.reshape(-1, 2), koi).contacts[0].raw_sd_N)
    assert found[1] > 3.0 * found[0]
