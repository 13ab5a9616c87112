"""Seeing many poses fast: pixel for pixel what the whole image shows."""

import numpy as np
import pytest
from numpy.typing import NDArray

from phytac_design.layout import Markers
from phytac_design.optics.gaps import marker_gaps, outline_gaps
from phytac_design.optics.incremental_renderer import IncrementalRenderer, RenderSample
from phytac_design.optics.raster import pixels_alone, rasterise
from phytac_design.optics.render_scene import RenderScene, paint_owner
from tests.optics.cases import Bench, make_design
from tests.optics.lenses import LENSES
from tests.optics.test_underload import random_motion


def whole_image(scene: RenderScene, bench: Bench) -> NDArray[np.int32]:
    return paint_owner(rasterise(scene, bench.camera).part)


def same_as_image(sample: RenderSample, owner: NDArray[np.int32], scene: RenderScene) -> None:
    y, x = np.nonzero(owner >= 0)
    for column, weights in enumerate((np.ones(len(x)), x, y)):
        sums = np.bincount(owner[y, x], weights=weights, minlength=scene.count)
        assert np.array_equal(sample.visible[:, column], sums)
    gaps = outline_gaps(sample.pixels, sample.starts, scene.colour)
    for mine, plain in zip(gaps, marker_gaps(owner, scene.colour), strict=True):
        assert np.array_equal(mine, plain)


@pytest.mark.parametrize("lens", ["pinhole", *LENSES])
def test_every_pose_is_that_of_the_whole_image(lens: str) -> None:
    layout = {"rows": 6, "columns": 16, "height_far_mm": 14.0}
    tables = {} if lens == "pinhole" else {"camera": LENSES[lens]}
    bench = Bench(make_design(layout=layout, **tables))
    rest = bench.scene()
    renderer = IncrementalRenderer(rest, bench.camera)
    for size in (0.0, 3.0, 0.5):  # Wide first: nothing of it may be left in the next.
        motion = random_motion(bench.markers.count, size)
        scene = rest.moved(motion[:, :3], motion[:, 3:], bench.markers.mid_mm)
        sample = renderer.render(scene)
        owner = whole_image(scene, bench)
        same_as_image(sample, owner, scene)
        if size > 1.0:
            assert (sample.visible[:, 0] < sample.alone[:, 0]).sum() > 10
        if lens == "pinhole":
            assert np.array_equal(sample.alone[:, 0], pixels_alone(scene, bench.camera)[0])


def test_markers_that_leave_the_picture(few: Bench) -> None:
    scene = few.scene()
    away = np.zeros((few.markers.count, 3))
    away[0] = [500.0, 0.0, 0.0]  # Out at the side.
    away[1] = [0.0, 0.0, -500.0]  # Behind the camera.
    away[2] = 3.0 * (few.markers.tip_mm[2] * [1.0, 1.0, 0.0])  # Half of it, perhaps.
    moved = scene.moved(away, np.zeros_like(away), few.markers.mid_mm)
    sample = IncrementalRenderer(scene, few.camera).render(moved)
    assert (sample.visible[:2] == 0.0).all()
    assert (sample.alone[:2] == 0.0).all()
    same_as_image(sample, whole_image(moved, few), moved)


def test_nothing_to_see() -> None:
    bench = Bench(make_design(layout={"rows": 1, "columns": 1}))
    scene = bench.scene()
    away = np.array([[0.0, 0.0, -500.0]])
    moved = scene.moved(away, np.zeros((1, 3)), bench.markers.mid_mm)
    sample = IncrementalRenderer(scene, bench.camera).render(moved)
    assert sample.pixels.shape == (0, 2)
    assert np.isinf(outline_gaps(sample.pixels, sample.starts, scene.colour)).all()


@pytest.mark.parametrize("scattered", [False, True])
def test_gaps_with_one_colour_and_hidden_markers(
    rng: np.random.Generator, *, scattered: bool
) -> None:
    """Blots of any form, some missing; and scattered pixels, where boxes tell nothing."""
    owner = np.full((80, 90), -1, dtype=np.int32)
    for marker in range(30):
        if marker % 7:
            top, left = rng.integers(0, 70), rng.integers(0, 80)
            owner[top : top + rng.integers(1, 9), left : left + rng.integers(1, 9)] = marker
    owner[rng.random(owner.shape) < 0.2] = -1
    if scattered:
        owner[:] = -1
        owner[rng.integers(0, 80, 150), rng.integers(0, 90, 150)] = rng.integers(0, 29, 150)
    y, x = np.nonzero(owner >= 0)
    order = np.argsort(owner[y, x], kind="stable")
    starts = np.searchsorted(owner[y, x][order], np.arange(31))
    pixels = np.column_stack([x, y])[order].astype(np.int64)
    for colours in (1, 3):
        colour = np.arange(30) % colours
        for mine, plain in zip(
            outline_gaps(pixels, starts, colour), marker_gaps(owner, colour), strict=True
        ):
            assert np.array_equal(mine, plain)
    assert np.isinf(outline_gaps(pixels, starts, np.zeros(30, dtype=np.int64))[1]).all()


def test_shell_hides_what_is_behind_it(few: Bench) -> None:
    scene = few.scene()
    out = np.zeros((few.markers.count, 3))
    out[5] = 8.0 * few.markers.normal[5]  # Through the wall, to the outside.
    sample = IncrementalRenderer(scene, few.camera).render(
        scene.moved(out, 0.0 * out, few.markers.mid_mm)
    )
    assert sample.visible[5, 0] == 0.0
    assert sample.alone[5, 0] > 0.0
    assert IncrementalRenderer(scene, few.camera).render(scene).visible[5, 0] > 0.0


def test_a_wall_that_moves_along_hides_nothing_that_dips_into_it(few: Bench) -> None:
    scene = few.scene()
    low = build_low(few)
    out = 0.3 * low[1].normal
    dipped = low[0].moved(out, 0.0 * out, low[1].mid_mm)
    still = IncrementalRenderer(low[0], few.camera).render(dipped)
    assert (still.visible[:, 0] < still.alone[:, 0]).all()
    along = IncrementalRenderer(low[0], few.camera, wall_setback=0.05).render(dipped)
    assert np.array_equal(along.visible, along.alone)
    far = np.zeros_like(out)
    far[5] = 12.0 * few.markers.normal[5]
    gone = IncrementalRenderer(scene, few.camera, wall_setback=0.05).render(
        scene.moved(far, 0.0 * far, few.markers.mid_mm)
    )
    assert gone.visible[5, 0] == 0.0
    # The light bar is as near as it is.
    hides = np.zeros_like(far)
    hides[8] = -few.markers.tip_mm[8] * [1.0, 1.0, 0.0] - few.markers.normal[8]
    inside = scene.moved(hides, 0.0 * hides, few.markers.mid_mm)
    plain = IncrementalRenderer(scene, few.camera).render(inside).visible[8]
    assert np.array_equal(
        IncrementalRenderer(scene, few.camera, wall_setback=0.05).render(inside).visible[8], plain
    )


def build_low(few: Bench) -> tuple[RenderScene, Markers]:
    """The same with receptors that are painted down to the wall."""
    layout = {"rows": 3, "columns": 4, "height_near_mm": 0.5, "height_far_mm": 0.5}
    bench = Bench(make_design(layout=layout, light={"bar_radius_mm": 0.0}))
    return bench.scene(), bench.markers
