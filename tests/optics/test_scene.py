import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

from phytac_design.design.fixture_table import BoxFixture
from phytac_design.geometry.triangles import grid_mesh
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import (
    BAR,
    FIRST_MARKER,
    SHELL,
    build_scene,
    fixture_mesh,
    paint_owner,
    red_owner,
    sides_of,
)
from phytac_design.optics.visibility import measure_visibility
from phytac_shapes.arrays import FloatArray, IntArray
from tests.optics.cases import FULL, Bench, make_design


def test_part_codes_name_their_marker() -> None:
    part = np.array([0, 1, 2, 3, 16, 17, 18, 19, 16 + 2 * 367, 17 + 2 * 367], dtype=np.int32)
    np.testing.assert_array_equal(paint_owner(part), [-1, -1, -1, -1, 0, -1, 1, -1, 367, -1])
    np.testing.assert_array_equal(red_owner(part), [-1, -1, -1, -1, -1, 0, -1, 1, -1, 367])


def area_mm2(vertices: FloatArray, triangles: IntArray) -> float:
    a, b, c = vertices[triangles].swapaxes(0, 1)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def test_paint_has_the_area_of_band_and_end(few: Bench) -> None:
    # Of circles; polygons fall a little short of them.
    scene, receptor = few.scene(), few.design.receptor
    outer, hole = receptor.diameter_outer_mm / 2.0, receptor.diameter_hole_mm / 2.0
    wanted = 2.0 * np.pi * outer * receptor.band_marker_mm + np.pi * (outer**2 - hole**2)
    for marker in (0, 5, 11):
        painted = scene.triangles[scene.part == FIRST_MARKER + 2 * marker]
        assert area_mm2(scene.vertices, painted) == pytest.approx(wanted, rel=0.1)


def test_a_box_is_closed() -> None:
    box = BoxFixture(name="box", centre_mm=(1.0, 2.0, 3.0), size_mm=(4.0, 5.0, 6.0), turn_deg=20.0)
    mesh = fixture_mesh(box, tolerance_mm=0.1)
    assert area_mm2(mesh.vertices_mm, mesh.triangles) == pytest.approx(2.0 * (20 + 24 + 30))
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}


def test_receptors_have_the_sizes_of_the_design(few: Bench) -> None:
    scene, markers, design = few.scene(), few.markers, few.design
    axis = (markers.tip_mm - markers.base_mm) / markers.height_mm[:, None]
    for marker in (0, 5, 11):
        own = scene.vertex_owner == marker
        arm = scene.vertices[own] - markers.tip_mm[marker]
        depth = -(arm @ axis[marker])
        radius = np.linalg.norm(arm + depth[:, None] * axis[marker], axis=1)
        painted = scene.triangles[scene.part == FIRST_MARKER + 2 * marker]
        lookup = np.cumsum(own) - 1
        p = np.unique(lookup[painted])
        assert depth[p].min() == pytest.approx(0.0, abs=1e-12)
        assert depth[p].max() == pytest.approx(design.receptor.band_marker_mm, abs=1e-12)
        assert radius[p].max() == pytest.approx(design.receptor.diameter_outer_mm / 2, abs=1e-12)
        assert radius[p].min() == pytest.approx(design.receptor.diameter_hole_mm / 2, abs=1e-12)
        wall = design.wall.thickness_mm
        assert depth.max() == pytest.approx(markers.height_mm[marker] + wall / 2, abs=1e-12)


@pytest.mark.parametrize(("on", "out"), [(False, -0.3), (True, 1.2)])
def test_red_tip_ends_where_the_switch_pushes_it(few: Bench, on: bool, out: float) -> None:
    scene, markers = few.scene(np.full(few.markers.count, on)), few.markers
    red = scene.part == FIRST_MARKER + 1 + 2 * 7
    tip = scene.vertices[scene.triangles[red]].reshape(-1, 3)
    axis = (markers.tip_mm - markers.base_mm)[7] / markers.height_mm[7]
    along = (tip - markers.tip_mm[7]) @ axis
    assert along.max() == pytest.approx(out, abs=1e-12)
    assert along.max() - along.min() == pytest.approx(1.8, abs=1e-12)  # stroke + recess


def test_shell_and_bar_lie_on_their_cylinders(small: Bench) -> None:
    scene = small.scene()
    corners = scene.vertices[scene.triangles[scene.part == SHELL]].reshape(-1, 3)
    radius = np.linalg.norm(corners[:, :2], axis=1)
    inner = (corners[:, 2] > -4.0) | (radius < 29.3)
    np.testing.assert_allclose(radius[inner], 29.2, rtol=1e-12)
    assert corners[:, 2].min() == pytest.approx(-4.0)
    assert corners[:, 2].max() == pytest.approx(124.0)
    assert radius.max() == pytest.approx(30.0 + 1.6)
    bar = scene.vertices[scene.triangles[scene.part == BAR]].reshape(-1, 3)
    assert np.linalg.norm(bar[:, :2], axis=1).max() == pytest.approx(3.0)
    assert (bar[:, 2].min(), bar[:, 2].max()) == pytest.approx((5.0, 120.0))


def test_sides_keep_the_polygon_within_its_tolerance() -> None:
    tolerance = np.array([0.001, 0.01, 0.1, 10.0])
    sides = sides_of(1.5, tolerance)
    sagitta = 1.5 * (1.0 - np.cos(np.pi / sides))
    assert np.all(sagitta[:3] <= tolerance[:3])
    assert np.all(np.diff(sides) <= 0)


def test_no_motion_changes_no_bit(small: Bench) -> None:
    scene = small.scene()
    zero = np.zeros((small.markers.count, 3))
    still = scene.moved(zero, zero, small.markers.mid_mm)
    np.testing.assert_array_equal(still.vertices, scene.vertices)
    one, two = rasterise(scene, small.camera), rasterise(still, small.camera)
    np.testing.assert_array_equal(one.part, two.part)
    np.testing.assert_array_equal(one.depth, two.depth)


def test_a_moved_receptor_moves_alone_and_as_a_rigid_body(
    few: Bench, rng: np.random.Generator
) -> None:
    scene, markers = few.scene(), few.markers
    shift, turn = np.zeros((markers.count, 3)), np.zeros((markers.count, 3))
    shift[5], turn[5] = [0.1, -0.4, 0.3], [0.05, 0.02, -0.03]
    moved = scene.moved(shift, turn, markers.mid_mm)
    own = scene.vertex_owner == 5
    np.testing.assert_array_equal(moved.vertices[~own], scene.vertices[~own])
    before = scene.vertices[own] - markers.mid_mm[5]
    after = moved.vertices[own] - markers.mid_mm[5] - shift[5]
    np.testing.assert_allclose(before @ before.T, after @ after.T, atol=1e-10)
    rotation = expm(np.cross(np.eye(3), turn[5]))
    np.testing.assert_allclose(after, before @ rotation.T, atol=1e-12)


def test_a_moved_tip_shifts_its_centroid_by_the_camera_jacobian(rng: np.random.Generator) -> None:
    # Large image, so that counting pixels is exact to a few hundredths of a pixel.
    # Receptors along the image's axes have sides that jump over whole rows of pixels: left out.
    layout = {"rows": 2, "columns": 7, "height_near_mm": 3.0, "height_far_mm": 6.0}
    bench = Bench(make_design(layout=layout, camera=FULL))
    n = bench.markers.count
    shift = rng.normal(0.0, 0.15, (n, 3))
    turn = np.zeros((n, 3))
    scene = bench.scene()
    moved = scene.moved(shift, turn, bench.markers.mid_mm)
    before = measure_visibility(scene, scene, bench.camera, noise_std=0.0, rng=rng)
    after = measure_visibility(moved, moved, bench.camera, noise_std=0.0, rng=rng)
    rows = np.einsum("nij,nj->ni", bench.camera.jacobian(before.paint_point_mm), shift)
    got = after.centroid_px - before.centroid_px
    # Of up to 9 px; the rest is the side of the tube that a new line of sight uncovers.
    assert np.linalg.norm(rows, axis=1).max() > 4.0
    slanted = np.abs(bench.markers.normal[:, :2]).min(axis=1) > 0.15
    assert slanted.sum() >= 10
    np.testing.assert_allclose(got[slanted], rows[slanted], atol=0.15)


def test_a_closed_grid_has_two_triangles_per_cell() -> None:
    points = np.zeros((3, 5, 3))
    assert len(grid_mesh(points, closed=True).triangles) == 2 * 2 * 5
    assert len(grid_mesh(points, closed=False).triangles) == 2 * 2 * 4


def test_a_leaning_receptor_has_no_gap_under_its_foot(few: Bench) -> None:
    markers = few.markers
    lean = np.cross(markers.normal, [0.0, 0.0, 1.0])
    axis = -markers.normal + 0.4 * lean / np.linalg.norm(lean, axis=1, keepdims=True)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    tip = markers.base_mm + markers.height_mm[:, None] * axis
    leaning = dataclasses.replace(markers, tip_mm=tip)
    scene = build_scene(Sensor.of(few.design, few.surface, leaning), tolerance_mm=0.05)
    for marker in (0, 5, 11):
        own = scene.vertices[scene.vertex_owner == marker]
        depth = -(own - tip[marker]) @ axis[marker]
        root = own[depth > depth.max() - 1e-9]
        above = (root - markers.base_mm[marker]) @ -markers.normal[marker]
        assert above.max() <= -0.9 * few.design.wall.thickness_mm / 2.0
