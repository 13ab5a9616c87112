"""Errors of forces that the tables do not describe, and how wide intervals are for them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from phytac_decoder.estimation import locator as search
from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.estimation.contact_shifts import changed_by_others, predicted_shifts
from phytac_decoder.estimation.locator import ContactLocator
from phytac_shapes.arrays import FloatArray
from phytac_shapes.discs import cut_disc_centroid
from tests.decoder.flat_sensor import (
    MARKERS,
    RADIUS_MM,
    flat_locator,
    nearest,
    per_newton,
)
from tests.decoder.test_pairs import AT, FORCES_N, aware, pressed, states

NOISE_PX = 0.02
STEPS = np.linspace(-1.0, 1.0, 41)
IN_DISC = np.stack(np.meshgrid(STEPS, STEPS), axis=-1).reshape(-1, 2)
IN_DISC = IN_DISC[np.linalg.norm(IN_DISC, axis=1) <= 1.0]
"""Points of a unit disc."""


def test_centroid_of_a_disc_that_an_edge_cuts_off() -> None:
    step = np.linspace(-1.0, 1.0, 2001)
    x, y = np.meshgrid(step, step)
    disc = x**2 + y**2 <= 1.0
    for gap, radius in ((0.0, 3.0), (0.7, 3.0), (2.9, 3.0), (1.0, 8.0)):
        depth = (gap + radius * x)[disc]
        mean = depth[depth >= 0.0].mean()
        assert cut_disc_centroid(np.array(gap), radius) == pytest.approx(mean, rel=1e-3)
    gaps = np.array([[3.0], [5.0]])
    assert cut_disc_centroid(gaps, np.array([1.0, 3.0])) == pytest.approx(np.tile(gaps, (1, 2)))


def fallen(x_mm: float, radius_mm: float) -> float:
    """Share of the motion that is left of a disc's: pressure at a distance d from a rim, d^1.4."""
    depth = x_mm + radius_mm * IN_DISC[:, 0]
    return float(np.mean(np.minimum(depth[depth > 0.0] / 15.0, 1.0) ** 1.4))


@cache
def clamped(*, far_side: bool = False) -> ContactLocator:
    """The flat sensor, linear, clamped at x = 0, and at y = 0 as well with ``far_side``."""
    plain = flat_locator(noise_px=NOISE_PX, place_mm=3.0)
    places = plain.places
    share = np.array([fallen(x, RADIUS_MM) for x in places.point_mm[:, 0]])
    if far_side:
        share = share * [fallen(y, RADIUS_MM) for y in places.point_mm[:, 1]]
    rows = (places.shift_px[:, :1] * share[:, None, None]).astype(np.float32)
    prior = replace(plain.prior, force_N=25.0)
    return replace(plain, places=replace(places, shift_px=rows), prior=prior)


def at(x: float, y: float) -> FloatArray:
    return np.array([x, y, 0.0])


def test_shifts_fall_towards_a_clamped_end_by_a_power() -> None:
    points = np.stack([at(1.0, 30.0), at(59.0, 30.0)])
    (gap, power), (_, plain) = (
        one.places.towards_end(points) for one in (clamped(), flat_locator())
    )
    np.testing.assert_allclose(gap, [1.0, 1.0], atol=1e-9)
    near, far = power - plain
    assert near == pytest.approx(1.4, abs=0.25)
    assert far == pytest.approx(0.0, abs=1e-3)


def test_beside_a_corner_the_power_is_that_of_a_side() -> None:
    places = clamped(far_side=True).places
    corner, side = places.towards_end(np.stack([at(0.5, 0.5), at(0.5, 30.0)]))[1]
    assert corner <= 1.35 * side


def found(seed: int) -> tuple[float, LocatedContact]:
    """Force of a disc of any size beside the clamped end, and what is found of it."""
    rng = np.random.default_rng(seed)
    place = at(rng.uniform(0.0, 2.5), rng.uniform(15.0, 45.0))
    force, radius = rng.uniform(4.0, 25.0), RADIUS_MM * rng.uniform(0.4, 1.3)
    motion = force * fallen(place[0], radius) * per_newton(place)
    motion = motion + rng.normal(0.0, NOISE_PX, 2 * len(MARKERS))
    one = clamped().find(motion.reshape(-1, 2), np.array([nearest(place)]))
    return force, one.contacts[0]


@pytest.mark.parametrize("known", [True, False])
def test_forces_of_discs_that_a_rim_cuts_off(known: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Small discs beside a rim read as weak ones: intervals hold them, and are no wider."""
    if not known:
        monkeypatch.setattr(search, "SETTINGS", replace(search.SETTINGS, rim_power_factor=0.0))
    pairs = [found(seed) for seed in range(80)]
    off = np.array([abs(one.force_N - force) for force, one in pairs])
    sd = np.array([one.sd_N for _, one in pairs])
    assert (np.mean(off <= 1.645 * sd) >= 0.85) == known
    assert np.median(sd) < 3.0 * np.median(off)


def test_far_from_the_end_a_disc_is_whole() -> None:
    sd_mm = np.full((2, 2), 0.5)
    points = np.stack([at(1.0, 30.0), at(20.0, 30.0)])
    near, far = clamped()._error_by_rim(points, sd_mm)
    assert near > 0.3
    assert far == 0.0
    # A place that is poorly known may be nearer.
    unsure, _ = clamped()._error_by_rim(points, sd_mm + np.array([[0.5, 0.0], [0.0, 0.0]]))
    assert unsure > near


@pytest.mark.parametrize("x_mm", [0.5, 1.5, 3.0])
def test_a_contact_beside_a_rim_is_found_without_a_switch(x_mm: float) -> None:
    """Its force is hardly known, and yet it is there."""
    hidden, other = at(x_mm, 30.0), at(45.0, 30.0)
    motion = 12.0 * fallen(x_mm, RADIUS_MM) * per_newton(hidden) + 8.0 * per_newton(other)
    stiff = replace(clamped(), threshold_N=np.full(len(MARKERS), 50.0))
    contacts = stiff.find(motion.reshape(-1, 2), np.array([nearest(other)])).contacts
    assert len(contacts) == 2
    one = min(contacts, key=lambda contact: float(contact.point_mm[0]))
    assert len(one.markers) == 0
    assert abs(one.force_N - 12.0) < 1.645 * one.sd_N


def changed(locator: ContactLocator, count: int = 2) -> FloatArray:
    """How far contacts of :mod:`tests.decoder.test_pairs` change each other."""
    some = states(locator.places)[:count]
    each_px = [part for part, _ in predicted_shifts(locator.places, some)]
    return changed_by_others(locator.places, some, each_px)


def test_how_far_contacts_change_each_other() -> None:
    assert (changed(aware(flat_locator()), 1) == 0.0).all()
    assert (changed(flat_locator()) == 0.0).all()
    places = aware(flat_locator()).places
    alone = [predicted_shifts(places, [one])[0][0] for one in states(places)]
    together = sum(part for part, _ in predicted_shifts(places, states(places)))
    change = np.linalg.norm(together - np.sum(alone, axis=0))
    assert change > 0.0
    # Each takes a part of the change.
    total = changed(aware(flat_locator())) @ [np.linalg.norm(one) for one in alone]
    assert total == pytest.approx(change, rel=0.1)


def test_forces_that_others_change_are_less_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    koi = np.array(sorted(nearest(place) for place in AT))
    motion, locator = pressed(AT, FORCES_N).reshape(-1, 2), aware(flat_locator())
    sd_N = []
    for share in (0.0, 0.4):
        settings = replace(search.SETTINGS, interaction_error=share, rim_power_factor=0.0)
        monkeypatch.setattr(search, "SETTINGS", settings)
        contacts = locator.find(motion, koi).contacts
        sd_N.append(np.array([one.raw_sd_N for one in contacts]))
    more = np.sqrt(sd_N[1] ** 2 - sd_N[0] ** 2) / [one.raw_N for one in contacts]
    expected = 0.4 * changed(locator)
    assert sorted(more) == pytest.approx(sorted(expected), rel=0.05)


@pytest.mark.parametrize(("x_mm", "force_N"), [(3.0, 12.0), (30.0, 12.0), (30.0, 0.6)])
def test_a_press_that_turns_no_switch_on_is_not_passed_over(x_mm: float, force_N: float) -> None:
    """The frame has no contact, and says that one may be missing; light touches are no matter."""
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, NOISE_PX, 2 * len(MARKERS))
    motion = force_N * fallen(x_mm, RADIUS_MM) * per_newton(at(x_mm, 30.0)) + noise
    idle, none = (
        clamped().find(shift.reshape(-1, 2), np.zeros(0, dtype=np.int64))
        for shift in (motion, noise)
    )
    assert not idle.contacts
    assert none.hidden_N == 0.0
    if force_N < 1.0:
        assert idle.hidden_N == 0.0
    else:
        assert idle.hidden_N == pytest.approx(force_N, rel=0.4)


def press(force_N: float, x_mm: float) -> FloatArray:
    """Shifts (n, 2) px by a press, with noise."""
    noise = np.random.default_rng(1).normal(0.0, NOISE_PX, 2 * len(MARKERS))
    shift = force_N * fallen(x_mm, RADIUS_MM) * per_newton(at(x_mm, 30.0)) + noise
    return shift.reshape(-1, 2)


NONE_ON = np.zeros(0, dtype=np.int64)


def test_of_unequal_switches_the_lightest_says_what_a_light_touch_is() -> None:
    threshold_N = np.full(len(MARKERS), 50.0)
    heavy = replace(clamped(), threshold_N=threshold_N)
    assert heavy.find(press(12.0, 30.0), NONE_ON).hidden_N == 0.0
    threshold_N = threshold_N.copy()
    threshold_N[0] = 0.5
    one = replace(clamped(), threshold_N=threshold_N)
    assert one.find(press(12.0, 30.0), NONE_ON).hidden_N > 8.0


def test_a_press_is_named_from_a_drop_of_chi2_on(monkeypatch: pytest.MonkeyPatch) -> None:
    light = clamped().find(press(2.0, 3.0), NONE_ON)
    assert light.hidden_N > 0.0
    settings = replace(search.SETTINGS, chi2_drop=1e4)
    monkeypatch.setattr(search, "SETTINGS", settings)
    assert clamped().find(press(2.0, 3.0), NONE_ON).hidden_N == 0.0


def test_what_no_contact_explains_is_no_press() -> None:
    """Markers that move each its own way: the noise of a poor picture, however large."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        motion = rng.normal(0.0, 15.0 * NOISE_PX, (len(MARKERS), 2))
        assert clamped().find(motion, NONE_ON).hidden_N == 0.0


@pytest.mark.parametrize("force_N", [4.0, 6.0, 12.0])
def test_without_switches_a_press_that_is_not_sure_is_named(force_N: float) -> None:
    """Beside a rim its force is hardly known, so that it is not reported; and yet it is there."""
    blind = replace(clamped(), blind=np.arange(len(MARKERS)))
    found = blind.find(press(force_N, 0.3), NONE_ON)
    assert found.contacts or found.hidden_N > 0.3 * force_N
    assert blind.find(press(0.0, 0.3), NONE_ON).hidden_N == 0.0
