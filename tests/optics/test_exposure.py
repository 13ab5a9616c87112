"""Lens, vignetting, electrons and compression, each against its law."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import KannalaBrandt
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import (
    CLEAN,
    Exposure,
    LensBlur,
    compressed,
    disc_points,
    expose,
    lens_blur,
    light_on_chip,
)
from phytac_design.optics.frame_renderer import render_light, sample_offsets
from phytac_design.optics.light import Strip, albedo, triangle_light
from phytac_design.optics.paint import to_linear, to_srgb
from phytac_design.optics.render_scene import FIRST_MARKER, RenderScene, paint_owner, red_owner
from phytac_design.optics.sharpness import sharpness
from phytac_shapes.arrays import FloatArray, IntArray
from tests.optics.cases import Bench, through_lens

FALL_OFF_MAX = 4.0

CAMERA = Camera.on_axis(width_px=160, height_px=120, focal_px=100.0, stand_off_mm=0.0)
BLUR = LensBlur(aperture_mm=2.0, focus_mm=50.0, diffraction_px=0.0)


def cards(*depth_mm: float) -> RenderScene:
    """A square of paint on each of some planes, side by side, before the camera."""
    vertices, triangles = [], []
    for k, z in enumerate(depth_mm):
        x = (k - (len(depth_mm) - 1) / 2.0) * 0.5 * z
        corners = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]
        square = 0.8 * z * np.array(corners) + [x, 0.0]
        vertices.append(np.column_stack([square, np.full(4, z)]))
        triangles += [[4 * k, 4 * k + 1, 4 * k + 2], [4 * k, 4 * k + 2, 4 * k + 3]]
    count = len(depth_mm)
    return RenderScene(
        vertices=np.concatenate(vertices),
        triangles=np.array(triangles, dtype=np.int32),
        part=np.repeat(FIRST_MARKER + 2 * np.arange(count), 2).astype(np.int32),
        vertex_owner=np.repeat(np.arange(count), 4).astype(np.int32),
        colour=np.zeros(count, dtype=np.int64),
        paints=("blue",),
    )


def disc(width: float) -> FloatArray:
    """Kernel of an even disc, its edge smoothed over the pixels."""
    fine, half = 32, int(np.ceil(width / 2.0)) + 1
    at = (np.arange((2 * half + 1) * fine) + 0.5) / fine - half - 0.5
    inside = (at[:, None] ** 2 + at**2 <= (width / 2.0) ** 2).astype(float)
    kernel = inside.reshape(2 * half + 1, fine, 2 * half + 1, fine).mean(axis=(1, 3))
    return np.asarray(kernel / kernel.sum())


def flat(level: float, shape: tuple[int, int] = (120, 160)) -> np.ndarray:
    """Even light."""
    return np.full((*shape, 3), level, dtype=np.float32)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 8, 13, 24, 64])
def test_lens_points_are_as_far_out_as_a_disc(count: int) -> None:
    points = BLUR.points_mm(count)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-12)
    assert (np.linalg.norm(points, axis=1) <= 1.15 * BLUR.aperture_mm / 2.0).all()
    square = points.T @ points / count
    if count > 1:
        np.testing.assert_allclose(np.diagonal(square), 0.25, atol=1e-12)
    if count > 2:  # two lie on a line
        np.testing.assert_allclose(square, np.eye(2) / 4.0, atol=1e-12)


@pytest.mark.parametrize(("depth", "samples", "worst"), [(100.0, 200, 0.045), (25.0, 8, 0.25)])
def test_blur_is_that_of_an_even_disc(depth: float, samples: int, worst: float) -> None:
    scene = cards(depth)
    light = np.ones((2, 3))
    wide = 100.0 * BLUR.aperture_mm * abs(1.0 / depth - 1.0 / BLUR.focus_mm)
    sharp = render_light(scene, CAMERA, light=light, samples=64)
    exact = cv2.filter2D(sharp, -1, disc(wide), borderType=cv2.BORDER_REPLICATE)
    got = light_on_chip(scene, CAMERA, light=light, blur=BLUR, samples=samples)
    error = (got - exact)[:, :, 0]
    assert np.abs(error).max() < worst
    assert np.abs(sharp - exact).max() > 1.4 * worst
    assert abs(error.sum()) < 1e-3 * exact[:, :, 0].sum()


def test_what_lies_in_focus_stays_sharp() -> None:
    scene, light = cards(50.0), np.ones((2, 3))
    sharp = render_light(scene, CAMERA, light=light, samples=8)
    lens = light_on_chip(scene, CAMERA, light=light, blur=BLUR)
    np.testing.assert_allclose(lens, sharp, atol=1e-6)
    turned = light_on_chip(scene, CAMERA, light=light, blur=replace(BLUR, diffraction_px=0.7))
    np.testing.assert_allclose(turned, cv2.GaussianBlur(sharp, (0, 0), 0.7), atol=1e-6)


def test_lens_looks_around_a_near_edge() -> None:
    # A dark card in focus before a bright one far behind, which the lens blurs over 3 px: whatever
    # filter blurs the finished image lets dark and bright mix at the edge, a lens does not.
    near, far = cards(50.0), cards(200.0)
    both = replace(
        near,
        vertices=np.concatenate([near.vertices, far.vertices * [2.0, 2.0, 1.0]]),
        triangles=np.concatenate([near.triangles, far.triangles + 4]).astype(np.int32),
        part=np.repeat([FIRST_MARKER, FIRST_MARKER + 2], 2).astype(np.int32),
        vertex_owner=np.repeat([0, 1], 4).astype(np.int32),
        colour=np.zeros(2, dtype=np.int64),
    )
    light = np.repeat([[0.0], [1.0]], 2, axis=0) * np.ones(3)
    row = light_on_chip(both, CAMERA, light=light, blur=BLUR, samples=64)[60, :, 0]
    np.testing.assert_array_equal(row[72:88], 0.0)  # 16 px wide
    np.testing.assert_array_equal(row[[66, 67, 68, 69, 70, 89, 90, 91, 92, 93]], 1.0)
    assert 0.6 < row[95] < 0.8  # its own edge, half a pixel away, is blurred


def test_blur_is_what_sharpness_says(few: Bench) -> None:
    found = sharpness(few.design.camera, few.camera, few.surface, few.markers)
    blur = lens_blur(Sensor.of(few.design, few.surface, few.markers), few.camera)
    edge = np.array([blur.aperture_mm / 2.0, 0.0])
    points = few.markers.tip_mm
    scene = replace(few.scene(), vertices=points)
    seen = [
        few.camera.project(through_lens(scene, few.camera, s * edge, blur.focus_mm).vertices)
        for s in (-1.0, 1.0)
    ]
    np.testing.assert_allclose(np.abs(seen[1] - seen[0])[:, 0], found.blur_px, rtol=1e-9)


def test_wide_lens_blurs_by_distance() -> None:
    lens = KannalaBrandt(
        width_px=160, height_px=120, fx_px=60.0, fy_px=60.0, cx_px=79.5, cy_px=59.5
    )
    camera = Camera.at(lens, z_mm=0.0)
    scene, light = cards(25.0), np.ones((2, 3))
    sharp = light_on_chip(scene, camera, light=light, blur=None, samples=128)
    blur = replace(BLUR, aperture_mm=6.0)
    got = light_on_chip(scene, camera, light=light, blur=blur, samples=128)
    wide = 60.0 * blur.aperture_mm * abs(1.0 / 25.0 - 1.0 / 50.0)
    bright = [image[:, :, 0] - image[:, :, 0].min() for image in (sharp, got)]
    variance = [np.sum(image * (np.arange(160) - 79.5) ** 2) / image.sum() for image in bright]
    # An even disc of width w spreads by w² / 16 each way.
    assert variance[1] - variance[0] == pytest.approx(wide**2 / 16.0, rel=0.1)


def test_vignetting_takes_its_share_in_the_corner() -> None:
    exposure = replace(CLEAN, vignetting=0.4)
    frame = to_linear(expose(flat(0.5), CAMERA, exposure).astype(np.float64)).mean(axis=2)
    assert frame[60, 80] == pytest.approx(0.5, rel=0.01)
    assert frame[0, 0] == pytest.approx(0.3, rel=0.01)
    assert frame[-1, -1] == pytest.approx(0.3, rel=0.01)
    half = np.hypot(79.5, 59.5) ** 2
    bend = (0.6**-0.5 - 1.0) / half
    assert frame[60, 0] == pytest.approx(0.5 / (1.0 + bend * (79.5**2 + 0.25)) ** 2, rel=0.01)


@pytest.mark.parametrize("level", [0.02, 0.2, 0.7])
def test_noise_is_that_of_the_electrons(level: float) -> None:
    exposure = Exposure(vignetting=0.0, full_well_e=4000.0, read_noise_e=6.0)
    frame = expose(flat(level, (300, 400)), CAMERA, exposure, rng=np.random.default_rng(3))
    light = to_linear(frame.astype(np.float64))
    wanted = np.sqrt(level * 4000.0 + 36.0) / 4000.0
    step = np.diff(to_linear(np.round(to_srgb(np.array(level))) + np.array([-0.5, 0.5])))[0]
    assert light.std() == pytest.approx(np.hypot(wanted, step / np.sqrt(12.0)), rel=0.03)
    assert light.mean() == pytest.approx(level, rel=0.01)
    # Colours and neighbours err on their own.
    error = light - light.mean()
    assert abs(np.mean(error[..., 0] * error[..., 1])) < 0.02 * light.var()
    assert abs(np.mean(error[1:] * error[:-1])) < 0.02 * light.var()


def test_noise_can_be_set_in_grey_levels() -> None:
    exposure = Exposure(vignetting=0.0, noise_pixel=2.0)
    level = float(to_linear(np.array(128.0)))
    frame = expose(flat(level, (300, 400)), CAMERA, exposure, rng=np.random.default_rng(3))
    assert frame.std() == pytest.approx(np.hypot(2.0, np.sqrt(1.0 / 12.0)), rel=0.03)
    silent = expose(
        flat(level), CAMERA, replace(exposure, noise_pixel=0.0), rng=np.random.default_rng(3)
    )
    np.testing.assert_array_equal(silent, 128)


def test_brightness_scales_light_up_to_white() -> None:
    frames = [expose(flat(0.3), CAMERA, CLEAN, brightness=b) for b in (0.5, 1.0, 4.0)]
    for frame, level in zip(frames, (0.15, 0.3, 1.0), strict=True):
        np.testing.assert_allclose(frame, to_srgb(np.array(level)), atol=0.6)


def test_same_generator_same_frame() -> None:
    a, b, c = (
        expose(flat(0.3), CAMERA, Exposure(), rng=np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(a, b)
    assert np.any(a != c)


def test_jpeg_loses_more_at_less_quality(few: Bench) -> None:
    light = render_light(few.scene(), few.camera)
    frame = expose(light, few.camera, CLEAN)
    lost = [
        np.abs(
            expose(light, few.camera, replace(CLEAN, jpeg_quality=q)).astype(float) - frame
        ).mean()
        for q in (100, 90, 50)
    ]
    assert 0.0 < lost[0] < lost[1] < lost[2] < 5.0
    np.testing.assert_array_equal(
        compressed(frame, 90), expose(light, few.camera, replace(CLEAN, jpeg_quality=90))
    )


def test_strip_lights_as_its_integral_says() -> None:
    points = np.array([[3.0, 4.0, 10.0], [0.0, 20.0, -5.0], [9.0, 0.0, 60.0]])
    strip = Strip(near_mm=2.0, far_mm=42.0, unit_mm=1.0)
    z = np.linspace(2.0, 42.0, 200_001)
    r = np.linalg.norm(points[:, :2], axis=1)[:, None]
    whole = np.trapezoid(r**2 / (r**2 + (z - points[:, 2:]) ** 2) ** 2, z, axis=1)
    np.testing.assert_allclose(strip.at(points), whole, rtol=1e-6)


def test_fall_off_leaves_the_median_marker(few: Bench) -> None:
    tips = few.markers.tip_mm
    strip = Strip.lighting(tips, near_mm=5.0, far_mm=120.0)
    assert np.median(strip.at(tips)) == pytest.approx(1.0)
    even = triangle_light(few.scene(), few.camera)
    fallen = triangle_light(few.scene(), few.camera, strip=strip)
    ratio = fallen.sum(axis=1) / np.maximum(even.sum(axis=1), 1e-30)
    centre = few.scene().vertices[few.scene().triangles].mean(axis=1)
    dim, bright = strip.at(centre) < 0.9, strip.at(centre) > 1.1
    assert (ratio[dim & (few.scene().part != 2)] <= 1.0).all()
    assert (ratio[bright & (few.scene().part != 2)] >= 1.0).all()
    assert ratio.max() <= FALL_OFF_MAX
    np.testing.assert_array_equal(ratio[few.scene().part == 2], 1.0)


def test_paint_scatters_by_colour(few: Bench) -> None:
    scene = few.scene()
    factor = np.array([[0.9, 1.0, 1.1], [1.0, 0.8, 1.0], [0.7, 1.0, 1.0]])
    ratio = albedo(scene, factor) / albedo(scene)
    owner, red = paint_owner(scene.part), red_owner(scene.part)
    for colour in (0, 1):
        own = (owner >= 0) & (scene.colour[owner] == colour)
        np.testing.assert_allclose(ratio[own], np.tile(factor[colour], (own.sum(), 1)))
    np.testing.assert_allclose(ratio[red >= 0], np.tile(factor[2], ((red >= 0).sum(), 1)))
    np.testing.assert_allclose(ratio[(owner < 0) & (red < 0)], 1.0)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_blur_comes_to_a_limit_as_samples_grow(few: Bench) -> None:
    scene = few.scene()
    blur = LensBlur(aperture_mm=0.5, focus_mm=53.0, diffraction_px=0.0)
    sent = triangle_light(scene, few.camera)

    def light(samples: int) -> FloatArray:
        return light_on_chip(scene, few.camera, light=sent, blur=blur, samples=samples)

    exact = light(600)
    coarse, usual, fine = (rms(light(n) - exact) for n in (24, 89, 216))
    assert fine < 0.9 * usual < 0.6 * coarse


@pytest.mark.parametrize("blur_px", [0.5, 2.0, -2.0])
def test_points_of_the_lens_are_paired_so_that_edges_are_blurred_evenly(blur_px: float) -> None:
    # In directions and with blurs between those that pairs are chosen by.
    count, rng = 89, np.random.default_rng(1)
    offsets, points = sample_offsets(count), disc_points(count)
    angle = np.pi * (np.arange(8) + 0.5) / 8
    across = np.array([np.cos(angle), np.sin(angle)])
    many = sample_offsets(800) + blur_px * rng.permutation(disc_points(800))
    place = np.linspace(-3.0, 3.0, 601)

    def covered(sums: FloatArray) -> FloatArray:
        """Share of samples on one side of an edge at each place and in each direction."""
        each = np.sort(sums @ across, axis=0).T
        return np.array([np.searchsorted(line, place) / len(line) for line in each])

    def off(order: IntArray) -> float:
        return rms(covered(offsets + blur_px * points[order]) - covered(many))

    usual = np.median([off(rng.permutation(count)) for _ in range(20)])
    assert off(np.arange(count)) < 0.8 * usual
