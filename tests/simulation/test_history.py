"""Creep and relaxation against closed forms, each other, and their own unrolled history."""

import numpy as np
import pytest

from phytac_design.simulation.scenario.viscoelasticity import (
    Creep,
    Relaxation,
    felt_cycles,
    felt_force,
    force_under_cycles,
    force_under_depth,
    light_at,
    switch_step,
)
from phytac_shapes.arrays import FloatArray
from tests.refusals import refused

G, TAU = 0.3, 2.0
SOLID = Relaxation(share=np.array([G]), time_s=np.array([TAU]))
"""Standard linear solid: its compliance is known in closed form."""
MANY = Relaxation(share=np.array([0.1, 0.25, 0.05, 0.2]), time_s=np.array([30.0, 0.2, 1000.0, 3.0]))
NONE = Relaxation(share=np.zeros(0), time_s=np.zeros(0))
ROUNDING = 1e-12
TIMES = np.array([0.0, 0.0, 0.3, 1.0, 4.0, 20.0])


def test_creep_of_the_standard_linear_solid() -> None:
    creep = SOLID.creep()
    assert creep.share == pytest.approx([G / (1.0 - G)], rel=ROUNDING)
    assert creep.time_s == pytest.approx([TAU / (1.0 - G)], rel=ROUNDING)
    stepped = felt_force(creep, TIMES, np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0]))
    known = 1.0 + G / (1.0 - G) * (1.0 - np.exp(-TIMES * (1.0 - G) / TAU))
    assert stepped[1:] == pytest.approx(known[1:], rel=ROUNDING)


def test_a_ramp_on_the_standard_linear_solid() -> None:
    t, late = TIMES[1:], TAU / (1.0 - G)
    known = t + G / (1.0 - G) * (t - late * (1.0 - np.exp(-t / late)))
    assert felt_force(SOLID.creep(), t, t) == pytest.approx(known, rel=1e-11)


def test_a_step_of_depth_relaxes_as_the_modulus() -> None:
    held = force_under_depth(MANY, TIMES, np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0]))
    fading = 1.0 - np.exp(-TIMES[1:, None] / MANY.time_s)
    assert held.force_N[1:] == pytest.approx(1.0 - fading @ MANY.share, rel=ROUNDING)


def test_a_ramp_of_depth_on_the_standard_linear_solid() -> None:
    t = TIMES[1:]
    known = t - G * (t - TAU * (1.0 - np.exp(-t / TAU)))
    assert force_under_depth(SOLID, t, t).force_N == pytest.approx(known, rel=1e-11)


@pytest.mark.parametrize("s", [1e-4, 0.03, 1.0, 40.0, 1e4])
def test_transforms_are_inverse(s: float) -> None:
    """s² L[J] L[G] = 1: the two hereditary integrals undo each other at every frequency."""
    creep = MANY.creep()
    modulus = 1.0 / s - np.sum(MANY.share * (1.0 / s - 1.0 / (s + 1.0 / MANY.time_s)))
    compliance = 1.0 / s + np.sum(creep.share * (1.0 / s - 1.0 / (s + 1.0 / creep.time_s)))
    assert s * s * modulus * compliance == pytest.approx(1.0, rel=1e-11)
    assert (creep.share > 0.0).all()
    assert (creep.time_s > 0.0).all()


def _wobble(count: int) -> tuple[FloatArray, FloatArray]:
    """Times and a force that grows, with two columns of different course."""
    t = np.linspace(0.0, 30.0, count)
    return t, np.column_stack([t * (2.0 + np.sin(t)), 5.0 * (1.0 - np.cos(0.2 * t))])


def test_creep_and_relaxation_undo_each_other() -> None:
    """Force to felt force and back; between nodes the felt force is not linear: second order."""
    errors = []
    for count in (101, 201, 401):
        t, force = _wobble(count)
        felt = felt_force(MANY.creep(), t, force)
        errors.append(float(np.abs(force_under_depth(MANY, t, felt).force_N - force).max()))
    rates = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert errors[-1] < 1e-2
    assert (rates > 1.7).all()


def test_more_times_on_straight_pieces_change_nothing() -> None:
    t, force = _wobble(11)
    fine = np.linspace(0.0, 30.0, 201)
    drawn = np.column_stack([np.interp(fine, t, force[:, k]) for k in range(2)])
    creep = MANY.creep()
    coarse = felt_force(creep, t, force)
    assert felt_force(creep, fine, drawn)[::20] == pytest.approx(coarse, rel=1e-11)
    held = force_under_depth(MANY, t, force).force_N
    assert force_under_depth(MANY, fine, drawn).force_N[::20] == pytest.approx(held, rel=1e-11)


@pytest.mark.parametrize("span", [1e-9, 1e9])
def test_steps_far_shorter_and_longer_than_every_time(span: float) -> None:
    """At once the wall is stiff, in the end it has its long-term modulus."""
    creep = MANY.creep()
    stiffness = 1.0 if span < 1.0 else 1.0 - float(MANY.share.sum())
    times = span * np.array([0.0, 0.5, 1.0])
    felt = felt_force(creep, times, np.array([0.0, 1.0, 1.0]))
    assert felt[-1] == pytest.approx(1.0 / stiffness, rel=1e-5)
    held = force_under_depth(MANY, times, np.array([0.0, 1.0, 1.0]))
    assert held.force_N[-1] == pytest.approx(stiffness, rel=1e-5)


def test_an_elastic_wall_remembers_nothing() -> None:
    t, force = _wobble(9)
    assert (felt_force(NONE.creep(), t, force) == force).all()
    held = force_under_depth(NONE, t, force)
    assert (held.force_N == force).all()
    assert (held.felt_N == force).all()
    cycles = felt_cycles(NONE.creep(), t, force[:, 0], np.array([0, 7]))
    assert (cycles == force[:, 0]).all()


CYCLE = np.array([0.0, 0.5, 1.5, 2.0, 3.0])
SHAPE = np.array([0.0, 1.0, 1.0, 0.0, 0.0])
CHOSEN = np.array([0, 1, 13, 40])


def _unrolled(count: int, parts: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Nodes of one cycle, and times and shape of ``count`` cycles, one after the other."""
    nodes = np.linspace(0.0, 4.0, 4 * parts + 1)
    one = np.interp(nodes, np.arange(5.0), CYCLE)
    shape = np.interp(nodes, np.arange(5.0), SHAPE)
    times = np.add.outer(3.0 * np.arange(count), one).ravel()
    return one, times, np.tile(shape, count)


def test_chosen_cycles_are_those_of_the_whole_history() -> None:
    one, times, force = _unrolled(41, 2)
    whole = felt_force(MANY.creep(), times, force).reshape(41, -1)
    found = felt_cycles(MANY.creep(), one, force[: len(one)], CHOSEN)
    assert found == pytest.approx(whole[CHOSEN], rel=1e-11, abs=1e-13)
    held = force_under_depth(MANY, times, force)
    some = force_under_cycles(MANY, one, force[: len(one)], CHOSEN)
    assert some.felt_N == pytest.approx(held.felt_N.reshape(41, -1)[CHOSEN], rel=1e-11)
    assert some.force_N == pytest.approx(held.force_N.reshape(41, -1)[CHOSEN], rel=1e-9, abs=1e-13)


def test_an_indenter_drawn_back_fast_leaves_a_wall_that_recovers_freely() -> None:
    """Its own force history, put through the hereditary integral, gives the felt force again."""
    _, times, depth = _unrolled(3, 256)
    held = force_under_depth(MANY, times, depth)
    assert (held.force_N >= 0.0).all()
    assert (held.felt_N >= depth).all()
    free = held.felt_N > depth
    assert free.any()
    assert (held.force_N[free] == 0.0).all()
    again = felt_force(MANY.creep(), times, held.force_N)
    assert np.abs(again - held.felt_N).max() < 2e-3
    rest = (times > 2.1) & (times < 3.0)
    assert (held.force_N[rest] == 0.0).all()
    assert (held.felt_N[rest] > 0.01).all()
    assert (np.diff(held.felt_N[rest]) < 0.0).all()


def test_switches_remember() -> None:
    on, off = np.array([0.5, 0.5]), np.array([0.4, 0.0])
    state = np.zeros(2, dtype=np.bool_)
    seen = []
    for force in (0.45, 0.5, 0.51, 0.45, 0.4, 0.39, 0.45, 0.6, 0.0, 0.3):
        state = switch_step(state, np.full(2, force), on, off)
        seen.append(state.tolist())
    assert [first for first, _ in seen] == [0, 0, 1, 1, 1, 0, 0, 1, 0, 0]
    # A bowl without release force still springs back when nothing presses it.
    assert [second for _, second in seen] == [0, 0, 1, 1, 1, 1, 1, 1, 0, 0]


def test_light_fades_to_its_share() -> None:
    light = light_at(np.array([0.0, 600.0, 1e9]), 0.05, 600.0)
    assert light == pytest.approx([1.0, 1.0 - 0.05 * (1.0 - np.exp(-1.0)), 0.95], rel=ROUNDING)


def test_times_must_grow() -> None:
    creep = Creep(share=np.array([0.1]), time_s=np.array([1.0]))
    with refused("force-history-order"):
        felt_force(creep, np.array([0.0, 2.0, 1.0]), np.zeros(3))
    with refused("force-history-order"):
        force_under_depth(SOLID, np.array([0.0, 2.0, 1.0]), np.zeros(3))
