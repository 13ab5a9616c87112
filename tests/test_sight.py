"""Line-of-sight heights: against the exact ID map, and the least that clears."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from phytac_design.layout import clearance_mm, make_markers, sight_heights_mm, with_heights
from phytac_design.layout.cameras import camera_of, tolerance_mm
from phytac_design.layout.dents import dent_motions
from phytac_design.layout.line_of_sight import clearance_under_load_mm, pressed_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.loaded_visibility import scene_state
from phytac_design.optics.render_scene import build_scene
from phytac_design.optics.visibility import check_visibility
from tests.designs import changed
from tests.refusals import refused

DENSE: dict[str, Any] = {
    "kind": "straight",
    "rows": 23,
    "columns": 8,
    "height_near_mm": 0.5,
    "height_far_mm": 20.0,
    "sight_margin_mm": 0.1,
}
BASE: dict[str, Any] = {
    "light": {"bar_radius_mm": 0.0},
    "camera": {"width_px": 1296, "height_px": 972, "focal_px": 485.0},
}


def case(**layout: Any) -> tuple[Any, Any, Any, Any]:
    design = changed(**BASE, layout=DENSE | layout)
    surface = design.surface()
    camera = camera_of(design, surface)
    return design, surface, make_markers(design, surface), camera


def test_no_receptor_hides_another() -> None:
    design, surface, markers, camera = case(heights="line-of-sight")
    seen = check_visibility(
        Sensor.of(design, surface, markers), rng=np.random.default_rng(0), camera=camera
    )
    # Where the band ends above the wall every pixel is seen; below, the wall takes a sliver.
    above = markers.height_mm > design.receptor.band_marker_mm
    assert above.sum() >= 8 * 8
    assert (seen.visible_fraction[above] == 1.0).all()
    assert seen.visible_fraction.min() > 0.95
    assert clearance_mm(design, markers, camera.position_mm).min() >= 0.1 - 1e-9
    # The same far height, grown linearly, hides some.
    top = float(markers.height_mm.max())
    plain = case(heights="linear", height_far_mm=top)
    hidden = check_visibility(
        Sensor.of(*plain[:3]), rng=np.random.default_rng(0), camera=camera
    ).visible_fraction
    assert hidden.min() < 0.9
    assert clearance_mm(plain[0], plain[2], camera.position_mm).min() < 0.0


def test_heights_are_the_least() -> None:
    design, surface, markers, camera = case(heights="line-of-sight")
    rows = markers.height_mm.reshape(23, 8)
    assert (np.ptp(rows, axis=1) == 0.0).all()
    assert rows[0, 0] == 0.5
    assert rows[-1, 0] > 1.0
    for row in np.flatnonzero(rows[:, 0] > 0.5):
        lower = markers.height_mm.copy()
        lower[markers.row == row] -= 0.05
        trial = with_heights(design, surface, markers, lower)
        mine = clearance_mm(design, trial, camera.position_mm)[markers.row == row]
        assert mine.min() < 0.1


def test_a_spiral_needs_less_than_a_straight_grid() -> None:
    straight = case(heights="line-of-sight", columns=16)[2].height_mm.max()
    spiral = case(heights="line-of-sight", kind="spiral", columns=16)[2].height_mm.max()
    assert spiral < straight


def test_gap_of_two_tubes_by_hand() -> None:
    """Two tubes one behind the other on a straight wall seen from its foot."""
    design, _, markers, _ = case()
    radius, camera = 1.5, np.array([0.0, 0.0, -30.0])
    foot = np.array([[30.0, 0.0, 10.0], [30.0, 0.0, 40.0]])
    inward = np.tile([-1.0, 0.0, 0.0], (2, 1))
    height = np.array([18.0, 12.0])
    two = replace(
        markers,
        base_mm=foot,
        tip_mm=foot + height[:, None] * inward,
        direction=inward,
        height_mm=height,
        row=np.arange(2),
        column=np.zeros(2, dtype=np.int64),
        lattice=None,
    )
    gap = clearance_mm(design, two, camera)
    # Lowest of the near tube's end face in the picture, highest of the far one's band; the disc's
    # near edge is at larger x / z for the first and its far edge at smaller x / z for the second.
    low = (30.0 - 18.0) / (40.0 + radius)
    high = (30.0 - 12.0 + 1.0) / (70.0 - radius)
    assert gap[0] == np.inf
    # The polygon around the circle is up to 1 % larger.
    assert gap[1] == pytest.approx((low - high) * 70.0, abs=0.05)
    hidden = clearance_mm(design, replace(two, height_mm=np.array([18.0, 2.0])), camera)
    assert hidden[1] < 0.0


def test_a_camera_beyond_the_far_end_mirrors() -> None:
    design, surface, markers, camera = case()
    near = sight_heights_mm(design, markers, camera.position_mm)
    back = np.array([0.0, 0.0, 120.0 - camera.position_mm[2]])
    far = sight_heights_mm(design, markers, back)
    assert far.reshape(23, 8)[::-1] == pytest.approx(near.reshape(23, 8), abs=1e-6)
    assert surface.name == "cylinder"


def test_markers_without_rows_are_cleared_one_by_one() -> None:
    design, _, markers, camera = case(
        heights="line-of-sight", kind="phyllotaxis", count=300, sight_margin_mm=1.5
    )
    assert clearance_mm(design, markers, camera.position_mm).min() >= 1.5 - 1e-9
    assert len(np.unique(markers.height_mm)) > 10


def test_what_cannot_be_cleared_is_refused() -> None:
    with refused("receptors-always-hidden") as caught:
        case(heights="line-of-sight", height_far_mm=1.0)
    caught.match("layout.height_far_mm")
    design, _, markers, _ = case()
    with refused("receptor-behind-camera") as caught:
        sight_heights_mm(design, markers, np.array([0.0, 0.0, 20.0]))
    caught.match("camera.stand_off_mm")


def dents(markers: Any) -> Any:
    """Bumps of the wall, 1.2 mm deep and about 8 mm wide, at three markers: motions (3, n, 6)."""
    motions = np.zeros((3, markers.count, 6))
    for motion, press in zip(motions, (60, 100, 160), strict=True):
        away = markers.mid_mm - markers.mid_mm[press]
        depth = 1.2 * np.exp(-np.sum(away**2, axis=1) / (2.0 * 8.0**2))
        motion[:, :3] = -depth[:, None] * markers.normal
        # The wall leans by the slope of the dent.
        slope = (depth / 8.0**2)[:, None] * away
        motion[:, 3:] = np.cross(slope, markers.normal)
    return motions


def test_heights_under_load_stay_clear_where_those_at_rest_do_not() -> None:
    design, surface, markers, camera = case(sight_margin_mm=0.2)
    camera_mm, motions = camera.position_mm, dents(markers)
    found = {}
    for name, given in (("rest", None), ("load", motions)):
        height = sight_heights_mm(design, markers, camera_mm, motions=given)
        settled = with_heights(design, surface, markers, height)
        found[name] = settled, clearance_under_load_mm(design, settled, camera_mm, motions)
    assert found["rest"][1].min() < 0.1
    assert found["load"][1].min() >= 0.2 - 0.005
    assert (found["load"][0].height_mm >= found["rest"][0].height_mm - 1e-9).all()
    assert (found["load"][0].height_mm > found["rest"][0].height_mm + 0.1).any()
    # By the exact ID map: whatever stands above the wall is seen whole in every press.
    settled = found["load"][0]
    scene = build_scene(
        Sensor.of(design, surface, settled), tolerance_mm=tolerance_mm(camera, settled)
    )
    above = settled.height_mm > design.receptor.band_marker_mm
    for motion in motions:
        moved = scene.moved(motion[:, :3], motion[:, 3:], settled.mid_mm)
        assert scene_state(moved, camera).fraction[above].min() > 0.99


def test_a_stated_dent_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """By dents elsewhere than those the heights were made for, of the same depth."""
    few = partial(dent_motions, dents=16)
    monkeypatch.setattr("phytac_design.layout.marker_layout.dent_motions", few)
    plain = case(heights="line-of-sight", sight_margin_mm=0.2)
    design, surface, markers, camera = case(
        heights="line-of-sight",
        sight_margin_mm=0.2,
        sight_dent_mm=0.5,
        sight_dent_radius_mm=16.0,
    )
    camera_mm = camera.position_mm
    assert dent_motions(plain[0], surface, plain[2]) is None
    own = few(design, surface, markers)
    assert own is not None
    assert clearance_under_load_mm(design, markers, camera_mm, own).min() >= 0.2 - 0.005
    depth = -np.einsum("pni,ni->pn", own[:, :, :3], markers.normal)
    assert depth.max() == pytest.approx(0.5)
    others = dents(markers) * (0.5 / 1.2)
    before = clearance_under_load_mm(design, plain[2], camera_mm, others).min()
    assert before < 0.12
    assert clearance_under_load_mm(design, markers, camera_mm, others).min() > 0.15


def test_a_dent_leans_the_wall_by_its_slope() -> None:
    """The rotation is that of the normal between two points of the dented wall."""
    design, surface, markers, _ = case(sight_dent_mm=0.5, sight_dent_radius_mm=60.0, columns=24)
    motions = dent_motions(design, surface, markers)
    assert motions is not None
    moved = markers.mid_mm + motions[0, :, :3]
    # Along the axis, where the wall itself is straight.
    columns = moved.reshape(23, 24, 3)
    rise = columns[2:] - columns[:-2]
    normal = markers.normal.reshape(23, 24, 3)[1:-1]
    turned = normal + np.cross(motions[0, :, 3:].reshape(23, 24, 3)[1:-1], normal)
    lean = np.sum(turned * rise, axis=2) / np.linalg.norm(rise, axis=2)
    plain = np.sum(normal * rise, axis=2) / np.linalg.norm(rise, axis=2)
    assert np.abs(plain).max() > 0.005
    assert np.abs(lean).max() < 0.1 * np.abs(plain).max()


def test_pressed_markers_move_like_the_scene() -> None:
    design, surface, markers, camera = case(kind="spiral")
    motion = dents(markers)[0]
    moved = pressed_markers(markers, motion)
    assert np.abs(moved.tip_mm - markers.tip_mm).max() > 1.0
    scene = build_scene(
        Sensor.of(design, surface, markers), tolerance_mm=tolerance_mm(camera, markers)
    )
    after = scene.moved(motion[:, :3], motion[:, 3:], markers.mid_mm)
    own = scene.vertex_owner == 60
    # The red tip's end is a point of the axis, the last ring of the receptor.
    shift = (after.vertices - scene.vertices)[own][-1]
    assert (moved.tip_mm - markers.tip_mm)[60] == pytest.approx(shift, abs=0.02)


def test_what_no_height_keeps_clear_under_load_is_refused() -> None:
    design, _, markers, camera = case(height_far_mm=12.0)
    motions = dents(markers)
    motions[:, :, :3] *= 6.0
    with refused("receptors-always-hidden"):
        sight_heights_mm(design, markers, camera.position_mm, motions=motions)


def test_clearance_under_load_is_the_least_of_all_motions() -> None:
    design, surface, _, camera = case(sight_margin_mm=0.2)
    markers = make_markers(design, surface)
    # One receptor alone, into the line of sight of those behind it, which stand still.
    alone = np.zeros((1, markers.count, 6))
    alone[0, 80, :3] = 3.0 * markers.direction[80]
    motions = np.concatenate([dents(markers), alone])
    found = clearance_under_load_mm(design, markers, camera.position_mm, motions)
    rest = clearance_mm(design, markers, camera.position_mm)
    plain = rest
    for motion in motions:
        now = pressed_markers(markers, motion)
        plain = np.minimum(plain, clearance_mm(design, now, camera.position_mm))
    behind = (
        clearance_mm(design, pressed_markers(markers, alone[0]), camera.position_mm) < rest - 1.0
    )
    assert behind[81:].any()
    assert (found[behind] < rest[behind] - 1.0).all()
    known = np.isfinite(plain) & np.isfinite(found)
    assert known.sum() > 100
    assert np.abs(found[known] - plain[known]).max() < 0.06
    assert (np.minimum(plain, found)[~known] > 1.0).all()
