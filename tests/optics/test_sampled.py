"""The sampled visible fraction against the exact ID map."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_design.design.design_file import load_design
from phytac_design.optics.raster import pixels_alone, project_scene, rasterise
from phytac_design.optics.render_scene import FIRST_MARKER, SHELL, RenderScene, paint_owner
from phytac_design.optics.sampled_visibility import Sampled, sampled_fraction
from phytac_design.optics.zbuffer import fill
from phytac_shapes.arrays import FloatArray, IntArray
from tests.optics.cases import FULL, Bench, make_design
from tests.optics.lenses import LENSES

NEAR = 0.02
SHARE = 0.99
"""Of the markers that are to be that near to their exact fraction."""

WIDE = {"model": "kannala_brandt", "focal_px": 620.0, "stand_off_mm": 15.0}


def exact_counts(scene: RenderScene, camera: Camera) -> tuple[IntArray, IntArray]:
    """Pixels of each marker's paint alone, and visible."""
    owner = paint_owner(rasterise(scene, camera).part)
    visible = np.bincount(owner[owner >= 0], minlength=scene.count).astype(np.int64)
    return pixels_alone(scene, camera), visible


def share_near(few: Sampled, alone: IntArray, visible: IntArray) -> float:
    """Share of the markers within ``NEAR``."""
    exact = np.divide(visible, alone, out=np.zeros(len(alone)), where=alone > 0)
    return float(np.mean(np.abs(few.fraction - exact) <= NEAR))


@pytest.mark.parametrize("kind", ["spiral", "straight"])
@pytest.mark.parametrize("name", ["pinhole", *sorted(LENSES)])
def test_all_rays_give_the_exact_pixels_and_few_are_near(name: str, kind: str) -> None:
    sections: dict[str, Any] = {"layout": {"kind": kind, "rows": 12, "columns": 16}}
    if name != "pinhole":
        sections["camera"] = LENSES[name]
    case = Bench(make_design(**sections))
    scene = case.scene(np.arange(case.markers.count) % 3 == 0)
    alone, visible = exact_counts(scene, case.camera)
    whole = sampled_fraction(scene, case.camera, rays=1_000_000)
    np.testing.assert_array_equal(whole.alone, alone)
    np.testing.assert_array_equal(whole.visible, visible)
    assert share_near(sampled_fraction(scene, case.camera), alone, visible) >= SHARE


def grids(few: Sampled, scene: RenderScene, camera: Camera, step: int) -> NDArray[np.bool_]:
    """Markers whose counts are those of one pixel in ``step`` each way of the exact picture."""
    view = project_scene(scene, camera)
    owner = scene.triangle_owner[view.source]
    seen = rasterise(scene, camera).part
    fits = np.zeros(scene.count, dtype=bool)
    for i in range(scene.count):
        shape = seen.shape
        triangle = np.full(shape, -1, dtype=np.int32)
        own = np.flatnonzero(owner == i).astype(np.int32)
        fill(view, own, (0, 0, 1, 0.0, 0.0), triangle, np.zeros(shape))
        paint = FIRST_MARKER + 2 * i
        alone = (triangle >= 0) & (scene.part[np.maximum(triangle, 0)] == paint)
        for k in range(step * step):
            part = (slice(k // step, None, step), slice(k % step, None, step))
            counts = int(alone[part].sum()), int((alone & (seen == paint))[part].sum())
            fits[i] |= counts == (few.alone[i], few.visible[i])
    return fits


@pytest.mark.parametrize("name", ["pinhole", "fisheye"])
def test_a_grid_sees_what_the_whole_picture_has_there(name: str) -> None:
    sections: dict[str, Any] = {"layout": {"kind": "straight", "rows": 4, "columns": 6}}
    if name != "pinhole":
        sections["camera"] = LENSES[name]
    case = Bench(make_design(**sections))
    scene = case.scene()
    alone = pixels_alone(scene, case.camera)
    few = sampled_fraction(scene, case.camera, rays=8)
    fits = [grids(few, scene, case.camera, step) for step in (1, 2, 3, 4)]
    assert np.any(fits, axis=0).all()
    assert (few.alone < 0.3 * alone).sum() >= 6


@pytest.mark.parametrize("wide", [{}, WIDE])
def test_half_hidden_markers_of_the_full_picture(wide: dict[str, Any]) -> None:
    case = Bench(make_design(layout={"kind": "straight"}, camera=FULL | wide))
    scene = case.scene()
    alone, visible = exact_counts(scene, case.camera)
    few = sampled_fraction(scene, case.camera)
    assert np.mean(visible < 0.99 * alone) > 0.2
    assert share_near(few, alone, visible) >= SHARE
    assert few.alone.sum() < 0.5 * alone.sum()


@pytest.mark.parametrize("receptor", [{}, {"colouring": "insert"}])
def test_flat_ends_hide_what_holes_hide(receptor: dict[str, Any]) -> None:
    case = Bench(make_design(layout={"kind": "straight"}, receptor=receptor))
    holes, flat = case.scene(), case.scene(hollow=False)
    assert len(flat.triangles) < 0.7 * len(holes.triangles)
    few, fewer = (sampled_fraction(scene, case.camera) for scene in (holes, flat))
    np.testing.assert_array_equal(fewer.alone, few.alone)
    np.testing.assert_array_equal(fewer.visible, few.visible)


def test_what_reaches_behind_the_camera_hides_markers_too() -> None:
    """Half of its corners lie behind the plane of a lens that does not need one."""
    ends: dict[str, Any] = {"from_mm": (10.0, 0.0, -60.0), "to_mm": (10.0, 0.0, 60.0)}
    rod = {"kind": "cylinder", "name": "rod", "radius_mm": 3.0} | ends
    layout = {"kind": "straight", "rows": 12, "columns": 16}
    free, behind = (
        Bench(make_design(layout=layout, camera=LENSES["fisheye"], fixtures=some))
        for some in ([], [rod])
    )
    without = sampled_fraction(free.scene(), free.camera, rays=1_000_000)
    scene = behind.scene()
    alone, visible = exact_counts(scene, behind.camera)
    whole = sampled_fraction(scene, behind.camera, rays=1_000_000)
    np.testing.assert_array_equal(whole.alone, alone)
    np.testing.assert_array_equal(whole.visible, visible)
    assert (visible < without.visible).sum() >= 3


def test_a_dome() -> None:
    case = Bench(load_design("hemisphere"))
    scene = case.scene()
    alone, visible = exact_counts(scene, case.camera)
    assert share_near(sampled_fraction(scene, case.camera), alone, visible) >= SHARE


def quads(*corners: tuple[FloatArray, int, int]) -> RenderScene:
    """Quads (corners (4, 3), part, owner) as a scene of two markers."""
    count = len(corners)
    start = 4 * np.arange(count)[:, None, None]
    triangles = (np.array([[0, 1, 2], [0, 2, 3]])[None] + start).reshape(-1, 3)
    return RenderScene(
        vertices=np.concatenate([c for c, _, _ in corners]),
        triangles=triangles.astype(np.int32),
        part=np.repeat([part for _, part, _ in corners], 2).astype(np.int32),
        vertex_owner=np.repeat([owner for _, _, owner in corners], 4).astype(np.int32),
        colour=np.zeros(2, dtype=np.int64),
        paints=("blue",),
    )


def square(x: float, y: float, z: float, half: float) -> FloatArray:
    return np.array([[x - half, y - half, z], [x + half, y - half, z],
                     [x + half, y + half, z], [x - half, y + half, z]])  # fmt: skip


@pytest.fixture
def camera() -> Camera:
    return Camera.on_axis(width_px=201, height_px=161, focal_px=100.0, stand_off_mm=0.0)


def test_of_two_markers_in_one_place_the_first_is_seen(camera: Camera) -> None:
    here = square(0.0, 0.0, 100.0, 30.3)
    both = quads((here, FIRST_MARKER, 0), (here, FIRST_MARKER + 2, 1))
    for rays in (64, 1_000_000):
        np.testing.assert_array_equal(
            sampled_fraction(both, camera, rays=rays).fraction, [1.0, 0.0]
        )


def test_a_fixed_part_in_front_hides_and_one_behind_does_not(camera: Camera) -> None:
    wall, one, two = square(-40.0, 0.0, 90.0, 25.0), square(-40.0, 0.0, 100.0, 20.2), None
    two = square(40.0, 0.0, 80.0, 20.2)
    behind = square(0.0, 0.0, 120.0, 500.0)
    scene = quads((behind, SHELL, -1), (wall, SHELL, -1), (one, FIRST_MARKER, 0),
                  (two, FIRST_MARKER + 2, 1))  # fmt: skip
    np.testing.assert_array_equal(sampled_fraction(scene, camera).fraction, [0.0, 1.0])


def test_a_part_that_slants_through_the_paint_hides_its_near_half(camera: Camera) -> None:
    paint = square(0.0, 0.0, 100.0, 30.0)
    slant = np.array([[-60.0, -60, 40], [60.0, -60, 160], [60.0, 60, 160], [-60.0, 60, 40]])
    scene = quads((paint, FIRST_MARKER, 0), (slant, SHELL, -1))
    few = sampled_fraction(scene, camera)
    assert few.fraction[0] == pytest.approx(0.5, abs=0.06)
    whole = sampled_fraction(scene, camera, rays=1_000_000)
    alone, visible = exact_counts(scene, camera)
    assert whole.visible[0] == visible[0]
    assert whole.alone[0] == alone[0]


def test_no_marker_in_view_and_one_marker(camera: Camera) -> None:
    scene = quads((square(0.0, 0.0, -50.0, 10.0), FIRST_MARKER, 0),
                  (square(900.0, 0.0, 50.0, 10.0), FIRST_MARKER + 2, 1))  # fmt: skip
    np.testing.assert_array_equal(sampled_fraction(scene, camera).alone, [0, 0])
    case = Bench(make_design(layout={"rows": 1, "columns": 1}))
    only = case.scene()
    np.testing.assert_array_equal(sampled_fraction(only, case.camera).fraction, [1.0])


def test_what_leaves_the_image_is_not_seen(small: Bench) -> None:
    scene = small.scene()
    # Also above and to the left, where a grid starts at negative pixels.
    narrow = replace(small.camera.lens, width_px=400, height_px=380, cx_px=200.0, cy_px=190.0)
    camera = replace(small.camera, lens=narrow)
    alone, visible = exact_counts(scene, camera)
    assert (visible < 0.9 * alone).sum() > 3
    whole = sampled_fraction(scene, camera, rays=1_000_000)
    np.testing.assert_array_equal(whole.visible, visible)
    np.testing.assert_array_equal(whole.alone, alone)
