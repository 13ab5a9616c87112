"""Layouts on every shape: what holds on all of them, and what is special to each kind."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from phytac_design.design.design_file import load_design, parse_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.arc import area_elements, by_area
from phytac_design.layout.heights_along import along_mm, length_mm, middle_mm
from phytac_design.layout.region_chart import chart_of
from phytac_design.rules.check import check_design
from phytac_shapes import REGISTRY, Surface
from phytac_shapes.errors import DesignError
from tests.refusals import refused

SHAPES: dict[str, dict[str, Any]] = {
    "cylinder": {"diameter_outer_mm": 60.0, "length_mm": 120.0},
    "cone": {"diameter_near_mm": 60.0, "diameter_far_mm": 36.0, "length_mm": 90.0},
    "plane": {"width_mm": 80.0, "height_mm": 60.0, "tilt_deg": 20.0},
    "cuboid": {"width_mm": 50.0, "depth_mm": 40.0, "length_mm": 90.0, "edge_radius_mm": 8.0},
    "hemisphere": {"diameter_outer_mm": 40.0, "skirt_mm": 10.0},
    "grip": {"diameters_mm": [42.0, 46.0, 43.0, 47.0, 50.0], "length_mm": 110.0},
    "patch": {
        "points_mm": [
            [[x, y, -0.004 * (x * x + y * y)] for x in (-35.0, -10.0, 12.0, 35.0)]
            for y in (-30.0, -10.0, 10.0, 30.0)
        ]
    },
}
KINDS = ("spiral", "straight", "phyllotaxis")
SHEETS = {"plane", "patch"}


def designed(shape: str, kind: str, *, shape_more: Any = None, **layout: Any) -> Design:
    table = {"kind": shape, **SHAPES[shape], **(shape_more or {})}
    base = {"kind": kind, "rows": 9, "columns": 12, "count": 90, "height_far_mm": 3.0}
    data = {"name": "case", "shape": table, "layout": base | layout, "light": {"bar_radius_mm": 0}}
    return parse_design(data, "case")


def made(shape: str, kind: str, **layout: Any) -> tuple[Design, Surface, Markers]:
    design = designed(shape, kind, **layout)
    surface = design.surface()
    return design, surface, make_markers(design, surface)


def test_every_shape_is_tried() -> None:
    assert set(SHAPES) == set(REGISTRY)
    assert {load_design(name).shape.kind for name in shipped_designs()} == set(REGISTRY)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_markers_of_every_shape(shape: str, kind: str) -> None:
    if kind == "spiral" and shape in SHEETS:
        with refused("spiral-on-open-surface"):
            made(shape, kind)
        return
    design, surface, markers = made(shape, kind)
    low, high = surface.domain.T
    assert ((markers.uv >= low) & (markers.uv <= high)).all()
    wall = design.wall.thickness_mm
    assert np.allclose(markers.base_mm, surface.point(markers.uv, -wall))
    assert np.allclose(markers.tip_mm, surface.point(markers.uv, -wall - markers.height_mm))
    # Near first, heights from near to far.
    assert (np.diff(markers.uv[:, 0]) > -1e-9).all()
    assert (np.diff(markers.height_mm) > -1e-9).all()
    assert markers.height_mm.min() >= 0.5
    assert markers.height_mm.max() <= 3.0
    if kind != "phyllotaxis":
        ends = markers.height_mm[[0, -1]]
        assert ends == pytest.approx([0.5, 3.0])
    # Spread: no two much nearer than on a square grid of the same density, both colours used.
    points = surface.point(markers.uv)
    nearest = cKDTree(points).query(points, k=2)[0][:, 1]
    square = np.sqrt(surface.area_mm2() / markers.count)
    assert nearest.min() > 0.55 * square
    share = np.bincount(markers.colour) / markers.count
    assert share == pytest.approx([0.5, 0.5], abs=0.06)
    near = markers.neighbours
    assert ((near >= -1) & (near < markers.count)).all()
    assert (near != np.arange(markers.count)[:, None]).all()
    known = (near >= 0).sum(axis=1)
    assert known.min() >= 3
    # Most have their eight; at the rims of so small lattices many cannot.
    assert known.mean() >= 6.5
    full = markers.lattice is not None
    assert full == (kind != "phyllotaxis" and not any(surface.poles))


@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_places_by_area_are_uniform(shape: str) -> None:
    """Shares of equal boxes hold equal areas, counted on the surface's own area elements."""
    surface = designed(shape, "straight").surface()
    rng = np.random.default_rng(5)
    uv = by_area(surface, rng.random((40_000, 2)))
    (u0, u1), (v0, v1) = surface.domain
    cells = 8
    edges = np.linspace(u0, u1, cells + 1), np.linspace(v0, v1, cells + 1)
    count = np.histogram2d(uv[:, 0], uv[:, 1], bins=edges)[0]
    fine = 60
    u = u0 + (u1 - u0) * (np.arange(cells * fine) + 0.5) / (cells * fine)
    v = v0 + (v1 - v0) * (np.arange(cells * fine) + 0.5) / (cells * fine)
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    metric = surface.metric(grid)
    det = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    area = np.sqrt(np.maximum(det, 0.0)).reshape(cells, fine, cells, fine).sum(axis=(1, 3))
    expected = 40_000 * area / area.sum()
    # χ² of 63 degrees of freedom: 130 is beyond one in a million.
    assert float(((count - expected) ** 2 / expected).sum()) < 130.0


def test_phyllotaxis_turns_by_the_golden_angle_from_the_pole() -> None:
    _, surface, markers = made("hemisphere", "phyllotaxis", shape_more={"skirt_mm": 0.0}, count=60)
    v = markers.uv[::-1, 1]
    turn = np.mod(np.diff(v), 2.0 * np.pi)
    assert turn == pytest.approx(np.pi * (3.0 - np.sqrt(5.0)), abs=1e-6)
    # Equal areas from the pole on a sphere are equal steps of height.
    z = surface.point(markers.uv)[::-1, 2]
    step = np.diff(z)
    assert step == pytest.approx(step.mean(), rel=2e-3)
    # The first sits half a step below the pole.
    assert 20.0 - z[0] == pytest.approx(-0.5 * step.mean(), rel=2e-3)


def test_near_markers_differ_in_colour_where_they_can() -> None:
    for colours in (["blue", "green"], ["blue", "green", "yellow", "magenta"]):
        _, surface, markers = made("plane", "phyllotaxis", colours=colours)
        points = surface.point(markers.uv)
        nearest = cKDTree(points).query(points, k=2)[0][:, 1].min()
        for colour in range(len(colours)):
            own = points[markers.colour == colour]
            apart = cKDTree(own).query(own, k=2)[0][:, 1].min()
            # Two colours cannot do on a triangular lattice; four put same colours well apart.
            assert apart > (1.0 if len(colours) == 2 else 1.5) * nearest


def test_rows_hold_fewer_towards_a_pole() -> None:
    design, surface, markers = made("hemisphere", "straight", rows=8, columns=12)
    held = np.bincount(markers.row)
    assert held[0] == 12
    assert (np.diff(held) <= 0).all()
    assert (held % 2 == 0).all()
    last = surface.point(markers.uv)[markers.row == 7]
    assert held[-1] < 6
    around = 2.0 * np.pi * np.hypot(*last[:, :2].T).mean()
    assert around / held[-1] > 0.6 * np.pi * design.shape.diameter_outer_mm / 12


def test_columns_of_a_sheet_keep_half_a_pitch_from_its_sides() -> None:
    _, _, markers = made("plane", "straight", rows=6, columns=8)
    v = markers.uv.reshape(6, 8, 2)[:, :, 1]
    assert v[0] == pytest.approx(-40.0 + 10.0 * (np.arange(8) + 0.5))
    assert (v == v[0]).all()


def test_only_sensing_faces_carry_markers() -> None:
    _, surface, markers = made("cuboid", "straight", shape_more={"faces": ["+x"]})
    assert 0 < markers.count < 9 * 12 / 2
    assert markers.lattice is None
    assert surface.sensing(markers.uv).all()
    assert (markers.normal[:, 0] > 0.7).all()
    # Rows and columns keep their numbers of the whole lattice.
    assert set(markers.row) == set(range(9))
    assert markers.name(0).startswith("(row 0, column ")


def test_nothing_left_is_refused() -> None:
    with refused("no-markers"):
        made("cuboid", "explicit", shape_more={"faces": ["+x"]}, positions=[[45.0, 90.0]])


@pytest.mark.parametrize("name", shipped_designs())
def test_shipped_designs_pass_the_rules(name: str) -> None:
    design = load_design(name)
    markers = check_design(design).markers
    assert 80 <= markers.count <= 744


def csv(tmp_path: Path, text: str, **layout: Any) -> Design:
    (tmp_path / "points.csv").write_text(text, encoding="utf-8")
    data = {
        "name": "mine",
        "shape": {"kind": "plane", "width_mm": 80.0, "height_mm": 60.0},
        "layout": {"kind": "explicit", "positions_csv": "points.csv", **layout},
        "light": {"bar_radius_mm": 0.0},
    }
    return Design.model_validate(data, context={"folder": tmp_path})


def test_positions_from_a_file(tmp_path: Path) -> None:
    text = "# mine\nx_mm,y_mm,z_mm,colour,height_mm\n0,10,0,green,2\n\n5, -12, 0, blue, 3\n"
    design = csv(tmp_path, text)
    markers = make_markers(design, design.surface())
    # Ordered along u, which runs along y here.
    assert np.allclose(markers.uv, [[-12.0, 5.0], [10.0, 0.0]])
    assert markers.height_mm.tolist() == [3.0, 2.0]
    assert markers.colour.tolist() == [0, 1]
    # The design holds the positions themselves: a resolved file needs no CSV, its hash sees them.
    again = parse_design(design.model_dump(mode="json"), "resolved")
    assert again == design
    moved = csv(tmp_path, text.replace("10", "11"))
    assert moved != design


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("u,v\n1,2\n3,x\n", r"points.csv, line 3: v must be a number \(got 'x'\)"),
        ("u,v\n1,2\n\n3\n", r"line 4: 2 cells are needed \(u,v\), got 1"),
        ("u,w\n1,2\n", r"line 1: columns must be u,v or x_mm,y_mm,z_mm.*got u,w"),
        ("u,v,height_mm\n1,2,-1\n", r"line 2: height_mm must be a height above 0 \(got '-1'\)"),
        ("u,v\n1,nan\n", r"line 2: v must be a number \(got 'nan'\)"),
        ("u,v\n", r"has 0 positions"),
        ("", r"has no positions"),
        ("u,v,colour\n1,2,pink\n", r"position_colours"),
        ("u,v,colour\n1,2,cyan\n", r"position_colours cyan must be among colours"),
        ("u,v\n0,99\n", r"position 1 lies off the surface"),
        ("x_mm,y_mm,z_mm\n0,0,7\n", r"position 1 lies 7.00 mm from the outer face"),
    ],
)
def test_bad_positions_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises((DesignError, ValueError), match=message):
        check_design(csv(tmp_path, text))


def test_positions_that_are_no_file_or_not_wanted(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_bytes(b"\xff\xfe\x00")
    with refused("positions-file-invalid"):
        Design.model_validate(
            {
                "name": "a",
                "shape": {"kind": "plane", "width_mm": 80.0, "height_mm": 60.0},
                "layout": {"kind": "explicit", "positions_csv": "points.csv"},
            },
            context={"folder": tmp_path},
        )
    with refused("positions-file-unreadable"):
        designed("plane", "explicit", positions_csv="missing.csv")
    with refused("field-invalid") as caught:
        designed("plane", "straight", positions=[[0.0, 0.0]])
    caught.match("explicit")
    with refused("field-invalid") as caught:
        designed("plane", "explicit")
    caught.match("positions")
    with refused("field-invalid") as caught:
        designed("plane", "explicit", positions=[[0.0, 0.0], [0.0, 0.0, 1.0]])
    caught.match(r"\(u, v\)")


def test_a_marker_may_sit_on_the_pole() -> None:
    pole = 10.0 + 20.0 * np.pi / 2.0
    positions = [[pole, 0.0], *([25.0, float(v)] for v in range(6))]
    design = designed("hemisphere", "explicit", positions=positions)
    sensor = check_design(design)
    markers = sensor.markers
    assert np.allclose(sensor.surface.point(markers.uv)[-1], [0.0, 0.0, 30.0])
    assert np.allclose(markers.direction[-1], [0.0, 0.0, -1.0])
    # All six around it are its neighbours, each in a sector of its own.
    assert set(markers.neighbours[-1]) == {-1, 0, 1, 2, 3, 4, 5}


def test_the_area_of_an_oblique_chart_is_that_of_its_parallelogram() -> None:
    # The lines of the chart meet at 51 degrees: its metric has a term off the diagonal.
    points = [[[x + 0.8 * y, y, 0.0] for x in (0.0, 20.0, 40.0, 60.0)] for y in (0.0, 15.0, 30.0)]
    surface = designed("patch", "straight", shape_more={"points_mm": points}).surface()
    u, v = (np.linspace(low, high, 9)[:-1] + (high - low) / 16.0 for low, high in surface.domain)
    cell = np.prod(np.ptp(surface.domain, axis=1)) / 64.0
    assert area_elements(surface, u, v).sum() * cell == pytest.approx(60.0 * 30.0, rel=1e-9)


def test_heights_and_shares_of_a_sheet_count_from_its_near_edge() -> None:
    # The chart of a sheet begins at minus half of its size, which differs between its axes.
    _, surface, markers = made("plane", "straight")
    up, across = markers.uv.T
    assert length_mm(surface) == pytest.approx(60.0)
    assert middle_mm(surface) == pytest.approx((0.125 * 60.0, 0.792 * 60.0))
    assert along_mm(surface, markers.uv) == pytest.approx(up + 30.0)
    chart = chart_of(surface, markers)
    assert not chart.closed
    assert chart.along == pytest.approx((up + 30.0) / 60.0)
    assert chart.around == pytest.approx((across + 40.0) / 80.0)
