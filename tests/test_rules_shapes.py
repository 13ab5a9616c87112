"""Rules on every shape: spacing by the place, edges by real distance, one marker, ten thousand."""

import re
import time
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_design.geometry.boundary_loops import edge_distance_mm
from phytac_design.layout import make_markers
from phytac_design.layout.receptor_distances import smallest_receptor_gap_mm
from phytac_design.rules.check import check_design
from phytac_design.solids.receptor_tubes import receptor_axes
from phytac_shapes.errors import DesignError
from tests.test_layout_shapes import SHAPES, designed

BOX: dict[str, Any] = {"width_mm": 50.0, "depth_mm": 50.0, "length_mm": 90.0, "edge_radius_mm": 4.0}


def of(kind: str, layout: dict[str, Any], **tables: Any) -> Design:
    table = {"kind": kind, **(tables.pop("shape", None) or SHAPES[kind])}
    data = {"name": "case", "shape": table, "layout": layout, "light": {"bar_radius_mm": 0.0}}
    return parse_design(data | tables, "case")


REFUSALS: dict[str, tuple[Design, str]] = {
    "wall of a box": (
        of("cuboid", {"kind": "straight", "rows": 4, "columns": 4}, wall={"thickness_mm": 9.0}),
        (
            r"wall is thicker than the cuboid allows \(thickness 9 mm ≥ edge_radius_mm 8 mm\); "
            r"lower wall.thickness_mm below 8 or raise shape.edge_radius_mm"
        ),
    ),
    "tips under an edge of the box": (
        of(
            "cuboid",
            {"kind": "explicit", "positions": [[45.0, 23.0]], "heights": "constant"}
            | {"height_near_mm": 3.3},
            shape=BOX,
        ),
        (
            r"tips of marker 0 collide where the wall's normals meet \(height 3.3 mm ≥ depth there "
            r"3.2 mm\); lower layout.height_near_mm to 3.1"
        ),
    ),
    "side of a sheet": (
        of("plane", {"kind": "straight", "rows": 6, "columns": 18}),
        (
            r"lies 2.22 mm from the side of the surface, less than the radius of its switch "
            r"footprint \(2.30 mm\): it cuts the rim; lower layout.columns or switch.footprint"
        ),
    ),
    "end of a dome": (
        of("hemisphere", {"kind": "explicit", "positions": [[1.0, 0.0]], "height_far_mm": 2.0}),
        r"receptor number 0 lies 1.00 mm from the end.*move it inward or lower receptor.diameter",
    ),
    "coincident": (
        of("patch", {"kind": "explicit", "positions": [[1.0, 1.0], [1.5, 1.5], [1.0, 1.0]]}),
        r"number 0 and number 1 meet: they overlap by 3.00 mm.*move layout.positions apart or low",
    ),
    "too many by the golden angle": (
        of("hemisphere", {"kind": "phyllotaxis", "count": 400, "height_far_mm": 2.0}),
        r"meet: they overlap by .*lower layout.count or receptor.diameter_outer_mm",
    ),
    "lean": (
        of(
            "cylinder",
            {"rows": 4, "columns": 8},
            receptor={"direction": "tilted", "tilt_deg": 20.0},
        ),
        r"does not fit the curved wall.*lower the lean of the receptors",
    ),
    "towards the axis on a sheet": (
        of("plane", {"kind": "straight"}, receptor={"direction": "axis"}),
        r"towards the axis would lie in the wall of the plane.*set receptor.direction to 'normal'",
    ),
    "patch larger than a sheet": (
        of(
            "plane",
            {"kind": "straight", "rows": 2, "columns": 2},
            shape={"width_mm": 80.0, "height_mm": 12.0},
        ),
        r"contact patches are larger than the sensor \(radius 7 mm > 6 mm\)",
    ),
    "a bar in a dome": (
        of(
            "hemisphere",
            {"kind": "phyllotaxis", "count": 60, "height_far_mm": 2.0},
            light={"bar_radius_mm": 3.0},
        ),
        r"receptor tips of marker \d+ reach the light bar.*lower light.bar_radius_mm",
    ),
}


@pytest.mark.parametrize("name", sorted(REFUSALS))
def test_refusals_on_shapes(name: str) -> None:
    design, text = REFUSALS[name]
    with pytest.raises(DesignError) as caught:
        check_design(design)
    assert re.search(text, str(caught.value)), str(caught.value)


def test_edges_of_a_box_do_not_limit_its_faces() -> None:
    tall = {"kind": "explicit", "positions": [[45.0, 0.0]], "heights": "constant"}
    check_design(of("cuboid", {**tall, "height_near_mm": 20.0}, shape=BOX))


@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_one_marker_passes(shape: str) -> None:
    kind = "phyllotaxis" if shape == "hemisphere" else "straight"
    design = designed(shape, kind, rows=1, columns=1, count=1)
    markers = check_design(design).markers
    assert markers.count == 1
    assert smallest_receptor_gap_mm(design, markers) == (np.inf, None)


def test_distance_to_an_edge_is_in_space() -> None:
    """On a dome the rim is nearer through space than along the meridian: a chord."""
    design = designed("hemisphere", "straight", shape_more={"skirt_mm": 0.0})
    surface = design.surface()
    uv = np.array([[12.0, 1.0], [5.0, 4.0], [0.0, 0.3]])
    chord = 40.0 * np.sin(uv[:, 0] / 20.0 / 2.0)
    found = [edge_distance_mm(surface, uv[k : k + 1], 0, 0)[0] for k in range(3)]
    assert found == pytest.approx(chord, abs=1e-9)
    near = edge_distance_mm(surface, uv, 0, 0, within_mm=float(chord[1]))
    assert near[1:] == pytest.approx(chord[1:], abs=1e-9)
    assert found[0] + 1e-4 < near[0] == pytest.approx(chord[0], abs=1e-3)
    # A corner of a patch: the nearest point is the edge's own end.
    sheet = designed("plane", "straight").surface()
    assert edge_distance_mm(sheet, np.array([[30.0, 40.0]]), 1, 1)[0] == pytest.approx(0.0)
    assert edge_distance_mm(sheet, np.array([[10.0, 33.0]]), 1, 1)[0] == pytest.approx(7.0)


def test_leaning_tubes_root_inside_the_wall() -> None:
    design = of(
        "cone",
        {"rows": 8, "columns": 10, "height_far_mm": 5.0},
        receptor={"direction": "tilted", "tilt_deg": 8.0, "diameter_outer_mm": 2.6},
    )
    sensor = check_design(design)
    surface, markers = sensor.surface, sensor.markers
    axes = receptor_axes(sensor)
    along = axes.tip_mm - axes.root_mm
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    assert np.allclose(along, markers.direction)
    # The whole root disc lies between the faces of the wall.
    across = np.cross(along, markers.normal)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    for turn in np.linspace(0.0, 2.0 * np.pi, 16):
        ring = np.cos(turn) * across + np.sin(turn) * np.cross(along, across)
        point = axes.root_mm + 1.3 * ring
        foot = surface.chart(point)
        depth = -np.sum((point - surface.point(foot)) * surface.normal(foot), axis=1)
        assert (depth > 0.0).all()
        assert (depth < 0.8).all()
    # The cutter goes through the node on the middle face.
    start, end = axes.hole_start_mm, axes.hole_end_mm
    arm = np.cross(markers.mid_mm - start, end - start)
    assert np.allclose(arm, 0.0, atol=1e-9)


@pytest.mark.parametrize("shape", ["hemisphere", "plane", "cuboid"])
def test_ten_thousand_receptors_by_the_golden_angle(shape: str) -> None:
    """Not a benchmark: all pairs would be 5e7 distances and far beyond this bound."""
    sizes = {
        "hemisphere": {"diameter_outer_mm": 400.0},
        "plane": {"width_mm": 640.0, "height_mm": 640.0},
        "cuboid": {"width_mm": 300.0, "depth_mm": 300.0, "length_mm": 400.0}
        | {"edge_radius_mm": 60.0},
    }
    design = of(
        shape,
        {"kind": "phyllotaxis", "count": 10_000, "height_far_mm": 3.0},
        shape=sizes[shape],
        switch={"footprint_diameter_mm": 3.2},
        receptor={"diameter_outer_mm": 2.4},
    )
    start = time.process_time()
    markers = check_design(design).markers
    assert markers.count == 10_000
    assert time.process_time() - start < 5.0


def test_coincident_markers_do_not_upset_the_layout() -> None:
    design, _ = REFUSALS["coincident"]
    markers = make_markers(design, design.surface())
    assert markers.count == 3
    assert np.isfinite(markers.tip_mm).all()
