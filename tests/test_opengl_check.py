"""The project's own frames against OpenGL's picture, by the decoder's detector."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from phytac_decoder.camera.camera import Camera
from phytac_design.cli.app import app
from phytac_design.design.design_file import to_toml
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.opengl_picture import render_picture
from phytac_design.optics.render_scene import RenderScene
from phytac_design.workflows import opengl_check
from phytac_design.workflows.opengl_check import compare_with_opengl
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import MissingPartError
from tests.designs import tiny


@pytest.fixture(scope="module")
def sensor() -> Sensor:
    sensor = Sensor(tiny(reference_marks={"count": 6}))
    try:
        compare_with_opengl(sensor)
    except MissingPartError as error:
        pytest.skip(str(error))  # a machine without EGL; `make test` installs it
    return sensor


def test_both_show_all_markers_at_the_same_places(sensor: Sensor) -> None:
    (found,) = compare_with_opengl(sensor)
    assert found.same
    assert found.markers == found.found == sensor.markers.count
    assert 0.0 < found.median_px < 0.2
    assert found.median_px <= found.max_px < 0.5


def test_a_picture_of_another_scene_is_not_the_same(
    sensor: Sensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    def half(scene: RenderScene, camera: Camera) -> ImageArray:
        picture = render_picture(scene, camera)
        picture[:, : camera.width_px // 2] = 0
        return picture

    def moved(scene: RenderScene, camera: Camera) -> ImageArray:
        return np.roll(render_picture(scene, camera), 1, axis=1)

    monkeypatch.setattr(opengl_check, "render_picture", half)
    (found,) = compare_with_opengl(sensor)
    assert found.found < found.markers
    assert not found.same
    monkeypatch.setattr(opengl_check, "render_picture", moved)
    (found,) = compare_with_opengl(sensor)
    assert found.found == found.markers
    assert found.median_px == pytest.approx(1.0, abs=0.2)
    assert not found.same


@pytest.mark.usefixtures("coarse_switches")
def test_check_reports_it_and_warns(
    sensor: Sensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "tiny.toml").write_text(to_toml(sensor.design))
    words = ["check", str(tmp_path / "tiny.toml"), "--opengl", "--json"]
    wrong = opengl_check.OpenGLComparison(markers=8, found=7, median_px=0.1, max_px=0.9)
    monkeypatch.setattr(opengl_check, "compare_with_opengl", lambda _: [wrong])
    result = CliRunner().invoke(app, words)
    report = json.loads(result.stdout)
    assert report["cameras"][0]["opengl"]["found"] == 7
    assert report["cameras"][0]["opengl"]["same"] is False
    assert any("the picture by OpenGL shows 7 of the 8 markers" in w for w in report["warnings"])
