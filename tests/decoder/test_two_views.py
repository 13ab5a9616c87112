"""Two cameras: the bundle that holds them, and pictures that show each other's markers."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from phytac_decoder.camera.camera import Camera
from phytac_decoder.io.bundle import SCHEMA, Bundle, CameraView, load_bundle, save_bundle
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.vision.matching import match_markers
from phytac_decoder.vision.segmentation import segment
from phytac_decoder.vision.switch_detection import TipModel
from phytac_shapes.arrays import FloatArray
from tests.decoder.test_forces import N, make_bundle
from tests.decoder.test_marker_detection import MODEL, discs, lattice
from tests.refusals import refused

FAR = np.arange(N) >= 7


def two_cameras() -> Bundle:
    """The toy's markers, the last five of them read from the far end."""
    bundle, rng = make_bundle(), np.random.default_rng(4)
    near = bundle.camera
    far = Camera.at(near.lens, z_mm=90.0, backward=True)
    shown = []
    for number in range(2):
        own = number == FAR
        rest = np.where(own[:, None], bundle.rest_px, rng.normal(size=(N, 2)))
        rest[2 if number else 9] = np.nan
        shown.append(CameraView(rest_px=rest, tips=bundle.tips))
    read_by = FAR.astype(np.int64)
    return replace(bundle, cameras=(near, far), read_by=read_by, shown=tuple(shown))


def test_a_bundle_of_two_cameras_comes_back_as_it_was(tmp_path: Path) -> None:
    bundle = two_cameras()
    save_bundle(bundle, tmp_path)
    back = load_bundle(tmp_path)
    for one, other in zip(bundle.cameras, back.cameras, strict=True):
        np.testing.assert_array_equal(one.position_mm, other.position_mm)
        np.testing.assert_array_equal(one.rotation, other.rotation)
    np.testing.assert_array_equal(back.read_by, bundle.read_by)
    for was, now in zip(bundle.shown, back.shown, strict=True):
        np.testing.assert_array_equal(was.rest_px, now.rest_px)
        np.testing.assert_array_equal(was.tips.red_on_px, now.tips.red_on_px)
    save_bundle(back, tmp_path / "again")
    for name in ("bundle.json", "bundle.safetensors"):
        assert (tmp_path / name).read_bytes() == (tmp_path / "again" / name).read_bytes()
    meta = json.loads((tmp_path / "bundle.json").read_text())
    assert meta["schema_version"] == "{}.{}".format(*SCHEMA)
    assert meta["camera"] == meta["cameras"][0]


def test_a_bundle_of_one_camera_has_no_more_than_it_needs(tmp_path: Path) -> None:
    save_bundle(make_bundle(), tmp_path)
    names = set(load_file(tmp_path / "bundle.safetensors"))
    assert not any(name.startswith("shown") for name in names)
    back = load_bundle(tmp_path)
    assert back.shown == ()
    np.testing.assert_array_equal(back.shown_by(0).rest_px, back.rest_px)


@pytest.mark.parametrize("version", ["1.0", "1.1", "1.2"])
def test_older_bundles_have_one_camera(tmp_path: Path, version: str) -> None:
    save_bundle(make_bundle(), tmp_path)
    path, arrays = tmp_path / "bundle.json", load_file(tmp_path / "bundle.safetensors")
    meta = json.loads(path.read_text())
    del meta["cameras"], meta["arrays_sha256"], arrays["read_by"], arrays["threshold_N"]
    path.write_text(json.dumps(meta | {"schema_version": version}))
    save_file(arrays, tmp_path / "bundle.safetensors")
    back = load_bundle(tmp_path)
    assert len(back.cameras) == 1
    assert back.read_by.tolist() == [0] * N
    assert back.threshold_N.tolist() == [meta["threshold_N"]] * N
    major, minor = SCHEMA
    newer = f"{major}.{minor + 1}"
    path.write_text(json.dumps(meta | {"schema_version": newer}))
    reported = rf"has schema {newer}, this decoder reads 1.0 to {major}.{minor}"
    with refused("bundle-schema-version") as caught:
        load_bundle(tmp_path)
    caught.match(reported)


def without(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda arrays: arrays.pop(name)


def with_nan(arrays: dict[str, Any]) -> None:
    arrays["shown_rest_px"][1, 11] = np.nan


def with_red_nan(arrays: dict[str, Any]) -> None:
    arrays["shown_tip_red_on_px"][0, 3] = np.nan


def with_third(arrays: dict[str, Any]) -> None:
    arrays["read_by"][5] = 2


def as_small(arrays: dict[str, Any]) -> None:
    arrays["read_by"] = arrays["read_by"].astype(np.int32)


@pytest.mark.parametrize(
    ("corrupt", "code"),
    [
        (without("shown_tip_on_px"), "bundle-array-missing"),
        (with_nan, "bundle-marker-hidden"),
        (with_red_nan, "bundle-not-finite"),
        (with_third, "bundle-id-invalid"),
        (as_small, "bundle-array-type"),
    ],
)
def test_malformed_bundles_are_rejected(
    tmp_path: Path, corrupt: Callable[[dict[str, Any]], None], code: str
) -> None:
    save_bundle(two_cameras(), tmp_path)
    arrays = load_file(tmp_path / "bundle.safetensors")
    corrupt(arrays)
    save_file(arrays, tmp_path / "bundle.safetensors")
    with refused(code):
        load_bundle(tmp_path)


def test_three_cameras_are_rejected(tmp_path: Path) -> None:
    save_bundle(two_cameras(), tmp_path)
    path = tmp_path / "bundle.json"
    meta = json.loads(path.read_text())
    path.write_text(json.dumps(meta | {"cameras": meta["cameras"] * 2}))
    with refused("bundle-camera-count"):
        load_bundle(tmp_path)


def test_what_an_image_does_not_show_is_not_looked_for() -> None:
    """Marker 8 is hidden and 9, of its colour, comes to where 8 would be."""
    rest, colour, near = lattice()
    colour[:] = 0
    keep = np.arange(30) != 8
    moved = rest.copy()
    moved[9] += [-16.0, 0.0]
    image = discs([tuple(p) for p in moved[keep]], ["blue"] * 29, radius=3.5, scale=4)
    blobs = segment(image, MODEL)
    known = np.where(keep[:, None], rest, np.nan)
    found = match_markers(blobs, rest_px=known, colour=colour, neighbours=near)
    assert not found.found[8]
    # The others are found as if there never had been a marker 8.
    fewer = np.where(near > 8, near - 1, np.where(near == 8, -1, near))[keep]
    alone = match_markers(blobs, rest_px=rest[keep], colour=colour[keep], neighbours=fewer)
    np.testing.assert_array_equal(found.position_px[keep], alone.position_px)
    assert found.found.sum() >= 28
    nothing = match_markers(blobs, rest_px=rest * np.nan, colour=colour, neighbours=near)
    assert not nothing.found.any()


def test_hidden_markers_do_not_affect_how_others_move() -> None:
    """Two of marker 14's neighbours are shown; they lead to where it went, beyond its reach."""
    rest, colour, near = lattice()
    colour[:] = 0
    keep = np.isin(np.arange(30), [0, 13, 14, 15])
    moved = rest + np.where(np.isin(np.arange(30), [13, 15])[:, None], [0.0, 12.0], 0.0)
    moved[14] += [0.0, 16.0]
    blobs = segment(
        discs([tuple(p) for p in moved[keep]], ["blue"] * 4, radius=3.5, scale=4), MODEL
    )
    known = np.where(keep[:, None], rest, np.nan)
    found = match_markers(blobs, rest_px=known, colour=colour, neighbours=near)
    np.testing.assert_array_equal(found.found, keep)
    assert np.abs(found.position_px - moved)[keep].max() < 0.2


def pair(foreign: FloatArray) -> tuple[Bundle, list[FloatArray]]:
    """30 markers; the near camera reads the first 24 and shows the others, at ``foreign``."""
    rest, colour, near = lattice()
    toy, count = make_bundle(), len(rest)
    toy_lens = Camera.on_axis(width_px=160, height_px=120, focal_px=80, stand_off_mm=30).lens
    cameras = (Camera.at(toy_lens, z_mm=-30.0), Camera.at(toy_lens, z_mm=90.0, backward=True))
    read_by = (np.arange(count) >= 24).astype(np.int64)
    here = np.where((read_by == 0)[:, None], rest, foreign)
    none = TipModel(
        on_px=np.full((count, 2), np.nan), red_rest_px=np.zeros(count), red_on_px=np.ones(count)
    )
    model = replace(
        toy.model,
        neighbours=near,
        shift_to_mm=np.zeros((count, 2)),
        stiffness=np.eye(count),
        compliance_px=np.ones((2 * count, count)),
        height_z_mm=np.zeros(count),
    )
    bundle = replace(
        toy,
        cameras=cameras,
        read_by=read_by,
        colours=MODEL,
        colour=colour,
        position_mm=np.zeros((count, 3)),
        head_mm=np.concatenate(
            [
                camera.position_mm + 40.0 * camera.rays(rest[read_by == number])
                for number, camera in enumerate(cameras)
            ]
        ),
        rest_px=rest,
        tip_bias_px=np.zeros((count, 2)),
        tips=none,
        model=model,
        threshold_N=np.full(count, 0.5),
        shown=(CameraView(rest_px=here, tips=none), CameraView(rest_px=rest, tips=none)),
    )
    names = [("blue", "green")[c] for c in colour]
    shown = np.isfinite(here[:, 0])
    first = discs(
        [tuple(p) for p in here[shown]],
        [name for name, there in zip(names, shown, strict=True) if there],
        radius=3.5,
        scale=4,
    )
    return bundle.with_mount(), [first, discs([tuple(p) for p in rest], names, radius=3.5, scale=4)]


def test_markers_of_the_other_camera_are_not_mistaken_for_its_own() -> None:
    rest, _, _ = lattice()
    # The other half's markers stand 9 px beside the last row that is read, in its colours.
    foreign = np.full_like(rest, np.nan)
    foreign[24:] = rest[18:24] + np.array([0.0, 9.0])
    bundle, frames = pair(foreign)
    measured = measure_frame(bundle, frames)
    assert measured.found.all()
    assert np.abs(measured.shift_px).max() < 0.1
    # A camera that knows of its own markers alone takes their paint for its own.
    near, far = bundle.shown
    own = np.where((bundle.read_by == 0)[:, None], near.rest_px, np.nan)
    blind = replace(bundle, shown=(replace(near, rest_px=own), far))
    assert np.abs(measure_frame(blind, frames).shift_px[18:24, 1]).min() > 3.0


def test_each_marker_is_measured_in_its_own_cameras_frame() -> None:
    rest, _, _ = lattice()
    bundle, (first, second) = pair(np.full_like(rest, np.nan))
    moved = np.roll(second, (0, 2), axis=(0, 1))
    measured = measure_frame(bundle, [first, moved])
    np.testing.assert_allclose(measured.shift_px[:24], 0.0, atol=0.1)
    np.testing.assert_allclose(measured.shift_px[24:], np.tile([2.0, 0.0], (6, 1)), atol=0.1)
    (warning,) = [
        text
        for text in measured.warnings(bundle, np.zeros(30), estimator="koi_inverse")
        if "since the rest frame" in text
    ]
    assert "the far camera has " in warning


@pytest.mark.parametrize(
    "scene",
    [
        [],
        {},
        {"name": "pad"},
        {"name": 3, "in_play": [0]},
        {"name": "pad", "in_play": [N]},
        {"name": "pad", "in_play": "all"},
    ],
)
def test_a_garbled_scene_is_rejected(tmp_path: Path, scene: Any) -> None:
    bundle = make_bundle()
    save_bundle(replace(bundle, notes={"scene": scene}), tmp_path)
    with refused("bundle-invalid"):
        load_bundle(tmp_path)
    save_bundle(replace(bundle, notes={"scene": {"name": "pad", "in_play": [0, 2]}}), tmp_path)
    assert any(
        "made for the scene 'pad'" in reported for reported in load_bundle(tmp_path).limits()
    )
