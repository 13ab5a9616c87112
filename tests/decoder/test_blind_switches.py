"""Contacts on switches that the camera cannot read, on a sensor in closed form."""

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

from phytac_decoder.estimation import contact_fit, locator
from phytac_decoder.estimation.contact_fit import ShiftNoise
from phytac_decoder.estimation.locator import SETTINGS, ContactLocator, SwitchForces
from phytac_decoder.vision.switch_detection import TipModel
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import MARKERS, flat_locator, nearest, shifts, together

COUNT = len(MARKERS)
LOCATOR = flat_locator()


def point(x: float, y: float) -> FloatArray:
    return np.array([x, y, 0.0])


def blind_at(point_mm: FloatArray) -> ContactLocator:
    """The locator of a camera that cannot read the switches around a point."""
    gap = np.linalg.norm(MARKERS - point_mm, axis=1)
    return replace(LOCATOR, blind=np.flatnonzero(gap < 8.0))


def test_an_unreadable_switch_is_no_evidence_against_a_contact() -> None:
    loud, unread = point(15.0, 15.0), point(45.0, 45.0)
    both = together([loud, unread], [10.0, 15.0])
    found = blind_at(unread).find(both.reshape(-1, 2), np.array([nearest(loud)]))
    first, second = found.contacts
    assert first.force_N == pytest.approx(10.0, rel=5e-3)
    assert second.force_N == pytest.approx(15.0, rel=5e-3)
    # It must have turned these switches on: the force is those receptors'.
    forces = found.receptor_forces_N(COUNT)
    assert forces[second.markers].sum() == pytest.approx(second.force_N)
    assert nearest(unread) in second.markers
    # All of them would be off, were they read: then there is no telling.
    alone = blind_at(point(45.0, 57.0)).find(both.reshape(-1, 2), np.array([nearest(loud)]))
    assert len(alone.contacts) == 1


def test_an_unread_contact_is_found_though_noise_is_presumed_too_much() -> None:
    loud, unread = point(15.0, 15.0), point(45.0, 45.0)
    both = together([loud, unread], [10.0, 3.0]).reshape(-1, 2)
    timid = replace(blind_at(unread), noise=ShiftNoise(centroid_px=0.5))
    found = timid.find(both, np.array([nearest(loud)]))
    first, second = found.contacts
    assert (first.force_N, second.force_N) == pytest.approx((10.0, 3.0), rel=0.05)
    assert nearest(unread) in second.markers
    # Noise by the design file, more than there is: what is missed is no misfit.
    missed = replace(timid, blind=timid.blind[:0]).find(both, np.array([nearest(loud)]))
    assert missed.reduced_chi2 < SETTINGS.chi2_unexplained
    assert len(missed.contacts) == 1
    # Nor is what is missed alone.
    none = np.zeros(0, dtype=np.int64)
    (alone,) = timid.find(shifts(unread, 3.0).reshape(-1, 2), none).contacts
    assert alone.force_N == pytest.approx(3.0, rel=0.05)


def test_what_would_turn_on_switches_that_are_off_is_no_contact_on_unread_ones() -> None:
    loud, other = point(15.0, 15.0), point(42.0, 42.0)
    both = together([loud, other], [10.0, 12.0]).reshape(-1, 2)
    # One of those it must have turned on cannot be read; the others are off.
    part = replace(LOCATOR, blind=np.array([nearest(point(45.0, 45.0))]))
    assert len(part.find(both, np.array([nearest(loud)])).contacts) == 1


def test_red_that_hardly_grows_cannot_be_read() -> None:
    rest = np.array([580.0, 600.0, 0.0])
    tips = TipModel(
        on_px=np.zeros((3, 2)), red_rest_px=rest, red_on_px=np.array([740.0, 795.0, 60.0])
    )
    assert tips.readable.tolist() == [False, True, True]
    assert tips.blind(np.array([True, False, False])).tolist() == [0]


def test_motion_alone_finds_a_press_on_an_unreadable_switch() -> None:
    at, aside = point(45.0, 45.0), point(15.0, 15.0)
    none = np.zeros(0, dtype=np.int64)
    for force in (3.0, 20.0):
        seen = shifts(at, force).reshape(-1, 2)
        (contact,) = blind_at(at).find(seen, none).contacts
        assert contact.force_N == pytest.approx(force, rel=5e-3)
        assert nearest(at) in contact.markers
        # Where the switches that are pressed can be read, theirs is the last word.
        assert blind_at(aside).find(seen, none).contacts == []


def test_noise_alone_makes_no_contact_where_switches_cannot_be_read() -> None:
    rng = np.random.default_rng(4)
    blind = replace(LOCATOR, blind=np.arange(0, COUNT, 3))
    for _ in range(50):
        noisy = rng.normal(0.0, 0.02, (COUNT, 2))
        assert blind.find(noisy, np.zeros(0, dtype=np.int64)).contacts == []


@pytest.mark.parametrize("unread_N", [0.0, 3.0])
def test_a_contact_is_tried_only_where_linear_theory_foresees_it(unread_N: float) -> None:
    """The forces of the compliance inverse on unreadable switches are often of other contacts."""
    loud, unread = point(15.0, 15.0), point(36.0, 36.0)
    both = together([loud, unread], [10.0, unread_N]).reshape(-1, 2)
    other = blind_at(unread)
    start = other._start(
        np.array([nearest(unread)]), SwitchForces(np.ones(1), np.ones(1)), np.arange(1)
    )
    with (
        mock.patch.object(ContactLocator, "_unreadable_starts", return_value=[start]),
        mock.patch.object(locator, "fit_contacts", wraps=contact_fit.fit_contacts) as tried,
    ):
        found = other.find(both, np.array([nearest(loud)]))
    assert len(found.contacts) == (2 if unread_N else 1)
    assert tried.call_count == (2 if unread_N else 1)


def doubtful_press(force_N: float, noise_px: float) -> tuple[ContactLocator, FloatArray]:
    """A locator of so much noise, and shifts by a press on switches that it cannot read."""
    at = point(45.0, 45.0)
    noisy = replace(blind_at(at), noise=ShiftNoise(centroid_px=noise_px))
    return noisy, shifts(at, force_N).reshape(-1, 2)


def test_a_contact_that_noise_nearly_hides_on_unreadable_switches_is_named() -> None:
    none = np.zeros(0, dtype=np.int64)
    doubtful, seen = doubtful_press(3.0, 2.0)
    hidden = doubtful.find(seen, none)
    assert hidden.contacts == []
    assert hidden.hidden_N == pytest.approx(3.0, rel=0.3)
    # In more noise nothing shows it; in less, it is found.
    drowned, _ = doubtful_press(3.0, 20.0)
    assert drowned.find(seen, none).hidden_N == 0.0
    clear, _ = doubtful_press(3.0, 0.02)
    found = clear.find(seen, none)
    assert len(found.contacts) == 1
    assert found.hidden_N == 0.0
    # Nothing is hidden where all switches can be read; sensors without switches are left out.
    assert replace(doubtful, blind=none).find(seen, none).hidden_N == 0.0
    assert replace(doubtful, blind=np.arange(COUNT)).find(seen, none).hidden_N == 0.0
    # A pull outwards is no press.
    assert doubtful.find(-seen, none).hidden_N == 0.0
    # A force that turns no switch on is not looked for.
    weak, seen = doubtful_press(0.4, 0.2)
    assert weak.find(seen, none).hidden_N == 0.0
    sensitive = replace(weak, threshold_N=0.5 * weak.threshold_N)
    assert sensitive.find(seen, none).hidden_N == pytest.approx(0.4, rel=0.1)


def test_a_hidden_contact_is_sought_beside_markers_too() -> None:
    gap = np.linalg.norm(MARKERS[:, None] - LOCATOR.places.point_mm, axis=2).min(axis=1)
    inside = ((MARKERS > 20.0) & (MARKERS < 40.0))[:, :2].all(axis=1)
    (beside, *_) = np.flatnonzero(inside & (gap > 0.5))
    one = replace(LOCATOR, blind=np.array([beside]), noise=ShiftNoise(centroid_px=2.0))
    seen = shifts(MARKERS[beside], 3.0).reshape(-1, 2)
    hidden = one.find(seen, np.zeros(0, dtype=np.int64))
    assert hidden.contacts == []
    assert hidden.hidden_N == pytest.approx(3.0, rel=0.05)


def test_a_contact_on_unreadable_switches_that_is_not_sure_enough_is_named() -> None:
    doubtful, seen = doubtful_press(3.0, 0.02)
    none = np.zeros(0, dtype=np.int64)
    demanding = replace(SETTINGS, force_sd_min=1e6)
    with mock.patch.object(locator, "SETTINGS", demanding):
        hidden = doubtful.find(seen, none)
    assert hidden.contacts == []
    assert hidden.hidden_N == pytest.approx(3.0, rel=0.01)
