"""Scene files: read, checked, rejected with a reason."""

import tomllib
from pathlib import Path

import pytest

from phytac_design.design.scene import SCENE_DEFAULTS, SCENE_FILES, Scene, load_scene
from tests.refusals import refused
from tests.study.planning.scenes import scene


def test_shipped_scenes_are_those_that_the_docs_name() -> None:
    assert SCENE_FILES.shipped() == ["fabrication", "fingertip", "grip5", "occlusion"]
    for name in SCENE_FILES.shipped():
        assert load_scene(name).name == name
        assert load_scene(name).description


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"output": ["decoder"]}, "unknown key 'output'; did you mean 'outputs'?"),
        ({"outputs": []}, "outputs"),
        ({"outputs": ["forces"]}, "outputs.0"),
        ({"camera": "left"}, "camera"),
        ({"contacts": {"force_N": 1.0}}, "unknown key 'contacts.force_N'"),
        ({"contacts": {"force_min_N": 9.0, "force_max_N": 3.0}}, "must not exceed"),
        ({"regions": [{"along": [0.6, 0.4]}]}, "along must grow"),
        ({"regions": [{"around": [0.3, 0.3]}]}, "around must have a size"),
        ({"regions": [{"along": [0.0, 1.2]}]}, "regions.0.along.1"),
        ({"error_allowed": 0.0}, "error_allowed"),
        ({"frame_rate_Hz": True}, "true or false"),
    ],
)
def test_invalid_keys_and_values_are_rejected(changes: dict, text: str) -> None:
    with refused("field-invalid") as caught:
        scene(**changes)
    assert text in str(caught.value)


def test_missing_file_and_no_toml(tmp_path: Path) -> None:
    with refused("toml-file-not-found") as caught:
        load_scene("fingertop")
    caught.match("did you mean 'fingertip'")
    bad = tmp_path / "bad.toml"
    bad.write_text("name = [")
    with refused("toml-syntax"):
        load_scene(str(bad))
    bad.write_bytes(b"\xff\xfe\x00\x81")
    with refused("toml-syntax"):
        load_scene(str(bad))


def test_a_scene_reads_back_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text('name = "own"\noutputs = ["mesh"]\n[[regions]]\naround = [0.9, 0.1]\n')
    loaded = load_scene(str(path))
    assert loaded == Scene.model_validate(tomllib.loads(path.read_text()))
    assert loaded.regions[0].around == (0.9, 0.1)
    assert not loaded.pictures


def test_a_report_wants_everything() -> None:
    everything = Scene(name="all", outputs=("report",))
    assert everything.pictures
    assert everything.networks
    # Stages then find what a build without a scene has, but for its name.
    parts = [name for name in SCENE_DEFAULTS if name != "name"]
    assert everything.inputs(parts) == {}


def test_inputs_are_what_differs_from_a_build_without_a_scene() -> None:
    found = scene().inputs(("pictures", "regions", "at_once", "networks"))
    assert found["pictures"] is False
    assert found["at_once"] == 1
    assert found["networks"] is False
    assert found["regions"] == [{"name": "", "along": [0.35, 0.65], "around": [0.0, 0.2]}]
    assert "reach_mm" not in scene(regions=[]).inputs(("reach_mm",))
