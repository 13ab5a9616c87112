"""Where plans press: areas, rims, places given by hand, and places that are not there."""

from typing import Any

import numpy as np
import pytest

from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import INDENTERS
from phytac_design.simulation.scenario.draw_plan import draw_plan
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from tests.designs import changed
from tests.refusals import refused
from tests.simulation.test_draw import AT, plan, scenario, sensor


def test_anywhere_is_even_by_area_in_its_part() -> None:
    """On a dome equal areas are equal steps of height (Archimedes)."""
    design, surface, _ = of = sensor("hemisphere")
    touch = {"samples": 2000, "multi_share": 0.0, "placement": "anywhere", "along": [0.5, 1.0]}
    got = plan(scenario(touch=touch), of)
    z = surface.point(got.touches.uv)[:, 2]
    low, high = surface.point(
        np.array([[surface.domain[0].mean(), 0.0], [surface.domain[0, 1], 0.0]])
    )[:, 2]
    count = np.histogram(z, bins=10, range=(low, high))[0]
    assert count.sum() == 2000
    # χ² of 9 degrees of freedom: 40 is beyond one in a hundred thousand.
    assert float(((count - 200.0) ** 2 / 200.0).sum()) < 40.0
    assert design.training.force_min_N <= got.touches.force_N.min()


@pytest.mark.parametrize("shape", ["cone", "plane", "hemisphere"])
def test_rims_are_pressed_near_open_edges_and_evenly(shape: str) -> None:
    _, surface, _ = sensor(shape)
    touch = {"samples": 400, "multi_share": 0.0, "placement": "rims", "rim_mm": 3.0}
    got = plan(scenario(touch=touch), sensor(shape))
    stations = np.linspace(0.0, 1.0, 2001)
    edges = []
    for axis, end in surface.edges():
        uv = np.empty((2001, 2))
        uv[:, axis] = surface.domain[axis, end]
        low, high = surface.domain[1 - axis]
        uv[:, 1 - axis] = low + stations * (high - low)
        edges.append(surface.point(uv))
    at = surface.point(got.touches.uv)
    apart = np.array(
        [np.linalg.norm(at[:, None] - edge[None], axis=2).min(axis=1) for edge in edges]
    )
    assert apart.min(axis=0).max() <= 3.0 + 1e-3
    assert apart.min(axis=0).mean() == pytest.approx(1.5, abs=0.25)
    length = np.array([np.linalg.norm(np.diff(e, axis=0), axis=1).sum() for e in edges])
    count = np.bincount(apart.argmin(axis=0), minlength=len(edges)) / 400.0
    assert count == pytest.approx(length / length.sum(), abs=0.08)


def test_rims_stay_within_the_touched_part() -> None:
    touch = {"samples": 60, "multi_share": 0.0, "placement": "rims", "rim_mm": 20.0}
    got = plan(scenario(touch=touch | {"along": [0.9, 1.0], "around": [0.1, 0.3]}))
    share = got.touches.uv / np.ptp(sensor("cylinder40")[1].domain, axis=1)
    assert share.min(axis=0) == pytest.approx([0.9, 0.1], abs=0.02)
    assert share.max(axis=0) == pytest.approx([1.0, 0.3], abs=0.02)
    assert share[:, 0].min() >= 0.9 - 1e-9


def test_every_way_to_name_a_place_is_the_same_place() -> None:
    _, surface, unit = sensor("cylinder40")
    marker = 40
    u, v = (unit.markers.uv[marker] - surface.domain[:, 0]) / np.ptp(surface.domain, axis=1)
    above = surface.point(unit.markers.uv[marker : marker + 1], 7.0)[0]
    row, column = int(unit.markers.row[marker]), int(unit.markers.column[marker])
    ways: list[dict[str, Any]] = [
        {"marker": marker},
        {"row": row, "column": column},
        {"along": float(u), "around": float(v)},
        {"point_mm": above.tolist()},
    ]
    at = [AT | way | {"sample": 3 - k} for k, way in enumerate(ways)]
    got = plan(scenario(touch={"at": at}))
    assert got.touches.samples == 4
    assert (got.touches.sample == np.arange(4)).all()
    assert surface.point(got.touches.uv) == pytest.approx(
        np.tile(surface.point(unit.markers.uv[marker : marker + 1]), (4, 1)), abs=1e-9
    )
    assert got.switching.bits[:, marker].all()


def test_a_point_beyond_the_edge_is_nearest_to_the_edge() -> None:
    _, surface, _ = sensor("plane")
    edge = float(np.abs(surface.bounds_mm()[:, 0]).max())
    near, far = ([edge + beyond, 3.0, 0.0] for beyond in (8.0, 400.0))
    got = plan(scenario(touch={"at": [AT | {"point_mm": near}]}), sensor("plane"))
    with refused("contact-point-off-surface"):
        plan(scenario(touch={"at": [AT | {"point_mm": far}]}), sensor("plane"))
    assert (
        (got.touches.uv >= surface.domain[:, 0]) & (got.touches.uv <= surface.domain[:, 1])
    ).all()
    assert (got.touches.uv == surface.domain).any()


def test_given_cylinders_have_their_length_and_direction() -> None:
    at = [
        AT | {"marker": 1, "indenter": "cylinder", "turn_deg": 90.0, "friction": [0.1, -0.2]},
        AT | {"marker": 99, "indenter": "cylinder", "length_mm": 20.0},
        AT | {"marker": 60, "indenter": "sphere"},
    ]
    touches = plan(scenario(touch={"at": at})).touches
    assert touches.length_mm.tolist() == [12.0, 20.0, 0.0]
    assert touches.turn_rad == pytest.approx([np.pi / 2.0, 0.0, 0.0])
    assert [INDENTERS[k] for k in touches.indenter] == ["cylinder", "cylinder", "sphere"]
    assert touches.friction[0].tolist() == [0.1, -0.2]


def test_drawn_indenters_follow_their_table() -> None:
    kinds = [
        {"kind": "sphere", "share": 3.0, "radius_share": 0.5},
        {"kind": "cylinder", "length_mm": 9.0, "turn_deg": 30.0, "radius_share": 0.25},
    ]
    touch = {"samples": 400, "multi_share": 0.0, "indenters": kinds, "friction_min": 0.1}
    touches = plan(
        scenario(touch=touch | {"friction_max": 0.3, "friction_deg": 90.0, "radius_min_mm": 4.0})
    ).touches
    rod = touches.indenter == 2
    assert rod.mean() == pytest.approx(0.25, abs=0.07)
    assert (touches.length_mm == np.where(rod, 9.0, 0.0)).all()
    assert touches.turn_rad == pytest.approx(np.where(rod, np.radians(30.0), 0.0))
    assert touches.radius_mm[rod].min() >= 1.0
    assert touches.radius_mm[rod].max() <= 7.0 / 4.0
    assert touches.radius_mm[~rod].min() >= 2.0
    assert touches.friction[:, 0] == pytest.approx(np.zeros(400), abs=1e-12)
    assert touches.friction[:, 1].min() >= 0.1
    assert touches.friction[:, 1].max() <= 0.3
    free = plan(scenario(touch={"samples": 120, "indenters": [{"kind": "cylinder"}]})).touches
    assert np.ptp(free.turn_rad) > 2.8
    assert free.length_mm == pytest.approx(4.0 * free.radius_mm)


def test_no_room_and_empty_parts_are_rejected() -> None:
    narrow = {"along": [0.5, 0.52], "around": [0.5, 0.52], "samples": 30}
    with refused("contact-range-empty"):
        plan(scenario(touch=narrow))
    with refused("presses-no-room"):
        plan(scenario(touch=narrow | {"placement": "anywhere"}))
    # Where there is room for several in some samples, others have one.
    tight = {"along": [0.5, 0.66], "around": [0.5, 0.56], "samples": 60, "placement": "anywhere"}
    some = plan(scenario(touch=tight | {"multi_share": 1.0})).touches.counts
    assert set(some.tolist()) >= {1, 2}
    assert some.min() == 1
    single = plan(scenario(touch=narrow | {"placement": "anywhere", "multi_share": 0.0}))
    assert (single.touches.counts == 1).all()
    with refused("contact-range-empty"):
        plan(scenario(touch={"placement": "rims", "along": [0.2, 0.8]}))
    with refused("range-over-open-seam"):
        plan(scenario(touch={"around": [0.9, 0.1]}), sensor("plane"))
    with refused("press-range-reversed") as caught:
        plan(scenario(touch={"force_min_N": 30.0}))
    caught.match("touch.force_min_N = 30")


def test_faces_that_do_not_sense_are_not_touched() -> None:
    design = changed("cuboid", shape={"faces": ["+y"]})
    surface = design.surface()
    unit = draw_sensor_instance(
        Sensor.of(design, surface, make_markers(design, surface)), SensorInstanceSection(), 0
    )
    for placement in ("anywhere", "rims"):
        touch = {"samples": 40, "multi_share": 0.0, "placement": placement}
        got = draw_plan(design, surface, unit, scenario(touch=touch), seed=0)
        assert surface.sensing(got.touches.uv).all()
    blind = {"placement": "anywhere", "around": [0.5, 0.9]}
    with refused("contact-range-empty"):
        draw_plan(design, surface, unit, scenario(touch=blind), seed=0)


WRONG_AT: list[tuple[str, dict[str, Any], str]] = [
    ("cylinder40", {"marker": 216}, "marker-unknown"),
    ("cylinder40", {"row": 18, "column": 0}, "marker-unknown"),
    ("hemisphere", {"row": 1, "column": 0}, "layout-without-rows"),
]


@pytest.mark.parametrize(("shape", "place", "code"), WRONG_AT)
def test_places_that_are_not_there(shape: str, place: dict[str, Any], code: str) -> None:
    with refused(code):
        plan(scenario(touch={"at": [AT | place]}), sensor(shape))
