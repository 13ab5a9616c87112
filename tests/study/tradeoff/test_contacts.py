"""Standard contacts: even, off the rims, always the same."""

import numpy as np
import pytest

from phytac_design.layout.arc import by_area
from phytac_design.study.tradeoff.force import standard_contacts
from tests.designs import drawn, small
from tests.refusals import refused


@pytest.mark.parametrize("kind", ["cylinder", "cone", "hemisphere", "plane", "grip"])
def test_contacts_stand_off_every_rim(kind: str) -> None:
    design = drawn(kind, 3)
    surface = design.surface()
    contacts = standard_contacts(design, surface, 12)
    for axis, end in surface.edges():
        uv = np.full((129, 2), surface.domain[axis, end])
        uv[:, 1 - axis] = np.linspace(*surface.domain[1 - axis], len(uv))
        gap = np.linalg.norm(surface.point(contacts.uv)[:, None] - surface.point(uv), axis=2)
        assert gap.min() >= 2.0 * contacts.radius_mm[0] - 1e-9
    assert len(np.unique(contacts.uv, axis=0)) == len(contacts.uv) == 12
    again = standard_contacts(design, design.surface(), 12)
    assert np.array_equal(contacts.uv, again.uv)
    assert np.array_equal(contacts.force_N, again.force_N)


def test_forces_span_a_fifth_to_the_largest() -> None:
    design = small()
    force = standard_contacts(design, design.surface()).force_N
    largest = design.training.force_max_N
    assert 0.2 * largest <= force.min() < 0.35 * largest
    assert 0.85 * largest < force.max() <= largest


def test_places_are_even_over_the_area_of_a_dome() -> None:
    surface = drawn("hemisphere", 1).surface()
    numbers = np.random.default_rng(0).random((20000, 2))
    z = surface.point(by_area(surface, numbers))[:, 2]
    low, high = surface.bounds_mm()[:, 2]
    # On a sphere the height is even (Archimedes), and so it is on a skirt.
    share = np.histogram(z, bins=10, range=(low, high))[0] / len(z)
    assert np.abs(share - 0.1).max() < 0.012


def test_a_sensor_that_is_all_rim_is_rejected() -> None:
    design = small(training={"patch_radius_min_mm": 30.0, "patch_radius_max_mm": 31.0})
    with refused("standard-contacts-no-room"):
        standard_contacts(design, design.surface())
