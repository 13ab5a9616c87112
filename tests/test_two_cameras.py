"""A sensor with a camera at each end, from its heights to the forces its two frames decode to."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline.decode import Frames, measure_frame, rest_positions
from phytac_design.cli.app import app
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.optics.pressed_scene import PressedScene
from phytac_design.stages.build import build
from phytac_design.stages.renders_stage import (
    FrameContacts,
    camera_scenes,
    draw_frame_contacts,
    noisy,
    render_sample,
)
from phytac_shapes.arrays import ImageArray
from tests.designs import of_shape
from tests.places_alone import places_alone
from tests.refusals import refused

SHAPE = {"diameter_outer_mm": 34.0, "length_mm": 44.0}
LAYOUT: dict[str, Any] = {
    "rows": 4,
    "columns": 10,
    "heights": "line-of-sight",
    "height_near_mm": 2.0,
    "height_far_mm": 6.0,
}
# Patches that cover a footprint: every contact trips a switch.
TRAINING = {"samples": 60, "samples_test": 30, "patch_radius_min_mm": 5.0}
STAGES = {"near": ["decoder"], "both": ["underload", "frames"]}
ACCURACY = replace(PRESETS["draft"], frames=1, press_places=1, place_share=1.5)
"""Forces are those of ``koi_inverse``, which uses no tables of one order."""


def cylinder(ends: str, **layout: Any) -> Design:
    camera = {"width_px": 648, "height_px": 486, "focal_px": 242.5, "ends": ends}
    return of_shape("cylinder", SHAPE, LAYOUT | layout, camera=camera, training=TRAINING)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    out = {}
    for ends in ("near", "both"):
        out[ends] = tmp_path_factory.mktemp(ends) / "x"
        only = STAGES[ends]
        with places_alone():
            build(cylinder(ends), out[ends], accuracy=ACCURACY, only=only, progress=lambda _: None)
    return out


def frames_in(out: Path, name: str) -> list[Any]:
    return [read_image(out / "views" / f"{name}{mark}.png") for mark in ("", "_far")]


def test_each_camera_reads_the_half_nearest_to_it(built: dict[str, Path]) -> None:
    bundle = load_bundle(built["both"] / "decoder")
    assert len(bundle.cameras) == len(bundle.shown) == 2
    assert bundle.camera is bundle.cameras[0]
    near, far = bundle.cameras
    assert near.position_mm[2] < 0.0
    assert far.position_mm[2] > SHAPE["length_mm"]
    np.testing.assert_array_equal(bundle.read_by, np.arange(40) >= 20)
    for number, shown in enumerate(bundle.shown):
        own = bundle.read_by == number
        np.testing.assert_array_equal(shown.rest_px[own], bundle.rest_px[own])
        np.testing.assert_array_equal(shown.tips.red_on_px[own], bundle.tips.red_on_px[own])
        # What it shows of the other half is elsewhere than in the other camera's image.
        assert np.abs(shown.rest_px[~own] - bundle.rest_px[~own]).max() > 20.0
    one = load_bundle(built["near"] / "decoder")
    assert len(one.cameras) == 1
    assert not one.read_by.any()
    assert one.shown == ()


def test_two_frames_decode_together(built: dict[str, Path]) -> None:
    out = built["both"]
    bundle = load_bundle(out / "decoder")
    rest = rest_positions(bundle, frames_in(out, "frame_rest"))
    assert np.abs(rest - bundle.rest_px).max() < 0.2
    measured = measure_frame(bundle, frames_in(out, "frame_pressed"), rest_px=rest)
    truth = json.loads((out / "views" / "frame_pressed.json").read_text())
    assert set(measured.koi) == {int(key) for key in truth}
    assert measured.found.all()
    forces = measured.forces_N(bundle, "koi_inverse")
    assert forces.sum() == pytest.approx(sum(truth.values()), rel=0.2)
    assert measured.warnings(bundle, forces, estimator="koi_inverse") == []


def test_forces_are_as_right_as_with_one_camera(built: dict[str, Path]) -> None:
    one, two = (
        load_bundle(built[ends] / "decoder").notes["test_relative_error"]["koi_inverse"]
        for ends in ("near", "both")
    )
    assert two < 0.12
    assert two < 1.1 * one


def presses(design: Design, count: int) -> tuple[Context, FrameContacts]:
    accuracy = replace(PRESETS["draft"], frames=count)
    context = Context(design=design, accuracy=accuracy, seed=7, progress=lambda _: None)
    return context, draw_frame_contacts(context)


def sample(
    context: Context, scenes: list[PressedScene], pressed: FrameContacts, index: int | None
) -> tuple[ImageArray, ...]:
    """Noisy frame of each camera."""
    return noisy(context, render_sample(context, scenes, pressed, index), index)


def decoded(bundle: Bundle, design: Design, count: int) -> tuple[float, float, int]:
    """Mean error and mean force (N) of all forces in a frame, and switches read wrongly."""
    context, pressed = presses(design, count)
    scenes = camera_scenes(context)
    rest = rest_positions(bundle, sample(context, scenes, pressed, None))
    off, force, wrong = [], [], 0
    for index, bits in enumerate(pressed.switching.bits):
        measured = measure_frame(bundle, sample(context, scenes, pressed, index), rest_px=rest)
        truth = pressed.switching.receptor_force_N[index]
        off.append(abs(measured.forces_N(bundle, "koi_inverse").sum() - truth.sum()))
        force.append(truth.sum())
        wrong += len(set(measured.koi) ^ set(np.flatnonzero(bits)))
    return float(np.mean(off)), float(np.mean(force)), wrong


@pytest.mark.long
def test_frames_decode_as_well_as_with_one_camera(built: dict[str, Path]) -> None:
    found = {
        ends: decoded(load_bundle(built[ends] / "decoder"), cylinder(ends), 3)
        for ends in ("near", "both")
    }
    assert found["both"][1] == pytest.approx(found["near"][1])
    for error, force, wrong in found.values():
        assert error < 0.15 * force
        assert wrong == 0


@pytest.mark.parametrize(
    ("pick", "code"),
    [
        (lambda a, _: a, "camera-count"),
        (lambda a, b: [a, b, a], "camera-count"),
        (lambda a, b: [b, a], "markers-not-found"),
        (lambda a, b: [a, 0 * b], "markers-not-found"),
        (lambda a, b: [a, b[:-1]], "frame-size"),
    ],
)
def test_wrong_frames_are_rejected(built: dict[str, Path], pick: Any, code: str) -> None:
    bundle = load_bundle(built["both"] / "decoder")
    frames: Frames = pick(*frames_in(built["both"], "frame_rest"))
    with refused(code):
        measure_frame(bundle, frames)


def test_one_camera_takes_one_frame(built: dict[str, Path]) -> None:
    bundle = load_bundle(built["near"] / "decoder")
    context, pressed = presses(cylinder("near"), 1)
    (frame,) = sample(context, camera_scenes(context), pressed, 0)
    alone, listed = measure_frame(bundle, frame), measure_frame(bundle, [frame])
    np.testing.assert_array_equal(alone.shift_px, listed.shift_px)
    with refused("camera-count"):
        measure_frame(bundle, [frame, frame])


def test_a_camera_that_moved_is_named(built: dict[str, Path]) -> None:
    out = built["both"]
    bundle = load_bundle(out / "decoder")
    rest = rest_positions(bundle, frames_in(out, "frame_rest"))
    near, far = frames_in(out, "frame_pressed")
    measured = measure_frame(bundle, [near, np.roll(far, (2, 3), axis=(0, 1))], rest_px=rest)
    texts = measured.warnings(bundle, measured.forces_N(bundle, "koi_inverse"))
    moved = [text for text in texts if "since the rest frame" in text]
    assert len(moved) == 1
    assert "the far camera has " in moved[0]


def test_the_command_takes_a_frame_of_each_camera(built: dict[str, Path]) -> None:
    out = built["both"]
    pressed = [str(out / "views" / f"frame_pressed{mark}.png") for mark in ("", "_far")]
    rest = [str(out / "views" / f"frame_rest{mark}.png") for mark in ("", "_far")]
    words = ["decode", str(out / "decoder"), *pressed, "--json"]
    words += ["--rest", rest[0], "--rest", rest[1]]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert done.exit_code == 0
    reported = json.loads(done.stdout)
    truth = json.loads((out / "views" / "frame_pressed.json").read_text())
    assert reported["found"] == 40
    assert set(reported["forces_N"]) == set(truth)
    with refused("camera-count"):
        CliRunner().invoke(app, words[:3], catch_exceptions=False)
