"""``phytac inspect``: mistakes planted in rendered assemblies are found, and none is invented."""

import json
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.camera import moved
from benchmarks.fabrication_inspect import Assembly, judge, plant
from phytac_decoder.io.sensor_limits import axial_rotation
from phytac_design.cli.app import app
from phytac_design.design.design_file import load_design
from phytac_design.fabrication.inserts.sprues import plan_sprues
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.check import check_design
from phytac_design.workflows.inspect_assembly import Step, inspect, spot_names, sprue_places
from phytac_shapes.arrays import ImageArray
from tests.refusals import refused

HANDLE = "examples/uses/handle.toml"


@cache
def handle() -> Sensor:
    return Sensor(load_design(HANDLE))


@cache
def clean(step: Step) -> Assembly:
    return Assembly(handle(), step)


@pytest.mark.parametrize(("step", "count"), [("painted", 12), ("assembled", 20)])
def test_planted_mistakes_are_found_in_a_disturbed_photo(step: Step, count: int) -> None:
    faulty = Assembly(handle(), step)
    planted = plant(faulty)
    assert len(planted) == count
    result = inspect(handle(), [faulty.photo(disturb=True, seed=5)], step)
    assert judge(handle(), planted, result) == ([], [])
    assert not inspect(handle(), [clean(step).photo(disturb=True, seed=6)], step).mistakes


def test_paint_that_is_too_small_everywhere_is_reported_once() -> None:
    faulty = Assembly(handle(), "painted")
    for number in range(handle().markers.count):
        faulty.half(number)
    found = inspect(handle(), [faulty.photo(disturb=False, seed=4)], "painted").mistakes
    (one,) = [mistake for mistake in found if mistake.place == "paint"]
    assert (one.fault, one.measured) == ("all too small", "50 % in the median")


def test_a_turned_shell_and_a_moved_camera_are_reported_once() -> None:
    camera = handle().cameras[0]
    turn = axial_rotation(1.0 / 16.0)
    turned = replace(camera, position_mm=camera.position_mm @ turn, rotation=camera.rotation @ turn)
    far = moved(camera, np.array([0.8, 0.0, 0.0]), np.array([0.0, 0.8, 0.0]), 0.0)
    for through, fault in ((turned, "shell turned"), (far, "camera moved")):
        photo = clean("assembled").photo(disturb=False, seed=7, camera=through)
        assert [one.fault for one in inspect(handle(), [photo], "assembled").mistakes] == [fault]


def black() -> ImageArray:
    return np.zeros((480, 640, 3), dtype=np.uint8)


def another(**size: float) -> ImageArray:
    """Photo of a handle of another size by the same camera."""
    shape = handle().design.shape.model_copy(update=size)
    other = Sensor(handle().design.model_copy(update={"shape": shape}))
    return Assembly(other, "assembled").photo(disturb=False, seed=8)


def test_a_photo_of_something_else_is_refused() -> None:
    with refused("markers-without-colour"):
        inspect(handle(), [black()], "assembled")
    with refused("photo-of-another-sensor"):
        inspect(handle(), [another(length_mm=60.0)], "assembled")
    with refused("photo-count"):
        inspect(handle(), [black(), black()], "assembled")


def test_the_command_names_receptor_mistake_and_next_step(tmp_path: Path) -> None:
    faulty = Assembly(handle(), "painted")
    faulty.missing(35)
    photo, out, picture = (tmp_path / name for name in ("in.png", "out.json", "out.png"))
    cv2.imwrite(str(photo), faulty.photo(disturb=False, seed=9))
    built = tmp_path / "handle" / "decoder"
    built.mkdir(parents=True)
    shutil.copyfile(HANDLE, built.parent / "design.toml")
    words = ["inspect", str(built), str(photo), "--step", "painted"]
    run = CliRunner().invoke(app, [*words, "--json", str(out), "--picture", str(picture)])
    assert run.exit_code == 4
    lines = run.stdout.splitlines()
    assert lines[1].split()[:2] == ["2.3", "missing"]
    assert lines[-2].startswith("1 mistake:")
    assert lines[-1].startswith("next: ")
    (one,) = json.loads(out.read_text())["mistakes"]
    assert (one["row"], one["column"]) == (2, 3)
    ringed = cv2.imread(str(picture)).astype(int) - cv2.imread(str(photo)).astype(int)
    place = np.argwhere(np.abs(ringed).max(axis=2) > 100)[:, ::-1]
    assert np.linalg.norm(place - one["at_px"], axis=1).min() < 30.0


@cache
def with_inserts() -> Sensor:
    receptor = handle().design.receptor.model_copy(update={"colouring": "insert"})
    return check_design(handle().design.model_copy(update={"receptor": receptor}))


def test_inserts_that_are_missing_swapped_or_too_long_are_found() -> None:
    sensor = with_inserts()
    good, faulty = (Assembly(sensor, "painted") for _ in range(2))
    assert not inspect(sensor, [good.photo(disturb=True, seed=3)], "painted").mistakes
    tall = np.flatnonzero(sensor.markers.height_mm > 1.0)
    missing, swapped, out = (int(k) for k in tall[[5, 20, 40]])
    faulty.without_insert(missing)
    faulty.swapped(swapped)
    faulty.pushed(out, 1.2)
    result = inspect(sensor, [faulty.photo(disturb=True, seed=4)], "painted")
    names = spot_names(sensor)
    found = {one.place: one for one in result.mistakes}
    assert set(found) == {names[k] for k in (missing, swapped, out)}
    assert found[names[missing]].fault == "missing"
    assert found[names[swapped]].fault == "wrong colour"
    assert found[names[out]].fault in {"too large", "off centre"}
    places = sprue_places(sensor)
    assert found[names[missing]].action.endswith(places[missing])
    assert "paint" not in found[names[swapped]].action


def test_a_sprue_that_was_left_out_is_named() -> None:
    sensor = with_inserts()
    sprue = next(one for one in plan_sprues(sensor) if len(one.markers) > 2)
    faulty = Assembly(sensor, "painted")
    for marker in sprue.markers:
        faulty.without_insert(marker)
    result = inspect(sensor, [faulty.photo(disturb=False, seed=4)], "painted")
    assert len(result.mistakes) == len(sprue.markers)
    assert any(note.startswith(f"sprue {sprue.label}: missing") for note in result.notes)
