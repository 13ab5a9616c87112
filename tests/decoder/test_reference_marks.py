"""Reference marks in the decoder: motion of the camera, and turn of the shell."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.camera_motion import MARKED, MarkedMotion
from phytac_decoder.estimation.measured_columns import MeasuredColumns
from phytac_decoder.io.bundle import Bundle, load_bundle, save_bundle
from phytac_decoder.io.frame import Frame
from phytac_decoder.io.sensor_limits import axial_rotation, symmetric_turns
from phytac_decoder.mechanics.receptor_table import ReceptorTable
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import FrameMeasurement, measure_frame, rest_positions
from phytac_decoder.pipeline.frame_reading import read
from phytac_decoder.pipeline.shell_turn import turned
from phytac_decoder.pipeline.tracker import Follower
from phytac_decoder.serving.camera_check import CameraCheck
from phytac_decoder.vision.reference_marks import ReferenceMarks
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.render_scene import build_scene
from phytac_design.simulation.imaging.nominal_view import (
    bundle_marks,
    expected_views,
    vision_bundle,
)
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.decoder.flat_sensor import flat_locator, nearest, shifts
from tests.decoder.test_bundle_locator import bundle as bundle_with_tables
from tests.decoder.test_camera_motion import motion as motion_of
from tests.decoder.test_camera_motion import moved
from tests.designs import small
from tests.refusals import refused

SENSOR = Sensor(small(reference_marks={"count": 12}))
CAMERA = SENSOR.cameras[0]
ON = 37
NOISE_PX = 0.06
MOTIONS = {
    "x 0.3 mm": [0.3, 0, 0, 0, 0, 0, 0],
    "z 0.3 mm": [0, 0, 0.3, 0, 0, 0, 0],
    "tilt 0.3 deg": [0, 0, 0, 0, 5.2e-3, 0, 0],
    "roll 0.3 deg": [0, 0, 0, 0, 0, 5.2e-3, 0],
    "zoom 0.3 %": [0, 0, 0, 0, 0, 0, 3e-3],
}


@cache
def seeing() -> Bundle:
    """Decoder that sees, and finds a force where one marker's image moves inward."""
    views = expected_views(SENSOR)
    count = SENSOR.markers.count
    compliance = np.zeros((2 * count, count))
    compliance[np.arange(2 * count), np.repeat(np.arange(count), 2)] = 1.0
    plain = vision_bundle(SENSOR, views, compliance_px=compliance)
    return replace(plain, marks=bundle_marks(SENSOR, views)).with_mount()


@cache
def frame(motion: tuple[float, ...] = (0.0,) * 7, turn: float = 0.0, on: int = -1) -> ImageArray:
    """Frame of the unloaded sensor with one switch on (or none), its shell turned."""
    camera = moved(CAMERA, list(motion))
    around = axial_rotation(turn)
    camera = Camera(
        lens=camera.lens,
        position_mm=camera.position_mm @ around,
        rotation=camera.rotation @ around,
    )
    bits = np.arange(SENSOR.markers.count) == on
    scene = build_scene(SENSOR, tolerance_mm=0.03, switch_on=bits)
    return render_frame(scene, camera)


def mark_shift(b: list[float]) -> FloatArray:
    points = SENSOR.reference_marks.point_mm
    return np.asarray(moved(CAMERA, b).project(points) - CAMERA.project(points))


@pytest.mark.parametrize("name", MOTIONS)
def test_marks_show_a_motion_far_beyond_the_mount(name: str) -> None:
    table, rng = seeing().mark_motion, np.random.default_rng(0)
    assert table is not None
    surprise = []
    for _ in range(40):
        noise = NOISE_PX * rng.normal(size=(12, 2))
        found = table.estimate_by_marks(mark_shift(MOTIONS[name]) + noise, NOISE_PX)
        assert found is not None
        error = found.mean - MOTIONS[name]
        surprise.append(error @ found.precision @ error)
    # Squared errors over their stated variance, of seven unknowns. Marks on one rim hardly separate
    # zoom from distance: there the mount's prior, three standard deviations off, counts.
    assert 0.4 < np.mean(surprise) / 7.0 < (2.5 if "zoom" in name else 1.5)
    assert found.marked.all()


def test_a_motion_along_the_axis_far_beyond_the_mount_widens_its_prior() -> None:
    table, b = seeing().mark_motion, [0, 0, 0.8, 0, 0, 0, 0]
    assert table is not None
    found = table.estimate_by_marks(mark_shift(b), NOISE_PX)
    assert found is not None
    # One rim separates distance from focal length ten times worse than a motion across.
    spread = np.sqrt(np.diagonal(np.linalg.inv(found.precision)))
    assert spread[2] > 10.0 * spread[0]
    assert found.mean[2] == pytest.approx(0.8, abs=0.03)


def test_what_marks_leave_open_is_the_prior_of_contacts() -> None:
    at = np.array([30.0, 30.0, 0.0])
    koi, seen = np.array([nearest(at)]), shifts(at, 8.0).reshape(-1, 2)
    table = motion_of("handheld")
    model = replace(
        bundle_with_tables().model,
        locator=replace(flat_locator(noise_px=0.02), camera_motion=table),
        camera_motion=table,
    )
    sure = MarkedMotion(
        mean=np.zeros(7), precision=1e12 * np.eye(7), marked=np.ones(7, dtype=np.bool_)
    )
    open_sd, marked_sd = (
        model.contacts(seen, koi, marked=marked).contacts[0].raw_sd_N for marked in (None, sure)
    )
    assert model.locator is not None
    still = replace(model.locator, camera_motion=None).find(seen, koi).contacts[0].raw_sd_N
    assert marked_sd == pytest.approx(still, rel=0.01)
    assert open_sd > 1.02 * still


def test_one_wrong_mark_does_not_matter_and_half_of_them_do() -> None:
    table = seeing().mark_motion
    assert table is not None
    b = MOTIONS["x 0.3 mm"]
    shift = mark_shift(b)
    shift[3] += 4.0
    found = table.estimate_by_marks(shift, NOISE_PX)
    assert found is not None
    np.testing.assert_allclose(found.mean[:2], b[:2], atol=0.01)
    shift[:6] += np.random.default_rng(1).normal(scale=30.0, size=(6, 2))
    assert table.estimate_by_marks(shift, NOISE_PX) is None
    hidden = mark_shift(b)
    hidden[:7] = np.nan
    assert table.estimate_by_marks(hidden, NOISE_PX) is None


def test_a_moved_camera_is_refused_without_marks_and_corrected_with_them() -> None:
    motion = (0.6, -0.1, 0.1, 1e-3, 4e-3, 3e-3, 2e-3)
    ready = calibrate_rest(seeing(), [frame()])
    seen = measure_frame(ready, frame(motion, on=ON))
    assert seen.koi.tolist() == [ON]
    others = np.delete(seen.shift_px, ON, axis=0)
    # Two hundredths of the motion's own shifts, which the fit of contacts takes off.
    assert float(np.sqrt(np.nanmean(others**2))) < 0.2
    assert read(ready, seen, "koi_inverse").valid
    assert seen.moved_cameras(ready, None) == []
    blind = replace(ready, marks=ReferenceMarks())
    alone = measure_frame(blind, frame(motion, on=ON))
    assert float(np.sqrt(np.nanmean(alone.shift_px**2))) > 2.0
    assert read(blind, alone, "koi_inverse").code == "rest-frame-outdated"


def test_rest_positions_and_the_tracker_hold_the_marks_too() -> None:
    plain, motion = seeing(), (0.1, 0.0, 0.0, 0.0, 0.0, 1e-3, 0.0)
    rest = rest_positions(plain, frame())
    assert rest.shape == (SENSOR.markers.count + 12, 2)
    follower = Follower(plain, frame())
    for seen in (measure_frame(plain, frame(motion), rest_px=rest), follower.follow(frame(motion))):
        assert seen.marked is not None
        np.testing.assert_allclose(seen.marked.mean[[0, 5]], [0.1, 1e-3], atol=0.01)
        assert float(np.nanmax(np.abs(seen.shift_px))) < 0.5
        assert seen.found.shape == (SENSOR.markers.count,)
    # Measured rest positions without those of the marks: these cannot be compared.
    markers = measure_frame(plain, frame(motion), rest_px=rest[: SENSOR.markers.count])
    assert markers.marked is None
    assert any("reference marks" in text for text in markers.warnings(plain, np.zeros(112)))


def test_motion_beyond_what_marks_can_show_is_refused() -> None:
    bundle, count = seeing(), SENSOR.markers.count
    table = bundle.mark_motion
    assert table is not None
    for factor, refusals in ((0.9, 0), (1.5, 1)):
        b = [factor * MARKED.shift_mm, 0, 0, 0, 0, 0, 0]
        marked = table.estimate_by_marks(mark_shift(b), NOISE_PX)
        seen = FrameMeasurement(
            koi=np.zeros(0, dtype=np.int64),
            shift_px=np.zeros((count, 2)),
            found=np.ones(count, dtype=np.bool_),
            marked=marked,
        )
        assert len(seen.moved_cameras(bundle, None)) == refusals


@pytest.mark.parametrize("step", [0, 1, 3, 6])
def test_a_turned_shell_is_recognised_and_keeps_its_numbers(step: int) -> None:
    bundle = seeing()
    assert bundle.symmetry_order == 7
    ready = calibrate_rest(bundle, [frame(turn=step / 7)])
    want = 360.0 * step / 7
    assert ready.turned_deg % 360.0 == pytest.approx(want)
    assert any("shell-turned" in text for text in ready.limits()) == (step > 0)
    seen = measure_frame(ready, frame(turn=step / 7, on=ON))
    assert seen.koi.tolist() == [ON]
    assert seen.marked is not None
    assert float(np.nanmax(np.abs(np.delete(seen.shift_px, ON, axis=0)))) < 0.2


def test_a_shell_that_is_turned_again_has_the_sum_of_both_turns() -> None:
    once = calibrate_rest(seeing(), [frame(turn=2 / 7)])
    again = calibrate_rest(once, [frame(turn=1 / 7)])
    assert again.turned_deg == pytest.approx(360.0 / 7)
    assert measure_frame(again, frame(turn=1 / 7, on=ON)).koi.tolist() == [ON]
    assert calibrate_rest(once, [frame(turn=2 / 7)]).turned_deg == once.turned_deg


def test_without_marks_the_ambiguity_is_reported_and_a_turned_shell_is_not_seen() -> None:
    blind = replace(seeing(), marks=ReferenceMarks())
    assert any("orientation-ambiguous" in text for text in blind.limits())
    ready = calibrate_rest(blind, [frame(turn=3 / 7)])
    assert measure_frame(ready, frame(turn=3 / 7, on=ON)).koi.tolist() != [ON]
    assert not any("orientation-ambiguous" in text for text in seeing().limits())


def test_marks_that_do_not_show_the_turn_are_refused() -> None:
    bundle = seeing()
    hidden = frame().copy()
    for x, y in np.rint(bundle.marks.rest_px[[0, 3, 5]]).astype(int):
        hidden[y - 25 : y + 25, x - 25 : x + 25] = hidden[y - 25, x - 25]
    with refused("orientation-unknown"):
        calibrate_rest(bundle, [hidden])


def test_a_decoder_of_one_print_or_scene_is_not_turned() -> None:
    scene = {"scene": {"name": "part", "regions": [], "in_play": [1, 2]}}
    with refused("shell-turned"):
        turned(replace(seeing(), notes=scene), 1)
    plain = seeing()
    columns = MeasuredColumns(marker=np.array([2]), shift_px=plain.model.compliance_px[:, 2:3])
    with refused("shell-turned"):
        turned(replace(plain, model=replace(plain.model, measured=columns)), 1)
    rows = np.zeros((1, 1, len(plain.model.compliance_px)), dtype=np.float32)
    receptors = ReceptorTable(
        marker=np.array([2]),
        shift_px=rows,
        pair=np.zeros((2, 0), dtype=np.int64),
        pair_px=rows[:0, 0],
        top_N=25.0,
    )
    with refused("shell-turned"):
        turned(replace(plain, model=replace(plain.model, receptors=receptors)), 1)


def ring(seed: int = 0) -> Bundle:
    """Random tables on three rings of ten markers in two colours."""
    plain = bundle_with_tables()
    row, column = np.divmod(np.arange(30), 10)
    angle = 2.0 * np.pi * (column / 10.0 + 0.03 * row)
    position = np.column_stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), 8.0 * row])
    locator = plain.model.locator
    assert locator is not None
    locator = replace(locator, position_mm=position, correction=None)
    rng = np.random.default_rng(seed)
    stiffness = rng.normal(size=(30, 30))
    return replace(
        plain,
        tip_bias_px=rng.normal(size=(30, 2)),
        position_mm=position,
        head_mm=position * [0.8, 0.8, 1.0],
        colour=column % 2,
        model=replace(plain.model, locator=locator, stiffness=stiffness),
    ).with_mount()


def test_all_tables_turn_alike() -> None:
    plain = ring()
    turns = symmetric_turns(plain.position_mm, plain.head_mm, plain.colour)
    assert len(turns) == 5
    for step, order in enumerate(turns):
        around = axial_rotation(step / 5)
        np.testing.assert_allclose(
            plain.position_mm @ around.T, plain.position_mm[order], atol=1e-9
        )
        out = turned(plain, step)
        rng = np.random.default_rng(step)
        shift, koi = rng.normal(size=(30, 2)), np.array([2, 11, 23])
        one = replace(plain.model, camera_motion=None)
        two = replace(out.model, camera_motion=None)
        for estimator in ("koi_inverse", "fem"):
            before = one.forces(estimator, shift, order[koi])
            after = two.forces(estimator, shift[order], koi)
            # Tables are of single precision.
            np.testing.assert_allclose(after, before[order], atol=1e-6)
        for name in ("rest_px", "tip_bias_px"):
            np.testing.assert_array_equal(getattr(out, name), getattr(plain, name)[order])
        for name in ("on_px", "red_rest_px", "red_on_px"):
            np.testing.assert_array_equal(getattr(out.tips, name), getattr(plain.tips, name)[order])
        # The image of every point of the shell is that of where it has come.
        points = rng.normal(scale=10.0, size=(9, 3))
        np.testing.assert_allclose(
            out.camera.project(points), plain.camera.project(points @ around.T)
        )
        a, b = one.locator, two.locator
        assert a is not None
        assert b is not None
        rows = a._rows.reshape(30, 30, 2)
        np.testing.assert_array_equal(b._rows.reshape(30, 30, 2), rows[order][:, order])
        assert a.places.pairs is not None
        assert b.places.pairs is not None
        pair = points[:2]
        np.testing.assert_allclose(
            b.places.pairs.between(pair).reshape(-1, 30, 2),
            a.places.pairs.between(pair @ around.T).reshape(-1, 30, 2)[:, order],
            atol=1e-4,
        )


def test_bundles_keep_marks_and_older_ones_have_none(tmp_path: Path) -> None:
    marks = ReferenceMarks(
        point_mm=np.arange(18.0).reshape(6, 3),
        colour=np.zeros(6, dtype=np.int64),
        rest_px=np.arange(12.0).reshape(6, 2),
        read_by=np.zeros(6, dtype=np.int64),
        neighbours=np.full((6, 8), -1),
    )
    plain = bundle_with_tables()
    save_bundle(replace(plain, marks=marks), tmp_path / "new")
    loaded = load_bundle(tmp_path / "new")
    for name in ("point_mm", "colour", "rest_px", "read_by", "neighbours"):
        np.testing.assert_array_equal(getattr(loaded.marks, name), getattr(marks, name))
    assert loaded.mark_motion is not None
    save_bundle(plain, tmp_path / "old")
    assert load_bundle(tmp_path / "old").marks.count == 0
    assert load_bundle(tmp_path / "old").mark_motion is None
    wrong = replace(marks, neighbours=np.full((6, 8), 6))
    save_bundle(replace(plain, marks=wrong), tmp_path / "wrong")
    with refused("bundle-id-invalid"):
        load_bundle(tmp_path / "wrong")


def test_a_camera_is_checked_with_marks() -> None:
    check = CameraCheck(seeing())
    for number in range(2):
        report = check.add(
            Frame(number=number, timestamp_s=float(number), images=(frame(),), ready_s=0.0)
        )
    assert report is not None
    (figures,) = report["cameras"]
    assert (figures["found"], figures["markers"]) == (SENSOR.markers.count,) * 2


def test_each_of_two_cameras_is_corrected_by_its_own_rim() -> None:
    design = small(
        reference_marks={"count": 12, "ends": "both"},
        camera={"ends": "both"},
        layout={"rows": 4, "columns": 8, "heights": "constant", "height_near_mm": 2.0},
    )
    sensor = Sensor(design)
    views = expected_views(sensor)
    plain = replace(vision_bundle(sensor, views), marks=bundle_marks(sensor, views)).with_mount()
    assert plain.marks.read_by.tolist() == [0] * 12 + [1] * 12
    scene = build_scene(sensor, tolerance_mm=0.03)
    near, far = sensor.cameras
    still = render_frame(scene, near)
    ready = calibrate_rest(plain, [still, render_frame(scene, far)])
    motion = [0, 0.3, 0, 0, 0, 3e-3, 0]
    seen = measure_frame(ready, [still, render_frame(scene, moved(far, motion))])
    assert seen.marked is not None
    np.testing.assert_allclose(seen.marked.mean[:2], 0.0, atol=0.01)
    np.testing.assert_allclose(seen.marked.mean[[7, 8, 12]], [0, 0.3, 3e-3], atol=0.01)
    assert float(np.nanmax(np.abs(seen.shift_px))) < 0.3
