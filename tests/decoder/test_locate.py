"""Contacts found from marker shifts, on a sensor in closed form."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

from phytac_decoder.estimation import locator
from phytac_decoder.estimation import locator as locator_module
from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.estimation.contact_fit import SETTINGS as FIT_SETTINGS
from phytac_decoder.estimation.contact_fit import ShiftObservation, robust_cost
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.locator import (
    SETTINGS,
    ContactLocator,
    SwitchForces,
    sd_with_factor,
)
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import (
    DISC,
    MARKERS,
    RADIUS_MM,
    flat_locator,
    flat_places,
    nearest,
    per_newton,
    shifts,
    together,
)

COUNT = len(MARKERS)
LOCATOR = flat_locator()


def find(shift: FloatArray, koi: list[int]) -> list[LocatedContact]:
    return LOCATOR.find(shift.reshape(-1, 2), np.array(koi, dtype=np.int64)).contacts


def point(x: float, y: float) -> FloatArray:
    return np.array([x, y, 0.0])


def test_cubic_between_places_is_exact_for_cubics() -> None:
    points = flat_places().point_mm
    x, y = points[:, 0] / 10.0, points[:, 1] / 10.0
    rows = np.stack([x**3 - x * y**2 + y, x**2 * y + 2.0 * y**2], axis=1)
    places = ResponseTable(
        point_mm=points,
        along=flat_places().along,
        around=flat_places().around,
        shift_px=rows[:, None].astype(np.float32),
        radius_mm=RADIUS_MM,
    )
    k = nearest_place(places, point(30.0, 20.0))
    got = places.cubic(k)[:, 0] * 10.0 ** np.array([0, 1, 1, 2, 2, 2, 3, 3, 3, 3])[:, None]
    a, b = 3.0, 2.0
    want = [
        (a**3 - a * b**2 + b, a**2 * b + 2 * b**2),
        (3 * a**2 - b**2, 2 * a * b),
        (-2 * a * b + 1, a**2 + 4 * b),
        (6 * a, 2 * b),
        (-2 * b, 2 * a),
        (-2 * a, 4),
        (6, 0),
        (0, 2),
        (-2, 0),
        (0, 0),
    ]
    np.testing.assert_allclose(got, want, atol=0.02)


def nearest_place(places: ResponseTable, at: FloatArray) -> int:
    return int(places.nearest(at[None])[0])


def test_far_side_of_a_thin_sensor_takes_no_part() -> None:
    plate = flat_places(5.0)
    below = plate.point_mm - [0.0, 0.0, 1.0]
    both = ResponseTable(
        point_mm=np.concatenate([plate.point_mm, below]),
        along=np.concatenate([plate.along, plate.along]),
        around=np.concatenate([plate.around, -plate.around]),
        shift_px=np.concatenate([plate.shift_px, 0.0 * plate.shift_px]),
        radius_mm=RADIUS_MM,
    )
    k = nearest_place(plate, point(30.0, 30.0))
    np.testing.assert_allclose(both.cubic(k), plate.cubic(k), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("force", [0.6, 5.0, 25.0])
def test_one_contact_between_places(force: float) -> None:
    at = point(31.3, 28.4)
    (contact,) = find(shifts(at, force), [nearest(at)])
    assert contact.force_N == pytest.approx(force, rel=3e-3)
    assert np.linalg.norm(contact.point_mm - at) < 0.05
    assert contact.radius_mm == pytest.approx(RADIUS_MM, rel=0.05)
    assert contact.markers.tolist() == [nearest(at)]


def test_switches_that_are_no_neighbours_may_be_of_one_contact() -> None:
    ends = [nearest(point(27.0, 33.0)), nearest(point(39.0, 33.0))]
    # The switch between them is stuck; noise decides which of two contacts would take the force.
    noise = 0.02 * np.random.default_rng(1).normal(size=(4, 2 * COUNT))
    for k, at in enumerate([(33.0, 33.0), (31.0, 33.0), (33.0, 34.0), (34.5, 33.0)]):
        (contact,) = find(shifts(point(*at), 8.0) + noise[k], ends)
        assert contact.force_N == pytest.approx(8.0, rel=0.02)
        assert contact.point_mm == pytest.approx(point(*at), abs=0.3)
        assert sorted(contact.markers) == sorted(ends)
    # Two whose discs overlap remain two.
    places, forces = [point(29.0, 33.0), point(37.0, 33.0)], [5.0, 9.0]
    two = sorted(find(together(places, forces), ends), key=lambda found: found.force_N)
    assert [found.force_N for found in two] == pytest.approx(forces, rel=0.1)


def test_points_about_one_place_or_each_its_own_have_the_same_coordinates() -> None:
    places = flat_places()
    tilted = replace(places, along=places.along + np.array([0.0, 0.0, 0.3]))
    points = np.random.default_rng(2).normal(size=(6, 3)) * [9.0, 9.0, 2.0]
    points[0] = tilted.point_mm[4]
    points[1] = tilted.point_mm[4] + [0.0, 0.0, 3.0]
    many = tilted.tangent_coordinates(4, points)
    one = tilted.tangent_coordinates([4] * len(points), points)
    np.testing.assert_allclose(one, many, rtol=1e-12, atol=1e-12)


def test_another_extent_differs_from_another_force() -> None:
    at, moments = point(33.0, 27.0), DISC + np.array([4.0, 1.5, -2.0])
    (contact,) = find(shifts(at, 10.0, moments), [nearest(at)])
    assert contact.force_N == pytest.approx(10.0, rel=5e-3)
    np.testing.assert_allclose(contact.moments_mm2, moments - DISC, atol=0.5)
    # A disc of the tables' own size, at its very place, is further off.
    plain = per_newton(at)
    naive = float(shifts(at, 10.0, moments, soft=0.0) @ plain / (plain @ plain))
    assert abs(naive - 10.0) > 0.1


def test_markers_that_were_not_found_are_left_out() -> None:
    at = point(27.0, 33.0)
    seen = shifts(at, 8.0).reshape(-1, 2)
    seen[np.linalg.norm(MARKERS - at, axis=1) < 5.0] = np.nan
    (contact,) = find(seen, [nearest(at)])
    assert contact.force_N == pytest.approx(8.0, rel=5e-3)


def test_a_contact_without_a_switch_is_found_and_carries_no_receptor() -> None:
    loud, silent = point(15.0, 15.0), point(45.0, 42.0)
    both = together([loud, silent], [10.0, 2.0])
    found = LOCATOR.find(both.reshape(-1, 2), np.array([nearest(loud)]))
    first, second = found.contacts
    assert first.force_N == pytest.approx(10.0, rel=5e-3)
    assert second.force_N == pytest.approx(2.0, rel=0.02)
    assert np.linalg.norm(second.point_mm - silent) < 0.3
    assert len(second.markers) == 0
    forces = found.receptor_forces_N(COUNT)
    assert forces.sum() == pytest.approx(first.force_N)
    assert np.flatnonzero(forces).tolist() == [nearest(loud)]


@pytest.mark.parametrize(("spread", "reported"), [(1.0, True), (0.9, True), (1.1, False)])
def test_unswitched_contacts_are_reported_by_the_spread_that_was_fitted(
    spread: float, reported: bool
) -> None:
    """Noise is not all that a sensor's own data know: faint ones far off were none."""
    loud, silent = point(15.0, 15.0), point(45.0, 42.0)
    both = together([loud, silent], [10.0, 2.0]).reshape(-1, 2)
    (_, faint) = LOCATOR.find(both, np.array([nearest(loud)])).contacts
    plain = ForceCorrection.plain(low_mm=np.zeros(3), size_mm=60.0, force_max_N=25.0)
    enough = faint.raw_N / (SETTINGS.force_sd_min * faint.raw_sd_N)
    learnt = replace(LOCATOR, correction=replace(plain, spread=0.999 * spread * enough))
    found = learnt.find(both, np.array([nearest(loud)]))
    assert len(found.contacts) == 1 + reported
    # It takes no force from the other, reported or not.
    assert found.contacts[0].force_N == pytest.approx(10.0, rel=5e-3)


def test_a_force_that_must_have_switched_is_no_unswitched_contact() -> None:
    """A dead switch: what it hides is left to those who judge the frame."""
    loud, dead = point(15.0, 15.0), point(45.0, 42.0)
    both = together([loud, dead], [10.0, 15.0])
    found = LOCATOR.find(both.reshape(-1, 2), np.array([nearest(loud)]))
    (contact,) = found.contacts
    assert contact.force_N == pytest.approx(10.0, rel=0.01)
    assert found.reduced_chi2 > 10.0
    # Where its switch is on, it is a contact like any other.
    assert len(find(both, [nearest(loud), nearest(dead)])) == 2


def test_a_fit_leaves_what_it_starts_from() -> None:
    """Another fit may start from the same."""
    at, koi = point(21.0, 21.0), np.array([nearest(point(24.0, 24.0))])
    seen = ShiftObservation(
        shift_px=shifts(at, 9.0), found=np.ones(2 * COUNT, dtype=np.bool_), koi=koi
    )
    force = SwitchForces(np.array([1.0]), np.array([0.1]))
    begun = [LOCATOR._start(koi, force, np.array([0]))]
    before = begun[0].x.copy()
    assert LOCATOR._fit(begun, seen).states[0].x[0] == pytest.approx(9.0, rel=0.01)
    assert begun[0].x.tolist() == before.tolist()


def test_a_receptor_whose_tip_is_out_counts_less() -> None:
    """How much paint the tip covers is not known: its shift is off by more than noise."""
    at = point(30.0, 30.0)
    marker = nearest(at)
    seen = shifts(at, 8.0).reshape(-1, 2)
    seen[marker] += (0.06, -0.04)  # not so far that it would be down-weighted

    def off_mm(switched_px: float) -> float:
        wary = replace(LOCATOR, noise=replace(LOCATOR.noise, switched_px=switched_px))
        (contact,) = wary.find(seen, np.array([marker])).contacts
        return float(np.linalg.norm(contact.point_mm - at))

    assert off_mm(1.0) < 0.001
    assert off_mm(0.0) > 0.005


@pytest.mark.parametrize("off_px", [(0.8, -0.5), (-3.0, -12.4)])
def test_a_marker_that_is_far_off_hardly_counts(off_px: tuple[float, float]) -> None:
    """A neighbour hides its paint, or something shines beside it: forces must not follow."""
    at = point(30.0, 30.0)
    seen = shifts(at, 8.0).reshape(-1, 2)
    beside = np.argsort(np.linalg.norm(MARKERS[:, :2] - at[:2], axis=1))[3]
    seen[beside] += off_px
    (contact,) = LOCATOR.find(seen, np.array([nearest(at)])).contacts
    assert contact.force_N == pytest.approx(8.0, rel=0.005)
    assert np.linalg.norm(contact.point_mm - at) < 0.1


def test_down_weighting_begins_where_a_marker_is_far_off_for_its_frame() -> None:
    inverse, limit = np.full(200, 4.0), FIT_SETTINGS.robust_threshold**2 * 2.0
    left = np.zeros(200)
    left[0] = np.sqrt(limit / 4.0)
    at_limit, share = robust_cost(left, inverse)
    assert at_limit == pytest.approx(limit)
    np.testing.assert_allclose(share, 1.0)
    left[0] *= 3.0
    beyond, share = robust_cost(left, inverse)
    assert beyond == pytest.approx(limit * (1.0 + np.log(9.0)))
    np.testing.assert_allclose(share[:4], [1.0 / 9.0, 1.0 / 9.0, 1.0, 1.0])
    # Where all are as far off, none is down-weighted; nor are those that were not found.
    left[:] = left[0]
    inverse[:100] = 0.0
    total, share = robust_cost(left, inverse)
    assert total == pytest.approx(float(inverse @ left**2))
    np.testing.assert_array_equal(share, 1.0)


def test_the_share_of_a_down_weighted_marker_is_what_its_sum_grows_with() -> None:
    """Weights are half the sum's derivative over the residual, as iterating them needs."""
    left, inverse = np.random.default_rng(0).normal(size=(2, 40)) ** [[1], [2]]
    left[6:10] *= 30.0
    _, share = robust_cost(left, inverse)
    assert (share < 0.5).any()
    assert (share == 1.0).any()
    for k in (6, 7, 20):
        step = np.zeros(40)
        step[k] = 1e-5 * left[k]
        up, down = robust_cost(left + step, inverse)[0], robust_cost(left - step, inverse)[0]
        assert (up - down) / (2.0 * step[k]) == pytest.approx(
            2.0 * share[k] * inverse[k] * left[k], rel=1e-4
        )


def test_intervals_hold_the_error_of_linear_tables() -> None:
    middle = point(31.3, 28.4)
    shift, koi = shifts(middle, 10.0).reshape(-1, 2), np.array([nearest(middle)])
    plain = replace(LOCATOR, prior=replace(LOCATOR.prior, force_N=20.0))
    curved = replace(plain, linear_error=0.4)

    def contact_of(one: ContactLocator) -> LocatedContact:
        (contact,) = one.find(shift, koi).contacts
        return contact

    other = contact_of(plain)
    read_N = other.force_N

    def half_width(error: float) -> float:
        one = contact_of(replace(plain, linear_error=error))
        assert one.force_N == read_N
        return 1.645 * float(np.sqrt(one.sd_N**2 - other.sd_N**2))

    for error in (0.04, 0.4, 0.9):
        true_N = read_N + half_width(error)
        assert true_N / (1.0 + error * true_N / 20.0) == pytest.approx(read_N, rel=1e-6)
    # No force reads as much: the interval reaches the largest, or that share above.
    assert half_width(2.2) == pytest.approx(1.1 * read_N**2 / 10.0, rel=1e-6)
    assert contact_of(curved.linear).sd_N == contact_of(plain.linear).sd_N
    # Data that a correction was fitted to have the error.
    fitted = ForceCorrection.plain(low_mm=np.zeros(3), size_mm=60.0, force_max_N=25.0)
    same, as_plain = (contact_of(replace(each, correction=fitted)).sd_N for each in (curved, plain))
    assert same == as_plain
    # Unless linear theory made them.
    unaware = replace(fitted, linear=True)
    assert contact_of(replace(curved, correction=unaware)).sd_N > 1.2 * as_plain


@pytest.mark.parametrize(("error", "reported"), [(0.0, True), (0.2, True), (0.4, False)])
def test_a_contact_that_linear_tables_may_have_made_up_is_not_reported(
    error: float, reported: bool
) -> None:
    # Of 10 N they may leave 0.2 · 10² / 20 = 1 N and more, where no switch says what it is.
    loud, silent = point(15.0, 15.0), point(45.0, 42.0)
    two = together([loud, silent], [10.0, 2.0]).reshape(-1, 2)
    prior = replace(LOCATOR.prior, force_N=20.0)
    locator = replace(LOCATOR, prior=prior, linear_error=error)
    found = locator.find(two, np.array([nearest(loud)]))
    assert len(found.contacts) == 1 + reported
    assert found.hidden_N == pytest.approx(0.0 if reported else 2.0, abs=0.1)
    # One that a switch shows is there.
    both = locator.find(two, np.array([nearest(loud), nearest(silent)]))
    assert len(both.contacts) == 2
    assert both.hidden_N == 0.0


def test_without_switches_linear_tables_hide_no_contact() -> None:
    two = together([point(15.0, 15.0), point(45.0, 42.0)], [10.0, 6.0]).reshape(-1, 2)
    prior, every = replace(LOCATOR.prior, force_N=20.0), np.arange(len(MARKERS))
    blind = replace(LOCATOR, prior=prior, blind=every, linear_error=3.0)
    assert len(blind.find(two, np.zeros(0, dtype=np.int64)).contacts) == 2


def test_no_contact_lies_beyond_a_rim() -> None:
    """Of a load off the edge the tables say nothing; there is no surface to press on."""
    reach_mm = FIT_SETTINGS.place_distance_max * LOCATOR.places.spacing_mm
    for x in (-4.0, -6.0, -8.0):
        (contact,) = find(shifts(point(x, 30.0), 10.0), [nearest(point(3.0, 30.0))])
        assert -reach_mm - 1e-9 <= contact.point_mm[0] < 0.0
        assert contact.point_mm[1] == pytest.approx(30.0, abs=0.1)


def test_a_start_is_not_drawn_away_from_markers_that_were_lost() -> None:
    """So much noise that the contact stays where its switches put it."""
    markers = [44, 54]
    at = MARKERS[markers].mean(axis=0)
    seen = shifts(at, 10.0).reshape(-1, 2)
    seen[[32, 33, 34, 35, 36, 42, 43, 44, 45, 46]] = np.nan
    blind = replace(
        LOCATOR,
        prior=replace(LOCATOR.prior, place_mm=0.2),
        noise=replace(LOCATOR.noise, centroid_px=2.0),
    )
    (contact,) = blind.find(seen, np.array(markers)).contacts
    assert np.linalg.norm(contact.point_mm - at) < 0.3


def test_what_is_left_without_a_place_is_not_fitted() -> None:
    """Noise above the presumed is no contact: no time is lost on one."""
    at, rng = point(30.0, 30.0), np.random.default_rng(5)
    for _ in range(10):
        noisy = shifts(at, 10.0) + rng.normal(0.0, 0.025, 2 * COUNT)
        with mock.patch.object(locator, "fit_contacts", wraps=locator.fit_contacts) as fitted:
            found = LOCATOR.find(noisy.reshape(-1, 2), np.array([nearest(at)]))
        assert found.reduced_chi2 > SETTINGS.chi2_unexplained
        assert fitted.call_count == 1


def test_noise_alone_makes_no_unswitched_contact() -> None:
    at = point(30.0, 30.0)
    rng = np.random.default_rng(3)
    for _ in range(20):
        noisy = shifts(at, 10.0) + rng.normal(0.0, 0.02, 2 * COUNT)
        assert len(find(noisy, [nearest(at)])) == 1


def test_without_switches_nothing_is_solved() -> None:
    found = LOCATOR.find(shifts(point(30.0, 30.0), 5.0).reshape(-1, 2), np.zeros(0, dtype=int))
    assert found.contacts == []
    assert found.reduced_chi2 > 10.0
    assert not found.receptor_forces_N(COUNT).any()


def test_spread_is_that_of_many_noisy_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    # These contacts have the shape of the tables'.
    known_shape = replace(locator_module.SETTINGS, extent_error=0.0)
    monkeypatch.setattr(locator_module, "SETTINGS", known_shape)
    locator = replace(LOCATOR, noise=replace(LOCATOR.noise, share=0.0))
    rng = np.random.default_rng(1)
    error, said = [], []
    for _ in range(300):
        offset = np.append(rng.normal(0.0, 1.5, 2), 0.0)
        at = MARKERS[44] + offset
        moments = DISC + rng.normal(0.0, [3.0, 2.0, 3.0]) * 0.5
        noisy = shifts(at, 10.0, moments) + rng.normal(0.0, 0.02, 2 * COUNT)
        (contact,) = locator.find(noisy.reshape(-1, 2), np.array([44])).contacts
        error.append(contact.force_N - 10.0)
        said.append(contact.raw_sd_N)
    assert np.std(error) == pytest.approx(np.mean(said), rel=0.15)
    assert abs(np.mean(error)) < 0.3 * np.std(error)


def test_forces_of_an_unknown_print_are_no_surer_than_its_stiffness() -> None:
    at = point(30.0, 30.0)
    seen = shifts(at, 8.0).reshape(-1, 2), np.array([nearest(at)])
    (unknown,) = LOCATOR.find(*seen).contacts
    # The upper end of the 95 % interval of a log-normal factor.
    assert unknown.sd_N == pytest.approx(8.0 * np.expm1(1.96 * 0.11) / 1.96, rel=5e-3)
    fitted = ForceCorrection.plain(
        low_mm=np.zeros(3),
        size_mm=60.0,
        force_max_N=25.0,
    )
    (known,) = replace(LOCATOR, correction=fitted).find(*seen).contacts
    assert known.raw_sd_N == unknown.raw_sd_N < 0.05
    assert known.sd_N == pytest.approx(known.raw_sd_N, rel=1e-9)


@pytest.mark.parametrize("sd_N", [0.1, 2.0, 5.0])
def test_intervals_reach_the_upper_end_of_a_force_times_a_factor(sd_N: float) -> None:
    rng = np.random.default_rng(2)
    force = 8.0 + sd_N * rng.normal(size=200_000)
    drawn = force * np.exp(0.2 * rng.normal(size=len(force)))
    stated = sd_with_factor(np.array([8.0]), np.array([sd_N]), 0.2)[0]
    high = np.quantile(drawn, 0.975)
    assert 8.0 + 1.96 * stated == pytest.approx(high, rel=0.04)
    low = np.quantile(drawn, 0.025)
    assert 8.0 - 1.96 * stated < low + 0.01 * 8.0


def test_scatter_of_prints_is_what_the_twin_presumes() -> None:
    unit = SensorInstanceSection()
    thickness = 2.3 * np.hypot(unit.thickness_share, unit.thickness_wave_share)
    assert (
        pytest.approx(np.hypot(unit.modulus_share, thickness), abs=0.005) == SETTINGS.stiffness_sd
    )


def test_forces_are_shared_by_overlap_and_sum_up() -> None:
    at = point(24.0, 27.0)
    koi = sorted(np.argsort(np.linalg.norm(MARKERS - at, axis=1))[:2].tolist())
    (contact,) = find(shifts(at, 9.0), koi)
    assert contact.markers.tolist() == koi
    assert contact.share.sum() == pytest.approx(1.0)
    assert contact.share == pytest.approx([0.5, 0.5], abs=0.02)


def test_a_stiffer_sensor_reads_the_same_force_from_less() -> None:
    stiffer = replace(LOCATOR, places=LOCATOR.places.scaled(1.2))
    at = point(30.0, 30.0)
    (contact,) = stiffer.find(
        shifts(at, 10.0 / 1.2).reshape(-1, 2), np.array([nearest(at)])
    ).contacts
    assert contact.force_N == pytest.approx(10.0, rel=5e-3)
    with pytest.raises(AssertionError):
        assert find(shifts(at, 10.0 / 1.2), [nearest(at)])[0].force_N == pytest.approx(
            10.0, rel=0.1
        )


def test_the_linear_part_knows_no_softening() -> None:
    at = point(30.0, 30.0)
    koi = np.array([nearest(at)])
    shift = shifts(at, 20.0, soft=0.0).reshape(-1, 2)
    (contact,) = LOCATOR.linear.find(shift, koi).contacts
    assert contact.force_N == pytest.approx(20.0, rel=3e-3)
    assert LOCATOR.find(shift, koi).contacts[0].force_N < 18.0


def test_same_shifts_same_contacts() -> None:
    shift = shifts(point(30.0, 31.0), 7.0).reshape(-1, 2)
    first, second = (LOCATOR.find(shift, np.array([44])).contacts[0] for _ in range(2))
    assert first.force_N == second.force_N
    assert (first.point_mm == second.point_mm).all()


def test_a_contact_beyond_the_disc_is_in_doubt_by_its_longest_side() -> None:
    # Of two contacts one has second moments that are 1 and 3 mm² larger than the disc's, along axes
    # turned by 30 degrees; the other is smaller.
    turn = np.array([[np.sqrt(0.75), -0.5], [0.5, np.sqrt(0.75)]])
    more = turn @ np.diag([3.0, 1.0]) @ turn.T
    moments = ((more[0, 0], more[0, 1], more[1, 1]), (-1.0, 0.0, -2.0))
    states: Any = [SimpleNamespace(x=np.array([5.0, 0.0, 0.0, *own, 0.0, 0.0])) for own in moments]
    far_from_ends = np.array([point(30.0, 30.0), point(30.0, 20.0)])
    error = LOCATOR._errors_of_tables(states, far_from_ends, np.zeros((2, 2)))
    disc = RADIUS_MM**2 / 4.0
    np.testing.assert_allclose(error, [SETTINGS.extent_error * 3.0 / disc, 0.0], atol=1e-12)
