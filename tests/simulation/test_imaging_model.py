"""Points against frames; noise, scatter and blindness of the imaging model."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import Readers, cameras_of, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.optics.exposure import Exposure
from phytac_design.optics.paint import to_srgb
from phytac_design.optics.render_scene import SHELL, build_scene
from phytac_design.optics.visibility import measure_visibility
from phytac_design.simulation.contacts import draw_contacts, switch_states
from phytac_design.simulation.imaging import imaging_model
from phytac_design.simulation.imaging.imaging_model import (
    ImagingModel,
    MarkerReading,
    RestObservation,
    pixel_phase_error,
)
from phytac_design.simulation.imaging.nominal_view import expected_views, paint_slope
from phytac_design.simulation.instance_shell import truth_shell
from phytac_design.simulation.linear_response import motion_responses, rigid_slope, superpose
from phytac_design.simulation.pressed_series import ImageResponse as Watched
from phytac_design.simulation.sensor_instance import SensorInstance, ThicknessField
from phytac_shapes.arrays import FloatArray
from tests.designs import changed, of_shape
from tests.refusals import refused

CELL_px = 0.1

AGREE_px = 0.05
"""RMS between points and frames without noise."""
EXPOSURE = Exposure(noise_pixel=2.0)


def design(ends: str = "near") -> Design:
    return changed(
        "cylinder60",
        shape={"length_mm": 50.0},
        layout={"rows": 5, "columns": 8, "height_near_mm": 1.5, "height_far_mm": 6.0},
        camera={"width_px": 864, "height_px": 648, "focal_px": 323.0, "ends": ends},
        light={"bar_radius_mm": 2.0},
        wall={"thickness_mm": 0.5},
    )


def unit_of(design: Design) -> SensorInstance:
    surface = design.surface()
    markers = make_markers(design, surface)
    threshold = thresholds_N(design, markers) * np.ones(markers.count)
    return SensorInstance(
        number=0,
        markers=markers,
        wall=ThicknessField.even(surface),
        modulus=1.0,
        on_N=threshold,
        off_N=0.7 * threshold,
        cameras=cameras_of(design, surface),
        paint=np.ones((len(design.layout.colours) + 1, 3)),
    )


def by_colour(rest: RestObservation) -> RestObservation:
    """The same for frames that are read without the edges of markers, as points are."""
    return replace(rest, bundle=replace(rest.bundle, edges=()))


class Rig:
    """A sensor instance and its imaging model, pressed a few times with 25 N."""

    def __init__(self, design: Design, unit: SensorInstance | None = None) -> None:
        self.design, self.surface = design, design.surface()
        self.unit = unit or unit_of(design)
        markers = make_markers(design, self.surface)
        drawn = draw_contacts(
            Sensor.of(design, self.surface, markers),
            samples=3,
            rng=np.random.default_rng(1),
            most=3,
        )
        contacts = replace(drawn, force_N=np.full(len(drawn.force_N), 25.0))
        mesh, model = truth_shell(design, self.surface, 2)
        response = motion_responses(
            model, mesh, self.surface, markers, uv=contacts.uv, radius_mm=contacts.radius_mm
        )
        self.motion = superpose(response, contacts)
        self.bits = switch_states(Sensor.of(design, self.surface, markers), contacts).bits
        self.views = expected_views(Sensor.of(design, self.surface, markers))
        self.imaging = self.make(self.unit)
        self.still = np.zeros((markers.count, 6))
        self.off = np.zeros(markers.count, dtype=np.bool_)

    def make(self, unit: SensorInstance, **options: Any) -> ImagingModel:
        return ImagingModel(
            self.design, self.surface, unit, exposure=EXPOSURE, views=self.views, **options
        )

    @property
    def by_colour(self) -> ImagingModel:
        """The model whose frames are read without the edges of markers."""
        return self.make(self.unit, at_rest=by_colour(self.imaging.at_rest))

    def errors(self, imaging: ImagingModel | None = None) -> tuple[FloatArray, FloatArray]:
        """Points less frames without noise, and those shifts, (samples, n, 2) px."""
        imaging = imaging or self.imaging
        zero = imaging.read(imaging.frame(self.still, self.off)).shift_px
        frames, points = [], []
        for motion, bits in zip(self.motion, self.bits, strict=True):
            seen = imaging.read(imaging.frame(motion, bits))
            np.testing.assert_array_equal(seen.bits, bits)
            assert seen.found.all()
            assert seen.status == ""
            frames.append(seen.shift_px - zero)
            points.append(imaging.points(motion, bits).shift_px)
        return np.array(points) - np.array(frames), np.array(frames)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig(design())


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_points_are_what_frames_show(rig: Rig) -> None:
    error, shift = rig.errors()
    moved = np.linalg.norm(shift, axis=2)
    assert moved.max() > 1.0
    assert rig.bits.sum() >= 3
    assert rms(error) < AGREE_px
    assert rms(error[moved > 0.1 * moved.max()]) < AGREE_px
    # Without what a tip covers as its receptor turns, those that are on would not agree.
    assert rms(error[rig.bits]) < 1.5 * AGREE_px


def test_paint_is_where_frames_show_it(rig: Rig) -> None:
    # Paint on a tube's far side would pull its centroid aside by pixels.
    place = rig.imaging._paints[0].centroids(rig.still)
    error = place - rig.imaging.at_rest.rest_px
    assert rms(error) < 0.25
    assert np.abs(error.mean(axis=0)).max() < 0.05


def test_a_tip_covers_other_paint_as_its_receptor_turns(rig: Rig) -> None:
    motion, bits = rig.still.copy(), rig.off.copy()
    some = np.array([2, 11, 22, 31, 37])
    bits[some] = True
    motion[some, 3:] = 0.3 * rig.unit.markers.normal[np.roll(some, 2)]
    imaging = rig.by_colour
    frames = imaging.read(imaging.frame(motion, bits))
    np.testing.assert_array_equal(frames.bits, bits)
    error = imaging.points(motion, bits).shift_px - frames.shift_px
    without = imaging._covered(motion, bits, bits)
    assert rms(error[some]) < 2.0 * AGREE_px
    assert rms(without[some]) > 2.4 * AGREE_px


def test_frames_of_small_markers_are_read_by_their_edges_too(rig: Rig) -> None:
    """As in use: compressed, they are then nearer to frames that are not."""
    colour, both = rig.by_colour, rig.imaging
    clean = [each.read(each.frame(rig.motion[0], rig.bits[0])).shift_px for each in (colour, both)]
    (frame,) = both.frame(rig.motion[0], rig.bits[0])
    data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
    coarse = (np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8),)
    errors = [
        rms(each.read(coarse).shift_px - plain)
        for each, plain in zip((colour, both), clean, strict=True)
    ]
    assert errors[1] < 0.5 * errors[0]


def test_frames_in_another_light_are_read_as_in_that_of_the_rest_frame(rig: Rig) -> None:
    (frame,) = rig.imaging.frame(rig.motion[0], rig.bits[0])
    usual = rig.imaging.read((frame,)).shift_px
    warm = np.rint(frame * np.array([0.7, 0.9, 1.0])).astype(np.uint8)
    seen = rig.imaging.read((warm,))
    np.testing.assert_array_equal(seen.bits, rig.bits[0])
    assert rms(seen.shift_px - usual) < 0.015


def test_pixels_agree_too(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    imaging = rig.make(rig.unit, centroids="pixels", at_rest=rig.imaging.rest)
    for camera in imaging.cameras:  # one receptor is moved so far that its wall would be in the way
        monkeypatch.setattr(camera, "scene", partial(camera.scene, wall_follows=False))
    motion, bits = rig.motion[0], rig.bits[0]
    paint, pixels = rig.imaging.exact(motion, bits), imaging.exact(motion, bits)
    assert rms(paint - pixels) < 0.02  # nothing hides anything here
    # A receptor brought before another one covers some of it, and only pixels know.
    push, tips, eye = rig.still.copy(), rig.unit.markers.tip_mm, rig.unit.cameras[0].position_mm
    push[20, :3] = eye + 0.8 * (tips[21] - eye) + [2.8, 2.8, 0.0] - tips[20]
    hidden = np.abs(imaging.exact(push, rig.off) - rig.imaging.exact(push, rig.off))[21].max()
    frames = imaging.read(imaging.frame(push, rig.off)).shift_px
    assert hidden > 0.5
    left = np.linalg.norm(imaging.exact(push, rig.off)[21] - frames[21])
    assert left < 0.15 * np.linalg.norm(frames[21])


def test_nothing_moves_at_rest(rig: Rig) -> None:
    np.testing.assert_array_equal(rig.imaging.exact(rig.still, rig.off), 0.0)
    np.testing.assert_array_equal(rig.imaging.points(rig.still, rig.off).shift_px, 0.0)
    dim = rig.imaging.read(rig.imaging.frame(rig.still, rig.off, 0.8)).shift_px
    assert rms(dim) < AGREE_px


def test_moving_all_receptors_is_moving_the_camera(rig: Rig) -> None:
    step = np.array([0.3, -0.2, 0.5])
    motion = rig.still.copy()
    motion[:, :3] = step
    paint = rig.imaging._paints[0]
    camera = paint.camera
    there = paint.centroids(motion)
    try:
        paint.camera = replace(camera, position_mm=camera.position_mm - step)
        here = paint.centroids(rig.still)
    finally:
        paint.camera = camera
    # Light from the bar stays where it is: shading differs a little.
    np.testing.assert_allclose(there, here, atol=0.02)


def test_points_have_the_noise_of_frames(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    imaging, rest = rig.by_colour, rig.imaging.at_rest
    # All frames below are of the same light.
    (camera,) = imaging.cameras
    light = camera.light(camera.scene(rig.still, rig.off))
    monkeypatch.setattr(camera, "light", lambda _: light)
    rng = np.random.default_rng(5)
    points = np.stack([imaging.points(rig.still, rig.off, 1.0, rng).shift_px for _ in range(100)])
    np.testing.assert_allclose(points.std(axis=0), rest.noise_px, rtol=0.35, atol=0.015)
    frames = np.stack(
        [imaging.read(imaging.frame(rig.still, rig.off, 1.0, rng)).shift_px for _ in range(8)]
    )
    assert rms(frames.std(axis=0, ddof=1)) == pytest.approx(rms(rest.noise_px), rel=0.2)
    assert 0.002 < np.median(rest.noise_px) < 0.1
    dark = np.stack([imaging.points(rig.still, rig.off, 0.25, rng).shift_px for _ in range(30)])
    assert rms(dark) > 1.6 * rms(points)
    dark_frames = np.stack(
        [imaging.read(imaging.frame(rig.still, rig.off, 0.25, rng)).shift_px for _ in range(8)]
    )
    # Frames suffer less: they are brought back to the brightness of the rest frame.
    assert 1.0 < rms(dark) / rms(dark_frames.std(axis=0, ddof=1)) < 1.7


def test_points_of_moved_markers_err_as_frames_without_noise_do(rig: Rig) -> None:
    """Paint crosses the grid of pixels as a marker moves; a marker at rest shows none of it."""
    quiet = replace(rig.imaging.at_rest, noise_px=np.zeros((len(rig.off), 2)))
    imaging = rig.make(rig.unit, at_rest=quiet)
    zero = imaging.read(imaging.frame(rig.still, rig.off)).shift_px
    framed, drawn = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        motion = rig.still.copy()
        motion[:, :3] = rng.normal(0.0, 0.3, 3)
        exact = imaging.points(motion, rig.off).shift_px
        framed.append(imaging.read(imaging.frame(motion, rig.off)).shift_px - zero - exact)
        drawn.append(imaging.points(motion, rig.off, 1.0, rng).shift_px - exact)
    assert rms(np.array(framed)) > 0.02
    assert rms(np.array(drawn)) == pytest.approx(rms(np.array(framed)), rel=0.35)
    still = imaging.points(rig.still, rig.off, 1.0, np.random.default_rng(0)).shift_px
    np.testing.assert_array_equal(still, 0.0)


def test_same_generator_same_sample(rig: Rig) -> None:
    motion, bits = rig.motion[0], rig.bits[0]
    one, two = (
        rig.imaging.points(motion, bits, 1.0, np.random.default_rng(4)).shift_px for _ in range(2)
    )
    np.testing.assert_array_equal(one, two)
    again = rig.make(rig.unit)
    a, b = (e.frame(motion, bits, 1.0, np.random.default_rng(4))[0] for e in (rig.imaging, again))
    np.testing.assert_array_equal(a, b)
    assert isinstance(again.rest, RestObservation)
    np.testing.assert_array_equal(again.rest.noise_px, rig.imaging.at_rest.noise_px)


def turned(camera: Camera, degrees: float, step_mm: FloatArray) -> Camera:
    """Camera turned about its own x, and moved."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return replace(
        camera, rotation=turn @ camera.rotation, position_mm=camera.position_mm + step_mm
    )


def test_a_scattered_instance_is_read_against_its_own_rest_frame(rig: Rig) -> None:
    rng = np.random.default_rng(2)
    unit = rig.unit
    markers = unit.markers
    aside = rng.normal(0.0, 0.1, (markers.count, 3))
    moved = replace(
        markers,
        base_mm=markers.base_mm + aside,
        tip_mm=markers.tip_mm + aside,
        mid_mm=markers.mid_mm + aside,
    )
    scattered = replace(
        unit,
        number=7,
        markers=moved,
        cameras=(turned(unit.cameras[0], 0.6, np.array([0.2, -0.1, 0.1])),),
        paint=1.0 + rng.normal(0.0, 0.05, (3, 3)),
    )
    imaging = rig.make(scattered)
    assert imaging.status == ""
    away = np.linalg.norm(imaging.at_rest.rest_px - imaging.nominal.rest_px, axis=1)
    assert away.max() > 4.0
    error, _ = rig.errors(imaging)
    assert rms(error) < AGREE_px


def test_an_unreadable_instance_has_a_status(rig: Rig) -> None:
    blind = replace(rig.unit, cameras=(turned(rig.unit.cameras[0], 30.0, np.zeros(3)),))
    imaging = rig.make(blind)
    assert "is this a frame of the sensor" in imaging.status
    frames = imaging.frame(rig.still, rig.off)
    for seen in (imaging.read(frames), imaging.points(rig.still, rig.off)):
        assert seen.status == imaging.status
        assert not seen.found.any()
        assert np.isnan(seen.shift_px).all()
    with refused("rest-frame-undecodable"):
        _ = imaging.at_rest


def test_a_frame_that_cannot_be_read_says_so(rig: Rig) -> None:
    dark = rig.imaging.read((np.zeros((648, 864, 3), dtype=np.uint8),))
    assert "found 0 of 40 markers" in dark.status
    small = rig.imaging.read((np.zeros((64, 86, 3), dtype=np.uint8),))
    assert "image is 86x64 px" in small.status
    assert not small.found.any()


@pytest.mark.long
def test_two_cameras_read_each_their_own() -> None:
    rig = Rig(design("both"))
    number = rig.imaging.nominal.read_by
    assert 8 < number.sum() < 32
    assert len(rig.imaging.frame(rig.still, rig.off)) == 2
    error, shift = rig.errors()
    for camera in (0, 1):
        assert rms(error[:, number == camera]) < AGREE_px
        assert np.abs(shift[:, number == camera]).max() > 0.3


def test_paint_counts_by_the_chroma_that_opencv_gives_its_colour(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    (paint,) = rig.imaging._paints
    light = np.random.default_rng(6).random((len(paint.owner), 3))
    monkeypatch.setattr(paint, "counts", lambda share: share)
    colour = to_srgb(light).astype(np.float32)[None] / 255.0
    chroma = 255.0 * (cv2.cvtColor(colour, cv2.COLOR_RGB2YCrCb)[0, :, 1:] - 0.5)
    share = (chroma * paint.chroma).sum(axis=1) / (paint.chroma**2).sum(axis=1)
    np.testing.assert_allclose(paint._seen_chroma(light), share, atol=2e-3)


def test_grid_error_is_the_unbiased_scatter_over_places_on_the_pixels(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Frames are the shifts of the image; a detector finds each with an error of known size.
    draw, grid_px, place_px = np.random.default_rng(2), 0.05, np.full((4000, 2), 100.0)

    def found(_: Any, frames: Any) -> tuple[SimpleNamespace, None]:
        error_px = grid_px * draw.standard_normal(place_px.shape)
        return SimpleNamespace(position_px=place_px + frames[0] + error_px), None

    monkeypatch.setattr(imaging_model, "locate_markers", found)
    monkeypatch.setattr(imaging_model.SimulatedCamera, "light", lambda *given: given[2])
    monkeypatch.setattr(ImagingModel, "_exposed", lambda *given: np.array(given[2]))
    before = found(None, (0.0,))[0].position_px
    # The detector above looks at no bundle.
    grid = rig.imaging._grid(None, before)  # type: ignore[arg-type]
    assert np.mean(grid**2) == pytest.approx(grid_px**2, rel=0.04)


def test_rest_frames_give_the_unbiased_noise_of_one(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A detector of known noise; tips that are out move what it finds by 2 px: 1.5 px are expected.
    draw, noise_px, count = np.random.default_rng(4), 0.05, 4000

    def found(_: Any, frames: Any) -> tuple[SimpleNamespace, None]:
        noise = noise_px * draw.standard_normal((count, 2))
        return SimpleNamespace(position_px=100.0 + float(frames[0]) + noise), None

    bundle = SimpleNamespace(tip_shift_px=lambda bits: np.full((count, 2), 1.5 * bits.all()))
    imaging = rig.make(rig.unit)
    monkeypatch.setattr(imaging_model, "locate_markers", found)
    monkeypatch.setattr(ImagingModel, "count", count)
    monkeypatch.setattr(ImagingModel, "_set_to", lambda *_: bundle)
    monkeypatch.setattr(ImagingModel, "_exposed", lambda *_: 0.0)
    monkeypatch.setattr(imaging_model, "prepared_frames", lambda *given: given[1])
    monkeypatch.setattr(imaging_model, "with_pictures_at_rest", lambda *given: given[0])
    monkeypatch.setattr(ImagingModel, "frame", lambda *_: (2.0,))
    for name in ("scene", "light"):
        monkeypatch.setattr(imaging_model.SimulatedCamera, name, lambda *_: None)
    rest = imaging.at_rest
    assert np.mean(rest.noise_px**2) == pytest.approx(noise_px**2, rel=0.04)
    assert np.mean(rest.rest_px) == pytest.approx(100.0, abs=0.01)
    assert np.mean(rest.tip_bias_px) == pytest.approx(0.5, abs=0.01)


def test_paint_beyond_the_image_is_not_seen(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    # The image is cut off just before and just after one marker's paint, at either side.
    (paint,) = rig.imaging._paints
    camera = paint.camera
    middle = paint.centroids(rig.still)
    marker = int(np.nanargmax(middle[:, 0]))
    last_px = camera.width_px - 1.0
    for at_px, seen in ((-1.0, False), (0.0, True), (last_px, True), (last_px + 1.0, False)):
        cx_px = camera.lens.cx_px + at_px - middle[marker, 0]
        monkeypatch.setattr(
            paint, "camera", replace(camera, lens=replace(camera.lens, cx_px=cx_px))
        )
        assert bool(np.isfinite(paint.centroids(rig.still)[marker, 0])) is seen


def test_keys_are_mixed_as_splitmix64_does() -> None:
    # Its first numbers from the seed 1234567, as implementations in other languages give them.
    state = np.uint64(1234567) + np.uint64(0x9E3779B97F4A7C15) * np.arange(3, dtype=np.uint64)
    wanted = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    assert imaging_model._mixed(state).tolist() == wanted


def test_grid_error_belongs_to_a_place() -> None:
    rng = np.random.default_rng(0)
    place = rng.uniform(0.0, 500.0, (20_000, 2))
    one = pixel_phase_error(place, 3)
    np.testing.assert_allclose(one.std(axis=0), 1.0, rtol=0.02)
    np.testing.assert_allclose(one.mean(axis=0), 0.0, atol=0.03)
    assert abs(np.mean(one[:, 0] * one[:, 1])) < 0.03
    np.testing.assert_array_equal(one, pixel_phase_error(place, 3))
    same = np.floor(place / CELL_px) == np.floor((place + 1e-4) / CELL_px)
    near = same.all(axis=1)
    np.testing.assert_array_equal(pixel_phase_error(place + 1e-4, 3)[near], one[near])
    for other in (
        pixel_phase_error(place + 1.0, 3),
        pixel_phase_error(place, 4),
        np.roll(one, 1, axis=0),
    ):
        assert abs(np.mean(other * one)) < 0.03


def test_the_wall_goes_with_its_receptors(rig: Rig) -> None:
    eye, markers = rig.imaging.cameras[0], rig.unit.markers
    wall = eye.wall
    np.testing.assert_array_equal(wall.moved(eye.rest, rig.still).vertices, eye.rest.vertices)
    motion = rig.still.copy()
    motion[:, :3], motion[:, 3:] = [0.1, 0.2, -0.1], [0.01, -0.02, 0.03]
    moved = wall.moved(eye.rest, motion).vertices - eye.rest.vertices
    shell = np.unique(eye.rest.triangles[eye.rest.part == SHELL])
    assert not np.any(np.delete(moved, shell, axis=0))
    z = eye.rest.vertices[shell, 2]
    edge = (z < 0.01) | (z > 49.99)
    np.testing.assert_allclose(moved[shell][edge], 0.0, atol=0.05)
    middle = shell[(z > 20.0) & (z < 30.0)]
    # Every marker turns about itself: what follows several of them turns about their mean.
    assert np.abs(moved[middle] - motion[0, :3]).max() < 0.35
    one = rig.still.copy()
    one[20, :3] = -markers.normal[20]
    bump = wall.moved(eye.rest, one).vertices[shell] - eye.rest.vertices[shell]
    near = np.linalg.norm(eye.rest.vertices[shell] - markers.mid_mm[20], axis=1)
    assert np.linalg.norm(bump[near.argmin()]) > 0.6
    assert not np.any(bump[near > 40.0])


def test_seen_of_nothing() -> None:
    seen = MarkerReading.nothing(3, "dark")
    assert (seen.status, seen.bits.sum(), seen.found.sum()) == ("dark", 0, 0)


def test_paint_slopes_are_how_frames_show_a_receptor_that_turns() -> None:
    """Seen from its end it shows more paint on one side; its centroid is no point of it."""
    flat = of_shape(
        "plane",
        {"width_mm": 48.0, "height_mm": 36.0},
        {"kind": "straight", "rows": 4, "columns": 6},
    )
    surface = flat.surface()
    markers = make_markers(flat, surface)
    (camera,) = cameras_of(flat, surface)
    tolerance = tolerance_mm(camera, markers)
    rest, on = (
        build_scene(
            Sensor.of(flat, surface, markers),
            tolerance_mm=tolerance,
            switch_on=np.full(markers.count, state),
        )
        for state in (False, True)
    )
    seen = measure_visibility(rest, on, camera, noise_std=0.0, rng=np.random.default_rng(0))
    slope = paint_slope(Sensor.of(flat, surface, markers), camera, rest=rest, seen=seen)
    readers = Readers(cameras=(camera,), read_by=np.zeros(markers.count, dtype=np.int64))
    arm = seen.paint_point_mm - markers.mid_mm
    imaging = ImagingModel(flat, surface, unit_of(flat), exposure=EXPOSURE)
    still, off = np.zeros((markers.count, 6)), np.zeros(markers.count, dtype=np.bool_)
    zero = imaging.read(imaging.frame(still, off)).shift_px
    # Tilts alone: motion moves a centroid as it moves any point.
    motion = np.zeros((markers.count, 6))
    motion[:, 3:5] = np.random.default_rng(2).normal(0.0, 0.05, (markers.count, 2))
    shown = imaging.read(imaging.frame(motion, off)).shift_px - zero
    error = {
        name: rms(Watched(readers, markers.mid_mm, arm, own).shift(motion) - shown) / rms(shown)
        for name, own in (("paint", slope), ("point", None))
    }
    assert error["point"] > 0.08
    assert error["paint"] < 0.03


def test_a_marker_that_nobody_sees_is_watched_at_its_tip() -> None:
    this = design()
    surface = this.surface()
    markers = make_markers(this, surface)
    (camera,) = cameras_of(this, surface)
    rest = build_scene(
        Sensor.of(this, surface, markers), tolerance_mm=tolerance_mm(camera, markers)
    )
    seen = measure_visibility(rest, rest, camera, noise_std=0.0, rng=np.random.default_rng(0))
    nowhere = replace(seen, paint_point_mm=np.full((markers.count, 3), np.nan))
    slope = paint_slope(Sensor.of(this, surface, markers), camera, rest=rest, seen=nowhere)
    arm = markers.tip_mm - markers.mid_mm
    np.testing.assert_array_equal(slope, rigid_slope(camera.jacobian(markers.tip_mm), arm))
