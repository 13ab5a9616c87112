import re
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phytac_design.layout import make_markers
from phytac_design.layout.receptor_distances import (
    nearest_pair,
    segment_distance_mm,
    smallest_receptor_gap_mm,
)
from phytac_design.rules.check import check_design
from phytac_shapes.errors import DesignError
from tests.fabrication.cases import built, design, shipped
from tests.refusals import refused

Sections = dict[str, dict[str, Any]]
FULL: Sections = {"layout": {"rows": 23, "columns": 16}}

REFUSALS: list[tuple[str, Sections, str]] = [
    (
        "wall thicker than the radius",
        {"wall": {"thickness_mm": 31.0}},
        (
            "the wall is thicker than the cylinder allows (thickness 31 mm ≥ radius 30 mm); "
            "lower wall.thickness_mm below 30"
        ),
    ),
    (
        "wall too thin",
        {"wall": {"thickness_mm": 0.3}},
        "the wall is too thin to print (0.3 mm < 0.4 mm); raise wall.thickness_mm to 0.4",
    ),
    (
        "tips at the axis",
        {"layout": {"height_far_mm": 31.0}},
        (
            "receptor tips of row 22 collide at the axis (height 31.0 mm ≥ inner radius 29.2 mm); "
            "lower layout.height_far_mm to 20.7"
        ),
    ),
    (
        "near tips at the axis",
        {"layout": {"height_near_mm": 30.0}},
        "receptor tips of row 0 collide at the axis (height 30.0 mm ≥ inner radius 29.2 mm)",
    ),
    (
        "tips in the light bar",
        {"layout": {"height_far_mm": 27.0}},
        (
            "receptor tips of row 22 reach the light bar (they end 2.2 mm from the axis, "
            "height 27.0 mm; the bar of radius 3 mm needs 3.3 mm)"
        ),
    ),
    (
        "red tips in the light bar",
        {"layout": {"height_far_mm": 25.5}},
        "pushed-out red tips of row 22 reach the light bar (they end 2.5 mm",
    ),
    (
        "neighbours of one row",
        {"layout": {"height_far_mm": 21.5}},
        (
            "receptors (row 22, column 0) and (row 22, column 1) meet: they are 0.00 mm apart "
            "(the printer needs a gap of 0.3 mm); lower layout.height_far_mm to 20.7, or lower "
            "layout.columns or receptor.diameter_outer_mm"
        ),
    ),
    (
        "neighbours on the wall",
        {"layout": {"columns": 60, "height_far_mm": 0.5}, "receptor": {"diameter_outer_mm": 3.2}},
        "meet: they overlap by",
    ),
    (
        "rows that meet",
        {
            "layout": {"kind": "straight", "rows": 60},
            "receptor": {"diameter_outer_mm": 1.9, "diameter_hole_mm": 1.0},
            "switch": {"tip_diameter_mm": 0.6, "footprint_diameter_mm": 1.5},
        },
        "(row 1, column 0) meet: they are 0.10 mm apart",
    ),
    (
        "tubes in the rim",
        {"layout": {"rows": 60}},
        (
            "receptor (row 0, column 0) lies 1.00 mm from the end of the surface, less than the "
            "radius of its tube (1.50 mm): it cuts the rim; lower layout.rows or "
            "receptor.diameter_outer_mm"
        ),
    ),
    (
        "footprints in the rim",
        {"layout": {"rows": 30}},
        (
            "less than the radius of its switch footprint (2.30 mm): it cuts the rim; lower "
            "layout.rows or switch.footprint_diameter_mm"
        ),
    ),
    (
        "hole wider than the tube",
        {"receptor": {"diameter_hole_mm": 3.0}},
        "the receptors' hole is not smaller than the tube (hole 3 mm ≥ outer 3 mm)",
    ),
    (
        "thin tube",
        {"receptor": {"diameter_hole_mm": 2.3}},
        (
            "the receptors' tube walls are too thin to print (0.35 mm < 0.4 mm); raise "
            "receptor.diameter_outer_mm to 3.1 or lower receptor.diameter_hole_mm"
        ),
    ),
    (
        "closed hole",
        {"receptor": {"diameter_hole_mm": 0.4}},
        (
            "the receptors' holes would close in printing (0.4 mm < 0.5 mm); raise "
            "receptor.diameter_hole_mm to 0.5"
        ),
    ),
    (
        "tight tip",
        {"switch": {"tip_diameter_mm": 1.5}},
        (
            "the switch's tip does not pass the receptor's hole (tip 1.5 mm in a hole of 1.6 mm "
            "leaves 0.10 mm < 0.3 mm); lower switch.tip_diameter_mm to 1.3 or raise "
            "receptor.diameter_hole_mm"
        ),
    ),
    (
        "release above threshold",
        {"switch": {"release_N": 0.5}},
        (
            "a switch must release below its threshold (release 0.5 N ≥ threshold 0.5 N); lower "
            "switch.release_N"
        ),
    ),
    (
        "hidden tip",
        {"switch": {"stroke_mm": 0.3}},
        (
            "the red tip never comes out (stroke 0.3 mm ≤ recess 0.3 mm); raise switch.stroke_mm "
            "above 0.3"
        ),
    ),
    (
        "bowl smaller than the hole",
        {"switch": {"footprint_diameter_mm": 1.6}},
        "the switch's bowl does not cover the hole (footprint 1.6 mm ≤ hole 1.6 mm)",
    ),
    (
        "bowls that overlap",
        {
            "layout": {"kind": "straight"},
            "switch": {"footprint_diameter_mm": 5.22},
            "wall": {"rim_length_mm": 0.0},
        },
        (
            "switches (row 0, column 0) and (row 1, column 0) overlap on the outer face (footprint "
            "5.22 mm, centres 5.22 mm apart); lower layout.rows or layout.columns or "
            "switch.footprint_diameter_mm to 5.2"
        ),
    ),
    (
        "tube wider than the curve",
        {
            "shape": {"diameter_outer_mm": 8.0},
            "receptor": {"diameter_outer_mm": 6.0},
            "layout": {"rows": 1, "columns": 1, "height_far_mm": 30.0},  # no far row: no effect
            "light": {"bar_radius_mm": 0.0},
        },
        "a receptor of row 0 does not fit the curved wall",
    ),
]


@pytest.mark.parametrize(("changes", "text"), [case[1:] for case in REFUSALS], ids=lambda _: "")
def test_refusals_say_what_got_and_fix(changes: Sections, text: str) -> None:
    sections = {key: {**FULL.get(key, {}), **changes.get(key, {})} for key in {*FULL, *changes}}
    with pytest.raises(DesignError) as caught:
        check_design(design(**sections))
    message = str(caught.value)
    assert text in message
    assert re.search(r"; (lower|raise) ", message)
    assert "\n" not in message


@pytest.mark.parametrize("name", ["cylinder60", "cylinder40"])
def test_shipped_designs_pass(name: str) -> None:
    case = shipped(name)
    sensor = check_design(case)
    markers = sensor.markers
    assert markers.count == case.layout.rows * case.layout.columns
    assert sensor.surface == case.surface()
    gap, _ = smallest_receptor_gap_mm(case, markers)
    assert gap >= 2.0


def test_cylinder40_is_as_its_comments_say() -> None:
    case = shipped("cylinder40")
    sensor = check_design(case)
    markers = sensor.markers
    assert 100.0 * markers.count / sensor.surface.area_mm2() == pytest.approx(2.15, abs=0.005)
    assert np.diff(np.unique(markers.height_mm)) == pytest.approx(0.5)
    assert np.hypot(*markers.tip_mm[:, :2].T).min() == pytest.approx(10.2)


def test_the_suggested_height_passes_and_a_little_more_does_not() -> None:
    check_design(design(layout={"rows": 23, "columns": 16, "height_far_mm": 20.7}))
    with refused("receptors-too-close"):
        check_design(design(layout={"rows": 23, "columns": 16, "height_far_mm": 20.8}))


def test_the_far_height_of_a_single_row_is_not_blamed() -> None:
    one = {"rows": 1, "columns": 1, "height_near_mm": 30.0, "height_far_mm": 30.0}
    with refused("tips-collide") as caught:
        check_design(design(layout=one))
    caught.match("layout.height_near_mm")
    assert "height_far_mm" not in str(caught.value)


def test_lengths_that_meet_a_rule_exactly_pass() -> None:
    check_design(
        design(
            wall={"thickness_mm": 0.4},
            receptor={"diameter_outer_mm": 2.4, "diameter_hole_mm": 1.6},
            switch={"tip_diameter_mm": 1.3},
        )
    )


def test_no_bar_no_bar_rule() -> None:
    tall = {"rows": 23, "columns": 1, "height_far_mm": 29.0}
    check_design(design(layout=tall, light={"bar_radius_mm": 0.0}))
    with refused("light-bar-hits-tips"):
        check_design(design(layout=tall))


def test_a_bar_that_starts_beyond_the_tall_rows_is_free() -> None:
    tall = {"rows": 1, "columns": 2, "height_near_mm": 26.5}
    check_design(design(layout=tall, light={"bar_start_mm": 70.0}))
    with refused("light-bar-hits-tips"):
        check_design(design(layout=tall, light={"bar_start_mm": 50.0}))


def test_coincident_receptors_are_named_not_missed() -> None:
    """Two turns of a full circle put row 1 upon row 0 if rows had no distance: use points."""
    points = np.array([[0.0, 0, 0], [5, 0, 0], [5, 0, 0], [9, 0, 0]])
    assert nearest_pair(points) == (0.0, (1, 2))


def test_gap_of_one_row_against_the_chord() -> None:
    case, _, markers = built(design(layout={"rows": 1, "columns": 8, "height_near_mm": 20.0}))
    gap, pair = smallest_receptor_gap_mm(case, markers)
    assert gap == pytest.approx(2.0 * 9.2 * np.sin(np.pi / 8.0) - 3.0, abs=1e-12)
    assert pair is not None


def test_a_single_receptor_has_no_gap() -> None:
    case, _, markers = built(design(layout={"rows": 1, "columns": 1}))
    assert smallest_receptor_gap_mm(case, markers) == (np.inf, None)


@pytest.mark.parametrize("apart", [0.25, 3.1])
def test_crossing_tubes_are_found_though_their_ends_are_apart(apart: float) -> None:
    """The nearest points lie between the samples of both axes (at 2.5 and 5 mm)."""
    case, _, markers = built(design(layout={"rows": 1, "columns": 2}))
    crossed = replace(
        markers,
        base_mm=np.array([[0.0, 0.0, 0.0], [3.75, -3.75, apart]]),
        tip_mm=np.array([[10.0, 0.0, 0.0], [3.75, 6.25, apart]]),
        height_mm=np.array([10.0, 10.0]),
    )
    gap, pair = smallest_receptor_gap_mm(case, crossed)
    assert pair == (0, 1)
    assert gap == pytest.approx(apart - 3.0, abs=1e-9)


coordinate = st.floats(-10.0, 10.0, allow_nan=False)
point = st.tuples(coordinate, coordinate, coordinate)


@settings(max_examples=60, deadline=None)
@given(points=st.tuples(point, point, point, point))
def test_segment_distance_against_dense_sampling(
    points: tuple[tuple[float, float, float], ...],
) -> None:
    p0, p1, q0, q1 = (np.array([p]) for p in points)
    along = np.linspace(0.0, 1.0, 301)[:, None]
    first, second = p0 + along * (p1 - p0), q0 + along * (q1 - q0)
    sampled = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    step = (np.linalg.norm(p1 - p0) + np.linalg.norm(q1 - q0)) / 600.0
    exact = segment_distance_mm(p0, p1, q0, q1)[0]
    assert exact <= sampled + 1e-9
    assert exact >= sampled - step - 1e-9
    assert segment_distance_mm(q1, q0, p0, p1)[0] == pytest.approx(exact, abs=1e-9)


def test_gap_against_all_pairs() -> None:
    case = design(layout={"rows": 9, "columns": 14, "height_far_mm": 16.0})
    markers = make_markers(case, case.surface())
    i, j = np.triu_indices(markers.count, 1)
    every = segment_distance_mm(
        markers.base_mm[i], markers.tip_mm[i], markers.base_mm[j], markers.tip_mm[j]
    )
    gap, _ = smallest_receptor_gap_mm(case, markers)
    assert gap == pytest.approx(every.min() - 3.0, abs=1e-9)


def test_ten_thousand_receptors_are_checked_without_all_pairs() -> None:
    """Not a benchmark: all pairs would be 5e7 distances and far beyond this bound."""
    case = design(
        shape={"diameter_outer_mm": 140.0, "length_mm": 420.0},
        layout={"rows": 100, "columns": 100},
        switch={"footprint_diameter_mm": 4.0},
    )
    start = time.perf_counter()
    check_design(case)
    assert time.perf_counter() - start < 5.0
