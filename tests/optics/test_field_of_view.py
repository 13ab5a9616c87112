"""Field of view in place of a focal length, and image sizes without one."""

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import design_hash, parse_design, to_toml
from phytac_design.design.field_of_view import fields_of_view_deg
from phytac_design.design.spec import CameraSection, Design
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.design_review import checkup, working_distance_mm
from tests.designs import changed
from tests.refusals import refused

SIZE = {"width_px": 1280, "height_px": 720}
K = (-0.02, 0.003, 0.0, 0.0)


def camera(**fields: Any) -> CameraSection:
    return CameraSection.model_validate(fields)


def design(**fields: Any) -> Design:
    shape = {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 120.0}
    return parse_design({"name": "a", "shape": shape, "camera": fields}, "design")


def test_focal_lengths_of_closed_forms() -> None:
    half = np.deg2rad(35.0)
    assert camera(**SIZE, field_of_view_deg=70).focal_px == pytest.approx(640 / np.tan(half), 1e-6)
    # Equidistant: the radius is the focal length times the angle.
    wide = camera(**SIZE, field_of_view_deg=160, model="kannala_brandt")
    assert wide.focal_px == pytest.approx(640 / np.deg2rad(80.0), 1e-6)
    assert camera(**SIZE, field_of_view_deg=160, model="fisheye") == wide


@pytest.mark.parametrize(
    ("model", "distortion", "angle"),
    [
        ("pinhole", (), 100.0),
        ("brown_conrady", (-0.1, 0.01, 0.0, 0.0), 80.0),
        ("kannala_brandt", K, 200.0),
        ("omnidirectional", (1.2,), 150.0),
    ],
)
def test_the_lens_sees_the_angle_that_was_given(
    model: str, distortion: tuple[float, ...], angle: float
) -> None:
    made = camera(**SIZE, model=model, distortion=distortion, field_of_view_deg=angle)
    assert fields_of_view_deg(made.lens())[0] == pytest.approx(angle, abs=1e-3)


def test_an_image_circle_inside_the_image_ends_the_field() -> None:
    lens = camera(**SIZE, model="kannala_brandt", focal_px=50.0).lens()
    assert fields_of_view_deg(lens)[0] == pytest.approx(2.0 * np.rad2deg(lens.field_rad))


def test_an_image_size_alone_keeps_field_of_view_and_chip() -> None:
    usual, small = camera(), camera(width_px=1296, height_px=972)
    assert (usual.focal_px, usual.pixel_um) == (970.0, 1.4)
    assert (small.focal_px, small.pixel_um) == (485.0, 2.8)
    assert fields_of_view_deg(small.lens()) == pytest.approx(fields_of_view_deg(usual.lens()))
    # What is given stays, and so does a preset.
    assert camera(width_px=1296, focal_px=970.0).pixel_um == 1.4
    assert camera(width_px=1296, pixel_um=3.0).pixel_um == 3.0
    fast = camera(preset="paper_480fps")
    assert (fast.focal_px, fast.pixel_um) == (239.5, 1.4)
    assert camera(preset="paper_480fps", field_of_view_deg=90).focal_px == 320.0


def test_a_field_of_view_is_read_as_its_focal_length() -> None:
    wide, same = design(**SIZE, field_of_view_deg=90), design(**SIZE, focal_px=640, pixel_um=2.835)
    assert wide == same
    assert design_hash(wide) == design_hash(same)
    assert "field_of_view_deg =" not in to_toml(wide)
    assert parse_design(tomllib.loads(to_toml(wide)), "again") == wide


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"field_of_view_deg": 70, "focal_px": 500}, r"got 70° and 500 px.*leave out one"),
        ({"field_of_view_deg": 180}, 'sees less than 180°.*"kannala_brandt"'),
        ({"field_of_view_deg": 170}, 'no lens without distortion sees 170°.*"kannala_brandt"'),
        ({"field_of_view_deg": 359, "model": "fisheye"}, "no lens sees 359°.*end at 280°"),
        ({"field_of_view_deg": 1e6, "model": "fisheye"}, "no lens sees 1e.06°"),
        (
            {"field_of_view_deg": 120, "model": "kannala_brandt", "distortion": [-1, 0, 0, 0]},
            "sees less than 120°",
        ),
    ],
)
def test_fields_of_view_that_cannot_be(fields: dict[str, Any], words: str) -> None:
    with refused("field-invalid") as caught:
        design(**fields)
    caught.match(words)


def test_the_check_states_field_of_view_and_working_distance() -> None:
    report = checkup(
        changed(layout={"rows": 4}, camera={"width_px": 1296, "height_px": 972, "focal_px": 485.0})
    )
    (seen,) = report["cameras"]
    assert seen["field_of_view_deg"] == pytest.approx((106.37, 90.12), abs=0.01)
    nearest, farthest = seen["working_distance_mm"]
    # The nearest tip stands on the first row, some 29 mm off the axis; the farthest one 120 mm in.
    assert seen["stand_off_mm"] < nearest < 60.0
    assert 120.0 < farthest < 120.0 + seen["stand_off_mm"] + 10.0


def test_distances_are_those_of_the_focus() -> None:
    sensor = Sensor(changed(layout={"rows": 4}))
    (pinhole,) = sensor.cameras
    ahead = pinhole.to_camera(sensor.markers.tip_mm)
    found = working_distance_mm(pinhole, sensor.markers)
    assert found == pytest.approx((ahead[:, 2].min(), ahead[:, 2].max()))
    wide = camera(**SIZE, field_of_view_deg=90, model="fisheye").lens()
    away = np.linalg.norm(ahead, axis=1)
    fisheye = replace(pinhole, lens=wide)
    found = working_distance_mm(fisheye, sensor.markers)
    assert found == pytest.approx((away.min(), away.max()))
    assert away.min() > ahead[:, 2].min() + 1.0
