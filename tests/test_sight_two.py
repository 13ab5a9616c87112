"""Line-of-sight heights for two cameras: each sees what is nearest to it."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from phytac_design.layout import Markers, clearance_mm, make_markers, sight_heights_mm, with_heights
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.line_of_sight import clearance_under_load_mm, nearest_camera
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.visibility import best_of, check_visibility
from phytac_shapes.arrays import FloatArray
from tests.designs import changed
from tests.refusals import refused
from tests.test_sight import BASE, DENSE, dents

MARGIN_mm = 0.8
LONG = DENSE | {
    "rows": 32,
    "heights": "line-of-sight",
    "height_far_mm": 30.0,
    "sight_margin_mm": MARGIN_mm,
}


def case(base: str = "cylinder60", **tables: Any) -> tuple[Any, Any, Any, Any]:
    """Design, surface, markers and the centres of its two cameras."""
    layout = LONG | tables.pop("layout", {})
    camera = BASE["camera"] | {"ends": "both"}
    shape = {"shape": {"length_mm": 160.0}} if base == "cylinder60" else {}
    design = changed(base, **(BASE | {"layout": layout, "camera": camera} | shape | tables))
    surface = design.surface()
    cameras_mm = np.stack([camera.position_mm for camera in cameras_of(design, surface)])
    return design, surface, make_markers(design, surface), cameras_mm


SCATTERED = {"kind": "phyllotaxis", "count": 400, "sight_margin_mm": 2.0}
CONE = {"base": "cone", "layout": {"rows": 18, "columns": 10, "sight_margin_mm": 0.5}}


def of_rows(markers: Markers, first: int, last: int) -> Markers:
    """Markers of some rows."""
    keep = (markers.row >= first) & (markers.row < last)
    arrays = {
        item.name: getattr(markers, item.name)[keep]
        for item in fields(markers)
        if item.name != "lattice"
    }
    return replace(markers, **arrays)


def test_each_half_is_as_with_its_camera_alone_and_one_row_stands_above() -> None:
    design, _, markers, cameras_mm = case()
    rows = markers.height_mm.reshape(32, 8)[:, 0]
    near = sight_heights_mm(design, of_rows(markers, 0, 17), cameras_mm[0])[::8]
    far = sight_heights_mm(design, of_rows(markers, 16, 32), cameras_mm[1])[::8]
    np.testing.assert_array_equal(rows[:16], near[:16])
    np.testing.assert_array_equal(rows[17:], far[1:])
    assert near[:16] == pytest.approx(far[::-1], abs=1e-6)
    # Just behind the near half's last row, which the near camera would see beside it.
    assert rows[16] == rows.max() == near[16] > far[0] + 0.5
    # One camera cannot see them all, however tall.
    with refused("receptors-always-hidden"):
        sight_heights_mm(design, markers, cameras_mm[0])


@pytest.mark.parametrize("tables", [{}, {"layout": SCATTERED}, CONE])
def test_each_camera_sees_what_is_nearest_to_it(tables: dict[str, Any]) -> None:
    design, _, markers, cameras_mm = case(**tables)
    margin = design.layout.sight_margin_mm
    gap = clearance_mm(design, markers, cameras_mm)
    assert gap.min() >= margin - 1e-9
    nearest = nearest_camera(markers, cameras_mm)
    away = np.linalg.norm(markers.base_mm[:, None] - cameras_mm, axis=2)
    if not markers.in_rows:
        np.testing.assert_array_equal(nearest, away.argmin(axis=1))
    for number, centre in enumerate(cameras_mm):
        own = nearest == number
        assert own.any()
        np.testing.assert_array_equal(clearance_mm(design, markers, centre)[own], gap[own])


def test_markers_are_visible_and_separate_in_the_exact_id_map() -> None:
    design, surface, markers, cameras_mm = case()
    nearest = nearest_camera(markers, cameras_mm)
    each = [
        check_visibility(
            Sensor.of(design, surface, markers), rng=np.random.default_rng(0), camera=camera
        )
        for camera in cameras_of(design, surface)
    ]
    fraction = np.stack([seen.visible_fraction for seen in each])[nearest, range(markers.count)]
    above = markers.height_mm > design.receptor.band_marker_mm
    assert above.sum() > 100
    assert fraction[above].min() > 0.95
    assert best_of(each)[0].clear.all()


def test_heights_are_the_least() -> None:
    design, surface, markers, cameras_mm = case()
    rows = markers.height_mm.reshape(32, 8)[:, 0]
    # Row 16 is taller, for the other camera's sake.
    tall = np.flatnonzero((rows > 0.5) & (np.arange(32) != 16))
    assert len(tall) > 10
    for row in tall[::4]:
        lower = markers.height_mm - 0.05 * (markers.row == row)
        trial = with_heights(design, surface, markers, lower)
        assert clearance_mm(design, trial, cameras_mm)[markers.row == row].min() < MARGIN_mm


def mirrored(motions: FloatArray) -> FloatArray:
    """The same presses in the other half of a straight layout: rows turned about, and z with them.

    Rotations are axial: those about the axis keep their sign when z is turned, others lose it.
    """
    rows = motions.reshape(len(motions), 32, 8, 6)[:, ::-1].reshape(motions.shape)
    return rows * np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])


def test_heights_stay_clear_under_load_for_both() -> None:
    design, surface, markers, cameras_mm = case(layout={"sight_margin_mm": 0.5})
    motions = np.concatenate([dents(markers), mirrored(dents(markers))])
    before = clearance_under_load_mm(design, markers, cameras_mm, motions)
    height = sight_heights_mm(design, markers, cameras_mm, motions=motions)
    settled = with_heights(design, surface, markers, height)
    after = clearance_under_load_mm(design, settled, cameras_mm, motions)
    far = nearest_camera(markers, cameras_mm) == 1
    # A press in either half reduces the gap, and releasing it restores it.
    assert before[far].min() < 0.4
    assert before[~far].min() < 0.4
    assert after.min() >= 0.5 - 0.005


@pytest.mark.parametrize(("exponent", "row"), [(0.7, 25), (1.4, 3)])
def test_what_its_camera_cannot_see_is_refused(exponent: float, row: int) -> None:
    """Rows crowd towards the far end, then towards the near one."""
    with refused("receptors-always-hidden") as caught:
        case(layout={"height_far_mm": 8.0, "row_pitch_exponent": exponent})
    caught.match(f"row {row} are hidden.*raise layout.height_far_mm")
