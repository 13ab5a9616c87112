import numpy as np
import pytest
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Pinhole
from phytac_design.optics.raster import clip_near, pixels_alone, rasterise
from phytac_design.optics.render_scene import FIRST_MARKER, SHELL, RenderScene
from phytac_shapes.arrays import FloatArray
from tests.optics.cases import Bench

NEAR_MM = 1e-3

AGREEMENT_MIN = 0.9999  # the rest are rays that Embree's float32 puts on the other side of an edge
DEPTH_RELATIVE = 1e-5  # float32 hit distance of Embree, a few hundred units in the last place


def simple_camera() -> Camera:
    return Camera.on_axis(width_px=101, height_px=81, focal_px=100.0, stand_off_mm=0.0)


def soup(*quads: tuple[list[list[float]], int, int]) -> RenderScene:
    """Quads (corners (4, 3), part, owner) as a scene of two triangles each."""
    vertices = np.concatenate([np.asarray(corners, float) for corners, _, _ in quads])
    start = 4 * np.arange(len(quads))[:, None, None]
    triangles = (np.array([[0, 1, 2], [0, 2, 3]])[None] + start).reshape(-1, 3)
    return RenderScene(
        vertices=vertices,
        triangles=triangles.astype(np.int32),
        part=np.repeat([part for _, part, _ in quads], 2).astype(np.int32),
        vertex_owner=np.repeat([owner for _, _, owner in quads], 4).astype(np.int32),
        colour=np.zeros(2, dtype=np.int64),
        paints=("blue",),
    )


def rectangle(
    x: tuple[float, float], y: tuple[float, float], z: float, far_z: float | None = None
) -> list[list[float]]:
    (x0, x1), (y0, y1), far = x, y, z if far_z is None else far_z
    return [[x0, y0, z], [x1, y0, far], [x1, y1, far], [x0, y1, z]]


def embree_triangles(scene: RenderScene, camera: Camera) -> tuple[NDArray[np.int32], FloatArray]:
    rtcore_scene = pytest.importorskip("embreex.rtcore_scene")
    from embreex.mesh_construction import TriangleMesh

    tree = rtcore_scene.EmbreeScene()
    TriangleMesh(tree, scene.vertices[scene.triangles].astype(np.float32))
    y, x = np.indices((camera.height_px, camera.width_px))
    rays = camera.rays(np.column_stack([x.ravel(), y.ravel()]))
    start = np.tile(camera.position_mm, (len(rays), 1)).astype(np.float32)
    hit = tree.run(start, rays.astype(np.float32), output=1)
    shape = (camera.height_px, camera.width_px)
    depth = (hit["tfar"] * (rays @ camera.rotation[2])).reshape(shape)
    return np.asarray(hit["primID"]).reshape(shape), depth


@pytest.mark.parametrize("bench", ["small", "few"])
def test_id_map_agrees_with_one_embree_ray_per_pixel(
    bench: str, request: pytest.FixtureRequest
) -> None:
    case: Bench = request.getfixturevalue(bench)
    scene = case.scene(np.arange(case.markers.count) % 3 == 0)
    ours = rasterise(scene, case.camera)
    hit, depth = embree_triangles(scene, case.camera)
    theirs = np.where(hit >= 0, scene.part[np.maximum(hit, 0)], 0)
    assert np.mean(ours.part == theirs) >= AGREEMENT_MIN
    same = (ours.triangle == hit) & (hit >= 0)
    assert same.sum() > 0.5 * same.size
    np.testing.assert_allclose(ours.depth[same], depth[same], rtol=DEPTH_RELATIVE)


def test_tilted_camera_agrees_with_embree(few: Bench) -> None:
    angle = 0.3
    c, s = np.cos(angle), np.sin(angle)
    camera = Camera(
        lens=Pinhole(
            width_px=300, height_px=200, fx_px=150.0, fy_px=140.0, cx_px=140.3, cy_px=99.9
        ),
        position_mm=np.array([4.0, -7.0, 20.0]),
        rotation=np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]),
    )
    scene = few.scene()  # The near rim and the first row lie behind this camera.
    assert camera.to_camera(scene.vertices)[:, 2].min() < 0.0
    hit, _ = embree_triangles(scene, camera)
    theirs = np.where(hit >= 0, scene.part[np.maximum(hit, 0)], 0)
    assert np.mean(rasterise(scene, camera).part == theirs) >= AGREEMENT_MIN


def test_a_quad_covers_exactly_the_pixels_inside_it() -> None:
    # Image x = 50 + 100 X / Z, y = 40 + 100 Y / Z: at Z = 100 one mm is one pixel.
    scene = soup((rectangle((-10.25, 20.25), (-5.5, 7.75), 100.0), SHELL, -1))
    buffers = rasterise(scene, simple_camera())
    rows, columns = np.nonzero(buffers.part == SHELL)
    assert (columns.min(), columns.max(), rows.min(), rows.max()) == (40, 70, 35, 47)
    assert len(rows) == 31 * 13
    np.testing.assert_allclose(buffers.depth[rows, columns], 100.0, rtol=1e-14)
    assert np.all(np.isinf(buffers.depth[buffers.part == 0]))
    assert np.all(buffers.triangle[buffers.part == 0] == -1)


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ((-70.0, -50.6), (-30.0, 30.0)),
        ((50.6, 70.0), (-30.0, 30.0)),
        ((-30.0, 30.0), (-60.0, -40.6)),
        ((-30.0, 30.0), (40.6, 60.0)),
    ],
)
def test_a_quad_that_ends_before_the_first_pixel_centre_colours_none(
    x: tuple[float, float], y: tuple[float, float]
) -> None:
    scene = soup((rectangle(x, y, 100.0), SHELL, -1))
    assert int((rasterise(scene, simple_camera()).part == SHELL).sum()) == 0


def test_edges_through_pixel_centres_leave_no_hole() -> None:
    # The diagonal and all sides pass through pixel centres.
    scene = soup((rectangle((-20.0, 20.0), (-20.0, 20.0), 100.0), SHELL, -1))
    assert int((rasterise(scene, simple_camera()).part == SHELL).sum()) == 41 * 41


def test_depth_of_a_steep_quad_is_perspective_correct() -> None:
    scene = soup((rectangle((-20.0, 60.0), (-10.0, 10.0), 50.0, 400.0), SHELL, -1))
    camera = simple_camera()
    depth = rasterise(scene, camera).depth[40]
    x = (np.flatnonzero(np.isfinite(depth)) - 50.0) / 100.0
    # z = 50 + 350 s, x z = -20 + 80 s  =>  z = 50 + 350 (x z + 20) / 80
    exact = (50.0 + 350.0 * 20.0 / 80.0) / (1.0 - 350.0 * x / 80.0)
    np.testing.assert_allclose(depth[np.isfinite(depth)], exact, rtol=1e-12)


def test_the_nearer_of_two_crossing_quads_wins_whatever_their_order() -> None:
    # One faces the camera at z = 100; the other runs from 50 to 150 and crosses it at x = 0.
    flat = (rectangle((-20.0, 20.0), (-10.0, 10.0), 100.0), FIRST_MARKER, 0)
    steep = (
        [[-10.0, -9.0, 50.0], [30.0, -27.0, 150.0], [30.0, 27.0, 150.0], [-10.0, 9.0, 50.0]],
        FIRST_MARKER + 2,
        1,
    )
    one = rasterise(soup(flat, steep), simple_camera()).part[40]
    two = rasterise(soup(steep, flat), simple_camera()).part[40]
    np.testing.assert_array_equal(one, two)
    # On the steep one z = 50 + 2.5 (x + 10); at z = 100 that is x = 10 mm = 10 px.
    assert np.all(one[31:60] == FIRST_MARKER + 2)
    assert np.all(one[61:71] == FIRST_MARKER)


def test_of_coincident_triangles_the_first_wins() -> None:
    sheet = rectangle((-10.0, 10.0), (-10.0, 10.0), 100.0)
    scene = soup((sheet, FIRST_MARKER, 0), (sheet, FIRST_MARKER + 2, 1))
    part = rasterise(scene, simple_camera()).part
    assert set(np.unique(part)) == {0, FIRST_MARKER}


def test_alone_counts_what_the_scene_hides_and_what_leaves_the_image() -> None:
    front = (rectangle((-10.25, 10.25), (-10.25, 10.25), 100.0), FIRST_MARKER, 0)
    behind = (rectangle((-10.25, 80.25), (-5.25, 5.25), 101.0), FIRST_MARKER + 2, 1)
    scene = soup(front, behind)
    camera = simple_camera()
    part = rasterise(scene, camera).part
    assert int((part == FIRST_MARKER).sum()) == 21 * 21
    # Behind: pixels -10.14 to 79.45 px from the centre at 40..129, of which 11..50 are seen.
    assert int((part == FIRST_MARKER + 2).sum()) == 40 * 11
    np.testing.assert_array_equal(pixels_alone(scene, camera), [21 * 21, 90 * 11])


def test_clipping_keeps_the_part_in_front_and_its_plane() -> None:
    points = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, -1.0], [0.0, 1.0, -1.0], [1.0, 1.0, 2.0]])
    triangles = np.array([[0, 1, 2], [1, 0, 3], [1, 2, 1]], dtype=np.int32)
    clipped, faces, source = clip_near(points, triangles)
    np.testing.assert_array_equal(source, [0, 1, 1])
    assert clipped[faces][..., 2].min() >= NEAR_MM
    corners = clipped[faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    whole = points[triangles]
    full = 0.5 * np.linalg.norm(
        np.cross(whole[:, 1] - whole[:, 0], whole[:, 2] - whole[:, 0]), axis=1
    )
    kept = (2.0 - NEAR_MM) / 3.0  # share of each edge that is in front
    assert area[0] == pytest.approx(full[0] * kept**2, rel=1e-12)
    assert area[1] + area[2] == pytest.approx(full[1] * (1.0 - (1.0 - kept) ** 2), rel=1e-12)


def test_rasterising_twice_gives_the_same_bits(small: Bench) -> None:
    scene = small.scene()
    one, two = rasterise(scene, small.camera), rasterise(scene, small.camera)
    for name in ("part", "depth", "triangle"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize("threads", ["2", "5"])
def test_threads_draw_what_one_draws(
    few: Bench, monkeypatch: pytest.MonkeyPatch, threads: str
) -> None:
    scene = few.scene()
    one = rasterise(scene, few.camera)
    monkeypatch.setenv("PHYTAC_THREADS", threads)
    several = rasterise(scene, few.camera)
    np.testing.assert_array_equal(several.triangle, one.triangle)
    np.testing.assert_array_equal(several.depth, one.depth)
