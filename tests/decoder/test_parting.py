"""Contacts whose switches are neighbours, on a sensor in closed form."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation import locator as search
from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.estimation.contact_fit import ShiftNoise
from phytac_decoder.estimation.contact_shifts import ContactState
from phytac_decoder.estimation.locator import SETTINGS, ContactLocator
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import (
    MARKERS,
    PITCH_MM,
    RADIUS_MM,
    flat_locator,
    nearest,
    shifts,
    together,
    with_fitted_noise,
)

LOCATOR = flat_locator()


def find(shift: FloatArray, koi: list[int]) -> list[LocatedContact]:
    return LOCATOR.find(shift.reshape(-1, 2), np.array(koi, dtype=np.int64)).contacts


def point(x: float, y: float) -> FloatArray:
    return np.array([x, y, 0.0])


def test_two_contacts_whose_switches_are_neighbours() -> None:
    one, two = point(21.0, 21.0), point(33.0, 33.0)
    koi = sorted({nearest(one), nearest(two), nearest(point(27.0, 27.0))})
    found = find(together([one, two], [6.0, 12.0]), koi)
    forces = sorted(contact.force_N for contact in found)
    assert forces == pytest.approx([6.0, 12.0], rel=0.02)
    assert sorted(m for contact in found for m in contact.markers) == koi


def test_fingers_side_by_side_are_parted() -> None:
    places = [point(x, 30.0) for x in (12.0, 27.0, 42.0)]
    koi = sorted({nearest(at + point(dx, 0.0)) for at in places for dx in (-3.0, 3.0)})
    forces = (9.0, 3.0, 6.0)
    seen = together(places, forces)
    found = sorted(find(seen, koi), key=lambda contact: contact.point_mm[0])
    assert [contact.force_N for contact in found] == pytest.approx(forces, rel=0.03)
    assert sorted(m for contact in found for m in contact.markers) == koi


def test_fingers_are_parted_though_noise_is_presumed_too_much() -> None:
    places = [point(x, 30.0) for x in (12.0, 30.0)]
    koi = np.arange(nearest(places[0]), nearest(places[1]) + 10, 10)
    seen = together(places, [6.0, 6.0]).reshape(-1, 2)
    timid = replace(LOCATOR, noise=ShiftNoise(centroid_px=0.4))
    found = timid.find(seen, koi)
    assert found.reduced_chi2 < 0.1
    assert [contact.force_N for contact in found.contacts] == pytest.approx([6.0, 6.0], rel=0.05)


def test_nine_fingers_are_parted_at_once() -> None:
    """More than may be found as contacts without a switch: their groups are parted first."""
    places = [point(x, y) for y in (9.0, 30.0, 51.0) for x in (12.0, 27.0, 42.0)]
    forces = (9.0, 3.0, 6.0, 4.0, 8.0, 5.0, 7.0, 3.0, 5.0)
    koi = sorted({nearest(at + point(dx, 0.0)) for at in places for dx in (-3.0, 3.0)})
    seen = together(places, forces)
    found = find(seen, koi)
    assert len(found) == 9
    for at, force in zip(places, forces, strict=True):
        near = min(found, key=lambda contact: float(np.linalg.norm(contact.point_mm - at)))
        assert near.force_N == pytest.approx(force, rel=0.03)


NARROW = 2.3
"""Radius of presses on the footprint of a switch, mm."""


def narrow_presses(locator: ContactLocator) -> ContactLocator:
    """The estimator after training with presses on receptors."""
    less = (NARROW**2 - RADIUS_MM**2) / 4.0
    prior = replace(
        locator.prior,
        place_mm=0.3,
        moments_mm2=(less, 0.0, less),
        moments_sd_mm2=(0.5, 0.5, 0.5),
    )
    return with_fitted_noise(replace(locator, prior=prior))


@pytest.mark.parametrize("force_N", [(9.0, 16.0), (4.0, 22.0)])
def test_narrow_presses_on_neighbouring_switches_are_two(force_N: tuple[float, float]) -> None:
    """One wider contact explains their motion nearly as well, and training has seen none."""
    ids, disc = np.array([44, 45]), NARROW**2 / 4.0 * np.array([1.0, 0.0, 1.0])
    seen = np.sum(
        [shifts(MARKERS[k], f, disc) for k, f in zip(ids, force_N, strict=True)], axis=0
    ).reshape(-1, 2)
    seen += np.random.default_rng(0).normal(0.0, 0.1, seen.shape)
    found = narrow_presses(flat_locator(noise_px=0.1)).find(seen, ids)
    contacts = sorted(found.contacts, key=lambda contact: contact.markers.tolist())
    assert [contact.markers.tolist() for contact in contacts] == [[44], [45]]
    for contact, f in zip(contacts, force_N, strict=True):
        assert contact.force_N == pytest.approx(f, rel=0.15)
    # Contacts of any width are one.
    assert len(flat_locator(noise_px=0.1).find(seen, ids).contacts) == 1


def test_more_contacts_than_fingers_are_no_contacts(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a frame of another colour all switches may seem on: the search for contacts ends soon."""
    counts: list[int] = []
    fit = ContactLocator._fit

    def counted(self: ContactLocator, states: list[ContactState], *given: Any, **named: Any) -> Any:
        counts.append(len(states))
        return fit(self, states, *given, **named)

    monkeypatch.setattr(ContactLocator, "_fit", counted)
    every = np.arange(len(MARKERS))
    shift = np.random.default_rng(3).normal(0.0, 1.0, (len(MARKERS), 2))
    with_fitted_noise(flat_locator(place_mm=0.3)).find(shift, every)
    assert 1 <= max(counts) <= SETTINGS.separate_max


def test_of_too_many_groups_of_switches_the_strongest_are_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """25 single switches seem on, and two are pressed."""
    monkeypatch.setattr(search, "SETTINGS", replace(SETTINGS, separate_max=6))
    single = np.flatnonzero((MARKERS[:, :2] % (2.0 * PITCH_MM) == 3.0).all(axis=1))
    at = [MARKERS[single[7]], MARKERS[single[18]]]
    found = find(together(at, [9.0, 14.0]), single.tolist())
    assert len(single) == 25
    assert len(found) == 6
    # No contact has a switch that is far away.
    for one in found:
        gap = np.linalg.norm(MARKERS[one.markers] - one.point_mm, axis=1)
        assert gap.max() < 2.0 * PITCH_MM
    for point, force in zip(at, (9.0, 14.0), strict=True):
        near = min(found, key=lambda one: float(np.linalg.norm(one.point_mm - point)))
        assert near.force_N == pytest.approx(force, rel=0.05)
