"""Contacts that soften each other, on a sensor in closed form."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.contact_fit import (
    ContactFit,
    ContactPrior,
    ShiftObservation,
    initial_state,
)
from phytac_decoder.estimation.contact_shifts import ContactState, centre_of, predicted_shifts
from phytac_decoder.estimation.locator import (
    SETTINGS,
    ContactLocator,
    _change_without_tentative_N,
)
from phytac_decoder.mechanics.interaction_table import (
    InteractionGrowth,
    InteractionTable,
    add_interactions,
    interaction_likeness,
)
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.training.marker_gain import apply_gain
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import (
    MARKERS,
    flat_locator,
    flat_places,
    nearest,
    per_newton,
    shifts,
    together,
)

REACH_MM = 25.0
PUSHED_MM = 0.05
AXES = 80
AT = [np.array([20.0, 20.0, 0.0]), np.array([38.0, 31.0, 0.0])]
FORCES_N = [6.0, 15.0]


def soft(one_mm: FloatArray, two_mm: FloatArray) -> float:
    """By how much of itself a newton on one changes the shifts by the other, 1/N."""
    return 0.01 * float(np.exp(-np.sum((one_mm - two_mm) ** 2) / REACH_MM**2))


def pushed(point_mm: FloatArray) -> FloatArray:
    """A newton's shifts (2n,) as if it stood a little along x."""
    return per_newton(point_mm + np.array([PUSHED_MM, 0.0, 0.0]))


def mixed(one_mm: FloatArray, two_mm: FloatArray) -> FloatArray:
    """M (2n,), px/N²: both seem stronger, and pushed along x."""
    return np.asarray(soft(one_mm, two_mm) * (pushed(one_mm) + pushed(two_mm)))


@cache
def pairs() -> InteractionTable:
    grid = flat_places(5.0)
    points = grid.point_mm
    there = np.stack([pushed(point) for point in points])
    much = np.array([[soft(one, two) for two in points] for one in points])
    images = much[:, :, None] * (there[:, None] + there[None])
    axes = np.linalg.svd(there, full_matrices=False)[2][:AXES]
    rows = (images @ axes.T).astype(np.float32)
    return InteractionTable(grid=replace(grid, shift_px=rows), axes_px=axes.astype(np.float32))


def aware(locator: ContactLocator) -> ContactLocator:
    return replace(locator, places=locator.places.with_rows(locator.places.shift_px, pairs=pairs()))


def pressed(at: list[FloatArray], force_N: list[float]) -> FloatArray:
    """Shifts (2n,) px of contacts at once."""
    total = np.sum([shifts(p, f) for p, f in zip(at, force_N, strict=True)], axis=0)
    for i in range(len(at)):
        for k in range(i):
            total = total + force_N[i] * force_N[k] * mixed(at[i], at[k])
    return np.asarray(total)


def states(
    places: ResponseTable, at: list[FloatArray] = AT, force_N: list[float] = FORCES_N
) -> list[ContactState]:
    prior = ContactPrior(place_mm=1e3)
    return [initial_state(places, prior, p, f) for p, f in zip(at, force_N, strict=True)]


def total(places: ResponseTable, found: list[ContactState]) -> FloatArray:
    return np.sum([one for one, _ in predicted_shifts(places, found)], axis=0)


def forces(found: ContactDetection) -> FloatArray:
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
    errors = np.abs(forces(aware(plain).find(seen, koi)) / force_N - 1.0)
    assert naive.max() > 0.04
    assert errors.max() < 0.004
    assert errors.max() < 0.1 * naive.max()


def test_one_contact_is_reported_as_before() -> None:
    at = np.array([31.0, 28.0, 0.0])
    seen, koi = shifts(at, 9.0).reshape(-1, 2), np.array([nearest(at)])
    plain = flat_locator()
    assert forces(aware(plain).find(seen, koi)) == forces(plain.find(seen, koi))


def test_mixed_terms_are_those_of_the_places_and_both_forces() -> None:
    places = aware(flat_locator()).places
    more = total(places, states(places)) - total(flat_locator().places, states(places))
    wanted = FORCES_N[0] * FORCES_N[1] * mixed(*AT)
    assert np.linalg.norm(more - wanted) < 0.02 * np.linalg.norm(wanted)


def test_slopes_by_forces_are_differences() -> None:
    places = aware(flat_locator()).places
    found = states(places)
    slopes = [slope[0] for _, slope in predicted_shifts(places, found)]
    for k, slope in enumerate(slopes):
        ends = []
        for step in (-0.01, 0.01):
            found[k].x[0] += step
            ends.append(total(places, found))
            found[k].x[0] -= step
        np.testing.assert_allclose(slope, (ends[1] - ends[0]) / 0.02, atol=2e-3)
        assert np.abs(slope).max() > 0.5


def test_a_stiffer_sensor_needs_more_force_for_the_same() -> None:
    """d(f) of tables scaled by k is d(f / k), with all that contacts do to each other."""
    plain = aware(flat_locator()).places
    k = 1.3
    stiff = plain.scaled(k)
    more = [k * force for force in FORCES_N]
    np.testing.assert_allclose(
        total(stiff, states(stiff, force_N=more)), total(plain, states(plain)), atol=1e-4
    )


def test_markers_show_mixed_terms_by_their_gains() -> None:
    plain = aware(flat_locator()).places
    gain = np.random.default_rng(0).normal(0.0, 0.1, (len(MARKERS), 2, 2))
    shown = apply_gain(plain, gain)
    before = total(plain, states(plain)).reshape(-1, 2)
    wanted = before + np.einsum("nij,nj->ni", gain, before)
    np.testing.assert_allclose(total(shown, states(shown)).reshape(-1, 2), wanted, atol=1e-4)


def test_coordinates_between_places_are_a_cubic_in_both() -> None:
    grid = flat_places(7.5)

    def value(one: FloatArray, two: FloatArray) -> FloatArray:
        x, y = one[..., 0] / 30.0, two[..., 1] / 30.0
        return np.asarray((x**3 - x) * (1.0 + y**2) + y**3 - one[..., 1] * two[..., 0] / 900.0)

    points = grid.point_mm
    rows = np.zeros((len(points), len(points), 4), dtype=np.float32)
    rows[:, :, 2] = value(points[:, None], points[None])
    axes = np.eye(4, 2 * len(MARKERS), dtype=np.float32)
    table = InteractionTable(grid=replace(grid, shift_px=rows), axes_px=axes)
    at = np.array([[21.3, 33.1, 0.0], [40.2, 18.7, 0.0], [11.0, 48.5, 0.0]])
    shifts_px = table.between(at)
    assert shifts_px.shape == (3, 2 * len(MARKERS))
    for image, (i, k) in zip(shifts_px, [(1, 0), (2, 0), (2, 1)], strict=True):
        assert image[2] == pytest.approx(value(at[i], at[k]), abs=2e-4)
        assert not np.delete(image, 2).any()


def test_mixed_terms_are_no_more_than_a_share_of_what_each_does_alone() -> None:
    places = aware(flat_locator()).places
    assert places.pairs is not None
    wild = replace(places.pairs, axes_px=50.0 * places.pairs.axes_px)
    at = [np.array([20.0, 20.0, 0.0]), np.array([27.0, 20.0, 0.0])]
    found = states(places, at, [20.0, 3.0])
    alone = [one for one, _ in predicted_shifts(flat_locator().places, found)]
    more = total(places.with_rows(places.shift_px, pairs=wild), found) - np.sum(alone, axis=0)
    assert np.linalg.norm(more) == pytest.approx(0.3 * np.linalg.norm(alone[1]), rel=1e-4)


def softer(softening: float, top_N: float = 25.0) -> ResponseTable:
    """Tables of a wall whose shifts beyond linear ones are f² / (1 - a·f), with interactions."""
    places = aware(flat_locator()).places
    forces = top_N * np.array([1.0, 2.0, 3.0]) / 3.0
    powers = np.linalg.solve(forces[:, None] ** np.arange(3), 1.0 / (1.0 - softening * forces))
    more = places.shift_px[:, 1:2] * powers[:, None].astype(np.float32)
    return places.with_rows(np.concatenate([places.shift_px[:, :1], more], axis=1), top_N=top_N)


@pytest.mark.parametrize("softening", [0.0, 0.005, 0.012, 0.02])
def test_softening_is_that_of_the_shifts(softening: float) -> None:
    np.testing.assert_allclose(softer(softening).softening, softening, rtol=0.06, atol=1e-6)


def test_walls_that_stiffen_or_have_two_powers_do_not_soften() -> None:
    assert not softer(-0.01).softening.any()
    assert not aware(flat_locator()).places.softening.any()
    assert not replace(softer(0.012), top_N=np.inf).softening.any()
    places = softer(0.012)
    still = places.with_rows(places.shift_px * np.array([1, 0, 0, 0], dtype=np.float32)[:, None])
    assert not still.softening.any()
    assert not flat_locator().linear.places.softening.any()
    # At half of the stiffness that is lost the tables end.
    assert softer(0.035).softening.max() == pytest.approx(0.5 / 25.0)


@pytest.mark.parametrize("force_N", [[6.0, 15.0], [9.0, 4.0, 12.0], [11.0, 3.0, 8.0, 5.0, 7.0]])
def test_contacts_on_one_place_are_one_contact_of_their_sum(force_N: list[float]) -> None:
    """On a wall whose shifts are f·L + f²·S / (1 - a·f)."""
    force, softening = np.array(force_N), 0.02
    line, square = np.array([1.0, -2.0, 0.5, 3.0]), np.array([1e-3, 2e-3, -1e-3, 4e-3])

    def shift(f: float) -> FloatArray:
        return f * line + f**2 * square / (1.0 - softening * f)

    def slope(f: float) -> FloatArray:
        left = 1.0 - softening * f
        return line + (2.0 * f / left + softening * f**2 / left**2) * square

    images = np.tile(2.0 * square, (len(force) * (len(force) - 1) // 2, 1))
    parts = [(shift(f), slope(f)[None]) for f in force_N]
    likeness = interaction_likeness(images, np.tile(square, (len(force), 1)))
    found = add_interactions(
        images, likeness, force, np.full(len(force), softening), parts, [line] * len(force)
    )
    whole = float(force.sum())
    np.testing.assert_allclose(np.sum([one for one, _ in found], axis=0), shift(whole), rtol=1e-5)
    for _, by_force in found:
        np.testing.assert_allclose(by_force[0], slope(whole), rtol=1e-5)


def test_likeness_has_a_sign_and_is_one_at_most() -> None:
    square = np.array([[1.0, 0.0], [4.0, 0.0]])
    for image, wanted in (((4.0, 0.0), 1.0), ((-2.0, 5.0), -0.5), ((9.0, 0.0), 1.0)):
        likeness = interaction_likeness(np.array([image]), square)
        np.testing.assert_allclose(likeness, [[1.0, wanted], [wanted, 1.0]])
    # Walls that are linear at a place have nothing to compare. Tables are in single precision.
    single = np.array([[4.0, 0.0]], dtype=np.float32)
    for linear in ([0], [0, 1]):
        square[linear] = 0.0
        likeness = interaction_likeness(single, square.astype(np.float32))
        np.testing.assert_array_equal(likeness, np.eye(2))


@pytest.mark.parametrize("likeness", [-0.5, 0.0, 0.7])
def test_two_contacts_share_the_stiffness_that_is_there(likeness: float) -> None:
    alike = np.array([[1.0, likeness], [likeness, 1.0]])
    grows = InteractionGrowth.of(alike, np.array([0.3, 0.1]))
    left = 0.7 - 0.1 * likeness, 0.9 - 0.3 * likeness
    np.testing.assert_allclose(grows.own, [0.7 / left[0], 0.9 / left[1]])
    np.testing.assert_allclose(grows.pair, [2.0 / sum(left)])
    # Towards buckling the growth ends.
    much = InteractionGrowth.of(alike, np.array([0.95, 1.9]))
    assert 0.0 < much.own.max() <= 1.0 + 4.0 * max(likeness, 0.0)
    assert 0.0 < much.pair[0] <= 5.0


@pytest.mark.parametrize("force_N", [[6.0, 15.0], [25.0, 22.0], [40.0, 45.0], [14.0, 9.0, 11.0]])
def test_slopes_by_forces_are_differences_where_the_wall_softens(force_N: list[float]) -> None:
    places = softer(0.012)
    at = [*AT, np.array([31.0, 18.0, 0.0])][: len(force_N)]
    found = states(places, at, force_N)
    slopes = [slope[0] for _, slope in predicted_shifts(places, found)]
    for one, slope in zip(found, slopes, strict=True):
        ends = []
        for step in (-0.01, 0.02):
            one.x[0] += step
            ends.append(total(places, found))
        one.x[0] -= 0.01
        np.testing.assert_allclose(slope, (ends[1] - ends[0]) / 0.02, atol=4e-3)


def test_contacts_on_each_other_stay_finite() -> None:
    places = aware(flat_locator()).places
    found = states(places, [AT[0], AT[0]], [9.0, 0.0])
    parts = predicted_shifts(places, found)
    assert all(np.isfinite(one).all() and np.isfinite(slope).all() for one, slope in parts)
    np.testing.assert_array_equal(centre_of(places, found[0]), centre_of(places, found[1]))


def test_a_linear_sensor_has_no_mixed_terms() -> None:
    assert aware(flat_locator()).linear.places.pairs is None


def test_a_tentative_contact_is_not_reported_and_takes_its_own_force(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Too faint to be sure of, and too strong to be left to its neighbour."""
    none = replace(pairs(), axes_px=np.zeros_like(pairs().axes_px))
    plain = flat_locator()
    locator = replace(plain, places=plain.places.with_rows(plain.places.shift_px, pairs=none))
    at = np.array([30.0, 30.0, 0.0])
    seen = together([at, np.array([43.0, 33.0, 0.0])], [10.0, 0.15])
    koi = np.array([nearest(at)])
    found = locator.find(seen.reshape(-1, 2), koi)
    (contact,) = found.contacts
    assert contact.force_N == pytest.approx(10.0, abs=0.02)
    np.testing.assert_allclose(found.shift_px, seen, atol=0.02)
    # Without an interaction table nothing is tentative.
    (alone,) = plain.find(seen.reshape(-1, 2), koi).contacts
    assert alone.force_N > 10.05
    # Whether it is there is not known: the interval holds the force in either case.
    assert found.state is not None
    (change_N,) = _change_without_tentative_N(found.state.fit, [0])
    assert 0.5 < change_N / (alone.force_N - contact.force_N) < 2.0
    module = "phytac_decoder.estimation.locator"
    monkeypatch.setattr(f"{module}._change_without_tentative_N", lambda *_: np.zeros(1))
    (narrow,) = locator.find(seen.reshape(-1, 2), koi).contacts
    wider_N = np.sqrt(contact.sd_N**2 - narrow.sd_N**2)
    assert wider_N == pytest.approx(change_N, rel=1e-6)
    monkeypatch.setattr(f"{module}.SETTINGS", replace(SETTINGS, tentative_chi2_drop=1e9))
    (accepted,) = locator.find(seen.reshape(-1, 2), koi).contacts
    assert accepted.force_N == alone.force_N


def test_a_contact_found_only_with_a_tentative_one_is_tentative_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where tables err by more than noise, one faint contact after another explains some of it."""
    locator = aware(flat_locator())
    state = states(locator.places, force_N=[0.2, 0.2])[0]
    seen = ShiftObservation(
        shift_px=np.zeros(2 * len(MARKERS)),
        found=np.ones(2 * len(MARKERS), dtype=np.bool_),
        koi=np.array([44]),
    )
    begun = replace(locator._fit([], seen), states=[state], cost=1000.0, reduced_chi2=2.0)
    monkeypatch.setattr(ContactLocator, "_unswitched_start", lambda *_: state.copy())
    for falls, wanted in (
        # A fall of χ² counts in units of the reduced χ² that is left, which is 2 here.
        ((100.0, 90.0, 10.0), [False, False, False]),
        ((60.0, 100.0, 10.0), [False, True, True]),
        ((100.0, 60.0, 120.0, 10.0), [False, False, True, True]),
    ):
        costs = iter(1000.0 - np.cumsum(falls))

        def fitted(
            _: ContactLocator,
            found: list[ContactState],
            __: ShiftObservation,
            costs: Iterator[float] = costs,
        ) -> ContactFit:
            return replace(begun, states=found, cost=float(next(costs)))

        monkeypatch.setattr(ContactLocator, "_fit", fitted)
        best = locator._add_unswitched(begun, seen)
        assert [one.tentative for one in best.states] == wanted
