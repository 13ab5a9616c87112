import sys
from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.camera.lens import BrownConrady, KannalaBrandt
from phytac_design.optics import frame_renderer as frame_module
from phytac_design.optics import opengl_picture
from phytac_design.optics.exposure import disc_points
from phytac_design.optics.frame_renderer import (
    add_noise,
    render_frame,
    render_light,
    sample_offsets,
)
from phytac_design.optics.light import albedo, triangle_light
from phytac_design.optics.opengl_picture import render_picture
from phytac_design.optics.paint import BACKGROUND, BAR, PAINTS, to_linear, to_srgb
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import BAR as BAR_CODE
from phytac_design.optics.render_scene import paint_owner
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray
from phytac_shapes.errors import MissingPartError
from tests.optics.cases import Bench, through_lens
from tests.refusals import refused

GL_CENTROID_PX = 0.35  # GL averages after the gamma, which shifts edges between light and dark
GL_MEDIAN_PX = 0.15


def hues(image: ImageArray) -> tuple[IntArray, FloatArray]:
    """Nearest paint of strongly coloured pixels, -1 elsewhere, and how coloured each is."""
    rgb = image[:, :, ::-1].astype(float)
    chroma = rgb - rgb.mean(axis=2, keepdims=True)
    strength = np.linalg.norm(chroma, axis=2)
    names = np.array([PAINTS[name] for name in ("blue", "green", "red")], dtype=float)
    names -= names.mean(axis=1, keepdims=True)
    names /= np.linalg.norm(names, axis=1, keepdims=True)
    return np.where(strength > 20.0, np.argmax(chroma @ names.T, axis=2), -1), strength


def test_frame_shows_each_part_in_its_paint(few: Bench) -> None:
    scene = few.scene(np.ones(few.markers.count, dtype=bool))
    frame = render_frame(scene, few.camera)
    assert frame.shape == (486, 648, 3)
    assert frame.dtype == np.uint8
    hue, _ = hues(frame)
    part = rasterise(scene, few.camera).part
    owner = paint_owner(part)
    inside = owner >= 0
    wanted = few.markers.colour[owner[inside]]
    # Pixels on an edge are mixtures.
    assert np.mean(hue[inside] == wanted) > 0.9
    bar = np.median(frame[part == BAR_CODE], axis=0)
    np.testing.assert_allclose(bar[::-1], BAR, atol=1.0)
    np.testing.assert_array_equal(frame[0, 0, ::-1], BACKGROUND)
    assert np.mean(hue[part >= 16] == 2) > 0.05


def test_frame_without_supersampling_is_the_lit_id_map(few: Bench) -> None:
    scene = few.scene()
    buffers = rasterise(scene, few.camera)
    light = to_srgb(triangle_light(scene, few.camera))[buffers.triangle]
    hit = buffers.triangle >= 0
    frame = render_frame(scene, few.camera, samples=1)
    # 4096 steps of linear light are up to 1.5 grey levels apart in the darkest paints.
    np.testing.assert_allclose(frame[hit][:, ::-1], light[hit], atol=2.0)


@pytest.mark.parametrize("count", [1, 4, 8, 13])
def test_samples_have_a_column_and_a_row_each(count: int) -> None:
    offsets = sample_offsets(count)
    even = (np.arange(count) + 0.5) / count - 0.5
    np.testing.assert_allclose(np.sort(offsets, axis=0), np.column_stack([even, even]))
    np.testing.assert_allclose(offsets.mean(axis=0), 0.0, atol=1e-15)


def test_samples_are_spread_over_the_pixel() -> None:
    offsets = sample_offsets(8)
    apart = np.linalg.norm(offsets[:, None] - offsets, axis=2)[~np.eye(8, dtype=bool)]
    assert apart.min() > 0.25  # a grid of eight has 0.35, a diagonal 0.18


@pytest.mark.parametrize("samples", [8, 24])
@pytest.mark.parametrize("lens", ["pinhole", "bent", "bent plane"])
def test_samples_are_what_cameras_at_points_of_the_lens_see(
    few: Bench, lens: str, samples: int
) -> None:
    scene, camera = few.scene(), few.camera
    sizes = {
        name: getattr(camera.lens, name)
        for name in ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
    }
    if lens == "bent":
        camera = replace(camera, lens=KannalaBrandt(**sizes, distortion=(0.02, 0.0, 0.0, 0.0)))
    elif lens == "bent plane":
        curved = (-0.02, 0.0, 0.0, 0.0, 0.0)
        camera = replace(camera, lens=BrownConrady(**sizes, distortion=curved))
    points, focus = 1.2 * disc_points(samples), 60.0
    got = render_light(scene, camera, samples=samples, lens_mm=points, focus_mm=focus)
    seen, sharp = np.zeros_like(got), np.zeros_like(got)
    for offset, point in zip(sample_offsets(samples), points, strict=True):
        moved = camera.shifted(-offset)
        through = through_lens(scene, camera, point, focus)
        light = triangle_light(scene, camera)
        seen += render_light(through, moved, light=light, samples=1) / samples
        sharp += render_light(scene, moved, light=light, samples=1) / samples
    off = np.abs(got - seen).max(axis=2)
    assert np.sqrt(np.mean(off**2)) < 0.1 * np.sqrt(np.mean((seen - sharp) ** 2))
    # Rounding may put a sample on the other side of an edge.
    assert np.mean(off > 0.02) < 1e-4
    assert off.max() < 1.2 / samples


def test_a_sample_is_what_a_shifted_camera_sees(
    few: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, offset = few.scene(), np.array([0.3, -0.2])
    shifted = few.camera.shifted(-offset)
    wanted = render_frame(scene, shifted, samples=1)
    monkeypatch.setattr(frame_module, "sample_offsets", lambda count: np.tile(offset, (count, 1)))
    got = render_frame(scene, few.camera, samples=1)
    # Rounding may put a pixel centre on the other side of an edge.
    assert np.mean(got != wanted) < 1e-4


def test_an_edge_along_the_image_moves_in_steps_of_a_sample(few: Bench) -> None:
    # The bar's near cap, pushed sideways: its coverage of a row follows in eighths of a pixel.
    scene = few.scene()
    row = few.camera.height_px // 2
    covered = []
    for shift in np.linspace(0.0, 1.0, 9):
        camera = few.camera.shifted(np.array([shift, 0.0]))
        line = to_linear(render_frame(scene, camera)[row].astype(float))[:, 0]
        left = slice(few.camera.width_px // 2 - 60, few.camera.width_px // 2)
        covered.append(line[left].sum())
    steps = -np.diff(covered)
    assert steps.mean() > 0.05  # the bar's light less that of what is behind it, by eighths
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.1)


def test_more_samples_change_little(few: Bench) -> None:
    frame = [render_frame(few.scene(), few.camera, samples=n).astype(float) for n in (8, 64)]
    assert np.abs(frame[0] - frame[1]).mean() < 0.5


def test_noise_has_its_standard_deviation_and_its_seed(few: Bench) -> None:
    image = np.full((200, 300, 3), 120, dtype=np.uint8)
    noisy = add_noise(image, 2.0, np.random.default_rng(1)).astype(float)
    assert noisy.mean() == pytest.approx(120.0, abs=0.05)
    assert noisy.std() == pytest.approx(np.hypot(2.0, np.sqrt(1 / 12)), rel=0.02)
    again = add_noise(image, 2.0, np.random.default_rng(1))
    np.testing.assert_array_equal(noisy, again)
    dark = add_noise(np.zeros_like(image), 5.0, np.random.default_rng(1))
    assert dark.max() < 40  # clipped, not wrapped around
    with pytest.raises(ValueError, match="rng"):
        render_frame(few.scene(), few.camera, noise_std=1.0)


def test_srgb_round_trip() -> None:
    levels = np.arange(256.0)
    np.testing.assert_allclose(to_srgb(to_linear(levels)), levels, atol=1e-9)
    assert to_linear(np.array(255.0)) == pytest.approx(1.0)


def test_every_triangle_is_lit(few: Bench) -> None:
    scene = few.scene()
    light, paint = triangle_light(scene, few.camera), albedo(scene)
    assert np.all(light <= paint + 1e-12)
    assert np.all(light >= 0.39 * paint)


@pytest.fixture(scope="module")
def gl_picture(few: Bench) -> ImageArray:
    scene = few.scene()
    try:
        return render_picture(scene, few.camera)
    except MissingPartError as error:
        pytest.skip(str(error))


def test_picture_and_frame_agree_on_every_marker(few: Bench, gl_picture: ImageArray) -> None:
    frame = render_frame(few.scene(), few.camera)
    owner = paint_owner(rasterise(few.scene(), few.camera).part)
    y, x = np.indices(owner.shape)

    def centroids(image: ImageArray) -> FloatArray:
        hue, strength = hues(image)
        out = []
        for i, colour in enumerate(few.markers.colour):
            rows, columns = np.nonzero(owner == i)
            near = (
                slice(rows.min() - 4, rows.max() + 5),
                slice(columns.min() - 4, columns.max() + 5),
            )
            w = np.where(hue[near] == colour, strength[near], 0.0)
            out.append([(w * x[near]).sum() / w.sum(), (w * y[near]).sum() / w.sum()])
        return np.array(out)

    apart = np.linalg.norm(centroids(frame) - centroids(gl_picture), axis=1)
    assert np.median(apart) < GL_MEDIAN_PX
    assert apart.max() < GL_CENTROID_PX


def test_picture_and_frame_agree_on_colours(few: Bench, gl_picture: ImageArray) -> None:
    frame = render_frame(few.scene(), few.camera).astype(float)
    assert gl_picture.shape == frame.shape
    apart = np.abs(frame - gl_picture)
    # Inside the parts: the shader's gamma is 2.2, sRGB's is piecewise; edges are mixtures.
    assert np.percentile(apart, 90) <= 4.0
    assert apart.mean() < 3.0


def test_missing_gl_names_the_packages(few: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrender", None)
    with refused("graphics-missing") as caught:
        render_picture(few.scene(), few.camera)
    assert "apt-get install libegl1 libgl1 libgl1-mesa-dri" in str(caught.value)


def test_a_driver_that_gives_no_context_names_the_packages(
    few: Bench, monkeypatch: pytest.MonkeyPatch, gl_picture: ImageArray
) -> None:
    class Broken:
        def __init__(self, *_size: int) -> None:
            raise OSError("EGL_NOT_INITIALIZED")

    module = opengl_picture._pyrender()
    monkeypatch.setattr(module, "OffscreenRenderer", Broken)
    with refused("graphics-missing") as caught:
        render_picture(few.scene(), few.camera)
    assert "EGL_NOT_INITIALIZED" in str(caught.value)
