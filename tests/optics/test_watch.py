"""A pose of the sensor: markers that leave the picture, and a wall that moves along."""

import numpy as np
import pytest

from phytac_design.layout import Markers
from phytac_design.optics.gaps import marker_gaps
from phytac_design.optics.loaded_visibility import scene_state
from phytac_design.optics.raster import pixels_alone, rasterise
from phytac_design.optics.render_scene import RenderScene, paint_owner
from tests.optics.cases import Bench, make_design
from tests.optics.lenses import LENSES
from tests.optics.test_underload import random_motion


@pytest.mark.parametrize("lens", ["pinhole", *LENSES])
def test_every_pose_is_that_of_the_whole_image(lens: str) -> None:
    layout = {"rows": 6, "columns": 16, "height_far_mm": 14.0}
    tables = {} if lens == "pinhole" else {"camera": LENSES[lens]}
    bench = Bench(make_design(layout=layout, **tables))
    rest = bench.scene()
    motion = random_motion(bench.markers.count, 3.0)
    scene = rest.moved(motion[:, :3], motion[:, 3:], bench.markers.mid_mm)
    state = scene_state(scene, bench.camera)
    owner = paint_owner(rasterise(scene, bench.camera).part)
    y, x = np.nonzero(owner >= 0)
    count = np.bincount(owner[y, x], minlength=scene.count)
    assert np.array_equal(state.visible_px, count)
    assert (state.fraction < 1.0).sum() > 10
    centre = state.alone_px + state.offset_px
    for axis, values in enumerate((x, y)):
        mean = np.bincount(owner[y, x], weights=values, minlength=scene.count)[count > 0]
        np.testing.assert_allclose(centre[count > 0, axis], mean / count[count > 0])
    gaps = marker_gaps(owner, scene.colour)
    assert np.array_equal(state.gap_same_px, gaps[0])
    assert np.array_equal(state.gap_other_px, gaps[1])
    if lens == "pinhole":
        alone = np.maximum(pixels_alone(scene, bench.camera), 1)
        np.testing.assert_allclose(state.fraction, count / alone)


def test_markers_that_leave_the_picture(few: Bench) -> None:
    scene = few.scene()
    away = np.zeros((few.markers.count, 3))
    away[0] = [500.0, 0.0, 0.0]  # Out at the side.
    away[1] = [0.0, 0.0, -500.0]  # Behind the camera.
    away[2] = 3.0 * (few.markers.tip_mm[2] * [1.0, 1.0, 0.0])  # Half of it, perhaps.
    state = scene_state(scene.moved(away, np.zeros_like(away), few.markers.mid_mm), few.camera)
    assert (state.visible_px[:2] == 0).all()
    assert (state.fraction[:2] == 0.0).all()
    assert np.isnan(state.alone_px[:2]).all()
    assert np.isinf(state.gap_same_px[:2]).all()


def test_shell_hides_what_is_behind_it(few: Bench) -> None:
    scene = few.scene()
    out = np.zeros((few.markers.count, 3))
    out[5] = 8.0 * few.markers.normal[5]  # Through the wall, to the outside.
    state = scene_state(scene.moved(out, 0.0 * out, few.markers.mid_mm), few.camera)
    assert state.visible_px[5] == 0
    assert np.isfinite(state.alone_px[5]).all()
    assert scene_state(scene, few.camera).visible_px[5] > 0


def test_a_wall_that_moves_along_hides_nothing_that_dips_into_it(few: Bench) -> None:
    scene = few.scene()
    low = build_low(few)
    out = 0.3 * low[1].normal
    dipped = low[0].moved(out, 0.0 * out, low[1].mid_mm)
    assert (scene_state(dipped, few.camera).fraction < 1.0).all()
    assert (scene_state(dipped, few.camera, wall_follows=True).fraction == 1.0).all()
    far = np.zeros_like(out)
    far[5] = 12.0 * few.markers.normal[5]
    gone = scene_state(
        scene.moved(far, 0.0 * far, few.markers.mid_mm), few.camera, wall_follows=True
    )
    assert gone.visible_px[5] == 0
    # The light bar is as near as it is.
    hides = np.zeros_like(far)
    hides[8] = -few.markers.tip_mm[8] * [1.0, 1.0, 0.0] - few.markers.normal[8]
    inside = scene.moved(hides, 0.0 * hides, few.markers.mid_mm)
    plain = scene_state(inside, few.camera)
    along = scene_state(inside, few.camera, wall_follows=True)
    assert along.visible_px[8] == plain.visible_px[8]
    np.testing.assert_array_equal(along.offset_px[8], plain.offset_px[8])


def build_low(few: Bench) -> tuple[RenderScene, Markers]:
    """The same with receptors that are painted down to the wall."""
    layout = {"rows": 3, "columns": 4, "height_near_mm": 0.5, "height_far_mm": 0.5}
    bench = Bench(make_design(layout=layout, light={"bar_radius_mm": 0.0}))
    return bench.scene(), bench.markers
