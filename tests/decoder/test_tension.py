"""What contacts on one flat wall do to each other; and where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from decoder.contact_fit import State, explain, start
from decoder.places import Places
from decoder.tension import powers_of, shared_N
from shapes.arrays import FloatArray
from tests.decoder.flat_sensor import (
    flat_locator,
    flat_places,
    nearest,
    per_newton,
    shifts,
    stretches,
    together,
)

LOCATOR = flat_locator()
ONE, TWO = np.array([18.0, 21.0, 0.0]), np.array([42.0, 36.0, 0.0])


def bent(radius_mm: float) -> Places:
    """The same places on a cylinder about an axis along the first tangent."""
    flat = flat_places()
    turn = (flat.point_mm[:, 1] - 30.0) / radius_mm
    zero, sin, cos = np.zeros(len(turn)), np.sin(turn), np.cos(turn)
    point = np.column_stack([flat.point_mm[:, 0], radius_mm * sin, radius_mm * cos])
    return replace(flat, point_mm=point, around=np.column_stack([zero, cos, -sin]))


def folded(places: Places) -> Places:
    """The same wall twice, the second at a right angle to it and far away."""
    point, along, around = places.point_mm, places.along, places.around
    aside = np.column_stack([point[:, 0], np.full(len(point), -40.0), point[:, 1]])
    up = np.tile([0.0, 0.0, 1.0], (len(point), 1))
    return replace(
        places,
        point_mm=np.concatenate([point, aside]),
        along=np.concatenate([along, along]),
        around=np.concatenate([around, up]),
        shift_px=np.concatenate([places.shift_px, places.shift_px]),
    )


def stretch_N(places: Places, at: list[FloatArray], forces: list[float]) -> FloatArray:
    return shared_N(places, states(places, at, forces))[0]


def states(places: Places, at: list[FloatArray], forces: list[float]) -> list[State]:
    return [start(places, LOCATOR.prior, p, f) for p, f in zip(at, forces, strict=True)]


def test_a_flat_wall_is_stretched_by_all_that_press_on_it() -> None:
    places = flat_places()
    assert places.flat.all()
    assert stretch_N(places, [ONE], [7.0]) == pytest.approx([7.0])
    at, forces = list(places.point_mm[[200, 420]]), [6.0, 8.0]
    each = np.stack([per_newton(one) for one in at])
    assert stretch_N(places, at, forces) == pytest.approx(stretches(each, np.array(forces)))
    # Far apart, and alike: the squares add up.
    far = [np.array([10.0, 10.0, 0.0]), np.array([50.0, 50.0, 0.0])]
    assert stretch_N(places, far, forces) == pytest.approx([10.0, 10.0], rel=0.05)
    # In one place: the forces do.
    assert stretch_N(places, [ONE, ONE], forces) == pytest.approx([14.0, 14.0])


def test_beside_a_clamped_edge_a_newton_stretches_less() -> None:
    places = flat_places()
    near = places.point_mm[:, 0] < 25.0
    rows = np.where(near[:, None, None], 0.2 * places.shift_px, places.shift_px)
    edge, middle = stretch_N(replace(places, shift_px=rows), [ONE, TWO], [8.0, 6.0])
    assert middle == pytest.approx(np.hypot(6.0, 0.2 * 8.0), rel=0.1)
    assert edge == pytest.approx(5.0 * middle, rel=0.1)


def test_growth_is_that_of_the_stretch() -> None:
    places = flat_places()
    at = [ONE, ONE + np.array([5.0, 2.5, 0.0]), TWO]
    forces = np.array([6.0, 9.0, 4.0])
    stretch, grows = shared_N(places, states(places, at, forces.tolist()))
    for k in range(3):
        step = np.where(np.arange(3) == k, 1e-4, 0.0)
        up, down = (stretch_N(places, at, (forces + s * step).tolist())[k] for s in (1.0, -1.0))
        assert grows[k] == pytest.approx(forces[k] / stretch[k] * (up - down) / 2e-4, rel=0.01)


def test_a_curved_wall_is_not() -> None:
    places = bent(30.0)
    assert not places.flat.any()
    at = [places.point_mm[200], places.point_mm[400]]
    assert stretch_N(places, at, [6.0, 8.0]) == pytest.approx([6.0, 8.0])
    # Two on one line of its axis look the same way, and that wall is curved all the same.
    line = np.flatnonzero(places.point_mm[:, 1] == places.point_mm[200, 1])[[0, -1]]
    at = list(places.point_mm[line])
    assert stretch_N(places, at, [6.0, 8.0]) == pytest.approx([6.0, 8.0])
    assert bent(1e5).flat.all()


def test_each_wall_of_a_box_stretches_alone() -> None:
    places = folded(flat_places())
    assert places.flat.all()
    aside = np.array([30.0, -40.0, 30.0])
    found = stretch_N(places, [ONE, aside, TWO], [6.0, 5.0, 8.0])
    one, two = stretch_N(places, [ONE, TWO], [6.0, 8.0])
    assert found == pytest.approx([one, 5.0, two])


def test_forces_that_stretch_a_wall_together_are_read_right() -> None:
    koi = np.array(sorted([nearest(ONE), nearest(TWO)]))
    seen = together([ONE, TWO], [20.0, 4.0]).reshape(-1, 2)
    found = LOCATOR.find(seen, koi)
    forces = sorted(contact.force_N for contact in found.contacts)
    assert forces == pytest.approx([4.0, 20.0], rel=0.01)
    # As if each stretched the wall alone the weak one is read a seventh too large.
    naive = shifts(ONE, 20.0) + shifts(TWO, 4.0)
    weak = min(c.force_N for c in LOCATOR.find(naive.reshape(-1, 2), koi).contacts)
    assert weak < 3.6


@pytest.mark.parametrize(("stretch", "top"), [(None, np.inf), (13.0, np.inf), (13.0, 10.0)])
def test_slopes_are_those_of_the_shifts(stretch: float | None, top: float) -> None:
    places = flat_places()
    (state,) = states(places, [ONE + 0.3], [9.0])

    def at(force: float) -> FloatArray:
        moved = state.copy()
        moved.x[0] = force
        # What stretches besides stays; its own part grows.
        others = 0.0 if stretch is None else stretch**2 - 81.0
        root = None if stretch is None else float(np.sqrt(others + force**2))
        return explain(moved, places.orders, stretch_N=root, top_N=top)[0]

    numeric = (at(9.01) - at(8.99)) / 0.02
    grows = 1.0 if stretch is None else 81.0 / stretch**2
    exact = explain(state, places.orders, stretch_N=stretch, grows=grows, top_N=top)[1][0]
    assert exact == pytest.approx(numeric, rel=1e-3, abs=1e-4 * np.abs(exact).max())


def test_beyond_the_tables_the_response_goes_on_as_it_does_there() -> None:
    """A membrane's response per newton falls by the power 2/3; powers of the force run away."""
    forces = 25.0 * np.arange(1, 4) / 3.0
    law = (1.0 + forces / 5.0) ** (-2.0 / 3.0)
    powers = np.linalg.solve(forces[:, None] ** np.arange(1, 4), law - 1.0)
    rows = np.outer(np.append(1.0, powers), np.ones(6)).astype(np.float32)

    def at(stretch: float, top: float) -> float:
        factors, _ = powers_of(rows, stretch, top)
        return float((factors @ rows)[0])

    assert at(20.0, 25.0) == at(20.0, np.inf)
    assert at(27.5 + 1e-9, 25.0) == pytest.approx(at(27.5, 25.0))
    true = (1.0 + 50.0 / 5.0) ** (-2.0 / 3.0)
    assert at(50.0, 25.0) == pytest.approx(true, rel=0.1)
    assert abs(at(50.0, np.inf) / true - 1.0) > 1.0
    # What softens goes on softening.
    soft = np.array([[1.0], [0.02]], dtype=np.float32)
    factors, grows = powers_of(soft, 40.0, 25.0)
    assert (factors @ soft)[0] == pytest.approx(1.0 + 0.02 * 40.0, rel=0.05)
    assert 0.0 < grows[0] < 1.0
    # And nothing falls faster than a force that moves no more.
    none = np.array([[1.0], [-0.04]], dtype=np.float32)
    assert powers_of(none, 50.0, 25.0)[1] == pytest.approx(-1.0)
