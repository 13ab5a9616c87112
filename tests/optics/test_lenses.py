"""ID maps, frames and counts through lenses that bend lines, against Embree and each other."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera, pinhole
from phytac_decoder.camera.lens import BrownConrady, KannalaBrandt
from phytac_design.optics.distorted_triangles import distorted_view
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.raster import all_pieces, pixels_alone, points_seen, rasterise
from phytac_design.optics.rays import pixel_rays, ray_grid
from phytac_design.optics.render_scene import SHELL, RenderScene
from phytac_design.optics.zbuffer import fill
from phytac_shapes.arrays import FloatArray
from tests.optics.cases import Bench, make_design
from tests.optics.lenses import LENSES

AGREEMENT_MIN = 0.9999  # the rest are rays that Embree's float32 puts on the other side of an edge
EVERY = pytest.mark.parametrize("name", sorted(LENSES))


@pytest.fixture(scope="module")
def benches() -> dict[str, Bench]:
    return {name: Bench(make_design(camera=table)) for name, table in LENSES.items()}


def embree(scene: RenderScene, camera: Camera) -> tuple[NDArray[np.int32], FloatArray]:
    """First triangle that each pixel's ray meets (-1 for none), and how far away."""
    rtcore_scene = pytest.importorskip("embreex.rtcore_scene")
    from embreex.mesh_construction import TriangleMesh

    tree = rtcore_scene.EmbreeScene()
    TriangleMesh(tree, scene.vertices[scene.triangles].astype(np.float32))
    y, x = np.indices((camera.height_px, camera.width_px))
    rays = camera.rays(np.column_stack([x.ravel(), y.ravel()]).astype(float))
    blind = np.isnan(rays[:, 0])
    rays[blind] = [0.0, 0.0, 1.0]
    start = np.tile(camera.position_mm, (len(rays), 1)).astype(np.float32)
    hit = tree.run(start, rays.astype(np.float32), output=1)
    triangle = np.where(blind, -1, hit["primID"])
    return triangle.reshape(x.shape), np.asarray(hit["tfar"]).reshape(x.shape)


def parts(scene: RenderScene, triangle: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.where(triangle >= 0, scene.part[np.maximum(triangle, 0)], 0)


@EVERY
def test_id_map_agrees_with_one_embree_ray_per_pixel(name: str, benches: dict[str, Bench]) -> None:
    case = benches[name]
    scene = case.scene(np.arange(case.markers.count) % 3 == 0)
    ours = rasterise(scene, case.camera)
    hit, distance = embree(scene, case.camera)
    assert np.mean(ours.part == parts(scene, hit)) >= AGREEMENT_MIN
    y, x = np.nonzero((ours.triangle == hit) & (hit >= 0))
    assert len(x) > 0.3 * hit.size
    seen = points_seen(scene, case.camera, ours, y, x)
    far = np.linalg.norm(seen - case.camera.position_mm, axis=1)
    np.testing.assert_allclose(far, distance[y, x], rtol=1e-4)
    np.testing.assert_allclose(
        case.camera.to_camera(seen)[:, 2], ours.depth[y, x], rtol=1e-6, atol=1e-6
    )


def moved(lens: Any, position: list[float], turn: float) -> Camera:
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    return Camera(lens=lens, position_mm=np.array(position), rotation=rotation)


@pytest.mark.parametrize("distortion", [(), (0.02, -0.003, 0.0, 0.0)])
def test_a_fisheye_inside_sees_what_is_beside_and_behind_it(
    small: Bench, distortion: tuple[float, ...]
) -> None:
    # 100 px per radian: the corners look 220 degrees apart, past the near rim behind the camera.
    lens = KannalaBrandt(
        width_px=400, height_px=320, fx_px=100.0, fy_px=104.0, cx_px=203.0, cy_px=158.0,
        distortion=distortion,
    )  # fmt: skip
    camera = moved(lens, [9.0, -6.0, 25.0], 0.4)
    scene = small.scene()
    ours = rasterise(scene, camera)
    hit, _ = embree(scene, camera)
    assert np.mean(ours.part == parts(scene, hit)) >= AGREEMENT_MIN
    behind = np.isfinite(ours.depth) & (ours.depth < 0.0)
    assert behind.mean() > 0.05


def test_a_lens_that_sees_all_around_agrees_with_embree(few: Bench) -> None:
    # The whole sphere but half a degree; the picture has its rim, and the antipode, in it.
    lens = KannalaBrandt(
        width_px=260, height_px=260, fx_px=40.0, fy_px=40.0, cx_px=130.0, cy_px=129.0
    )
    camera = moved(lens, [2.0, 9.0, 60.0], 2.1)
    scene = few.scene()
    ours = rasterise(scene, camera)
    hit, _ = embree(scene, camera)
    assert np.mean(ours.part == parts(scene, hit)) >= AGREEMENT_MIN
    assert np.isnan(pixel_rays(lens)[..., 0]).any()
    assert np.all(ours.part[np.isnan(pixel_rays(lens)[..., 0])] == 0)


def test_a_triangle_as_large_as_the_view_is_split_enough() -> None:
    corner = 1e4
    lens = KannalaBrandt(
        width_px=300, height_px=300, fx_px=90.0, fy_px=90.0, cx_px=149.5, cy_px=149.5
    )
    scene = RenderScene(
        vertices=np.array([[-corner, -corner, 5.0], [corner, -corner, 5.0], [0.0, corner, 5.0]]),
        triangles=np.array([[0, 1, 2]], dtype=np.int32),
        part=np.array([SHELL], dtype=np.int32),
        vertex_owner=np.full(3, -1, dtype=np.int32),
        colour=np.zeros(0, dtype=np.int64),
        paints=("blue",),
    )
    camera = moved(lens, [0.0, 0.0, 0.0], 0.0)
    part = rasterise(scene, camera).part
    rays = pixel_rays(lens)
    # A plane at z = 5 as wide as 90 degrees almost: what looks forward sees it.
    inside = rays[..., 2] > 0.01
    assert np.mean(part[inside] == SHELL) == 1.0
    assert np.all(part[rays[..., 2] < 0.0] == 0)


def test_bent_pieces_of_a_pinhole_give_the_straight_ones(few: Bench) -> None:
    # The same lens through the other path: distortion too small to matter.
    lens = pinhole(width_px=648, height_px=486, focal_px=242.5)
    bent = BrownConrady(
        width_px=648, height_px=486, fx_px=242.5, fy_px=242.5, cx_px=323.5, cy_px=242.5,
        distortion=(1e-14, 0.0, 0.0, 0.0),
    )  # fmt: skip
    scene = few.scene()
    straight = rasterise(scene, Camera.at(lens, z_mm=-30.0))
    other = rasterise(scene, Camera.at(bent, z_mm=-30.0))
    assert np.mean(straight.part == other.part) > 0.9999
    # Pixels on an edge that two triangles share may go to either.
    assert np.mean(straight.triangle == other.triangle) > 0.998
    same = (straight.triangle == other.triangle) & (straight.triangle >= 0)
    np.testing.assert_allclose(straight.depth[same], other.depth[same], rtol=1e-6)


@EVERY
def test_pixel_rays_are_the_lens_itself(name: str, benches: dict[str, Bench]) -> None:
    lens = benches[name].camera.lens
    rays = pixel_rays(lens)
    y, x = np.indices(rays.shape[:2])
    exact = lens.unproject(np.column_stack([x.ravel(), y.ravel()]).astype(float))
    rays = rays.reshape(-1, 3)
    np.testing.assert_array_equal(np.isnan(rays), np.isnan(exact))
    assert np.nanmax(np.abs(rays - exact)) <= 2e-8
    offset = np.array([0.375, -0.44])
    some = ray_grid(lens).rows(10, 12, offset)[1, 20:25]
    pixels = np.column_stack([np.arange(20.0, 25.0), np.full(5, 11.0)]) + offset
    np.testing.assert_allclose(some, lens.unproject(pixels), atol=2e-8)


def test_a_field_smaller_than_a_coarse_cell_is_not_missed() -> None:
    # A strong barrel folds 12 px from the centre; everything beyond is blind.
    lens = BrownConrady(
        width_px=400, height_px=300, fx_px=40.0, fy_px=40.0, cx_px=212.0, cy_px=140.0,
        distortion=(-2.5, 0.0, 0.0, 0.0),
    )  # fmt: skip
    seen = np.isfinite(pixel_rays(lens)[..., 0])
    y, x = np.indices(seen.shape)
    exact = np.isfinite(lens.unproject(np.column_stack([x.ravel(), y.ravel()]).astype(float))[:, 0])
    assert 100 < exact.sum() < 1000
    np.testing.assert_array_equal(seen.ravel(), exact)


@EVERY
def test_frame_without_supersampling_is_the_id_map(name: str, benches: dict[str, Bench]) -> None:
    case = benches[name]
    scene = case.scene()
    lit = render_frame(scene, case.camera, samples=1).astype(int).sum(axis=2) > 40
    part = rasterise(scene, case.camera).part
    # The one sample lies in the middle of the pixel.
    assert np.mean(lit == (part > 0)) > 0.999


def test_a_bent_sample_is_what_a_shifted_lens_sees(benches: dict[str, Bench]) -> None:
    case, offset = benches["fisheye"], np.array([0.3, -0.2])
    scene = case.scene()
    shifted = rasterise(scene, case.camera.shifted(-offset))
    view = distorted_view(case.camera.to_camera(scene.vertices), scene.triangles, case.camera)
    rows = 486
    rays = ray_grid(case.camera.lens).rows(0, rows, offset)
    owner = np.full(rays.shape[:2], -1, dtype=np.int32)
    here = view._replace(rays=rays, origin=np.array([0, 0]))
    grid = (0, 0, 1, float(offset[0]), float(offset[1]))
    fill(here, all_pieces(here), grid, owner, np.zeros(owner.shape))
    assert np.mean(owner == shifted.triangle) > 0.9999


def test_alone_counts_what_leaves_a_bent_image(benches: dict[str, Bench]) -> None:
    # The same lens with and without the outer third of its picture.
    table = LENSES["fisheye"] | {"stand_off_mm": 15.0}
    whole = Bench(make_design(camera=table))
    cut = {"width_px": 216, "height_px": 162, "centre_offset_px": (0.0, 0.0)}
    section = whole.design.camera.model_copy(update=cut)
    camera = Camera.at(section.lens(), z_mm=-15.0)
    scene = whole.scene()
    here, there = pixels_alone(scene, camera), pixels_alone(scene, whole.camera)
    leaves = np.abs(whole.camera.project(whole.markers.tip_mm) - 0.5 * np.array([647, 485]))
    beyond = np.any(leaves > 0.5 * np.array([216, 162]) - 12, axis=1)
    counted = np.all(leaves < np.array([216, 162]) - 12, axis=1)
    assert (beyond & counted).sum() > 20
    np.testing.assert_array_equal(here[counted], there[counted])
