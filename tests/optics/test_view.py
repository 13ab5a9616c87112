from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import KannalaBrandt
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import camera_of, cameras_of, tolerance_mm
from phytac_shapes import Cylinder
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError
from tests.optics.cases import FULL, make_design
from tests.refusals import refused


def camera_for(**camera: Any) -> Camera:
    design = make_design(camera=FULL | camera)
    return camera_of(design, design.surface())


def test_fit_fills_the_smaller_side_with_the_near_rim() -> None:
    camera = camera_for(fill=0.975)
    assert camera.position_mm[2] == pytest.approx(-970.0 * 29.2 / (972.0 * 0.975))
    edge = camera.project(np.array([[0.0, 29.2, 0.0]]))[0] - camera.centre_px
    assert edge[1] == pytest.approx(0.975 * 972.0)


@pytest.mark.parametrize(
    "camera",
    [
        {"model": "kannala_brandt", "focal_px": 620.0},
        {"model": "brown_conrady", "distortion": (-0.05, 0.01, 0.0, 0.0)},
        {"model": "omnidirectional", "focal_px": 1500.0, "distortion": (1.2,)},
        {"focal_ratio": 1.1},
    ],
)
def test_fit_fills_the_smaller_side_for_any_lens(camera: dict[str, Any]) -> None:
    made = camera_for(fill=0.9, **camera)
    turn = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    rim = 29.2 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(64)])
    away = np.linalg.norm(made.project(rim) - made.centre_px, axis=1).max()
    assert away == pytest.approx(0.9 * 972.0, rel=1e-6)


def test_a_lens_wider_than_the_picture_stays_before_the_rim() -> None:
    # At the rim's plane its edge is 90 degrees aside, 628 px from the middle: that always fits.
    camera = camera_for(model="kannala_brandt", focal_px=400.0)
    assert camera.position_mm[2] == pytest.approx(-0.05 * 29.2)


def test_two_cameras_look_at_each_other() -> None:
    design = make_design(camera=FULL | {"ends": "both"})
    near, far = cameras_of(design, design.surface())
    assert near.position_mm[2] == pytest.approx(-29.887, abs=1e-3)
    assert far.position_mm[2] == pytest.approx(120.0 + 29.887, abs=1e-3)
    point = np.array([[3.0, 4.0, 60.0]])
    one, two = near.project(point) - near.centre_px, far.project(point) - far.centre_px
    np.testing.assert_allclose(two, one * [[-1.0, 1.0]], rtol=1e-9)
    with refused("one-camera-only"):
        camera_of(design, design.surface())


def test_a_rim_beyond_the_field_is_refused() -> None:
    camera = {"model": "brown_conrady", "distortion": (-0.28, 0.09, 0.0, 0.0, -0.012)}
    design = make_design(camera=FULL | camera | {"stand_off_mm": 10.0})
    with refused("rim-outside-view") as caught:
        camera_of(design, design.surface())
    caught.match(r"6\d\.\d°")


def test_tolerance_is_a_tenth_of_a_pixel_at_the_end_face() -> None:
    design = make_design(camera=FULL)
    surface = design.surface()
    markers = make_markers(design, surface)
    camera = camera_of(design, surface)
    aside = np.array([1.0, 0.0, 0.0]) * tolerance_mm(camera, markers)[:, None]
    moved = camera.project(markers.tip_mm + aside) - camera.project(markers.tip_mm)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 0.1, rtol=1e-9)


@pytest.mark.parametrize(
    ("camera", "light", "words"),
    [
        ({"stand_off_mm": -5.0}, {}, ("inside the sensor", "z = 5.00 mm", '"fit"', "29.89")),
        ({"stand_off_mm": 0.0}, {}, ("inside the sensor", "stand_off_mm = 0")),
        ({"stand_off_mm": 20.0}, {}, ("cannot see the near rim", "1416", "972", "29.14")),
        ({"stand_off_mm": 30.0}, {"bar_start_mm": -40.0}, ("inside the light bar", "-40.00")),
    ],
)
def test_a_camera_that_cannot_work_is_refused(
    camera: dict[str, Any], light: dict[str, Any], words: tuple[str, ...]
) -> None:
    design = make_design(camera=FULL | camera, light=light)
    with pytest.raises(DesignError) as caught:
        camera_of(design, design.surface())
    for word in words:
        assert word in str(caught.value)


class Lid(Cylinder):
    """A cylinder whose chart takes any point to a lid in front of the camera."""

    name = "lid"

    def chart(self, points_mm: FloatArray) -> FloatArray:
        return np.tile([3.0, 1.0], (len(points_mm), 1))

    def normal(self, uv: FloatArray) -> FloatArray:
        lid = uv[:, :1] == 3.0
        return np.asarray(np.where(lid, [0.0, 0.0, -1.0], super().normal(uv)))

    def point(self, uv: FloatArray, offset_mm: FloatArray | float = 0.0) -> FloatArray:
        lid = uv[:, :1] == 3.0
        return np.asarray(np.where(lid, [0.0, 0.0, -30.2], super().point(uv, offset_mm)))


def test_a_camera_in_the_wall_is_refused() -> None:
    # No on-axis camera can stand in a cylinder's wall; in a shape that closes over the axis, it
    # can. Its outer face here is at z = -30.2, the camera 0.31 mm behind it.
    surface = Lid(diameter_outer_mm=60.0, length_mm=120.0)
    with refused("camera-inside-wall") as caught:
        camera_of(make_design(camera=FULL), surface)
    caught.match(r"0\.31 mm")


def test_tolerance_of_receptors_beyond_the_field_is_finite() -> None:
    lens = KannalaBrandt(
        width_px=400,
        height_px=300,
        fx_px=120.0,
        fy_px=120.0,
        cx_px=199.5,
        cy_px=149.5,
        distortion=(0.0, 0.0, 0.0, 0.0),
    )
    design = make_design()
    markers = make_markers(design, design.surface())
    # Straight before a tip, looking away: that receptor lies beyond the field.
    ahead = markers.tip_mm[0] + np.array([0.0, 0.0, 5.0])
    inside = replace(Camera.at(lens, z_mm=0.0), position_mm=ahead)
    assert not np.isfinite(inside.jacobian(markers.tip_mm[:1])).all()
    found = tolerance_mm(inside, markers)
    assert np.isfinite(found).all()
    assert (found > 0.0).all()
