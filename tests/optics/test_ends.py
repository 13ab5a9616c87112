"""Cameras before the near end, beyond the far one, and at both."""

import dataclasses
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.io.bundle import load_bundle
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline.decode import measure_frame, rest_positions
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.layout.cameras import Readers, camera_of, cameras_of, stand_off_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import BAR, RESIN, SHELL
from phytac_design.optics.visibility import best_of, check_visibility, visibility_advice
from phytac_design.rules.design_review import checkup
from phytac_design.stages.build import build
from phytac_design.stages.resolution_stage import RESOLUTION
from phytac_design.stages.views_stage import VIEWS
from tests.designs import COARSE
from tests.optics.cases import Bench, make_design
from tests.refusals import refused

SIZE = {"width_px": 648, "height_px": 486, "focal_px": 242.5}
ROWS = {"rows": 4, "columns": 8}
TOWARDS_FAR = ROWS | {"height_near_mm": 0.5, "height_far_mm": 6.0}
TOWARDS_NEAR = ROWS | {"height_near_mm": 6.0, "height_far_mm": 0.5}


def at(ends: str, layout: dict[str, Any], **sections: Any) -> Design:
    shape = {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 60.0}
    return make_design(
        shape=shape, layout=layout, camera=SIZE | {"ends": ends}, **({"name": ends} | sections)
    )


def test_the_far_camera_sees_what_the_near_one_sees_of_the_mirrored_sensor() -> None:
    straight = {"kind": "straight"}
    near = Bench(at("near", TOWARDS_FAR | straight))
    far = Bench(at("far", TOWARDS_NEAR | straight))
    stands = [stand_off_mm(b.design, b.surface, b.camera) for b in (near, far)]
    assert stands[0] == pytest.approx(stands[1], rel=1e-12)
    assert far.camera.position_mm[2] == pytest.approx(60.0 + stands[1], rel=1e-12)
    one, two = rasterise(near.scene(), near.camera).part, rasterise(far.scene(), far.camera).part
    # The sensor is mirrored in z, and the far camera's x runs the other way.
    for code in (SHELL, BAR):
        assert ((one == code) != (two[:, ::-1] == code)).mean() < 2e-4


def test_the_far_cameras_bar_begins_at_its_rim() -> None:
    bench = Bench(at("far", TOWARDS_NEAR))
    scene = bench.scene()
    bar = scene.vertices[scene.triangles[scene.part == BAR]]
    assert bar[..., 2].max() == pytest.approx(55.0)
    assert bar[..., 2].min() == pytest.approx(0.0)
    flat = np.ptp(bar[..., 2], axis=1) == 0.0
    np.testing.assert_allclose(bar[flat][..., 2], 55.0)  # one cap, towards the camera
    shell = scene.vertices[scene.triangles[scene.part == SHELL]].reshape(-1, 3)
    radius = np.hypot(shell[:, 0], shell[:, 1])
    outer = shell[radius > 30.0 + bench.design.wall.rim_flange_mm - 1e-6]
    np.testing.assert_allclose(outer[:, 2], 64.0)  # the end of the rim that the camera sees


def test_heights_that_grow_towards_the_camera_are_said() -> None:
    assert checkup(at("far", TOWARDS_NEAR))["warnings"] == []
    (warning,) = checkup(at("far", TOWARDS_FAR))["warnings"]
    assert "height_far_mm < height_near_mm" in warning
    (warning,) = checkup(at("near", TOWARDS_NEAR))["warnings"]
    assert "height_far_mm > height_near_mm" in warning


def test_one_camera_that_sees_a_marker_is_enough() -> None:
    hidden = {"kind": "straight", "rows": 2, "columns": 4}
    layout = hidden | {"height_near_mm": 24.0, "height_far_mm": 1.0}
    alone = checkup(at("near", layout))
    assert alone["occluded_markers"] == [4, 5, 6, 7]
    design = at("both", layout)
    report = checkup(design)
    assert report["clear"]
    assert [camera["end"] for camera in report["cameras"]] == ["near", "far"]
    assert report["cameras"][0]["visibility"]["occluded"] == 4
    assert sum(camera["best_for"] for camera in report["cameras"]) == 8
    bench_markers = Bench(at("near", layout)).markers
    surface, rng = design.surface(), np.random.default_rng(0)
    each = [
        check_visibility(Sensor.of(design, surface, bench_markers), rng=rng, camera=camera)
        for camera in cameras_of(design, surface)
    ]
    best, camera = best_of(each)
    assert set(camera[4:]) == {1}
    np.testing.assert_array_equal(best.visible_px[4:], each[1].visible_px[4:])
    np.testing.assert_array_equal(
        best.centroid_px[:4][camera[:4] == 0], each[0].centroid_px[:4][camera[:4] == 0]
    )


def test_the_best_camera_separates_the_marker() -> None:
    bench = Bench(at("near", TOWARDS_FAR))
    rng = np.random.default_rng(0)
    one = check_visibility(Sensor.of(bench.design, bench.surface, bench.markers), rng=rng)
    assert one.clear[:4].all()
    assert not one.switch_unreadable[:4].any()
    marker = np.arange(bench.markers.count)
    two = dataclasses.replace(
        one,
        visible_px=one.visible_px + 100,
        fused=marker == 0,
        occluded=marker == 1,
        red_on_px=np.where(marker == 2, 0, one.red_on_px),
    )
    best, camera = best_of([one, two])
    np.testing.assert_array_equal(camera[:4], [0, 0, 0, 1])
    assert best.clear[:4].all()
    assert best.visible_px[2] == one.visible_px[2]
    assert best.visible_px[3] == one.visible_px[3] + 100


def test_two_cameras_want_heights_that_grow_from_both_ends() -> None:
    hidden, none = np.array([3]), np.array([], dtype=np.int64)
    by = np.full(32, RESIN)
    for ends, heights, said in (
        ("both", "linear", True),
        ("both", "line-of-sight", False),
        ("near", "linear", False),
    ):
        bench = Bench(at("near", TOWARDS_FAR))
        design = at(ends, TOWARDS_FAR | {"heights": heights})
        advice = visibility_advice(design, bench.markers, hidden, none, by)
        assert ("grow from both ends" in advice) == said


def test_a_closed_end_has_no_camera() -> None:
    design = load_design("hemisphere")
    section = design.camera.model_copy(update={"ends": "far"})
    with refused("camera-end-closed"):
        cameras_of(design.model_copy(update={"camera": section}), design.surface())


@pytest.mark.parametrize(("start", "words"), [(-40.0, "bar starts at z = 100.00"), (5.0, "")])
def test_a_far_camera_inside_the_bar_is_refused(start: float, words: str) -> None:
    design = at("far", TOWARDS_NEAR, light={"bar_start_mm": start})
    if not words:
        assert camera_of(design, design.surface()).position_mm[2] > 60.0
        return
    with refused("camera-inside-light-bar") as caught:
        camera_of(design, design.surface())
    caught.match(words)
    assert "raise light.bar_start_mm above -29.88" in str(caught.value)


TRAINING = {"samples": 40, "samples_test": 20}


def test_a_build_with_a_far_camera_decodes_its_own_frames(tmp_path: Path) -> None:
    design = at("far", TOWARDS_NEAR, training=TRAINING)
    only = ["underload", "frames"]
    build(design, tmp_path / "x", accuracy=COARSE, only=only, progress=lambda _: None)
    bundle = load_bundle(tmp_path / "x" / "decoder")
    np.testing.assert_allclose(bundle.camera.rotation, np.diag([-1.0, 1.0, -1.0]))
    views = tmp_path / "x" / "views"
    rest = rest_positions(bundle, read_image(views / "frame_rest.png"))
    frame = read_image(views / "frame_pressed.png")
    measured = measure_frame(bundle, frame, rest_px=rest)
    truth = json.loads((views / "frame_pressed.json").read_text())
    assert set(measured.koi) == {int(key) for key in truth}
    forces = measured.forces_N(bundle, "koi_inverse")
    # Few markers far apart decode coarsely, from either end: the linear inverse presses whole cells
    # of markers, which dent the wall less than a contact does.
    assert forces.sum() == pytest.approx(sum(truth.values()), rel=0.6)


def resolved(design: Design) -> tuple[dict[str, Any], set[str]]:
    """Facts of the stage ``resolution``, and names of pictures, run as a build does."""
    context = Context(design=design, accuracy=PRESETS["draft"], seed=0, progress=lambda _: None)
    with tempfile.TemporaryDirectory() as name:
        views, bound = Path(name) / "views", Path(name) / "bound"
        views.mkdir()
        bound.mkdir()
        VIEWS.run(context, views)
        context.folders["views"] = views
        RESOLUTION.run(context, bound)
        context.folders["resolution"] = bound
        pictures = {path.name for path in (views / "export" / "views").iterdir()}
        return context.facts("resolution"), pictures


def test_two_cameras_give_two_sets_of_pictures_and_a_better_bound() -> None:
    one, pictures = resolved(at("near", TOWARDS_FAR))
    assert pictures == {"camera.png", "camera_all_on.png", "ids.png"}
    two, pictures = resolved(at("both", TOWARDS_FAR))
    assert pictures == {"camera.png", "camera_all_on.png", "ids.png"} | {
        "camera_far.png",
        "camera_far_all_on.png",
        "ids_far.png",
    }
    assert (one["cameras"], two["cameras"]) == (1, 2)
    for key in ("force_N_worst", "along_mm_median", "force_known_place_N_median"):
        assert two["bound"]["10 N"][key] < 0.9 * one["bound"]["10 N"][key]
        # Markers seen by one camera each give less information than by both.
        assert two["bound"]["10 N"][key] < two["bound_as_read"]["10 N"][key]
    assert "bound_as_read" not in one
    # The same camera at half of the markers: with the place known, better than it alone.
    known = "force_known_place_N_median"
    assert two["bound_as_read"]["10 N"][known] < one["bound"]["10 N"][known]


def test_what_only_the_other_camera_sees_is_expected_nowhere(tmp_path: Path) -> None:
    """A tall near row hides the far one from the near camera, wholly where it is straight."""
    hidden = {"kind": "straight", "rows": 2, "columns": 4}
    design = at("both", hidden | {"height_near_mm": 24.0, "height_far_mm": 1.0})
    context = Context(design=design, accuracy=PRESETS["draft"], seed=0, progress=lambda _: None)
    VIEWS.run(context, tmp_path)
    with np.load(tmp_path / "arrays.npz") as views:
        near, far = views["shown_rest_px"]
        assert views["camera"].tolist()[4:] == [1] * 4
        assert np.isnan(near[4:]).all()
        assert np.isfinite(far[4:]).all()
        np.testing.assert_array_equal(views["rest_px"][4:], far[4:])
        assert np.isfinite(views["paint_slopes"]).all()
    readers = Readers(cameras=cameras_of(design, context.surface), read_by=np.repeat([0, 1], 4))
    tips = context.markers.tip_mm
    pixels, slopes = readers.project(tips), readers.jacobian(tips)
    for number, camera in enumerate(readers.cameras):
        own = slice(4 * number, 4 * number + 4)
        np.testing.assert_array_equal(pixels[own], camera.project(tips)[own])
        np.testing.assert_array_equal(slopes[own], camera.jacobian(tips)[own])
    many = readers.project(np.stack([tips, tips + 1.0]))
    np.testing.assert_array_equal(many[0], pixels)
    np.testing.assert_array_equal(many[1], readers.project(tips + 1.0))


def test_blur_is_said_of_the_camera_that_reads_the_marker() -> None:
    """In focus near its own rim each camera blurs the other end, which it does not read."""
    sharp = {"ends": "near", "focus_mm": 30.0, "f_number": 0.7, "pixel_um": 5.6}
    design = at("near", ROWS | {"rows": 10, "height_near_mm": 3.0, "height_far_mm": 3.0})

    def said(**camera: Any) -> list[str]:
        section = design.camera.model_copy(update=sharp | camera)
        report = checkup(design.model_copy(update={"camera": section}))
        return [text for text in report["warnings"] if "px wide" in text]

    assert len(said()) == 1
    assert said(ends="both") == []
