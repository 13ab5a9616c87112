"""What contacts on one flat wall do to each other; and where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from phytac_decoder.estimation.contact_fit import initial_state
from phytac_decoder.estimation.contact_shifts import (
    ContactState,
    changed_by_others,
    predicted_shifts,
)
from phytac_decoder.mechanics.membrane_stretching import BergerWall, lost_softness, order_factors
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import (
    RADIUS_MM,
    SOFTENING,
    flat_locator,
    flat_places,
    nearest,
    per_newton,
    together,
)

ONE, TWO, THREE = (np.array(at) for at in ([18.0, 21.0, 0.0], [42.0, 36.0, 0.0], [24.0, 39.0, 0.0]))
ASIDE = np.array([0.4, 0.3, 0.0])
PER_PX = 0.02
"""Slopes of the wall over the shifts of a newton: then 20 N take a fifth of its softness."""
MOST = 0.8


def walled(places: ResponseTable, wall: int = 0) -> ResponseTable:
    """Places on a wall that slopes as its markers move, of one mode: both go by 1 - v."""
    first = places.shift_px[:, 0]
    slope = np.float32(PER_PX) * first
    return replace(
        places,
        shift_px=np.concatenate([places.shift_px, -first[:, None]], axis=1),
        walls=BergerWall(
            wall=np.full(len(first), wall), slopes=np.stack([slope, -slope], axis=1), most=MOST
        ),
    )


PLACES = walled(flat_places())
LOCATOR = replace(flat_locator(), places=PLACES)


def share(at: list[FloatArray], forces: list[float]) -> float:
    """Softness lost under loads, by its equation."""
    slope = PER_PX * sum(f * per_newton(p) for p, f in zip(at, forces, strict=True))
    square = float(slope @ slope)
    return float(brentq(lambda v: v - (1.0 - v) ** 3 * square, 0.0, 1.0, xtol=1e-14))


def closed_form(at: list[FloatArray], forces: list[float]) -> FloatArray:
    """Shifts (2n,) px of loads on the wall at once."""
    more = [share(at, forces) - share([p], [f]) for p, f in zip(at, forces, strict=True)]
    return np.sum(
        [
            f * (1.0 + SOFTENING * f - lost) * per_newton(p)
            for p, f, lost in zip(at, forces, more, strict=True)
        ],
        axis=0,
    )


def states(places: ResponseTable, at: list[FloatArray], forces: list[float]) -> list[ContactState]:
    return [initial_state(places, LOCATOR.prior, p, f) for p, f in zip(at, forces, strict=True)]


def total(places: ResponseTable, pressed: list[ContactState]) -> FloatArray:
    return np.sum([shifts for shifts, _ in predicted_shifts(places, pressed)], axis=0)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_flat_wall_is_stretched_by_all_that_press_on_it(count: int) -> None:
    at, forces = [ONE + ASIDE, TWO, THREE][:count], [12.0, 20.0, 6.0][:count]
    found, true = total(PLACES, states(PLACES, at, forces)), closed_form(at, forces)
    np.testing.assert_allclose(found, true, atol=2e-3 * np.abs(true).max())
    alone = together(at, forces)
    assert (np.linalg.norm(alone - true) > 0.05 * np.linalg.norm(true)) == (count > 1)


def test_slopes_are_those_of_the_shifts_of_all() -> None:
    """A force stiffens the wall for the others, which counts as its own slope."""
    pressed = states(PLACES, [ONE + ASIDE, TWO, THREE - ASIDE], [12.0, 20.0, 6.0])
    pressed[1].x[3:6] = (2.0, -1.0, 1.5)
    steps = np.array([1e-2, 1e-2, 1e-2, 0.1, 0.1, 0.1])
    for k, (_, slope) in enumerate(predicted_shifts(PLACES, pressed)):
        for unknown, step in enumerate(steps):
            sides = []
            for sign in (1.0, -1.0):
                moved = [one.copy() for one in pressed]
                moved[k].x[unknown] += sign * step
                sides.append(total(PLACES, moved))
            numeric = (sides[0] - sides[1]) / (2.0 * step)
            np.testing.assert_allclose(
                slope[unknown], numeric, atol=2e-3 * np.abs(numeric).max(), err_msg=f"{k} {unknown}"
            )


def test_forces_that_stretch_a_wall_together_are_read_right() -> None:
    koi = np.array(sorted([nearest(ONE), nearest(TWO)]))
    seen = closed_form([ONE, TWO], [20.0, 8.0]).reshape(-1, 2)
    forces = sorted(contact.force_N for contact in LOCATOR.find(seen, koi).contacts)
    assert forces == pytest.approx([8.0, 20.0], rel=0.01)
    # As if each pressed a wall of its own the weak one is read a seventh too small.
    naive = min(contact.force_N for contact in flat_locator().find(seen, koi).contacts)
    assert naive < 7.0


def test_each_wall_of_a_box_stretches_alone() -> None:
    flat = flat_places()
    point, along, around = flat.point_mm, flat.along, flat.around
    aside = np.column_stack([point[:, 0], np.full(len(point), -40.0), point[:, 1]])
    up = np.tile([0.0, 0.0, 1.0], (len(point), 1))
    box = ResponseTable(
        point_mm=np.concatenate([point, aside]),
        along=np.concatenate([along, along]),
        around=np.concatenate([around, up]),
        shift_px=np.concatenate([flat.shift_px, flat.shift_px]),
        radius_mm=RADIUS_MM,
    )
    both = walled(box)
    assert both.walls is not None
    number = np.repeat([0, 1], len(point))
    both = replace(both, walls=replace(both.walls, wall=number))
    third = np.array([30.0, -40.0, 30.0])
    parts = predicted_shifts(both, states(both, [ONE, third, TWO], [12.0, 15.0, 20.0]))
    one, two = predicted_shifts(both, states(both, [ONE, TWO], [12.0, 20.0]))
    (alone,) = predicted_shifts(both, states(both, [third], [15.0]))
    for found, wanted in zip(parts, (one, alone, two), strict=True):
        # To rounding: processors add 32-bit numbers in different orders.
        np.testing.assert_allclose(found[0], wanted[0], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(found[1], wanted[1], rtol=1e-5, atol=1e-6)
    # Near its edge only the wall's own places give its slopes.
    assert both.walls is not None
    near = np.append(np.arange(19), len(point))
    weights = np.ones((10, 20), dtype=np.float32)
    whole = both.walls.cubic(near, weights, 0)
    np.testing.assert_allclose(whole[0], both.walls.slopes[:19].sum(axis=0), rtol=1e-5)


def test_a_place_on_no_wall_answers_alone() -> None:
    off = walled(flat_places(), wall=-1)
    at, forces = [ONE, TWO], [12.0, 20.0]
    np.testing.assert_allclose(
        total(off, states(off, at, forces)),
        total(flat_places(), states(flat_places(), at, forces)),
        rtol=1e-5,
        atol=1e-6,
    )


def bent(radius_mm: float) -> ResponseTable:
    """The same places on a cylinder about an axis along the first tangent."""
    flat = flat_places()
    turn = (flat.point_mm[:, 1] - 30.0) / radius_mm
    zero, sin, cos = np.zeros(len(turn)), np.sin(turn), np.cos(turn)
    point = np.column_stack([flat.point_mm[:, 0], radius_mm * sin, radius_mm * cos])
    return replace(flat, point_mm=point, around=np.column_stack([zero, cos, -sin]))


def test_a_curved_wall_is_not_flat() -> None:
    """Two places on one line of its axis look the same way, and it is curved all the same."""
    assert flat_places().flat.all()
    assert not bent(30.0).flat.any()
    assert bent(1e5).flat.all()


def test_a_stiffer_sensor_stretches_under_more() -> None:
    stiffer = PLACES.scaled(1.3)
    at, forces = [ONE, TWO], [12.0, 20.0]
    found = total(stiffer, states(stiffer, at, [1.3 * f for f in forces]))
    wanted = total(PLACES, states(PLACES, at, forces))
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5)


def unlost(v: float, slopes: FloatArray) -> float:
    """Residual of the equation of v."""
    return v - (1.0 - v) * float(np.sum((v ** np.arange(len(slopes)) @ slopes) ** 2))


def test_softness_is_lost_by_its_equation() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        slopes = rng.normal(size=(1, 5)) * np.exp(rng.uniform(-4.0, 1.0))
        # What is stiffer slopes less, and not by a straight line.
        slopes = np.concatenate([slopes, -0.7 * slopes, 0.2 * slopes])
        true = brentq(unlost, 0.0, 1.0, args=(slopes,), xtol=1e-15)
        lost, grows = lost_softness(slopes, 0.95)
        assert lost == pytest.approx(min(true, 0.95), rel=1e-9)
        sides = [lost_softness(np.sqrt(1.0 + s) * slopes, 0.95)[0] for s in (1e-3, -1e-3)]
        square = np.sum((lost ** np.arange(3) @ slopes) ** 2)
        assert grows * square == pytest.approx((sides[0] - sides[1]) / 2e-3, rel=1e-4, abs=1e-9)
    assert lost_softness(np.zeros((2, 3)), 0.8)[0] == 0.0
    # As far as the tables go, and no farther.
    assert lost_softness(np.array([[1e6], [0.0]]), 0.8) == (0.8, 0.0)


def test_beyond_the_tables_the_response_is_extrapolated_by_a_power_law() -> None:
    """A membrane's response per newton falls by the power 2/3; powers of the force run away."""
    forces = 25.0 * np.arange(1, 4) / 3.0
    law = (1.0 + forces / 5.0) ** (-2.0 / 3.0)
    powers = np.linalg.solve(forces[:, None] ** np.arange(1, 4), law - 1.0)
    rows = np.outer(np.append(1.0, powers), np.ones(6)).astype(np.float32)

    def at(force: float, top: float) -> float:
        factors, _ = order_factors(rows, force, top)
        return float((factors @ rows)[0])

    assert at(20.0, 25.0) == at(20.0, np.inf)
    assert at(27.5 + 1e-9, 25.0) == pytest.approx(at(27.5, 25.0))
    true = (1.0 + 50.0 / 5.0) ** (-2.0 / 3.0)
    assert at(50.0, 25.0) == pytest.approx(true, rel=0.1)
    assert abs(at(50.0, np.inf) / true - 1.0) > 1.0
    # What softens softens further.
    soft = np.array([[1.0], [0.02]], dtype=np.float32)
    factors, grows = order_factors(soft, 40.0, 25.0)
    assert (factors @ soft)[0] == pytest.approx(1.0 + 0.02 * 40.0, rel=0.05)
    assert 0.0 < grows[0] < 1.0
    # And nothing falls faster than a force that moves no more.
    none = np.array([[1.0], [-0.04]], dtype=np.float32)
    assert order_factors(none, 50.0, 25.0)[1] == pytest.approx(-1.0)


@pytest.mark.parametrize("top", [np.inf, 10.0])
def test_slopes_of_one_contact_are_those_of_its_shifts(top: float) -> None:
    places = replace(flat_places(), top_N=top)
    (state,) = states(places, [ONE + ASIDE], [13.0])

    def at(force: float) -> FloatArray:
        moved = state.copy()
        moved.x[0] = force
        return total(places, [moved])

    numeric = (at(13.01) - at(12.99)) / 0.02
    exact = predicted_shifts(places, [state])[0][1][0]
    assert exact == pytest.approx(numeric, rel=1e-3, abs=1e-4 * np.abs(exact).max())


def test_what_a_wall_does_to_its_contacts_is_no_interaction_of_tables() -> None:
    pressed = states(PLACES, [ONE, TWO], [8.0, 12.0])
    each_px = [shifts for shifts, _ in predicted_shifts(PLACES, pressed)]
    alone = [predicted_shifts(PLACES, [one])[0][0] for one in pressed]
    assert np.abs(np.subtract(each_px, alone)).max() > 0.1
    assert (changed_by_others(PLACES, pressed, each_px) == 0.0).all()
