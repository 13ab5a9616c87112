"""Lens calibrations of other tools: there and back, as those tools write them, and refused."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_decoder.camera.lens import BrownConrady, KannalaBrandt, Lens, Omnidirectional, Pinhole
from phytac_decoder.io.bundle_camera import camera_from, lens_table
from phytac_design.design.camera_files import read_lens, write_lens
from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import CameraSection
from tests.optics.cases import make_design
from tests.refusals import refused

SIZE: dict[str, Any] = {
    "width_px": 640,
    "height_px": 480,
    "fx_px": 239.51234567890123,
    "fy_px": 241.1,
    "cx_px": 318.7,
    "cy_px": 0.1 + 0.2 + 240.0,
}
LENS: dict[str, Lens] = {
    "pinhole": Pinhole(**SIZE),
    "radtan": BrownConrady(**SIZE, distortion=(-0.28, 0.09, 1e-3, -5e-4)),
    "plumb_bob": BrownConrady(**SIZE, distortion=(-0.28, 0.09, 1e-3, -5e-4, -0.012)),
    "rational": BrownConrady(**SIZE, distortion=(0.3, 0.2, 1e-3, 2e-3, 0.05, 0.4, 0.1, 0.02)),
    "fisheye": KannalaBrandt(**SIZE, distortion=(-0.01, 0.003, -0.002, 0.0003)),
    "omni": Omnidirectional(**SIZE, distortion=(1.2, -0.2, 0.05, 1e-3, -2e-3)),
}
CANNOT = {("ros", "omni"), ("kalibr", "plumb_bob"), ("kalibr", "rational")}


@pytest.mark.parametrize("name", sorted(LENS))
@pytest.mark.parametrize("kind", ["opencv", "ros", "kalibr"])
def test_files_come_back_as_they_were(kind: Any, name: str, tmp_path: Path) -> None:
    lens, path = LENS[name], tmp_path / "lens.yaml"
    if (kind, name) in CANNOT:
        with refused("lens-not-representable"):
            write_lens(lens, path, kind)
        return
    back = read_lens(write_lens(lens, path, kind))
    assert back.model == lens.model
    for field in ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px"):
        assert getattr(back, field) == pytest.approx(getattr(lens, field), rel=1e-15)
    padded = [*lens.distortion, *[0.0] * (len(back.distortion) - len(lens.distortion))]
    assert list(back.distortion) == pytest.approx(padded, rel=1e-15)


ROS = """
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [431.5, 0.0, 322.3, 0.0, 430.9, 245.1, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.33, 0.12, 0.0007, -0.0006, 0.0]
"""
KALIBR = """
cam0:
  cam_overlaps: []
  camera_model: pinhole
  distortion_coeffs: [-0.012, 0.021, -0.034, 0.018]
  distortion_model: equidistant
  intrinsics: [431.5, 430.9, 322.3, 245.1]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
"""


def test_files_as_ros_and_kalibr_write_them(tmp_path: Path) -> None:
    path = tmp_path / "cam.yaml"
    for text, model, last in ((ROS, "brown_conrady", 0.0), (KALIBR, "kannala_brandt", 0.018)):
        path.write_text(text)
        lens = read_lens(path)
        assert (lens.model, lens.width_px, lens.height_px) == (model, 640, 480)
        assert (lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px) == (431.5, 430.9, 322.3, 245.1)
        assert lens.distortion[-1] == last


def test_opencv_reads_what_is_written(tmp_path: Path) -> None:
    lens = LENS["plumb_bob"]
    path = write_lens(lens, tmp_path / "lens.yaml", "opencv")
    store = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    matrix, bent = (store.getNode(k).mat() for k in ("camera_matrix", "distortion_coefficients"))
    store.release()
    points = np.array([[1.0, 2.0, 5.0], [-2.0, 0.3, 4.0]])
    theirs = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, bent)[0][:, 0]
    np.testing.assert_allclose(lens.project(points), theirs, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("a: 1", "lens-file-unknown-format"),
        (ROS.replace("plumb_bob", "thin_prism"), "lens-file-invalid"),
        (ROS.replace("image_width: 640\n", ""), "lens-file-invalid"),
        (ROS.replace("431.5, 0.0,", "431.5, 9.0,"), "lens-file-invalid"),
        (ROS.replace("431.5", "-431.5"), "lens-not-finite"),
        (ROS.replace("[-0.33, 0.12, 0.0007, -0.0006, 0.0]", "[.nan, 0, 0, 0]"), "lens-not-finite"),
        (KALIBR.replace("equidistant", "fov"), "lens-file-invalid"),
        (KALIBR.replace("431.5, ", ""), "lens-file-invalid"),
        ("cam0: [", "lens-file-invalid"),
        ("%YAML:1.0\n---\na: 1\n", "lens-file-invalid"),
    ],
)
def test_unusable_files_are_refused(text: str, code: str, tmp_path: Path) -> None:
    path = tmp_path / "cam.yaml"
    path.write_text(text)
    with refused(code):
        read_lens(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with refused("file-unreadable"):
        read_lens(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize("name", sorted(LENS))
def test_a_design_takes_its_lens_from_a_file(name: str, tmp_path: Path) -> None:
    kind: Any = "kalibr" if name in ("omni", "radtan") else "opencv"
    path = write_lens(LENS[name], tmp_path / "lens.yaml", kind)
    design = make_design(camera={"calibration": str(path)})
    assert design.camera.calibration == ""  # the design holds the numbers, not the file
    lens, wanted = design.camera.lens(), LENS[name]
    assert lens.model == wanted.model
    points = np.random.default_rng(0).uniform([-3, -3, 4], [3, 3, 9], (20, 3))
    np.testing.assert_allclose(lens.project(points), wanted.project(points), rtol=1e-12)
    again = parse_design(design.model_dump(mode="json"), "again")
    assert again == design


def test_a_calibration_lies_beside_its_design(tmp_path: Path) -> None:
    write_lens(LENS["fisheye"], tmp_path / "lens.yaml", "opencv")
    section = CameraSection.model_validate(
        {"calibration": "lens.yaml"}, context={"folder": tmp_path}
    )
    assert section.distortion == LENS["fisheye"].distortion
    with refused("field-invalid") as caught:
        parse_design(
            {
                "name": "twice",
                "shape": {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 120.0},
                "camera": {"calibration": "lens.yaml", "focal_px": 100.0},
            },
            "design",
        )
    caught.match("focal_px")


def test_presets_are_the_papers_cameras() -> None:
    fast = CameraSection.model_validate({"preset": "paper_480fps"})
    assert (fast.width_px, fast.height_px, fast.frame_rate_Hz) == (640, 480, 480.0)
    large = CameraSection.model_validate({"preset": "paper_30fps"})
    assert (large.width_px, large.height_px, large.frame_rate_Hz) == (2592, 1944, 30.0)
    # The same field of view: the smaller side over the focal length.
    assert fast.focal_px / 480 == pytest.approx(large.focal_px / 1944, rel=1e-3)
    own = CameraSection.model_validate({"preset": "paper_480fps", "focal_px": 300.0})
    assert own.focal_px == 300.0
    with pytest.raises(ValueError, match="preset 'paper_480fps' has width_px = 640"):
        CameraSection.model_validate({"preset": "paper_480fps", "width_px": 800})


def test_a_design_with_an_impossible_lens_is_refused() -> None:
    for camera, words in (
        ({"model": "kannala_brandt", "distortion": (0.1,)}, "takes 0 or 4"),
        ({"model": "omnidirectional", "distortion": (-1.0,)}, "ξ must be 0 or more"),
    ):
        with pytest.raises(ValueError, match=words):
            CameraSection.model_validate(camera)


@pytest.mark.parametrize("name", sorted(LENS))
def test_a_bundle_holds_the_lens(name: str) -> None:
    table = lens_table(LENS[name]) | {"position_mm": [1, 2, 3], "rotation": np.eye(3).tolist()}
    assert camera_from(table, Path()).lens == LENS[name]
    with refused("lens-distortion-count"):
        camera_from(table | {"distortion": [0.0] * 7}, Path())
    with pytest.raises(ValueError, match="model 'glass' is not known"):
        camera_from(table | {"model": "glass"}, Path())


def test_a_bundle_of_schema_1_0_is_a_pinhole() -> None:
    table = lens_table(LENS["pinhole"]) | {"position_mm": [1, 2, 3], "rotation": np.eye(3).tolist()}
    del table["distortion"]
    lens = camera_from(table | {"focal_px": 970.0}, Path()).lens
    assert (lens.model, lens.fx_px, lens.fy_px) == ("pinhole", 970.0, 970.0)
