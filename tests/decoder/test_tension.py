"""What contacts on one flat wall do to each other; and where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from decoder.contact_fit import State, explain, start
from decoder.places import Places
from decoder.tension import shared_N
from shapes.arrays import FloatArray
from tests.decoder.flat_sensor import flat_locator, flat_places, nearest, shifts, together

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


def states(places: Places, at: list[FloatArray], forces: list[float]) -> list[State]:
    return [start(places, LOCATOR.prior, p, f) for p, f in zip(at, forces, strict=True)]


def test_a_flat_wall_is_stretched_by_all_that_press_on_it() -> None:
    places = flat_places()
    assert places.flat.all()
    assert shared_N(places, states(places, [ONE], [7.0])) == pytest.approx([7.0])
    both = shared_N(places, states(places, [ONE, TWO], [6.0, 8.0]))
    assert both == pytest.approx([10.0, 10.0])


def test_a_curved_wall_is_not() -> None:
    places = bent(30.0)
    assert not places.flat.any()
    at = [places.point_mm[200], places.point_mm[400]]
    assert shared_N(places, states(places, at, [6.0, 8.0])) == pytest.approx([6.0, 8.0])
    # Two on one line of its axis look the same way, and that wall is curved all the same.
    line = np.flatnonzero(places.point_mm[:, 1] == places.point_mm[200, 1])[[0, -1]]
    at = list(places.point_mm[line])
    assert shared_N(places, states(places, at, [6.0, 8.0])) == pytest.approx([6.0, 8.0])
    assert bent(1e5).flat.all()


def test_each_wall_of_a_box_stretches_alone() -> None:
    places = folded(flat_places())
    assert places.flat.all()
    aside = np.array([30.0, -40.0, 30.0])
    found = shared_N(places, states(places, [ONE, aside, TWO], [6.0, 5.0, 8.0]))
    assert found == pytest.approx([10.0, 5.0, 10.0])


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


@pytest.mark.parametrize("stretch", [None, 13.0])
def test_slopes_are_those_of_the_shifts(stretch: float | None) -> None:
    places = flat_places()
    (state,) = states(places, [ONE + 0.3], [9.0])

    def at(force: float) -> FloatArray:
        moved = state.copy()
        moved.x[0] = force
        # What stretches besides stays; its own part grows.
        others = 0.0 if stretch is None else stretch**2 - 81.0
        root = None if stretch is None else float(np.sqrt(others + force**2))
        return explain(moved, places.orders, root)[0]

    numeric = (at(9.01) - at(8.99)) / 0.02
    exact = explain(state, places.orders, stretch)[1][0]
    assert exact == pytest.approx(numeric, rel=1e-3, abs=1e-4 * np.abs(exact).max())
