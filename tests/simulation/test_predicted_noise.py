"""Noise and covered paint by design, in frames of the sensor ``handle``."""

from functools import cache

import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.vision.switch_detection import TipCovers
from phytac_design.design.design_file import load_design
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import Exposure, expose, lens_blur, light_on_chip
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.light import triangle_light
from phytac_design.optics.render_scene import FIRST_MARKER, build_scene
from phytac_design.simulation.imaging import nominal_view, predicted_noise
from phytac_design.simulation.imaging.nominal_view import Shot, look
from phytac_design.simulation.imaging.predicted_noise import predict_noise
from phytac_design.simulation.imaging.tip_covers import as_detected, exact_covers
from phytac_design.simulation.imaging.virtual_camera import bar_strip
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import DesignError

SENSOR = Sensor(load_design("examples/uses/handle.toml"))


@cache
def shot() -> Shot:
    return look(SENSOR, SENSOR.cameras[0], rng=np.random.default_rng(0))


def positions(on: BoolArray, noise_std: float = 0.0, seed: int = 0) -> FloatArray:
    camera = SENSOR.cameras[0]
    scene = build_scene(SENSOR, tolerance_mm=tolerance_mm(camera, SENSOR.markers), switch_on=on)
    rng = np.random.default_rng([9, seed])
    return shot().positions(SENSOR, render_frame(scene, camera, noise_std=noise_std, rng=rng))


def through_lens(on: BoolArray) -> FloatArray:
    """Positions in a frame of the simulated camera, without noise, by 89 points of the lens."""
    camera, exposure = SENSOR.cameras[0], Exposure()
    scene = build_scene(SENSOR, tolerance_mm=tolerance_mm(camera, SENSOR.markers), switch_on=on)
    sent = triangle_light(scene, camera, strip=bar_strip(SENSOR))
    blur = lens_blur(SENSOR, camera)
    light = light_on_chip(scene, camera, light=sent, blur=blur, samples=89)
    return shot().positions(SENSOR, expose(light, camera, exposure))


def test_paint_behind_a_tip_moves_away_from_it() -> None:
    paint, red, empty = FIRST_MARKER, FIRST_MARKER + 3, -1
    rest = np.array([[paint, paint, paint, paint, empty]], dtype=np.int32)
    on = np.array([[paint, paint, paint, red, red]], dtype=np.int32)
    covers = exact_covers(rest, on, 2)
    assert (covers.marker.tolist(), covers.tip.tolist()) == ([0], [1])
    np.testing.assert_allclose(covers.shift_px, [[1.0 - 1.5, 0.0]])


@pytest.mark.parametrize(
    ("found", "taken"), [(1.3, 1.3), (0.8, 0.8), (3.0, 2.0), (0.1, 0.5), (np.nan, 1.0)]
)
def test_covers_are_as_large_as_a_detector_finds_them(found: float, taken: float) -> None:
    # Markers 0 and 1 lie behind tips 2 and 3; tip 1 is not out, for its marker is watched.
    covers = TipCovers(
        marker=np.array([0, 1, 2]),
        tip=np.array([2, 3, 1]),
        shift_px=np.array([[3.0, -1.0], [0.5, 2.0], [7.0, 7.0]]),
    )
    place_px = np.arange(8.0).reshape(4, 2)
    scaled = as_detected(covers, 4, lambda out: place_px + found * covers.shift(out))
    np.testing.assert_allclose(scaled.shift_px, taken * covers.shift_px)


def test_covers_are_those_of_single_tips_in_frames() -> None:
    covers, count = shot().covers, SENSOR.markers.count
    assert len(covers.marker) > 40
    strong = np.argsort(-np.linalg.norm(covers.shift_px, axis=1))[:30]
    chosen = [k for k in strong.tolist() if covers.marker[k] not in covers.tip[strong]]
    on = np.zeros(count, dtype=np.bool_)
    on[covers.tip[chosen]] = True
    measured = through_lens(on) - through_lens(np.zeros_like(on))
    markers = covers.marker[chosen]
    predicted = covers.shift(on)[markers]
    left = measured[markers] - predicted
    assert len(chosen) >= 5
    assert np.sqrt(np.mean(predicted**2)) > 0.2
    assert np.sqrt(np.mean(left**2)) < 0.5 * np.sqrt(np.mean(predicted**2))
    # Sharp frames would have them 0.87 times as large.
    assert np.sum(measured[markers] * predicted) == pytest.approx(np.sum(predicted**2), rel=0.08)


def test_own_bias_and_covers_are_all_that_tips_do_behind_the_lens() -> None:
    every = np.ones(SENSOR.markers.count, dtype=np.bool_)
    total = shot().expected.tip_bias_px + shot().covers.shift(every)
    left = total - (through_lens(every) - through_lens(~every))
    sharp = total - (positions(every) - positions(~every))
    assert np.sqrt(np.mean(left**2)) < 0.03
    # Without blur, tips take less of the paint beside them.
    assert np.sqrt(np.mean(sharp**2)) > 2.0 * np.sqrt(np.mean(left**2))


def test_tips_are_measured_in_sharp_frames_where_the_lens_has_no_focus(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nothing_sharp(*_: object) -> None:
        raise DesignError("camera-focus", "nothing is sharp")

    monkeypatch.setattr(nominal_view, "lens_blur", nothing_sharp)
    seen = look(SENSOR, SENSOR.cameras[0], rng=np.random.default_rng(0))
    every = np.ones(SENSOR.markers.count, dtype=np.bool_)
    total = seen.expected.tip_bias_px + seen.covers.shift(every)
    left = total - (positions(every) - positions(~every))
    assert np.sqrt(np.mean(left**2)) < 0.03


def test_noise_of_other_frames_is_as_predicted() -> None:
    one, markers = shot(), SENSOR.markers
    noise_std = SENSOR.design.camera.noise_pixel
    still, moved = predict_noise(
        one.rest,
        one.camera,
        lambda frame: one.positions(SENSOR, frame),
        clean=one.frames[0],
        point_mm=one.seen.paint_point_mm,
        neighbours=markers.neighbours,
        noise_std=noise_std,
        rng=np.random.default_rng(1),
    )
    off = np.zeros(markers.count, dtype=np.bool_)
    frames = np.stack([positions(off, noise_std, seed) for seed in range(6)])
    ratio = np.sqrt(2.0 * frames.var(axis=0, ddof=1).mean()) / np.sqrt((still**2).mean())
    assert 0.8 < ratio < 1.25
    assert np.median(moved) > np.median(still)


def test_noise_and_the_error_of_motion_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    # A detector whose errors are known: noise in every frame, and a larger error where a frame is
    # not the first camera's. Frames are the cameras themselves.
    noise_px, grid_px, count = 0.02, 0.04, 3000
    draw = np.random.default_rng(3)
    camera = Camera.on_axis(width_px=640, height_px=480, focal_px=300.0, stand_off_mm=40.0)
    point_mm = draw.uniform(-20.0, 20.0, (count, 3))

    def detect(frame: Camera) -> FloatArray:
        errors = draw.standard_normal((2, count, 2))
        error_px = noise_px * errors[0] + (0.0 if frame is camera else grid_px) * errors[1]
        return frame.project(point_mm) + error_px

    turned: list[Camera] = []
    monkeypatch.setattr(predicted_noise, "render_frame", lambda _, c, **_k: turned.append(c) or c)
    monkeypatch.setattr(predicted_noise, "add_noise", lambda frame, *_: frame)
    neighbours = draw.integers(0, count, (count, 8))
    neighbours[0] = -1
    # Cameras stand for their frames, and nothing is rendered.
    still, moved = predict_noise(
        None,  # type: ignore[arg-type]
        camera,
        detect,  # type: ignore[arg-type]
        clean=camera,  # type: ignore[arg-type]
        point_mm=point_mm,
        neighbours=neighbours,
        noise_std=1.0,
        rng=np.random.default_rng(1),
    )
    # Over one pixel, no more: a marker lies anywhere on it.
    middle = np.zeros((1, 3))
    axis = [other.project(middle) - camera.project(middle) for other in turned]
    assert len(turned) == 3
    assert 0.25 < np.abs(axis).max() <= 0.5 + 1e-3
    # A shift is the difference of two positions.
    assert np.mean(still**2) == pytest.approx(2.0 * noise_px**2, rel=0.05)
    assert np.mean(moved**2) == pytest.approx(grid_px**2, rel=0.05)
