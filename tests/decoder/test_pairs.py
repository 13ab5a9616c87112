"""Contacts that soften each other, on a sensor in closed form."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from decoder.contact_fit import Prior, start
from decoder.locate import Found, Locator
from decoder.pairs import MOST, ROWS, Pairs, mixed_off_N
from shapes.arrays import FloatArray
from tests.decoder.flat_sensor import (
    flat_locator,
    flat_places,
    nearest,
    per_newton,
    shifts,
)

REACH_MM = 25.0
STEP_MM = 0.05
PUSHED_MM = 0.05


def soft(one_mm: FloatArray, two_mm: FloatArray) -> float:
    """By how much of itself a newton on one changes the shifts by the other, 1/N."""
    return 0.01 * float(np.exp(-np.sum((one_mm - two_mm) ** 2) / REACH_MM**2))


def slope(point_mm: FloatArray) -> FloatArray:
    """Change of a newton's shifts as it moves along x and y, (2, 2n) px/mm."""
    ways = STEP_MM * np.eye(3)[:2]
    return np.stack(
        [(per_newton(point_mm + w) - per_newton(point_mm - w)) / (2 * STEP_MM) for w in ways]
    )


def pushed(point_mm: FloatArray) -> FloatArray:
    """A newton's shifts (2n,) a little along x."""
    return np.asarray(per_newton(point_mm) + PUSHED_MM * slope(point_mm)[0])


def mixed(one_mm: FloatArray, two_mm: FloatArray) -> FloatArray:
    """M (2n,), px/N²: both seem stronger, and pushed along x."""
    return np.asarray(soft(one_mm, two_mm) * (pushed(one_mm) + pushed(two_mm)))


@cache
def pairs(step_mm: float = 7.5) -> Pairs:
    grid = flat_places(step_mm)
    points = grid.point_mm
    there = np.stack([pushed(point) for point in points])
    rows = np.zeros((len(points), ROWS, len(points)))
    for i, one in enumerate(points):
        own = np.concatenate([per_newton(one)[None], slope(one)])
        much = np.array([soft(one, two) for two in points])
        rows[i, :3] = own @ (there[i] + there).T * much / (own[0] @ own[0])
    return Pairs(grid=replace(grid, shift_px=rows.astype(np.float32)))


def aware(locator: Locator) -> Locator:
    return replace(locator, places=locator.places.with_rows(locator.places.shift_px, pairs()))


def pressed(at: list[FloatArray], force_N: list[float]) -> FloatArray:
    """Shifts (2n,) px of contacts at once."""
    total = np.sum([shifts(p, f) for p, f in zip(at, force_N, strict=True)], axis=0)
    for i in range(len(at)):
        for k in range(i):
            total = total + force_N[i] * force_N[k] * mixed(at[i], at[k])
    return np.asarray(total)


def forces(found: Found) -> FloatArray:
    order = np.argsort([contact.point_mm[0] for contact in found.contacts])
    return np.array([found.contacts[k].force_N for k in order])


PRESSES = [
    ([(20.0, 20.0, 0.0), (38.0, 31.0, 0.0)], [6.0, 15.0]),
    ([(14.0, 30.0, 0.0), (30.0, 22.0, 0.0), (47.0, 35.0, 0.0)], [12.0, 4.0, 9.0]),
]


@pytest.mark.parametrize(("at", "force_N"), PRESSES)
def test_contacts_at_once_no_longer_take_each_others_force(
    at: list[tuple[float, float, float]], force_N: list[float]
) -> None:
    points = [np.array(p) for p in at]
    koi = np.array(sorted({nearest(p) for p in points}))
    seen = pressed(points, force_N).reshape(-1, 2)
    plain = flat_locator()
    naive = np.abs(forces(plain.find(seen, koi)) / force_N - 1.0)
    told = np.abs(forces(aware(plain).find(seen, koi)) / force_N - 1.0)
    assert naive.max() > 0.04
    assert told.max() < 0.012
    assert told.max() < 0.2 * naive.max()


def test_one_contact_is_told_as_before() -> None:
    at = np.array([31.0, 28.0, 0.0])
    seen, koi = shifts(at, 9.0).reshape(-1, 2), np.array([nearest(at)])
    plain = flat_locator()
    assert forces(aware(plain).find(seen, koi)) == forces(plain.find(seen, koi))


def test_a_stiffer_sensor_needs_more_force_for_the_same() -> None:
    """d(f) of tables scaled by k is d(f / k): k times the forces, and k times what they are off."""
    plain = aware(flat_locator()).places
    k = 1.3
    stiff = plain.scaled(k)
    assert plain.pairs is not None
    assert stiff.pairs is not None
    off = []
    for places, own, scale in ((plain, plain.pairs, 1.0), (stiff, stiff.pairs, k)):
        at = [np.array([20.0, 20.0, 0.0]), np.array([38.0, 31.0, 0.0])]
        states = [
            start(places, Prior(place_mm=1e3), p, scale * f)
            for p, f in zip(at, (6.0, 15.0), strict=True)
        ]
        off.append(mixed_off_N(own, places, states, 1e-6) / scale)
    assert off[0][0] > 0.3
    np.testing.assert_allclose(off[1], off[0], rtol=1e-4)


def test_rows_between_places_are_a_cubic_in_both() -> None:
    grid = flat_places(7.5)

    def value(one: FloatArray, two: FloatArray) -> FloatArray:
        x, y = one[..., 0] / 30.0, two[..., 1] / 30.0
        return np.asarray((x**3 - x) * (1.0 + y**2) + y**3 - one[..., 1] * two[..., 0] / 900.0)

    points = grid.point_mm
    rows = np.zeros((len(points), ROWS, len(points)), dtype=np.float32)
    rows[:, 2] = value(points[:, None], points[None])
    table = Pairs(grid=replace(grid, shift_px=rows))
    at = np.array([[21.3, 33.1, 0.0], [40.2, 18.7, 0.0], [11.0, 48.5, 0.0]])
    told = table.between(at)
    np.testing.assert_allclose(told[:, :, 2], value(at[:, None], at[None]), atol=2e-4)
    assert np.abs(told[:, :, [0, 1, 3]]).max() == 0.0


def test_no_contact_loses_more_than_a_share_of_its_force() -> None:
    places = aware(flat_locator()).places
    assert places.pairs is not None
    grid = places.pairs.grid
    wild = Pairs(grid=replace(grid, shift_px=50.0 * grid.shift_px))
    at = [np.array([20.0, 20.0, 0.0]), np.array([27.0, 20.0, 0.0])]
    states = [start(places, Prior(place_mm=1.0), p, 20.0) for p in at]
    off = mixed_off_N(wild, places, states, 0.02)
    assert np.abs(off).max() == pytest.approx(MOST * 20.0)


def test_a_linear_sensor_has_no_mixed_terms() -> None:
    assert aware(flat_locator()).linear.places.pairs is None


def test_pairs_need_no_slopes_where_places_are_known() -> None:
    """Centres that are known to the last bit leave the force alone to be off."""
    places = aware(flat_locator()).places
    assert places.pairs is not None
    at = [np.array([20.0, 20.0, 0.0]), np.array([52.0, 52.0, 0.0])]
    known = Prior(place_mm=1e-9)
    states = [start(places, known, p, f) for p, f in zip(at, (6.0, 15.0), strict=True)]
    off = mixed_off_N(places.pairs, places, states, 1.0)
    near, far = (places.pairs.between(np.stack(at))[i, 1 - i, 0] for i in (0, 1))
    rows = [per_newton(p) for p in at]
    gram = np.array([[a @ b for b in rows] for a in rows])
    seen = 90.0 * np.array([near * gram[0, 0], far * gram[1, 1]])
    np.testing.assert_allclose(off, np.linalg.solve(gram, seen), rtol=0.02)
