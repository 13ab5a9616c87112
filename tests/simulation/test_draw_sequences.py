"""Plans of grips and cycles: what a wall and its switches remember."""

from typing import Any

import numpy as np
import pytest

from phytac_design.simulation.scenario.grips import cap_forces
from phytac_design.simulation.scenario.presses import reach_mm
from phytac_design.simulation.scenario.scenario_file import load_scenario
from phytac_design.simulation.scenario.viscoelasticity import felt_force
from tests.refusals import refused
from tests.simulation.test_draw import AT, SERIES, WALL, plan, scenario, sensor

PLACE = AT | {"marker": 80}


def test_a_grip_keeps_its_places_and_changes_its_forces() -> None:
    got = plan(scenario("grips", touch={"samples": 23}, grip={"levels": 5}))
    assert got.sequence.tolist() == [k // 5 for k in range(23)]
    uv = got.touches.uv.reshape(23, 9, 2)
    assert (uv[0] == uv[4]).all()
    assert not np.allclose(uv[4], uv[5])
    force = got.touches.force_N.reshape(23, 9)
    total = force.sum(axis=1)
    assert len(np.unique(total)) == 23
    assert total.min() >= 9 * 0.5
    # No pad is cut off where the sum is small: all levels have the same proportions.
    small = np.flatnonzero(force.max(axis=1) < 25.0)
    pairs = [(a, b) for a in small for b in small if a < b and a // 5 == b // 5]
    assert pairs
    for a, b in pairs:
        assert force[a] / total[a] == pytest.approx(force[b] / total[b])


def test_hands_come_from_everywhere_or_from_one_side() -> None:
    def first_pads(**grip: Any) -> Any:
        own = scenario("grips", touch={"samples": 60}, grip={"levels": 1, **grip})
        return plan(own).touches.uv.reshape(60, 9, 2)

    still = first_pads(turn="none", flip="none", shift=0.0)
    assert np.ptp(still, axis=0).max() < 1e-9
    moved = first_pads(turn="none", flip="none", shift=0.1)
    assert np.ptp(moved[:, 0, 0]) > 0.15 * 80.0
    assert np.ptp(moved[:, 0, 1]) < 1e-9
    flipped = first_pads(turn="none", flip="any", shift=0.0)
    middle = flipped[:, 0, 0]
    assert len(np.unique(middle.round(6))) == 2
    assert len(np.unique(first_pads(flip="none", shift=0.0)[:, 0, 1].round(6))) == 60
    half = scenario("grips", touch={"samples": 60, "around": [0.25, 0.75]}, grip={"levels": 1})
    v = plan(half).touches.uv[:, 1] / (2.0 * np.pi)
    assert v.min() >= 0.25
    assert v.max() <= 0.75


@pytest.mark.parametrize("shape", ["hemisphere", "plane", "cylinder40"])
def test_pads_of_a_hand_do_not_overlap(shape: str) -> None:
    _, surface, _ = sensor(shape)
    touches = plan(load_scenario("grips"), sensor(shape)).touches
    at = surface.point(touches.uv).reshape(200, 9, 3)
    size = reach_mm(touches).reshape(200, 9)
    apart = np.linalg.norm(at[:, :, None] - at[:, None], axis=3)
    apart += np.where(np.eye(9, dtype=np.bool_), np.inf, 0.0)
    assert (apart > size[:, :, None] + size[:, None]).all()


def test_pads_without_room_are_rejected() -> None:
    pads = [{"along": 0.5, "around": 0.5}, {"along": 0.51, "around": 0.5}]
    with refused("grip-pads-no-room"):
        plan(scenario("grips", grip={"pads": pads}))


def test_more_than_all_pads_can_give_is_rejected() -> None:
    with refused("grip-force-range") as caught:
        plan(scenario("grips", grip={"total_max_N": 230.0}))
    caught.match("grip.total_max_N")
    with refused("grip-force-range") as caught:
        plan(scenario("grips", grip={"total_min_N": 222.0}))
    caught.match("grip.total_min_N")


def test_capped_forces_sum_to_the_given_total() -> None:
    rng = np.random.default_rng(0)
    parts = rng.random((500, 9)) ** 3
    parts /= parts.sum(axis=1, keepdims=True)
    total = rng.uniform(1.0, 225.0, 500)
    force = cap_forces(parts, total, 25.0)
    assert force.sum(axis=1) == pytest.approx(total, rel=1e-9)
    assert force.max() <= 25.0
    # Those below the cap keep their proportions.
    for row, part in zip(force, parts, strict=True):
        free = row < 25.0 - 1e-9
        if free.sum() > 1:
            assert np.ptp(row[free] / part[free]) < 1e-9 * (row[free] / part[free]).max()


def test_a_wall_remembers_the_levels_of_its_grip_only() -> None:
    own = scenario("grips", touch={"samples": 6}, grip={"levels": 3}, time=WALL)
    got = plan(own)
    force = got.touches.force_N.reshape(2, 3, 9)
    felt = got.felt_N.reshape(2, 3, 9)
    times = np.array([0.0, 0.5, 1.5, 2.0, 3.0, 3.5, 4.5])
    for grip in range(2):
        drawn = np.zeros((7, 9))
        drawn[1::2] = drawn[2::2] = force[grip]
        known = felt_force(SERIES.creep(), times, drawn)[2::2]
        assert felt[grip] == pytest.approx(known, rel=1e-12)
    assert got.time_s == pytest.approx([1.5, 3.0, 4.5, 7.5, 9.0, 10.5])


def test_switches_of_a_grip_remember_its_levels() -> None:
    """One pad on one receptor: its switch is on between release and threshold only if it was."""
    _, surface, unit = sensor("cylinder40")
    share = (unit.markers.uv[80] - surface.domain[:, 0]) / np.ptp(surface.domain, axis=1)
    pad = {"along": float(share[0]), "around": float(share[1])}
    grip = {"pads": [pad], "levels": 200, "turn": "none", "flip": "none", "shift": 0.0}
    grip |= {"total_min_N": 0.3, "total_max_N": 0.6}
    touch = {"samples": 200, "radius_min_mm": 0.2, "radius_max_mm": 0.2, "force_min_N": 0.1}
    got = plan(scenario("grips", touch=touch, grip=grip))
    state, seen = False, set()
    for k, force in enumerate(got.touches.force_N):
        before = state
        state = force > 0.5 or (state and force >= 0.4)
        assert got.switching.bits[k, 80] == state, k
        if 0.4 <= force <= 0.5:
            seen.add(before)
    assert seen == {True, False}


CYCLE = {"count": 12, "every": 4, "phases": [0.5, 1.0, 2.0, 2.5, 3.0, 4.0]}


def test_cycles_are_sampled_at_their_phases() -> None:
    got = plan(scenario("cycles", touch={"at": [PLACE]}, cycle=CYCLE))
    assert got.touches.samples == 18
    assert got.sequence.tolist() == [cycle for cycle in (0, 4, 8) for _ in range(6)]
    phase = np.array([0.25, 0.5, 1.5, 1.75, 2.0, 3.0])
    assert got.time_s == pytest.approx(np.add.outer([0.0, 12.0, 24.0], phase).ravel())
    total = np.bincount(got.touches.sample, got.touches.force_N, minlength=18)
    assert total == pytest.approx(np.tile([2.0, 4.0, 4.0, 2.0, 0.0, 0.0], 3))
    # An elastic wall at rest has no contact.
    assert got.touches.counts.reshape(3, 6).tolist() == [[1, 1, 1, 1, 0, 0]] * 3
    assert (got.felt_N == got.touches.force_N).all()


def test_a_wall_that_creeps_has_not_come_back_at_rest() -> None:
    got = plan(scenario("cycles", touch={"at": [PLACE]}, cycle=CYCLE, time=WALL))
    assert (got.touches.counts == 1).all()
    force, felt = got.touches.force_N.reshape(3, 6), got.felt_N.reshape(3, 6)
    assert (force[:, 4:] == 0.0).all()
    assert (felt[:, 4] > felt[:, 5]).all()
    assert (felt[:, 5] > 0.0).all()
    assert not got.switching.bits.reshape(3, 6, -1)[:, 4:].any()
    assert (np.diff(felt, axis=0) > 0.0).all()
    # The whole history, unrolled.
    corners = np.array([0.0, 0.25, 0.5, 1.5, 1.75, 2.0, 3.0])
    times = np.add.outer(3.0 * np.arange(12), corners).ravel()
    drawn = np.tile([0.0, 2.0, 4.0, 4.0, 2.0, 0.0, 0.0], 12)
    known = felt_force(SERIES.creep(), times, drawn).reshape(12, 7)[::4, 1:]
    assert felt == pytest.approx(known, rel=1e-11)


def test_many_cycles_at_a_held_depth() -> None:
    cycle = {"count": 400, "every": 133, "phases": [1.0, 2.0, 4.0]}
    time = WALL | {"control": "displacement"}
    got = plan(scenario("cycles", touch={"at": [PLACE]}, cycle=cycle, time=time))
    force = np.bincount(got.touches.sample, got.touches.force_N, minlength=12).reshape(4, 3)
    felt = np.bincount(got.touches.sample, got.felt_N, minlength=12).reshape(4, 3)
    assert felt[:, :2] == pytest.approx(np.full((4, 2), 4.0))
    assert (force[:, 1] < force[:, 0]).all()
    assert (force[:, 2] == 0.0).all()
    assert (felt[:, 2] > 0.0).all()
    # The memory has settled long before cycle 133, lower than at first.
    assert force[1] == pytest.approx(force[3], rel=1e-9)
    assert (force[1, :2] < force[0, :2]).all()


def test_switches_open_later_than_they_close() -> None:
    """At the same 0.45 N on the footprint: off on the way up, on on the way down."""
    at = PLACE | {"radius_mm": 0.2, "force_N": 0.9}
    cycle = {"count": 3, "every": 1, "phases": [0.5, 1.0, 2.5, 4.0]}
    got = plan(scenario("cycles", touch={"at": [at]}, cycle=cycle))
    assert got.switching.bits[:, 80].tolist() == [False, True, True, False] * 3
    assert got.switching.receptor_force_N[:, 80] == pytest.approx([0, 0.9, 0.45, 0] * 3)
    low = plan(scenario("cycles", touch={"at": [at | {"force_N": 0.78}]}, cycle=cycle))
    assert low.switching.bits[:, 80].tolist() == [False, True, False, False] * 3


def test_a_cycled_press_may_be_drawn_or_absent() -> None:
    drawn = plan(scenario("cycles", cycle=CYCLE))
    assert len(np.unique(drawn.touches.uv, axis=0)) == 1
    assert drawn.touches.counts.max() == 1
    none = plan(scenario("cycles", touch={"at": []}, cycle=CYCLE))
    assert none.touches.samples == 18
    assert (none.touches.counts == 0).all()
    both = plan(scenario("cycles", touch={"at": [PLACE, AT | {"marker": 5}]}, cycle=CYCLE))
    assert both.touches.counts.reshape(3, 6).tolist() == [[2, 2, 2, 2, 0, 0]] * 3


def test_the_light_drifts_with_the_time_of_the_samples() -> None:
    light = {"drift_share": 0.2, "drift_time_s": 30.0}
    got = plan(scenario(touch={"samples": 50}, light=light))
    assert got.light == pytest.approx(1.0 - 0.2 * (1.0 - np.exp(-got.time_s / 30.0)))
    assert (plan(scenario(touch={"samples": 5})).light == 1.0).all()
