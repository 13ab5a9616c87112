"""Plans: samples that do not depend on each other's number, histories, switches, region."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import INDENTERS
from phytac_design.mechanics.shell.footprints import footprint_shares
from phytac_design.simulation.contacts import Contacts, assign_forces, switch_states
from phytac_design.simulation.sample_plan import ChartBox, SamplePlan
from phytac_design.simulation.scenario import draw_plan as plan_module
from phytac_design.simulation.scenario import presses
from phytac_design.simulation.scenario.contact_placement import grid_numbers
from phytac_design.simulation.scenario.draw_plan import draw_plan
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.presses import reach_mm
from phytac_design.simulation.scenario.scenario_file import (
    Scenario,
    SensorInstanceSection,
    load_scenario,
    parse_scenario,
    shipped_scenarios,
)
from phytac_design.simulation.scenario.viscoelasticity import (
    Relaxation,
    felt_force,
    force_under_depth,
)
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from tests.long_cases import TUBES, with_long
from tests.refusals import refused

JITTER_MM = 1.0

Drawn = tuple[Design, Surface, SensorInstance]
WALL = {"relax_share": [0.1, 0.05], "relax_s": [0.7, 20.0]}
SERIES = Relaxation(share=np.array([0.1, 0.05]), time_s=np.array([0.7, 20.0]))


@cache
def sensor(name: str, number: int = 0) -> Drawn:
    design = load_design(name)
    surface = design.surface()
    section = SensorInstanceSection(number=number)
    return (
        design,
        surface,
        draw_sensor_instance(Sensor.of(design, surface, make_markers(design, surface)), section, 1),
    )


def scenario(kind: str = "presses", **tables: Any) -> Scenario:
    return parse_scenario({"name": "t", "kind": kind, **tables}, "t")


def plan(own: Scenario, of: Drawn | None = None, seed: int = 5) -> SamplePlan:
    design, surface, unit = of or sensor("cylinder40")
    return draw_plan(design, surface, unit, own, seed=seed)


def columns(touches: Contacts) -> dict[str, Any]:
    return {name: array for name, array in vars(touches).items() if name != "samples"}


@pytest.mark.parametrize("shape", with_long(shipped_designs(), TUBES))
@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_scenario_runs_on_every_design(shape: str, name: str) -> None:
    own = load_scenario(name)
    if name in {"platform", "grips", "paper-protocol", "paper-grips"} and shape != "cylinder60":
        own = _asked(own, 80)  # samples do not depend on how many there are
    design, surface, unit = sensor(shape)
    got = draw_plan(design, surface, unit, own, seed=1)
    touches, samples = got.touches, got.touches.samples
    assert samples == (own.touch.samples or {"cycles": 140}.get(name, 598))
    for array in (got.time_s, got.sequence, got.light, got.switching.bits):
        assert len(array) == samples
    assert (np.diff(touches.sample) >= 0).all()
    assert touches.sample.max() < samples
    assert (np.diff(got.time_s) > 0.0).all()
    assert np.isfinite(got.felt_N).all()
    low, high = surface.domain.T
    assert ((touches.uv >= low) & (touches.uv <= high)).all()
    assert got.switching.tripped.any()
    if name == "platform":
        assert (touches.counts > 1).mean() == pytest.approx(0.48, abs=3.0 / samples)
        assert touches.counts.max() == 5
        assert touches.force_N.min() >= design.training.force_min_N
        assert touches.force_N.max() <= design.training.force_max_N
        assert (np.bincount(touches.indenter) > 0.25 * len(touches.indenter)).all()
    if name == "paper-protocol":
        assert set(np.unique(touches.counts)) == {1, 4, 5}
        assert (touches.counts > 1).mean() == pytest.approx(0.48, abs=3.0 / samples)
        assert (touches.radius_mm == design.switch.footprint_diameter_mm / 2.0).all()
        markers = make_markers(design, surface)
        gap = np.linalg.norm(touches.uv[:, None] - markers.uv, axis=2)
        pressed = np.unique(gap.argmin(axis=1))
        assert gap.min(axis=1).max() < 1e-9
        columns_of = grid_numbers(markers)[1]
        assert set(columns_of[pressed]) == {0, 1}
        # Each of them is pressed alone, in turn.
        assert samples < 598 or len(pressed) == (columns_of < 2).sum()
    if name in {"grips", "paper-grips"}:
        assert (touches.counts == 9).all()
        assert touches.force_N.max() <= 25.0
        assert np.bincount(touches.sample, touches.force_N).max() > 200.0


def _asked(own: Scenario, samples: int) -> Scenario:
    touch = own.touch.model_copy(update={"samples": samples})
    return own.model_copy(update={"touch": touch})


def test_a_gripper_keeps_its_shape_and_goes_round_the_seam() -> None:
    fingers = [[0, 0], [3, 1], [5, 2]]
    own = scenario(
        touch={
            "samples": 60,
            "multi_share": 1.0,
            "jitter_mm": 0.0,
            "grippers": [{"fingers": fingers}],
        }
    )
    design, surface, _ = sensor("cylinder60")
    got, markers = plan(own, sensor("cylinder60")).touches, make_markers(design, surface)
    place = np.linalg.norm(got.uv[:, None] - markers.uv, axis=2).argmin(axis=1).reshape(-1, 3)
    row, column = (values[place] for values in grid_numbers(markers))
    assert (row - row[:, :1] == [0, 3, 5]).all()
    assert ((column - column[:, :1]) % (markers.column.max() + 1) == [0, 1, 2]).all()
    assert (np.diff(column, axis=1) < 0).any()
    assert len(np.unique(got.force_N)) == len(got.force_N)


def test_only_the_columns_that_are_pressed_are_modelled_finely() -> None:
    own = scenario(touch={"samples": 6, "placement": "columns", "columns": [1, 2], "most": 2})
    design, surface, _ = sensor("plane")
    region, markers = plan(own, sensor("plane")).region, make_markers(design, surface)
    across = markers.uv[np.isin(markers.column, [1, 2]), 1]
    assert region.low[1] < across.min() < across.max() < region.high[1]
    assert region.high[1] - region.low[1] < 0.6 * np.ptp(surface.domain[1])


def test_a_gripper_without_room_is_refused() -> None:
    touch = {"multi_share": 1.0, "columns": [0], "grippers": [{"fingers": [[0, 0], [0, 1]]}]}
    with refused("gripper-no-room"):
        plan(scenario(touch={"samples": 3, **touch}))
    with refused("contact-range-empty"):
        plan(scenario(touch={"samples": 3, "placement": "columns", "columns": [99]}))


DRAWN = {
    "columns": scenario(
        touch={"placement": "columns", "most": 3, "indenters": [{"kind": k} for k in INDENTERS]}
    ),
    "anywhere": scenario(touch={"placement": "anywhere", "empty_share": 0.2, "friction_max": 0.4}),
    "rims": scenario(touch={"placement": "rims", "multi_share": 0.0}),
    "grips": scenario("grips", time=WALL),
}


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize("shape", ["cylinder40", "hemisphere"])
def test_a_sample_does_not_depend_on_the_number_of_samples(name: str, shape: str) -> None:
    few, many = (plan(_asked(DRAWN[name], n), sensor(shape)) for n in (23, 61))
    first = many.touches.sample < 23
    for key, array in columns(few.touches).items():
        assert (array == columns(many.touches)[key][first]).all(), key
    assert (few.felt_N == many.felt_N[first]).all()
    assert (few.switching.bits == many.switching.bits[:23]).all()
    assert (few.switching.owner == many.switching.owner[:23]).all()
    assert (few.time_s == many.time_s[:23]).all()
    assert (few.region.low == many.region.low).all()
    assert (few.region.high == many.region.high).all()


@pytest.mark.parametrize("name", DRAWN)
def test_the_seed_is_all_that_draws(name: str) -> None:
    own = _asked(DRAWN[name], 20)
    first, again, other = plan(own), plan(own), plan(own, seed=6)
    assert (first.touches.uv == again.touches.uv).all()
    assert (first.felt_N == again.felt_N).all()
    assert not np.array_equal(first.touches.force_N, other.touches.force_N)


def test_chunks_of_samples_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    own = _asked(DRAWN["anywhere"], 30)
    whole = plan(own)
    monkeypatch.setitem(plan_module._switching.__kwdefaults__, "block", 7)
    monkeypatch.setitem(presses.draw_presses.__kwdefaults__, "chunk", 11)
    parts = plan(own)
    for name, array in vars(whole.switching).items():
        assert np.all(array == getattr(parts.switching, name)), name
    assert (whole.touches.uv == parts.touches.uv).all()


def test_the_rig_goes_column_after_column() -> None:
    design, surface, unit = sensor("cylinder40")
    markers = unit.markers
    got = plan(_asked(DRAWN["columns"], 250))
    first = got.touches.uv[np.unique(got.touches.sample, return_index=True)[1]]
    order = np.lexsort((markers.row, markers.column))[np.arange(250) % markers.count]
    apart = surface.point(first) - surface.point(markers.uv[order])
    assert np.linalg.norm(apart, axis=1).max() <= JITTER_MM * np.sqrt(2.0) + 1e-6
    assert (np.diff(markers.column[order[: markers.count]]) >= 0).all()
    assert design.layout.columns == 1 + markers.column[order[-35]]


def test_without_rows_it_goes_strip_after_strip() -> None:
    _, surface, unit = sensor("hemisphere")
    count = unit.markers.count
    own = scenario(touch={"placement": "columns", "multi_share": 0.0, "jitter_mm": 0.0})
    got = plan(_asked(own, count), sensor("hemisphere"))
    pressed = surface.point(got.touches.uv)
    every = surface.point(unit.markers.uv)
    nearest = np.linalg.norm(pressed[:, None] - every[None], axis=2).argmin(axis=1)
    assert sorted(nearest) == list(range(count))
    u = got.touches.uv[:, 0]
    assert (np.diff(u) < 0.0).sum() == round(np.sqrt(count)) - 1


def test_contacts_of_a_sample_keep_apart() -> None:
    design, surface, _ = sensor("cylinder40")
    touches = plan(_asked(DRAWN["columns"], 150)).touches
    at, size = surface.point(touches.uv), reach_mm(touches)
    same = touches.sample[:, None] == touches.sample[None]
    apart = np.linalg.norm(at[:, None] - at[None], axis=2)
    room = size[:, None] + size[None] + design.switch.footprint_diameter_mm
    pairs = same & ~np.eye(len(at), dtype=np.bool_)
    assert pairs.any()
    assert (apart[pairs] > room[pairs]).all()


def _inside(region: ChartBox, surface: Surface, uv: FloatArray) -> BoolArray:
    span = np.ptp(surface.domain, axis=1)
    turned = np.where(surface.periodic, np.mod(uv - region.low, span), uv - region.low)
    size = region.high - region.low
    size = np.where((size < 0.0) & surface.periodic, size + span, size)
    held = (turned >= -1e-9) & (turned <= size + 1e-9)
    return np.array((held | region.whole).all(axis=1), dtype=np.bool_)


def _ring(surface: Surface, uv: FloatArray, radius: FloatArray) -> FloatArray:
    """Chart positions in and on the edge of discs, by the distance in space."""
    low, high = surface.domain.T
    rng = np.random.default_rng(0)
    probe = low + rng.random((20_000, 2)) * (high - low)
    apart = np.linalg.norm(surface.point(probe)[:, None] - surface.point(uv)[None], axis=2)
    return np.asarray(probe[(apart <= radius).any(axis=1)])


@pytest.mark.parametrize("shape", ["cylinder40", "hemisphere", "patch", "cuboid"])
@pytest.mark.parametrize("placement", ["receptor", "anywhere", "columns"])
def test_a_part_is_touched_and_the_region_holds_it(shape: str, placement: str) -> None:
    _, surface, _ = sensor(shape)
    around = [0.8, 0.1] if surface.periodic[1] else [0.5, 0.9]
    touch: dict[str, Any] = {"along": [0.2, 0.6], "around": around, "placement": placement}
    touch["jitter_mm"] = 0.0
    if placement == "anywhere":
        touch["indenters"] = [{"kind": "cylinder", "radius_share": 0.2, "length_mm": 16.0}]
        touch["multi_share"] = 0.0
    got = plan(scenario(touch=touch | {"samples": 40, "most": 2}), sensor(shape))
    (u0, u1), (v0, v1) = surface.domain
    share = (got.touches.uv - [u0, v0]) / [u1 - u0, v1 - v0]
    assert ((share[:, 0] >= 0.2 - 1e-9) & (share[:, 0] <= 0.6 + 1e-9)).all()
    v = np.mod(share[:, 1] - around[0], 1.0)
    assert (v <= np.mod(around[1] - around[0], 1.0) + 1e-9).all()
    seam = got.region.low[1] > got.region.high[1]
    assert seam == (surface.periodic[1] and not got.region.whole[1])
    if shape != "hemisphere":  # near its pole every patch is on all sides
        assert not got.region.whole.any()
    patch = _ring(surface, got.touches.uv, reach_mm(got.touches))
    assert _inside(got.region, surface, patch).all()
    # It is no larger than it has to be: the rest of the chart is left out.
    low, high = surface.domain.T
    probe = low + np.random.default_rng(1).random((4000, 2)) * (high - low)
    at, middle = surface.point(probe), surface.point(got.touches.uv)
    far = np.linalg.norm(at[:, None] - middle[None], axis=2).min(axis=1) > 35.0
    if far.any():
        assert not _inside(got.region, surface, probe)[far].all()


AT = {"force_N": 4.0, "radius_mm": 3.0}


def test_samples_without_contact() -> None:
    none = plan(scenario(touch={"samples": 5, "at": []}))
    assert none.touches.samples == 5
    assert len(none.touches.force_N) == 0
    assert none.switching.bits.shape == (5, sensor("cylinder40")[2].markers.count)
    assert not none.switching.bits.any()
    assert (none.region.low == none.region.high).all()
    some = plan(scenario(touch={"samples": 300, "empty_share": 0.3}))
    assert (some.touches.counts == 0).mean() == pytest.approx(0.3, abs=0.02)
    empty = some.touches.counts == 0
    assert not some.switching.bits[empty].any()
    every = plan(scenario(touch={"samples": 4, "empty_share": 1.0}))
    assert (every.touches.counts == 0).all()


@pytest.mark.parametrize("control", ["force", "displacement"])
def test_presses_creep_or_relax_until_they_are_sampled(control: str) -> None:
    touch = {"samples": 12}
    still = plan(scenario(touch=touch))
    got = plan(scenario(touch=touch, time=WALL | {"control": control}))
    times = np.array([0.0, 0.5, 1.5])
    ramp = np.array([0.0, 1.0, 1.0])
    if control == "force":
        felt = felt_force(SERIES.creep(), times, ramp)[-1]
        assert felt > 1.05
        assert (got.touches.force_N == still.touches.force_N).all()
        assert got.felt_N == pytest.approx(felt * still.touches.force_N, rel=1e-12)
    else:
        left = force_under_depth(SERIES, times, ramp).force_N[-1]
        assert left < 0.95
        assert (got.felt_N == still.touches.force_N).all()
        assert got.touches.force_N == pytest.approx(left * still.touches.force_N, rel=1e-12)
    assert got.time_s == pytest.approx(1.5 + 3.0 * np.arange(12))


def test_switches_of_single_presses_are_those_of_the_activation_law() -> None:
    design, surface, unit = sensor("cylinder40")
    got = plan(scenario(touch={"samples": 80, "most": 4}))
    known = switch_states(Sensor.of(design, surface, unit.markers), got.touches)
    assert got.switching.bits.any()
    for name, array in vars(known).items():
        assert getattr(got.switching, name) == pytest.approx(array, abs=1e-9), name


def test_switches_are_those_of_the_print_the_places_those_of_the_design() -> None:
    own = scenario(touch={"samples": 60, "multi_share": 0.0})
    design, surface, unit = sensor("cylinder40", number=1)
    first, other = plan(own), plan(own, sensor("cylinder40", number=1))
    assert (first.touches.uv == other.touches.uv).all()
    share = footprint_shares(
        surface, other.touches, unit.markers.uv, design.switch.footprint_diameter_mm / 2.0
    )
    assert (other.switching.bits == (share * other.touches.force_N[:, None] > unit.on_N)).all()
    known = assign_forces(other.touches, share, other.switching.bits)
    assert other.switching.receptor_force_N == pytest.approx(known.receptor_force_N, abs=1e-9)
    assert (first.switching.bits != other.switching.bits).any()


def test_a_relaxing_press_keeps_the_switch_that_its_peak_tripped() -> None:
    design, surface, unit = sensor("cylinder40")
    middle = scenario(touch={"at": [AT | {"marker": 80, "radius_mm": 0.1}]})
    held = {"relax_share": [0.3], "relax_s": [0.1], "hold_s": 60.0, "control": "displacement"}
    for peak, on in ((0.55, True), (0.65, True), (0.49, False)):
        at = [AT | {"marker": 80, "radius_mm": 0.1, "force_N": peak}]
        # A slow ramp relaxes as it goes: up in a hundredth of the time constant.
        got = plan(scenario(touch={"at": at}, time=held | {"ramp_s": 0.001}))
        force = float(got.touches.force_N[0])
        assert force == pytest.approx(0.7 * peak, rel=1e-6)
        assert got.switching.bits[0, 80] == (on and force >= 0.4)
    assert design.switch.threshold_N == 0.5
    assert unit.off_N[80] == pytest.approx(0.4)
    assert plan(middle).switching.bits[0, 80]
    assert surface.name == "cylinder"
