"""The pinhole camera: inverse pairs and derivatives."""

import numpy as np

from phytac_decoder.camera.camera import Camera

CAMERA = Camera.on_axis(width_px=2592, height_px=1944, focal_px=970, stand_off_mm=30)


def cloud(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform([-30, -30, 0], [30, 30, 120], (50, 3))


def test_rays_invert_project() -> None:
    points = cloud()
    rays = CAMERA.rays(CAMERA.project(points))
    toward = points - CAMERA.position_mm
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    assert np.abs(rays - toward).max() < 1e-12


def test_jacobian_matches_differences() -> None:
    points, step = cloud(1), 1e-5
    exact = CAMERA.jacobian(points)
    for axis in range(3):
        move = step * np.eye(3)[axis]
        slope = (CAMERA.project(points + move) - CAMERA.project(points - move)) / (2 * step)
        assert np.allclose(exact[:, :, axis], slope, rtol=1e-6, atol=1e-6)


def test_behind_the_camera_is_nowhere() -> None:
    assert np.isnan(CAMERA.project(np.array([[1.0, 2.0, -30.0], [1.0, 2.0, -50.0]]))).all()


def test_axis_hits_the_middle_pixel() -> None:
    assert np.allclose(CAMERA.project(np.array([[0.0, 0.0, 5.0]])), [[1295.5, 971.5]])
