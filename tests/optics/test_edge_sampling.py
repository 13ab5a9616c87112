"""Frames sampled finely where light changes are those that are sampled finely everywhere."""

from dataclasses import replace
from statistics import NormalDist
from types import SimpleNamespace

import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import BrownConrady, KannalaBrandt
from phytac_decoder.pipeline.decode import rest_positions
from phytac_design.core.threads import THREADS
from phytac_design.layout.sensor import Sensor
from phytac_design.optics import edge_sampling, frame_renderer
from phytac_design.optics.edge_sampling import mark_edges
from phytac_design.optics.exposure import disc_points
from phytac_design.optics.frame_renderer import (
    SAMPLES,
    add_noise,
    quick_samples,
    render_frame,
    render_light,
    sample_offsets,
)
from phytac_design.optics.raster import paint_alone, project_scene, rasterise
from phytac_design.optics.render_scene import RenderScene
from phytac_design.simulation.imaging.nominal_view import expected_views, vision_bundle
from phytac_shapes.arrays import FloatArray
from tests.optics.cases import Bench


def lens_of(few: Bench, kind: str) -> Camera:
    """A quarter of the camera's image, by its own lens or by one that bends lines."""
    whole = few.camera.lens
    quarter = replace(whole, width_px=whole.width_px // 2, height_px=whole.height_px // 2)
    names = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
    sizes = {name: getattr(quarter, name) for name in names}
    bent = KannalaBrandt(**sizes, distortion=(0.02, 0.0, 0.0, 0.0))
    return replace(few.camera, lens=quarter if kind == "pinhole" else bent)


def everywhere(scene: RenderScene, camera: Camera, samples: int) -> FloatArray:
    """Light with all samples in every pixel, each of a camera that is moved."""
    total = np.zeros((camera.height_px, camera.width_px, 3))
    for offset in sample_offsets(samples):
        total += render_light(scene, camera.shifted(-offset), samples=1)
    return total / samples


@pytest.mark.parametrize("kind", ["pinhole", "bent"])
def test_light_is_that_of_fine_samples_everywhere(
    few: Bench, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, camera = few.scene(), lens_of(few, kind)
    wanted = everywhere(scene, camera, 600)
    plain = render_light(scene, camera, samples=8)
    # Not by looking at every pixel as often.
    monkeypatch.delattr(frame_renderer, "_look")
    fine = render_light(scene, camera)
    off, off_plain = (np.abs(image - wanted).max(axis=2) for image in (fine, plain))
    # Without bias, and much closer than a few samples everywhere.
    assert abs(float((fine - wanted).mean())) < 2e-5
    assert np.sqrt(np.mean(off**2)) < 0.35 * np.sqrt(np.mean(off_plain**2))
    assert np.percentile(off, 99.9) < 0.02
    # A sliver between four samples of a pixel, beside nothing else, is the worst that is missed.
    assert off.max() < 0.15


@pytest.mark.parametrize("kind", ["pinhole", "bent"])
def test_hidden_faces_of_closed_bodies_are_left_out_and_not_missed(few: Bench, kind: str) -> None:
    whole, camera = few.scene(), lens_of(few, kind)
    assert whole.closed
    each = replace(whole, closed=False)
    pieces = [len(project_scene(scene, camera).source) for scene in (whole, each)]
    assert pieces[0] < 0.95 * pieces[1]
    maps = [rasterise(scene, camera) for scene in (whole, each)]
    np.testing.assert_array_equal(maps[0].part, maps[1].part)
    np.testing.assert_array_equal(paint_alone(whole, camera), paint_alone(each, camera))
    light = [render_light(scene, camera) for scene in (whole, each)]
    assert np.abs(light[0] - light[1]).max() < 0.01


@pytest.mark.parametrize("std", [0.4, 2.0, 12.0])
def test_noise_is_normal_and_rounded(std: float) -> None:
    grey = np.full((400, 500, 3), 128, dtype=np.uint8)
    noise = add_noise(grey, std, np.random.default_rng(0)).astype(np.float64) - 128.0
    level = np.arange(-3, 4)
    cdf = np.vectorize(NormalDist(0.0, std).cdf)
    wanted = cdf(level + 0.5) - cdf(level - 0.5)
    found = [(noise == value).mean() for value in level]
    np.testing.assert_allclose(found, wanted, atol=3e-3)
    assert abs(np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]) < 0.01


def test_centroids_are_exact_to_a_few_thousandths_of_a_pixel(few: Bench) -> None:
    sensor = Sensor.of(few.design, few.surface, few.markers)
    bundle = vision_bundle(sensor, expected_views(sensor))
    errors = []
    for samples in (SAMPLES, 8):
        shift = np.array([0.31, 0.17])
        seen = [
            rest_positions(bundle, render_frame(few.scene(), camera, samples=samples))
            for camera in (few.camera, few.camera.shifted(shift))
        ]
        exact = [
            rest_positions(bundle, render_frame(few.scene(), camera, samples=987))
            for camera in (few.camera, few.camera.shifted(shift))
        ]
        errors.append(float(np.sqrt(np.mean((seen[1] - seen[0] - exact[1] + exact[0]) ** 2))))
    assert errors[0] < 0.02
    assert errors[0] < 0.45 * errors[1]


@pytest.mark.long
def test_the_field_of_a_lens_may_end_within_the_image(few: Bench) -> None:
    lens = few.camera.lens
    narrow = KannalaBrandt(
        width_px=lens.width_px,
        height_px=lens.height_px,
        fx_px=0.2 * lens.fx_px,
        fy_px=0.2 * lens.fy_px,
        cx_px=lens.cx_px,
        cy_px=lens.cy_px,
        distortion=(-0.5, 0.0, 0.0, 0.0),
    )
    camera = replace(few.camera, lens=narrow)
    blind = ~np.isfinite(camera.lens.unproject(np.array([[0.0, 0.0]]))).all()
    assert blind
    fine = render_light(few.scene(), camera)
    wanted = everywhere(few.scene(), camera, 96)
    off = np.abs(fine - wanted).max(axis=2)
    assert np.isfinite(fine).all()
    # Rays of pixels beside the end of the field have neighbours on one side alone.
    assert np.sqrt(np.mean(off**2)) < 0.004


def test_depths_of_a_lens_that_images_planes_sharply_are_along_its_axis(few: Bench) -> None:
    # As its blur is.
    scene, lens = few.scene(), few.camera.lens
    sizes = {n: getattr(lens, n) for n in ("width_px", "height_px", "fx_px", "fy_px", "cx_px")}
    bent = BrownConrady(**sizes, cy_px=lens.cy_px, distortion=(-0.02, 0.0, 0.0, 0.0))
    camera = replace(few.camera, lens=bent)
    view, rows = project_scene(scene, camera), camera.height_px
    extent = frame_renderer.row_extent(view)
    owner, inverse = frame_renderer._owners(view, extent, camera, 0, rows, np.zeros(2), 1)
    hit = owner >= 0
    np.testing.assert_allclose(1.0 / inverse[hit], rasterise(scene, camera).depth[hit], rtol=1e-9)


@pytest.mark.parametrize("aperture_mm", [0.0, 0.4])
@pytest.mark.parametrize("kind", ["pinhole", "bent"])
def test_light_does_not_depend_on_threads_or_bands(
    few: Bench, kind: str, aperture_mm: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    lights, camera = [], lens_of(few, kind)
    points = aperture_mm * disc_points(24)
    for threads, rows in (("1", 128), ("3", 34)):
        monkeypatch.setenv(THREADS, threads)
        monkeypatch.setattr(frame_renderer, "BAND_ROWS", rows)
        lights.append(render_light(few.scene(), camera, lens_mm=points, focus_mm=60.0, samples=24))
    np.testing.assert_array_equal(lights[0], lights[1])


def test_edges_are_marked_on_both_sides_and_where_shades_differ() -> None:
    owner = np.zeros((8, 12), dtype=np.int32)
    owner[:, 6:] = 1
    owner[:, 10:] = 2
    shade = np.array([[10.0, 10, 10], [20.0, 10, 10], [20.5, 10, 10]], dtype=np.float32)
    edge = np.zeros((4, 6), dtype=np.bool_)
    mark_edges(owner, shade, 2, 1.0, edge)
    # Between pixels 2 and 3 lies the edge; triangles 1 and 2 look the same.
    np.testing.assert_array_equal(edge, np.tile([False, False, True, True, False, False], (4, 1)))


def test_large_frames_that_are_only_decoded_take_fewer_samples() -> None:
    small, large = (
        Camera.on_axis(width_px=w, height_px=h, focal_px=300.0, stand_off_mm=20.0)
        for w, h in ((640, 480), (2592, 1944))
    )
    assert quick_samples(large) < quick_samples(small) == SAMPLES


def test_rays_of_a_pinhole_are_the_same_by_differences() -> None:
    # As Python runs them: bent lenses take differences of neighbouring rays.
    fx, fy, cx, cy = lens = np.array([30.0, 40.0, 3.2, 1.7])
    row, column = (axis.astype(np.float64) for axis in np.indices((4, 7)))
    rays = np.stack([(column - cx) / fx, (row - cy) / fy, np.ones_like(row)], axis=-1)
    view, slot = SimpleNamespace(rays=rays, origin=(0, 0)), np.arange(28).reshape(4, 7)
    here, change = np.empty((28, 3)), np.empty((28, 2, 3))
    edge_sampling._bent_rays.py_func(view, 0, slot, here, change)
    for k in range(28):
        wanted = edge_sampling._straight_ray.py_func(lens, k % 7, k // 7)
        got = edge_sampling._bent_ray.py_func(here, change, k)
        np.testing.assert_allclose(got, wanted, atol=1e-15)
