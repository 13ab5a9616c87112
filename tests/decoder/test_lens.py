"""Lens models: against OpenCV, there and back, at the rim of the field and behind the camera."""

from typing import Any

import cv2
import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import (
    LENSES,
    BrownConrady,
    KannalaBrandt,
    Lens,
    Omnidirectional,
    Pinhole,
)
from phytac_shapes.arrays import FloatArray
from tests.refusals import refused

SIZE: dict[str, Any] = {
    "width_px": 2592,
    "height_px": 1944,
    "fx_px": 970.0,
    "fy_px": 930.0,
    "cx_px": 1290.3,
    "cy_px": 980.6,
}
BARREL = (-0.28, 0.09, 1e-3, -5e-4, -0.012)
RATIONAL = (0.3, 0.2, 1e-3, 2e-3, 0.05, 0.4, 0.1, 0.02)
FISH = (-0.01, 0.003, -0.002, 0.0003)
OMNI = (1.2, -0.2, 0.05, 1e-3, -2e-3)
LENS: dict[str, Lens] = {
    "pinhole": Pinhole(**SIZE),
    "barrel": BrownConrady(**SIZE, distortion=BARREL),
    "rational": BrownConrady(**SIZE, distortion=RATIONAL),
    "fisheye": KannalaBrandt(**SIZE, distortion=FISH),
    "equidistant": KannalaBrandt(**SIZE),
    "omni": Omnidirectional(**SIZE, distortion=OMNI),
    "mirror": Omnidirectional(**SIZE, distortion=(0.7,)),
}
ALL = pytest.mark.parametrize("name", sorted(LENS))


def direction(theta: Any, phi: Any) -> FloatArray:
    theta, phi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    ).reshape(-1, 3)


def cloud(lens: Lens, count: int = 2000, share: float = 1.0) -> FloatArray:
    """Unit directions all over the field."""
    rng = np.random.default_rng(0)
    most = min(lens.field_rad, np.deg2rad(89.0)) if lens.model == "pinhole" else lens.field_rad
    return direction(rng.uniform(0.0, share * most, count), rng.uniform(0.0, 2.0 * np.pi, count))


def matrix(lens: Lens) -> FloatArray:
    return np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1.0]])


@ALL
def test_there_and_back(name: str) -> None:
    lens = LENS[name]
    d = cloud(lens)
    far = d * np.random.default_rng(1).uniform(0.1, 1e3, (len(d), 1))
    pixels = lens.project(far)
    assert np.abs(lens.unproject(pixels) - d).max() < 1e-9
    again = lens.project(lens.unproject(pixels))
    np.testing.assert_allclose(again, pixels, rtol=1e-9, atol=1e-9)


@ALL
def test_jacobian_is_the_derivative(name: str) -> None:
    lens = LENS[name]
    points = 50.0 * cloud(lens, 200, 0.98)
    exact = lens.jacobian(points)
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        slope = (lens.project(points + step) - lens.project(points - step)) / 2e-5
        np.testing.assert_allclose(exact[:, :, axis], slope, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("name", ["pinhole", "barrel", "rational"])
def test_brown_conrady_is_opencvs(name: str) -> None:
    lens = LENS[name]
    points = 30.0 * cloud(lens)
    k = np.array(lens.distortion)
    theirs, slope = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix(lens), k)
    np.testing.assert_allclose(lens.project(points), theirs[:, 0], rtol=1e-9, atol=1e-9)
    # Columns 3 to 5 are by the translation, which is by the point.
    ours = lens.jacobian(points).reshape(-1, 3)
    np.testing.assert_allclose(ours, slope[:, 3:6], rtol=1e-6, atol=1e-6)


def test_fisheye_is_opencvs_in_front() -> None:
    lens = LENS["fisheye"]
    points = 30.0 * cloud(lens)
    points = points[points[:, 2] > 0.0]
    theirs, _ = cv2.fisheye.projectPoints(
        points[None], np.zeros(3), np.zeros(3), matrix(lens), np.array(lens.distortion)
    )
    np.testing.assert_allclose(lens.project(points), theirs[0], rtol=1e-9, atol=1e-9)


def test_fisheye_continues_behind_the_image_plane() -> None:
    # OpenCV's fisheye folds these back into the picture; the radius has to keep rising.
    lens = LENS["equidistant"]
    angle = np.deg2rad([89.5, 90.0, 90.5, 120.0, 179.0])
    pixels = lens.project(direction(angle, 0.0))
    np.testing.assert_allclose(pixels[:, 0], lens.cx_px + lens.fx_px * angle, rtol=1e-12)
    np.testing.assert_allclose(pixels[:, 1], lens.cy_px, atol=1e-9)


def test_omnidirectional_is_opencvs_in_all_its_field() -> None:
    lens = LENS["omni"]
    assert lens.field_rad > np.deg2rad(100.0)
    points = 30.0 * cloud(lens)
    theirs, _ = cv2.omnidir.projectPoints(
        points[None], np.zeros(3), np.zeros(3), matrix(lens), OMNI[0], np.array([OMNI[1:]])
    )
    np.testing.assert_allclose(lens.project(points), theirs.reshape(-1, 2), rtol=1e-9, atol=1e-9)


@ALL
def test_outside_of_the_field_is_nowhere(name: str) -> None:
    lens = LENS[name]
    outside = direction(np.linspace(lens.field_rad + 1e-6, np.pi, 50), 0.7)
    assert np.isnan(lens.project(outside)).all()
    assert np.isnan(lens.jacobian(outside)).all()
    assert not lens.in_field(outside).any()
    assert np.isnan(lens.project(np.zeros((1, 3)))).all()


@ALL
def test_the_image_never_folds_over(name: str) -> None:
    # Along every ray from the centre of the image the angle rises, until there is nothing.
    lens = LENS[name]
    for turn in np.linspace(0.0, 2.0 * np.pi, 7):
        radius = np.linspace(0.0, 6000.0, 3000)[:, None]
        line = lens.centre_px + radius * [np.cos(turn), np.sin(turn)]
        angle = np.arccos(np.clip(lens.unproject(line)[:, 2], -1.0, 1.0))
        seen = np.isfinite(angle)
        assert seen[: int(seen.sum())].all()
        assert (np.diff(angle[seen]) > -1e-7).all()


def test_a_barrel_lens_ends_where_its_polynomial_turns() -> None:
    k1 = -0.3
    lens = BrownConrady(**SIZE, distortion=(k1, 0.0, 0.0, 0.0))
    # In angle: d/dθ of m + k1 m³ with m = tan θ is (1 + 3 k1 m²)(1 + m²).
    m2 = np.square(np.tan(lens.field_rad))
    speed = (1.0 + 3.0 * k1 * m2) * (1.0 + m2)
    assert Lens.slope_min <= speed < Lens.slope_min + 0.01
    assert np.isnan(lens.unproject(np.array([[SIZE["cx_px"] + 2000.0, SIZE["cy_px"]]]))).all()


def test_an_omnidirectional_lens_ends_where_its_sphere_turns() -> None:
    # d/dθ of sin θ / (cos θ + ξ) is (1 + ξ cos θ) / (cos θ + ξ)², and 1 / (1 + ξ) on the axis.
    xi = 1.2
    cosine = np.cos(Omnidirectional(**SIZE, distortion=(xi,)).field_rad)
    speed = (1.0 + xi) * (1.0 + xi * cosine) / (cosine + xi) ** 2
    assert Lens.slope_min <= speed < Lens.slope_min + 0.02


def test_poles() -> None:
    for lens in LENS.values():
        ahead = np.array([[0.0, 0.0, 5.0], [1e-300, 0.0, 5.0], [0.0, 1e-14, 5.0]])
        np.testing.assert_allclose(lens.project(ahead), np.tile(lens.centre_px, (3, 1)), atol=1e-9)
        slope = lens.jacobian(ahead)
        assert np.isfinite(slope).all()
        np.testing.assert_allclose(slope[0], slope[2], atol=1e-9)
        assert np.isnan(lens.project(-ahead[:1])).all()
        np.testing.assert_allclose(lens.unproject(lens.centre_px[None]), [[0, 0, 1.0]], atol=1e-15)


def test_a_lens_of_179_degrees_and_one_of_twice_that() -> None:
    for half in (89.5, 179.0):
        d = direction(np.deg2rad(half), np.linspace(0.0, 6.0, 9))
        lens = LENS["equidistant"]
        pixels = lens.project(d)
        away = (pixels - lens.centre_px) / lens.focal_px
        np.testing.assert_allclose(np.linalg.norm(away, axis=1), np.deg2rad(half), rtol=1e-12)
        assert np.abs(lens.unproject(pixels) - d).max() < 1e-9
        barrel = np.isnan(LENS["barrel"].project(d)).all()
        assert barrel


@pytest.mark.parametrize(
    ("model", "change", "code"),
    [
        ("brown_conrady", {"distortion": (0.1, 0.2)}, "lens-distortion-count"),
        ("pinhole", {"distortion": (0.1,)}, "lens-distortion-count"),
        ("kannala_brandt", {"distortion": (0.1, 0.0, 0.0)}, "lens-distortion-count"),
        ("omnidirectional", {"distortion": (-0.1,)}, "lens-xi-negative"),
        ("pinhole", {"fx_px": 0.0}, "lens-not-finite"),
        ("pinhole", {"cx_px": np.nan}, "lens-not-finite"),
    ],
)
def test_impossible_lenses_are_rejected(model: str, change: dict[str, Any], code: str) -> None:
    with refused(code):
        LENSES[model](**{**SIZE, **change})


def test_a_camera_that_looks_back() -> None:
    camera = Camera.at(LENS["fisheye"], z_mm=150.0, backward=True)
    assert np.linalg.det(camera.rotation) == pytest.approx(1.0)
    points = np.array([[0.0, 0.0, 100.0], [3.0, 0.0, 100.0], [0.0, 3.0, 100.0]])
    pixels = camera.project(points) - camera.centre_px
    np.testing.assert_allclose(pixels[0], 0.0, atol=1e-12)
    assert pixels[1, 0] < 0.0 < pixels[2, 1]
    toward = points - camera.position_mm
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    np.testing.assert_allclose(camera.rays(camera.project(points)), toward, atol=1e-12)
    assert camera.sees(points).all()
    assert not camera.sees(np.array([[0.0, 0.0, 200.0]])).any()
