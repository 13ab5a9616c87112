"""Noise and covered paint by design, in frames of the sensor ``handle``."""

from functools import cache

import numpy as np

from phytac_design.design.design_file import load_design
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.render_scene import FIRST_MARKER, build_scene
from phytac_design.simulation.imaging.nominal_view import Shot, look
from phytac_design.simulation.imaging.predicted_noise import predict_noise
from phytac_design.simulation.imaging.tip_covers import exact_covers
from phytac_shapes.arrays import BoolArray, FloatArray

SENSOR = Sensor(load_design("examples/uses/handle.toml"))


@cache
def shot() -> Shot:
    return look(SENSOR, SENSOR.cameras[0], rng=np.random.default_rng(0))


def positions(on: BoolArray, noise_std: float = 0.0, seed: int = 0) -> FloatArray:
    camera = SENSOR.cameras[0]
    scene = build_scene(SENSOR, tolerance_mm=tolerance_mm(camera, SENSOR.markers), switch_on=on)
    rng = np.random.default_rng([9, seed])
    return shot().positions(SENSOR, render_frame(scene, camera, noise_std=noise_std, rng=rng))


def test_paint_behind_a_tip_moves_away_from_it() -> None:
    paint, red, empty = FIRST_MARKER, FIRST_MARKER + 3, -1
    rest = np.array([[paint, paint, paint, paint, empty]], dtype=np.int32)
    on = np.array([[paint, paint, paint, red, red]], dtype=np.int32)
    covers = exact_covers(rest, on, 2)
    assert (covers.marker.tolist(), covers.tip.tolist()) == ([0], [1])
    np.testing.assert_allclose(covers.shift_px, [[1.0 - 1.5, 0.0]])


def test_covers_are_those_of_single_tips_in_frames() -> None:
    covers, count = shot().covers, SENSOR.markers.count
    assert len(covers.marker) > 40
    strong = np.argsort(-np.linalg.norm(covers.shift_px, axis=1))[:30]
    chosen = [k for k in strong.tolist() if covers.marker[k] not in covers.tip[strong]]
    on = np.zeros(count, dtype=np.bool_)
    on[covers.tip[chosen]] = True
    measured = positions(on) - positions(np.zeros_like(on))
    markers = covers.marker[chosen]
    predicted = covers.shift(on)[markers]
    left = measured[markers] - predicted
    assert len(chosen) >= 5
    assert np.sqrt(np.mean(predicted**2)) > 0.2
    assert np.sqrt(np.mean(left**2)) < 0.5 * np.sqrt(np.mean(predicted**2))


def test_own_bias_and_covers_are_all_that_tips_do() -> None:
    every = np.ones(SENSOR.markers.count, dtype=np.bool_)
    total = shot().expected.tip_bias_px + shot().covers.shift(every)
    measured = positions(every) - positions(~every)
    np.testing.assert_allclose(total, measured, atol=0.02)


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
