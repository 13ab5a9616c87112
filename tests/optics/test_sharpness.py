"""Millimetres per pixel, blur and depth of field, against thin-lens formulae."""

from typing import Any

import numpy as np
import pytest

from phytac_design.optics.sharpness import Sharpness, sharpness
from tests.optics.cases import FULL, Bench, make_design
from tests.refusals import refused


def facts(**camera: Any) -> tuple[Sharpness, Bench]:
    bench = Bench(make_design(camera=FULL | camera))
    section = bench.design.camera
    return sharpness(section, bench.camera, bench.surface, bench.markers), bench


def test_scale_of_a_pinhole_on_a_cylinder() -> None:
    got, bench = facts()
    p = bench.camera.to_camera(bench.markers.tip_mm)
    radius = np.hypot(p[:, 0], p[:, 1])
    exact = np.column_stack([p[:, 2] ** 2 / radius, p[:, 2], p[:, 2]]) / 970.0
    np.testing.assert_allclose(got.mm_per_px, exact, rtol=1e-9)
    np.testing.assert_allclose(got.noise_mm, 0.04 * exact, rtol=1e-9)


def test_blur_is_a_pixel_at_the_ends_of_the_depth_of_field() -> None:
    focal, pixel, focus, stop = 970.0 * 1.4e-3, 1.4e-3, 60.0, 2.8
    got, bench = facts(focus_mm=focus)
    for distance in (got.depth_near_mm, got.depth_far_mm):
        image = 1.0 / (1.0 / focal - 1.0 / distance)
        chip = 1.0 / (1.0 / focal - 1.0 / focus)
        assert focal / stop * abs(image - chip) / image == pytest.approx(pixel, rel=1e-9)
    z = bench.camera.to_camera(bench.markers.tip_mm)[:, 2]
    image, chip = 1.0 / (1.0 / focal - 1.0 / z), 1.0 / (1.0 / focal - 1.0 / focus)
    np.testing.assert_allclose(
        got.blur_px, focal / stop * np.abs(image - chip) / image / pixel, rtol=1e-9
    )


def test_focus_left_open_blurs_both_ends_alike() -> None:
    got, _ = facts()
    assert got.blur_px[0] == pytest.approx(got.blur_px[-1], rel=1e-9)
    assert got.summary()["max_blur_px"] == pytest.approx(got.blur_px[0], rel=1e-9)
    wide, _ = facts(f_number=32.0)
    assert wide.depth_far_mm == float("inf")


def test_a_fisheye_has_facts_as_well() -> None:
    got, bench = facts(model="kannala_brandt", focal_px=620.0, stand_off_mm=15.0)
    along = bench.camera.jacobian(bench.markers.tip_mm)[:, :, 2]
    np.testing.assert_allclose(got.mm_per_px[:, 0], 1.0 / np.linalg.norm(along, axis=1), rtol=1e-9)
    assert np.isfinite(got.blur_px).all()


def test_a_focus_inside_the_lens_is_refused() -> None:
    with refused("focus-within-focal-length"):
        facts(focus_mm=1.0)
