"""The lattice of the published sensor, and its neighbours."""

import numpy as np
import pytest

from phytac_design.design_file import load_design
from phytac_design.layout import NEIGHBOUR_STEPS, make_markers
from tests.designs import changed, small


def test_cylinder60_is_the_published_sensor() -> None:
    design = load_design("cylinder60")
    surface = design.surface()
    markers = make_markers(design, surface)
    assert markers.count == 368
    assert markers.count / (surface.area_mm2() / 100) == pytest.approx(1.63, abs=0.01)
    heights = markers.height_mm.reshape(23, 16)
    assert np.allclose(heights[:, 0], np.arange(0.5, 11.6, 0.5))
    assert (heights == heights[:, :1]).all()
    # Blue and green by column: two interleaved spirals, not rings.
    colours = markers.colour.reshape(23, 16)
    assert (colours == np.arange(16) % 2).all()


def test_spiral_angle_is_measured_from_the_axis() -> None:
    design = load_design("cylinder60")
    surface = design.surface()
    markers = make_markers(design, surface)
    first = markers.uv.reshape(23, 16, 2)[:, 0]
    around = np.diff(np.unwrap(first[:, 1])) * 30.0
    along = np.diff(first[:, 0])
    assert np.degrees(np.arctan2(around, along)) == pytest.approx(50.5)


def test_straight_lines_rows_up() -> None:
    design = changed(layout={"kind": "straight"})
    markers = make_markers(design, design.surface())
    angle = markers.uv.reshape(23, 16, 2)[:, :, 1]
    assert np.allclose(angle, angle[:1])


def test_points_stand_on_the_wall() -> None:
    design = small()
    markers = make_markers(design, design.surface())
    radius = np.linalg.norm(markers.foot_mm[:, :2], axis=1)
    assert np.allclose(radius, 30.0 - 0.8)
    assert np.allclose(
        markers.foot_mm - markers.tip_mm, markers.height_mm[:, None] * markers.normal
    )
    assert np.allclose(markers.mid_mm - markers.foot_mm, 0.4 * markers.normal)


@pytest.mark.parametrize("kind", ["spiral", "straight"])
def test_neighbours_surround(kind: str) -> None:
    design = changed(layout={"kind": kind})
    markers = make_markers(design, design.surface())
    near = markers.neighbours
    inner = (markers.row > 0) & (markers.row < 22)
    assert (near[inner] >= 0).all()
    assert (near[markers.row == 0][:, :3] == -1).all()
    assert (near[markers.row == 22][:, 5:] == -1).all()
    for slot, (row, _) in enumerate(NEIGHBOUR_STEPS):
        known = near[:, slot] >= 0
        assert (markers.row[near[known, slot]] - markers.row[known] == row).all()
    # The middle neighbour of the next row is the nearest of that row, around the seam too.
    for slot in (1, 6):
        ids = np.flatnonzero(near[:, slot] >= 0)
        gap = markers.uv[near[ids, slot], 1] - markers.uv[ids, 1]
        gap = np.abs(np.mod(gap + np.pi, 2 * np.pi) - np.pi)
        assert gap.max() <= markers.lattice.pitch_v / 2 + 1e-12
    # Side neighbours are mutual.
    left, right = near[:, 3], near[:, 4]
    assert (right[left] == np.arange(markers.count)).all()


def test_one_marker_has_no_neighbours() -> None:
    design = small(layout={"rows": 1, "columns": 1})
    assert (make_markers(design, design.surface()).neighbours == -1).all()
