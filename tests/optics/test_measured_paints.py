"""Paints measured in a photo: rendered frames of a sensor whose true paints are known."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from phytac_design.cli.app import app
from phytac_design.design.design_file import design_hash, load_design, parse_design
from phytac_design.design.paints_table import PaintsSection
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.measured_paints import measure_paints
from phytac_design.optics.render_scene import build_scene
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.designs import changed, of_shape
from tests.refusals import refused

SHAPE = {"diameter_outer_mm": 50.0, "length_mm": 40.0}
LAYOUT = {"rows": 4, "columns": 10, "height_far_mm": 4.0}
OWN = {
    "blue": [60, 70, 160],
    "green": [70, 140, 90],
    "red": [180, 60, 50],
    "resin": [150, 160, 170],
    "white": [200, 210, 220],
    "resin_dark": [50, 48, 46],
    "black": [40, 40, 50],
}


def design(paints: dict[str, list[int]] | None = None, **layout: object) -> Design:
    solid = {"receptor": {"diameter_outer_mm": 2.4, "diameter_hole_mm": 0.0}} if layout else {}
    tables = {"paints": paints or {}} | solid
    return of_shape("cylinder", SHAPE, LAYOUT | layout, **tables)


def photo(sensor_design: Design, *, tips: bool = False) -> ImageArray:
    sensor = Sensor(sensor_design)
    on = np.full(sensor.markers.count, tips)
    scene = build_scene(sensor, tolerance_mm=0.1, switch_on=on)
    rng = np.random.default_rng(3)
    return render_frame(scene, sensor.cameras[0], noise_std=2.0, rng=rng)


def hue(rgb: object) -> FloatArray:
    ycc = cv2.cvtColor(np.array([[rgb]], dtype=np.uint8), cv2.COLOR_RGB2YCrCb)[0, 0].astype(float)
    return np.asarray(np.degrees(np.arctan2(ycc[2] - 128.0, ycc[1] - 128.0)))


@pytest.mark.parametrize("own", [{}, OWN], ids=["nominal", "own"])
def test_paints_are_measured_in_a_picture_of_them(own: dict[str, list[int]]) -> None:
    true = design(own)
    names = ("blue", "green", "red")
    found, separation = measure_paints(photo(true, tips=True), design(), names)
    for name in names:
        assert abs(hue(getattr(found, name)) - hue(getattr(true.paints, name))) < 6.0
        # The light falls on walls and tubes at an angle: full light is not reached everywhere.
        ratio = np.array(getattr(found, name)) / np.array(getattr(true.paints, name))
        assert 0.7 < np.median(ratio) < 1.1
    assert np.ptp(np.array(found.resin) / np.array(true.paints.resin)) < 0.1
    assert separation.hue_deg.min() > 90.0
    # Compression mixes paint with the wall beside it.
    squeezed = cv2.imencode(".jpg", photo(true, tips=True), [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
    jpeg, _ = measure_paints(np.asarray(cv2.imdecode(squeezed, 1)), design(), names)
    for name in names:
        assert abs(hue(getattr(jpeg, name)) - hue(getattr(found, name))) < 6.0
    # The same photo gives the same table.
    assert measure_paints(photo(true, tips=True), design(), names)[0] == found


@pytest.mark.parametrize(("paint", "wall"), [("white", "resin_dark"), ("black", "resin")])
def test_dots_and_their_wall_are_measured(paint: str, wall: str) -> None:
    true = design(OWN, colours=[paint])
    found, _ = measure_paints(photo(true), design(colours=[paint]), (paint,))
    np.testing.assert_allclose(getattr(found, paint), OWN[paint], atol=35.0)
    np.testing.assert_allclose(getattr(found, wall), OWN[wall], atol=35.0)
    # Each is nearer to its own than to the nominal one of the other.
    bright, dark = sorted((np.mean(getattr(found, paint)), np.mean(getattr(found, wall))))[::-1]
    assert bright > 2.0 * dark


def test_paints_of_a_sensor_with_dots_are_not_named() -> None:
    dots = changed(layout={"colours": ["white"]}, receptor={"diameter_hole_mm": 0.0})
    with refused("paint-not-of-design"):
        measure_paints(np.zeros((9, 9, 3), dtype=np.uint8), dots, ("blue", "green"))


def test_own_paints_change_frames_decoder_and_hash() -> None:
    plain, own = design(), design(OWN)
    assert design_hash(plain) != design_hash(own)
    # Paints that were not measured, and all that came later, leave the hash of earlier versions.
    earlier = "919bed26ac06f8e23ef61908de997b6b01d6c945e0ceb61cd909fe819e5b7407"
    assert design_hash(load_design("cylinder60")) == earlier
    assert np.abs(photo(plain).astype(float) - photo(own)).max() > 40.0


def test_what_cannot_be_separated_or_named_is_refused() -> None:
    frame, nominal = photo(design(), tips=True), design()
    with refused("colours-not-separable"):
        measure_paints(frame, nominal, ("blue", "green", "red", "magenta"))
    with refused("photo-with-other-colours"):
        measure_paints(frame, nominal, ("blue",))
    with refused("paint-not-recognised"):
        measure_paints(frame, nominal, ("yellow", "magenta", "cyan"))
    with refused("paint-unknown"):
        measure_paints(frame, nominal, ("pink",))
    with refused("photo-without-paint"):
        measure_paints(np.full_like(frame, 128), nominal, ("blue", "green"))


def test_the_command_writes_lines_for_the_design_file(tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    cv2.imwrite(str(path), photo(design(OWN), tips=True))
    words = ["paints", str(path), "--colours", "blue,green,red"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    lines = [line for line in result.output.splitlines() if "=" in line]
    values = {name.strip(): json.loads(rgb) for name, _, rgb in (s.partition("=") for s in lines)}
    assert set(values) == {"blue", "green", "red", "resin"}
    data = load_design("cylinder60").model_dump(mode="json") | {"paints": values}
    assert parse_design(data, "x").paints == PaintsSection(**values)
    assert "are nearest" in result.output
    as_json = json.loads(CliRunner().invoke(app, [*words, "--json"]).output)
    assert as_json["paints"] == values
