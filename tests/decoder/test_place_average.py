"""Contacts beside a rim, whose force and place are confused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from phytac_decoder.estimation import contact_fit, place_average
from phytac_decoder.estimation import locator as search
from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.estimation.contact_fit import ShiftObservation
from phytac_decoder.estimation.contact_shifts import centre_of
from phytac_decoder.estimation.locator import ContactLocator, SwitchForces
from phytac_decoder.estimation.place_average import PlaceAverage
from phytac_shapes.arrays import FloatArray
from phytac_shapes.discs import disc_overlap_share
from tests.decoder.flat_sensor import (
    DISC,
    MARKERS,
    RADIUS_MM,
    flat_locator,
    nearest,
    per_newton,
    shifts,
    together,
)

NOISE_PX = 0.25
ONLY_BEST = replace(place_average.SETTINGS, force_share=np.inf, log_switches_min=-np.inf)
"""No averages: the best place alone."""


def softness(x_mm: float) -> float:
    """Share of the motion that is left at a distance from the rim at x = 0."""
    return float(np.exp(min(x_mm - 15.0, 0.0) / 4.0))


@cache
def with_rim() -> ContactLocator:
    """The flat sensor, linear, whose wall stiffens towards the rim at x = 0."""
    plain = flat_locator(noise_px=NOISE_PX, place_mm=3.0)
    places = plain.places
    soft = np.array([softness(x) for x in places.point_mm[:, 0]])
    rows = (places.shift_px[:, :1] * soft[:, None, None]).astype(np.float32)
    prior = replace(plain.prior, force_N=25.0)
    return replace(plain, places=replace(places, shift_px=rows), prior=prior)


def pressed(rng: np.random.Generator) -> tuple[float, FloatArray, LocatedContact]:
    """Force and place of a random contact near the rim, and what is found."""
    at = np.array([rng.uniform(2.0, 9.0), rng.uniform(15.0, 45.0), 0.0])
    force = rng.uniform(8.0, 25.0)
    motion = force * softness(at[0]) * per_newton(at) + rng.normal(0.0, NOISE_PX, 2 * len(MARKERS))
    gap = np.linalg.norm(MARKERS - at, axis=1)
    on = force * disc_overlap_share(gap, RADIUS_MM, with_rim().footprint_mm) >= 0.5
    found = with_rim().find(motion.reshape(-1, 2), np.flatnonzero(on))
    return force, at, found.contacts[0]


@pytest.fixture(params=[True, False], ids=["averaged", "best place alone"])
def averaged(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether places are averaged."""
    if not request.param:
        monkeypatch.setattr(place_average, "SETTINGS", ONLY_BEST)
    return bool(request.param)


def test_forces_and_places_beside_a_rim(averaged: bool) -> None:
    """Switches and the curved relation of place and force say more than the best place alone."""
    found = [pressed(np.random.default_rng(seed)) for seed in range(80)]
    off_N = np.array([one.raw_N - force for force, _, one in found])
    off_mm = np.array([np.linalg.norm(one.point_mm - at) for _, at, one in found])
    sd_N = np.array([one.raw_sd_N for *_, one in found])
    share = np.abs(off_N) / np.array([force for force, *_ in found])
    assert np.mean(np.abs(off_N) <= 1.96 * sd_N) >= 0.95
    assert (np.mean(share) < 0.22) == averaged
    assert (np.mean(off_mm) < 1.22) == averaged


def test_the_average_is_that_of_a_fine_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the posterior by brute force over force and place; extent and shear are sure."""
    monkeypatch.setattr(
        ContactLocator, "_log_switches", lambda _, states, **__: np.zeros(len(states))
    )
    known = replace(place_average.SETTINGS, usual_freedom=1e6)
    monkeypatch.setattr(place_average, "SETTINGS", known)
    monkeypatch.setattr(search, "SETTINGS", replace(search.SETTINGS, rim_power_factor=0.0))
    locator = with_rim()
    sure = replace(locator.prior, moments_sd_mm2=(1e-3, 1e-3, 1e-3), shear_sd=1e-3)
    locator = replace(locator, prior=sure, noise=replace(locator.noise, share=0.0))
    at, marker = np.array([5.0, 33.0, 0.0]), nearest(np.array([3.0, 33.0, 0.0]))
    motion = 12.0 * softness(at[0]) * per_newton(at)
    (one,) = locator.find(motion.reshape(-1, 2), np.array([marker])).contacts

    x = np.linspace(-1.0, 14.0, 151)
    y = np.linspace(27.0, 39.0, 31)
    force = np.geomspace(0.5, 120.0, 300)
    log_density = np.full((len(x), len(y), len(force)), -np.inf)
    for i, along in enumerate(x):
        for j, around in enumerate(y):
            point = np.array([along, around, 0.0])
            unit = softness(along) * per_newton(point)
            off = motion[:, None] - unit[:, None] * force
            place = float(np.sum((point - MARKERS[marker]) ** 2)) / locator.prior.place_mm**2
            # The prior of a place has the tails of Cauchy's distribution.
            far = contact_fit.SETTINGS.place_sds**2
            cost = np.sum(off**2, axis=0) / NOISE_PX**2 + far * np.log1p(place / far)
            log_density[i, j] = -0.5 * (cost + (force / 25.0) ** 2)
    density = np.exp(log_density - log_density.max())
    # On the grid of forces, which is even in their logarithm.
    each = density.sum(axis=(0, 1))
    share = np.cumsum(each) / each.sum()
    median = float(np.interp(0.5, share, force))
    assert one.raw_N == pytest.approx(median, rel=0.1)
    uniform = np.cumsum(each * force) / np.sum(each * force)
    high = float(np.interp(0.975, uniform, force))
    assert one.raw_N + 1.96 * one.raw_sd_N == pytest.approx(high, rel=0.06)
    mean_x = float(np.sum(density.sum(axis=(1, 2)) * x) / density.sum())
    assert one.point_mm[0] == pytest.approx(mean_x, abs=0.2)
    sd_x = np.sqrt(np.sum(density.sum(axis=(1, 2)) * (x - mean_x) ** 2) / density.sum())
    assert one.sd_mm[0] == pytest.approx(sd_x, rel=0.1)


def average_of(
    locator: ContactLocator, seen: ShiftObservation, fit: contact_fit.ContactFit
) -> PlaceAverage:
    """Average of contacts of which switches say nothing."""
    return PlaceAverage(
        places=locator.places,
        prior=locator.prior,
        noise=locator.noise,
        seen=seen,
        fit=fit,
        scale=1.0,
        log_switches=lambda states: np.zeros(len(states)),
    )


def own_noise(residual_px: FloatArray) -> place_average._OwnNoise:
    """Noise of a contact's own markers, whose shifts (n,) are so far from the fitted ones."""
    at, locator = np.array([24.0, 33.0, 0.0]), flat_locator(noise_px=0.1)
    state = locator.find(shifts(at, 10.0).reshape(-1, 2), np.array([nearest(at)])).state
    assert state is not None
    seen = ShiftObservation(
        shift_px=state.fit.predicted_px + np.repeat(residual_px, 2),
        found=np.ones(2 * len(MARKERS), dtype=np.bool_),
        koi=np.array([nearest(at)]),
    )
    return average_of(locator, seen, state.fit)._own_noise(0)


def test_a_force_is_as_uncertain_as_its_own_markers_are_noisy() -> None:
    """Blur and compression do most harm where markers move and turn most."""
    gap = np.linalg.norm(MARKERS - np.array([24.0, 33.0, 0.0]), axis=1)
    calm = own_noise(np.zeros(len(MARKERS)))
    beside, elsewhere = own_noise(0.3 * (gap < 12.0)), own_noise(0.3 * (gap > 30.0))
    assert calm.scale == 1.0
    assert calm.freedom > place_average.SETTINGS.usual_freedom + 4.0
    assert beside.scale > 2.0
    assert elsewhere.scale == pytest.approx(1.0, abs=0.05)


def test_a_contact_of_which_no_marker_is_found_is_as_uncertain_as_its_prior() -> None:
    locator, koi = flat_locator(noise_px=0.1), np.array([nearest(np.array([24.0, 33.0, 0.0]))])
    nothing = np.full((len(MARKERS), 2), np.nan)
    for one in locator.find(nothing, koi).contacts:
        assert np.isfinite([one.force_N, one.sd_N, *one.point_mm, *one.sd_mm]).all()
        assert one.sd_N > 0.5 * one.force_N
    state = locator.find(nothing, koi).state
    assert state is not None
    seen = ShiftObservation(
        shift_px=np.zeros(nothing.size), found=np.zeros(nothing.size, dtype=np.bool_), koi=koi
    )
    noise = average_of(locator, seen, state.fit)._own_noise(0)
    assert (noise.scale, noise.freedom) == (1.0, place_average.SETTINGS.usual_freedom)


def test_a_density_with_a_scale_that_is_poorly_known_is_student_s() -> None:
    noise = place_average._OwnNoise(scale=1.7, freedom=6.0)
    x = np.linspace(-400.0, 400.0, 800_001)
    density = np.exp(-0.5 * noise.cost(x**2))
    density /= density.sum()
    # The 97.5 % quantile with six degrees of freedom.
    assert np.interp(0.975, np.cumsum(density), x) == pytest.approx(2.4469 * 1.7**0.5, rel=1e-3)
    assert density @ x**2 == pytest.approx(noise.spread, rel=1e-3)


def test_a_contact_out_of_reach_of_its_switch_is_nearer_to_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Noise moves a weak contact to a switch that reads off, away from its own."""
    locator = flat_locator(noise_px=0.6, place_mm=3.0)
    at = np.array([33.0, 33.0, 0.0])
    seen = shifts(at + np.array([12.0, 0.0, 0.0]), 1.5).reshape(-1, 2)
    koi = np.array([nearest(at)])
    (near,) = locator.find(seen, koi).contacts
    settings = replace(place_average.SETTINGS, log_switches_min=-np.inf)
    monkeypatch.setattr(place_average, "SETTINGS", settings)
    (far,) = locator.find(seen, koi).contacts
    off = [float(np.linalg.norm(one.point_mm - at)) for one in (near, far)]
    assert off[0] < off[1] - 1.0


@pytest.mark.parametrize(("coupling_min", "share", "cost"), [(0.1, 0.15, 0.1), (0.99, 0.25, 0.5)])
def test_neighbours_follow_a_contact_along_its_places(
    monkeypatch: pytest.MonkeyPatch, coupling_min: float, share: float, cost: float
) -> None:
    """Nodes with neighbours fitted, or by linear theory, against fits of all contacts."""
    settings = replace(place_average.SETTINGS, coupling_min=coupling_min)
    monkeypatch.setattr(place_average, "SETTINGS", settings)
    rng, locator = np.random.default_rng(3), with_rim()
    points = [np.array([6.0, y, 0.0]) for y in (12.0, 21.0, 51.0)]
    motion = rng.normal(0.0, NOISE_PX, 2 * len(MARKERS))
    for at, force in zip(points, (12.0, 9.0, 15.0), strict=True):
        motion += force * softness(at[0]) * per_newton(at)
    koi = np.array([nearest(at) for at in points])
    state = locator.find(motion.reshape(-1, 2), koi).state
    assert state is not None
    seen = ShiftObservation(shift_px=motion, found=np.ones(len(motion), dtype=np.bool_), koi=koi)
    average = average_of(locator, seen, state.fit)
    known = place_average._OwnNoise(scale=1.0, freedom=1e6)
    nodes = average._nodes_along(average._line(0, np.array([1.0, 0.0]), known), 1.0)
    least = min(node.cost for node in nodes)
    likely = [node for node in nodes if node.cost - least < 5.0]
    assert len(likely) > 4
    for node in likely:
        centre = centre_of(locator.places, node.state)
        held = replace(node.state, start_mm=centre, place_sd_mm=1e-4)
        fit = contact_fit.fit_contacts(
            locator.places,
            [each.copy() for each in (held, *state.fit.states[1:])],
            seen,
            prior=locator.prior,
            noise=locator.noise,
        )
        own = replace(fit.states[0], start_mm=node.state.start_mm)
        states = [replace(own, place_sd_mm=node.state.place_sd_mm), *fit.states[1:]]
        off = contact_fit.prior_residual(locator.places, states, locator.prior)
        whole = contact_fit.prior_cost(states, off, locator.prior).sum()
        whole += fit.residual_cost - state.fit.residual_cost
        sd_N = np.sqrt(fit.covariance[0, 0])
        assert node.state.x[0] == pytest.approx(own.x[0], abs=share * sd_N)
        assert np.sqrt(node.covariance[0, 0]) == pytest.approx(sd_N, rel=0.08)
        assert node.cost == pytest.approx(whole, abs=cost)


def test_nothing_is_averaged_in_a_frame_that_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    at, places = np.array([6.0, 30.0, 0.0]), list[int]()
    seen, koi = (12.0 * softness(at[0]) * per_newton(at)).reshape(-1, 2), np.array([nearest(at)])
    whole = with_rim().find(seen, koi)
    monkeypatch.setattr(place_average.PlaceAverage, "contact", lambda *_: places.append(0))
    refused = with_rim().find(seen, koi, too_far=lambda _: True)
    assert len(whole.contacts) == 1
    assert refused.contacts == places == []
    assert refused.reduced_chi2 == whole.reduced_chi2


def test_on_a_surface_smaller_than_a_step_the_best_place_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng
    *_, averaged = pressed(rng(0))
    monkeypatch.setattr(place_average.PlaceAverage, "_moved", lambda *_: None)
    *_, alone = pressed(rng(0))
    monkeypatch.setattr(place_average, "SETTINGS", ONLY_BEST)
    *_, wanted = pressed(rng(0))
    assert alone.raw_N == wanted.raw_N != averaged.raw_N
    assert alone.raw_sd_N == wanted.raw_sd_N


def test_a_prior_centre_is_as_sure_as_the_forces_on_its_switches() -> None:
    koi = np.array([nearest(np.array([x, 33.0, 0.0])) for x in (3.0, 9.0)])
    locator, rows = with_rim(), np.arange(2)
    sure = SwitchForces(np.array([0.0, 5.0]), np.array([0.01, 0.01]))
    point, sd_mm = locator._centroid(koi, sure, rows)
    assert point[0] == pytest.approx(9.0, abs=0.1)
    assert sd_mm == pytest.approx(locator.prior.place_mm, rel=0.01)
    stiff = SwitchForces(np.array([0.0, 5.0]), np.array([5.0, 0.01]))
    point, sd_mm = locator._centroid(koi, stiff, rows)
    assert point[0] == pytest.approx(6.0, abs=0.1)
    # Half of the 6 mm between them, by the share 5 / 10 that is unknown.
    assert sd_mm == pytest.approx(np.hypot(locator.prior.place_mm, 1.5), rel=0.01)


def test_beside_a_rim_a_force_on_a_switch_is_hardly_known() -> None:
    koi = np.array([nearest(np.array([x, 33.0, 0.0])) for x in (3.0, 21.0)])
    seen = ShiftObservation(
        shift_px=np.zeros(2 * len(MARKERS)),
        found=np.ones(2 * len(MARKERS), dtype=np.bool_),
        koi=koi,
    )
    rim, middle = with_rim()._switch_forces(seen).sd_N
    assert rim > 10.0 * middle
    assert rim < with_rim().prior.force_N


def test_one_group_of_switches_is_split_where_another_is_not() -> None:
    """A large contact stays one, though two contacts elsewhere are one group."""
    large = np.array([30.0, 15.0, 0.0])
    two = [np.array([x, 45.0, 0.0]) for x in (18.0, 36.0)]
    seen = shifts(large, 12.0, 2.5 * DISC) + shifts(two[0], 9.0) + shifts(two[1], 8.0)
    koi = [nearest(np.array([x, 15.0, 0.0])) for x in (21.0, 27.0, 33.0, 39.0)]
    koi += [nearest(np.array([x, 45.0, 0.0])) for x in (15.0, 21.0, 27.0, 33.0, 39.0)]
    found = flat_locator().find(seen.reshape(-1, 2), np.unique(koi)).contacts
    force = sorted(round(one.force_N) for one in found)
    assert force == [8, 9, 12]


def test_two_groups_of_switches_are_both_split() -> None:
    places = [np.array([x, y, 0.0]) for y in (12.0, 48.0) for x in (18.0, 36.0)]
    seen = together(places, [9.0, 8.0, 7.0, 6.0])
    koi = [nearest(np.array([x, y, 0.0])) for y in (9.0, 45.0) for x in range(15, 40, 6)]
    found = flat_locator().find(seen.reshape(-1, 2), np.unique(koi)).contacts
    assert sorted(round(one.force_N) for one in found) == [6, 7, 8, 9]
