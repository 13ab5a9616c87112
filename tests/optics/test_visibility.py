from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.density import density_of
from phytac_design.optics.gaps import marker_gaps
from phytac_design.optics.raster import pixels_alone, rasterise
from phytac_design.optics.render_scene import paint_owner
from phytac_design.optics.visibility import (
    Visibility,
    check_visibility,
    fused_markers,
    measure_visibility,
)
from phytac_design.simulation.imaging.nominal_view import look
from phytac_design.stages.views_stage import straight_of
from phytac_shapes.arrays import IntArray
from tests.optics.cases import Bench, make_design


def layout(**values: Any) -> Design:
    return make_design(layout=values)


def test_a_lone_receptor_is_seen_whole(rng: np.random.Generator) -> None:
    bench = Bench(layout(rows=1, columns=1, height_near_mm=5.0, height_far_mm=5.0))
    seen = check_visibility(Sensor.of(bench.design, bench.surface, bench.markers), rng=rng)
    assert seen.visible_fraction[0] == 1.0
    assert seen.visible_px[0] == seen.alone_px[0] > 30
    assert not seen.occluded[0]
    assert not seen.fused[0]
    assert np.isinf(seen.gap_same_colour_px[0])
    assert np.isinf(seen.gap_other_colour_px[0])
    assert seen.red_on_px[0] > seen.red_rest_px[0]


def test_centroid_and_paint_point_are_one_line_of_sight(
    few: Bench, rng: np.random.Generator
) -> None:
    seen = check_visibility(Sensor.of(few.design, few.surface, few.markers), rng=rng)
    # The mean of projections is the projection of the mean up to the tube's relief.
    np.testing.assert_allclose(few.camera.project(seen.paint_point_mm), seen.centroid_px, atol=0.35)
    axis = (few.markers.tip_mm - few.markers.base_mm) / few.markers.height_mm[:, None]
    depth = np.sum((few.markers.tip_mm - seen.paint_point_mm) * axis, axis=1)
    assert np.all((depth > 0.0) & (depth < few.design.receptor.band_marker_mm))


def test_a_tall_receptor_in_front_hides_the_one_behind(rng: np.random.Generator) -> None:
    # Straight rows one behind the other. The line of sight to the far marker passes the near
    # receptor's row above its end face, or below it when the near one is taller.
    def fractions(near: float, far: float) -> tuple[Visibility, IntArray]:
        bench = Bench(
            layout(kind="straight", rows=2, columns=4, height_near_mm=near, height_far_mm=far)
        )
        seen = check_visibility(Sensor.of(bench.design, bench.surface, bench.markers), rng=rng)
        return seen, bench.markers.row

    seen, row = fractions(1.0, 4.0)
    assert np.all(seen.visible_fraction == 1.0)
    seen, row = fractions(24.0, 1.0)
    assert np.all(seen.visible_fraction[row == 0] == 1.0)
    # The near receptor is 3 mm wide in front of a 3 mm marker farther away: nothing is left.
    assert np.all(seen.visible_px[row == 1] == 0)
    assert np.all(seen.occluded == (row == 1))
    assert np.all(np.isnan(seen.centroid_px[row == 1]))


def test_a_covered_half_counts_as_half(few: Bench) -> None:
    # Hide exactly the pixels of one side of marker 0 with a marker of its own in front.
    scene, camera = few.scene(), few.camera
    part = rasterise(scene, camera).part
    visible = np.bincount(paint_owner(part)[paint_owner(part) >= 0], minlength=12)
    alone = pixels_alone(scene, camera)
    np.testing.assert_array_equal(visible, alone)
    x = np.nonzero(paint_owner(part) == 0)[1]
    cut = int(np.median(x)) + 0.5
    ray = camera.rays(np.array([[cut, 0.0], [cut, 2000.0], [cut + 400.0, 2000.0]]))
    at = camera.position_mm + ray * (5.0 / ray[:, 2:])
    up = np.array([0.0, 200.0, 0.0])
    curtain = replace(
        scene,
        vertices=np.concatenate([scene.vertices, at - up, at + up]),
        triangles=np.concatenate(
            [scene.triangles, (len(scene.vertices) + np.array([[0, 3, 2], [3, 5, 2]])).astype("i4")]
        ),
        part=np.concatenate([scene.part, [1, 1]]).astype(np.int32),
        vertex_owner=np.concatenate([scene.vertex_owner, -np.ones(6)]).astype(np.int32),
    )
    seen = measure_visibility(curtain, curtain, camera, noise_std=0.0, rng=np.random.default_rng(0))
    assert seen.visible_px[0] == int((x < cut).sum())
    assert seen.visible_fraction[0] == pytest.approx((x < cut).sum() / len(x))


def test_the_published_spiral_is_seen_and_a_straight_grid_fuses(rng: np.random.Generator) -> None:
    # At 3/4 of the camera's resolution; the full one is in benchmarks/results/visibility.json.
    camera = {"width_px": 1944, "height_px": 1458, "focal_px": 727.5}
    spiral = Bench(make_design(camera=camera))
    seen = check_visibility(Sensor.of(spiral.design, spiral.surface, spiral.markers), rng=rng)
    assert seen.summary()["occluded"] == seen.summary()["fused"] == 0
    assert seen.visible_fraction.min() > 0.98
    straight = Bench(make_design(camera=camera, layout={"kind": "straight"}))
    other = check_visibility(
        Sensor.of(straight.design, straight.surface, straight.markers), rng=rng
    )
    assert 116 <= other.fused.sum() <= 316  # design study, over painted bands of 0.5 to 1.5 mm
    assert other.visible_fraction.min() < seen.visible_fraction.min()
    assert np.all(seen.red_on_px > seen.red_rest_px)


def test_a_check_and_a_build_find_the_same_markers_fused() -> None:
    """The straight rows of ``grip``: by coarser frames 8 markers are fused, by these 17."""
    sensor = Sensor(straight_of(load_design("grip")))
    camera, noise = sensor.cameras[0], sensor.design.camera.noise_pixel
    checked = check_visibility(sensor, rng=np.random.default_rng(0))
    built = look(sensor, camera, noise_std=noise, rng=np.random.default_rng(0)).seen
    assert checked.fused.any()
    np.testing.assert_array_equal(checked.fused, built.fused)


def test_visibility_is_the_same_twice(small: Bench) -> None:
    one, two = (
        check_visibility(
            Sensor.of(small.design, small.surface, small.markers), rng=np.random.default_rng(3)
        )
        for _ in range(2)
    )
    for name in one.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_gaps_are_distances_between_nearest_pixels(rng: np.random.Generator) -> None:
    marker = np.full((60, 80), -1, dtype=np.int32)
    marker[10:15, 10:20] = 0  # blue
    marker[10:15, 23:25] = 1  # blue, 4 columns on from column 19
    marker[17:20, 5:12] = 2  # green, 3 rows on from row 14
    marker[40, 70] = 3  # green
    own, other = marker_gaps(marker, np.array([0, 0, 1, 1, 1]))
    far = np.hypot(70 - 11, 40 - 19)
    np.testing.assert_allclose(own, [4.0, 4.0, far, far, np.inf])
    np.testing.assert_allclose(other[:3], [3.0, np.hypot(23 - 11, 3), 3.0])
    assert np.isinf(other[4])


def test_gaps_agree_with_every_pair_of_pixels(small: Bench) -> None:
    marker = paint_owner(rasterise(small.scene(), small.camera).part)
    colour = small.markers.colour
    own, other = marker_gaps(marker, colour)
    y, x = np.nonzero(marker >= 0)
    owner = marker[y, x]
    for i in (0, 100, 200, 367):
        mine = owner == i
        d = np.hypot(x[mine][:, None] - x[~mine], y[mine][:, None] - y[~mine])
        same = colour[owner[~mine]] == colour[i]
        assert own[i] == pytest.approx(d[:, same].min())
        assert other[i] == pytest.approx(d[:, ~same].min())


def test_fused_markers_share_a_blob_of_their_colour() -> None:
    marker = np.array([[0, 0, 0, 1, 1, 1], [2, 2, 2, 3, 3, 3], [4, 4, 4, 5, 5, 0]], dtype=np.int32)
    labels = np.array([[1, 1, 1, 1, 1, 1], [2, 2, 2, 3, 3, 3], [4, 4, 4, 4, 4, 4]])
    colours = np.array([0, 0, 0, 0, 0, 0])
    fused = fused_markers(labels, np.array([0, 0, 0, 0]), marker, colours)
    # 0 and 1 share blob 1; 5 and 0 have fewer than three pixels of blob 4.
    np.testing.assert_array_equal(fused, [True, True, False, False, False, False])
    # A blob of another colour does not fuse them.
    none = fused_markers(labels, np.array([1, 1, 1, 1]), marker, colours)
    assert not none.any()


def test_density_names_area_and_kind_of_surface(small: Bench) -> None:
    density = density_of(small.surface, small.markers)
    assert density.count == 368
    assert density.area_cm2 == pytest.approx(2 * np.pi * 30.0 * 120.0 / 100.0)
    assert density.per_cm2 == pytest.approx(1.63, abs=0.01)
    assert density.surface_class == "parallel"
    up = np.tile([0.0, 0.0, 1.0], (368, 1))
    facing = density_of(small.surface, replace(small.markers, normal=up))
    assert facing.surface_class == "perpendicular"
    mixed = np.concatenate([up[:1], small.markers.normal[1:]])
    oblique = density_of(small.surface, replace(small.markers, normal=mixed))
    assert oblique.surface_class == "oblique"
