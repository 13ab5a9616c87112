"""Contacts whose switches are neighbours, on a sensor in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.estimation.contact_fit import ShiftNoise
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import flat_locator, nearest, together

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
