"""Line-of-sight heights: against the exact ID map, and the least that clears."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_design.layout import clearance_mm, make_markers, sight_heights_mm, with_heights
from phytac_design.optics.view import camera_of
from phytac_design.optics.visibility import check_visibility
from shapes.errors import DesignError
from tests.designs import changed

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
    seen = check_visibility(design, surface, markers, rng=np.random.default_rng(0), camera=camera)
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
        *plain[:3], rng=np.random.default_rng(0), camera=camera
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
        foot_mm=foot,
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
    with pytest.raises(DesignError, match=r"row \d+ are hidden.*raise layout.height_far_mm"):
        case(heights="line-of-sight", height_far_mm=1.0)
    design, _, markers, _ = case()
    with pytest.raises(DesignError, match=r"in front of the camera.*raise camera.stand_off_mm"):
        sight_heights_mm(design, markers, np.array([0.0, 0.0, 20.0]))
