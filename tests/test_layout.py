"""The lattice of the published sensor, its neighbours, its heights and where receptors point."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_design.design.design_file import load_design
from phytac_design.design.spec import SHAPE_MODELS
from phytac_design.layout import NEIGHBOUR_STEPS, make_lattice, make_markers
from phytac_design.layout.scattered import sector_neighbours
from tests.designs import changed, small
from tests.refusals import refused


def test_cylinder60_is_the_published_sensor() -> None:
    design = load_design("cylinder60")
    surface = design.surface()
    markers = make_markers(design, surface)
    assert markers.count == 368
    assert markers.count / (surface.area_mm2() / 100) == pytest.approx(1.63, abs=0.01)
    heights = markers.height_mm.reshape(23, 16)
    assert np.allclose(heights[:, 0], np.arange(0.5, 11.6, 0.5))
    assert np.allclose(heights, heights[:, :1])
    # Blue and green by column: two interleaved spirals, not rings.
    colours = markers.colour.reshape(23, 16)
    assert (colours == np.arange(16) % 2).all()


@pytest.mark.parametrize(("measured_from", "angle"), [("axis", 50.5), ("circumference", 39.5)])
def test_spiral_angle_is_measured_from_where_it_says(measured_from: str, angle: float) -> None:
    design = changed(layout={"spiral_from": measured_from})
    markers = make_markers(design, design.surface())
    first = markers.uv.reshape(23, 16, 2)[:, 0]
    around = np.diff(np.unwrap(first[:, 1])) * 30.0
    along = np.diff(first[:, 0])
    assert np.degrees(np.arctan2(around, along)) == pytest.approx(angle)


def test_a_spiral_along_the_circumference_is_refused() -> None:
    design = changed(layout={"spiral_from": "circumference", "spiral_angle_deg": 0.5})
    with refused("spiral-angle-too-small"):
        make_markers(design, design.surface())


def test_straight_lines_rows_up() -> None:
    design = changed(layout={"kind": "straight"})
    markers = make_markers(design, design.surface())
    angle = markers.uv.reshape(23, 16, 2)[:, :, 1]
    assert np.allclose(angle, angle[:1])


def test_checkerboard_moves_on_by_one_colour_a_row() -> None:
    colours = ["blue", "green", "yellow"]
    design = changed(
        layout={"kind": "straight", "colour_pattern": "checkerboard", "colours": colours}
    )
    colour = make_markers(design, design.surface()).colour.reshape(23, 16)
    assert (colour[1:] == (colour[:-1] + 1) % 3).all()
    assert (colour[0] == np.arange(16) % 3).all()


def test_points_stand_on_the_wall() -> None:
    design = small()
    markers = make_markers(design, design.surface())
    radius = np.linalg.norm(markers.base_mm[:, :2], axis=1)
    assert np.allclose(radius, 30.0 - 0.8)
    assert np.allclose(
        markers.base_mm - markers.tip_mm, markers.height_mm[:, None] * markers.normal
    )
    assert np.allclose(markers.mid_mm - markers.base_mm, 0.4 * markers.normal)
    assert np.allclose(markers.direction, -markers.normal)


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
    assert markers.lattice is not None
    for slot in (1, 6):
        ids = np.flatnonzero(near[:, slot] >= 0)
        gap = markers.uv[near[ids, slot], 1] - markers.uv[ids, 1]
        gap = np.abs(np.mod(gap + np.pi, 2 * np.pi) - np.pi)
        assert gap.max() <= markers.lattice.pitch_v / 2 + 1e-12
    # Side neighbours are mutual.
    left, right = near[:, 3], near[:, 4]
    assert (right[left] == np.arange(markers.count)).all()


def test_sectors_find_the_neighbours_of_a_square_grid() -> None:
    """Rows 5.22 mm apart, columns made as far apart: both ways to neighbours must agree."""
    design = changed(layout={"kind": "straight", "columns": 36})
    surface = design.surface()
    markers = make_markers(design, surface)
    found = sector_neighbours(surface, markers.uv, markers.normal)
    assert (found == markers.neighbours).all()


def test_one_marker_has_no_neighbours() -> None:
    design = small(layout={"rows": 1, "columns": 1})
    assert (make_markers(design, design.surface()).neighbours == -1).all()


@pytest.mark.parametrize("exponent", [0.7, 1.0, 1.2])
def test_rows_widen_by_the_exponent(exponent: float) -> None:
    design = changed(layout={"row_pitch_exponent": exponent})
    u = make_lattice(design, design.surface()).rows_u
    # Half a uniform pitch stays free at both ends.
    assert u[0] == pytest.approx(60.0 / 23)
    assert u[-1] == pytest.approx(120.0 - 60.0 / 23)
    k = np.arange(1, 23)
    slope = np.polyfit(np.log(k), np.log(u[1:] - u[0]), 1)[0]
    assert slope == pytest.approx(exponent, abs=1e-9)


def test_heights_follow_their_profile() -> None:
    def heights(**layout: object) -> np.ndarray:
        design = changed(layout=layout)
        markers = make_markers(design, design.surface())
        return markers.height_mm[markers.column == 0]

    k = np.arange(23) / 22
    assert heights(heights="constant") == pytest.approx(0.5)
    assert heights(heights="power", height_exponent=3.0) == pytest.approx(0.5 + 11.0 * k**3)
    # Linear in the distance along the surface, not in the row's number.
    assert heights(row_pitch_exponent=1.3) == pytest.approx(0.5 + 11.0 * k**1.3)


def test_receptors_point_where_the_design_says() -> None:
    cone = {"kind": "cone", "diameter_near_mm": 60.0, "diameter_far_mm": 40.0, "length_mm": 80.0}
    base = small(layout={"height_far_mm": 4.0}).model_dump(mode="json")

    def made(**receptor: object) -> object:
        design = changed(**{**base, "receptor": {**base["receptor"], **receptor}})
        data = design.model_copy(update={"shape": _shape(cone)})
        return make_markers(data, data.surface())

    axis, plain, tilted = (
        made(direction="axis"),
        made(),
        made(direction="tilted", tilt_deg=10.0),
    )
    assert np.allclose(axis.direction[:, 2], 0.0)
    out = axis.base_mm[:, :2] / np.linalg.norm(axis.base_mm[:, :2], axis=1, keepdims=True)
    assert np.allclose(axis.direction[:, :2], -out)
    lean = np.degrees(np.arccos(-np.sum(tilted.direction * tilted.normal, axis=1)))
    assert lean == pytest.approx(10.0)
    # Towards the near end, where the camera is.
    assert (tilted.tip_mm[:, 2] < plain.tip_mm[:, 2]).all()
    for markers in (axis, plain, tilted):
        assert np.allclose(
            markers.tip_mm - markers.base_mm, markers.height_mm[:, None] * markers.direction
        )
        # The axis passes through the mesh node and meets the inner face (a cone is straight).
        arm = markers.base_mm - markers.mid_mm
        assert np.allclose(np.cross(arm, markers.direction), 0.0, atol=1e-12)
        assert np.sum(arm * markers.normal, axis=1) == pytest.approx(-0.4)


def _shape(shape: dict) -> object:
    return SHAPE_MODELS[shape["kind"]].model_validate(shape)


def test_names_in_messages() -> None:
    design = small()
    markers = make_markers(design, design.surface())
    assert markers.name(15) == "(row 1, column 1)"
    assert markers.place(15) == "row 1"
    loose = replace(markers, lattice=None, row=np.arange(markers.count))
    assert loose.name(15) == "number 15"
    assert loose.place(15) == "marker 15"
