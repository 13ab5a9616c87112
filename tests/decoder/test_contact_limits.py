"""Contacts where their rules just hold, or just do not: gates, lost frames, merged ones."""

import numpy as np
import pytest

from phytac_decoder.estimation.contact_grouping import Contact, ContactGrouper
from phytac_decoder.estimation.contact_tracker import SETTINGS, ContactTracker
from tests.decoder.test_contacts import FPS, PLANE, around, ids_of, press, spiral, tracker

SPACING_MM = 5.0


def alone(watch: ContactTracker, x: float, time_s: float) -> int:
    """The id of one small finger at x."""
    (contact,) = watch.update(press((x, 70.0, 3.0, 5.0)), time_s)
    return contact.id


def test_a_pull_does_not_push_a_contact_aside() -> None:
    """``fem`` gives negative forces beside a press."""
    forces = np.zeros(len(PLANE.position_mm))
    forces[[820, 821]] = (5.0, -3.0)
    (found,) = PLANE.find(forces, np.array([820, 821]))
    assert found.position_mm == pytest.approx(tuple(PLANE.position_mm[820]), abs=1e-6)
    assert found.force_N == pytest.approx(2.0)


def test_the_strongest_contact_comes_first() -> None:
    forces = np.zeros(len(PLANE.position_mm))
    forces[[100, 820, 1400]] = (2.0, 9.0, 4.0)
    found = PLANE.find(forces, np.array([100, 820, 1400]))
    assert [contact.force_N for contact in found] == [9.0, 4.0, 2.0]


def test_a_quadric_is_not_asked_far_away() -> None:
    position = spiral()
    face = ContactGrouper(position_mm=position, neighbours=around(position))
    out = position[147] * [1.0, 1.0, 0.0] / np.linalg.norm(position[147, :2])
    tangent = np.cross(out, [0.0, 0.0, 1.0])
    for axis in (tangent, np.array([0.0, 0.0, 1.0])):
        found = face.onto_surface(position[147] + 200.0 * axis, [147]) - position[147]
        assert abs(found @ axis) < 2.5 * face.spacing_mm


def test_a_wide_contact_may_go_farther() -> None:
    """Beyond the gate of a point, within half its own width more; no marker in common."""
    step_mm = 17.5
    for radius, same in ((6.0, True), (1.0, False)):
        watch = tracker()
        (first,) = watch.update(press((60.0, 70.0, radius, 5.0)), 0.0)
        (second,) = watch.update(press((60.0 + step_mm, 70.0, radius, 5.0)), 1.0 / FPS)
        assert not set(first.markers) & set(second.markers)
        assert (first.id == second.id) is same


def test_a_fast_contact_is_not_searched_for_beyond_its_gate() -> None:
    """It stops while frames are lost: to go on for all that time would take it past all gates."""
    watch = tracker()
    assert [alone(watch, 40.0 + 10.0 * k, 0.01 * k) for k in range(4)] == [0] * 4
    assert alone(watch, 70.0 + 15.0, 0.03 + 0.1) == 0


def test_speed_is_forgotten_over_a_pause() -> None:
    watch = tracker()
    assert [alone(watch, 40.0 + 10.0 * k, 0.01 * k) for k in range(4)] == [0] * 4
    later = 0.03 + SETTINGS.hold_s + 0.1
    assert alone(watch, 70.0, later) == 0
    assert alone(watch, 56.0, later + 0.01) == 0


def test_four_that_merge_two_by_two_get_their_ids_back() -> None:
    def frame(inner: float, outer: float) -> list[Contact]:
        places = [100.0 + sign * (outer + side * inner) for sign in (-1, 1) for side in (-1, 1)]
        return press(*((x, 70.0, 4.0, 5.0 + k) for k, x in enumerate(places)))

    near = [(gap, 42.0) for gap in np.arange(16.0, 5.0, -1.0)]
    all_one = [(6.0, outer) for outer in np.arange(42.0, 11.0, -1.0)]
    way = [*near, *all_one]
    frames = [frame(inner, outer) for inner, outer in [*way, *way[::-1]]]
    assert {len(contacts) for contacts in frames} >= {1, 2, 4}
    found = ids_of(tracker(), frames)
    assert len(set(found[0])) == 4
    assert found[-1] == found[0]


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_merged_contacts_that_slide_over_one_old_place_are_still_both(sign: float) -> None:
    def frame(gap: float, aside: float) -> list[Contact]:
        return press(
            (100.0 - gap / 2 + aside, 70.0, 5.0, 6.0), (100.0 + gap / 2 + aside, 70.0, 5.0, 7.0)
        )

    meet = [frame(gap, 0.0) for gap in np.arange(30.0, 11.0, -2.0)]
    slide = [frame(12.0, sign * step) for step in np.arange(1.0, 26.0)]
    found = ids_of(tracker(), [*meet, *slide])
    (one,) = found[len(meet) - 1]
    assert found[len(meet) :] == [[one]] * len(slide)


def at(*places_mm: float) -> list[Contact]:
    """Small contacts along x."""
    return [
        Contact(force_N=1.0, position_mm=(x, 0.0, 0.0), size_mm=2.0, markers=(int(x),))
        for x in places_mm
    ]


def test_more_pieces_than_merged_have_ids_of_their_own() -> None:
    watch = ContactTracker(spacing_mm=10.0)
    spread = (0, 5, 25, 45, 50)
    one = Contact(force_N=2.0, position_mm=(25.0, 0.0, 0.0), size_mm=2.0, markers=spread)
    frames = (at(5.0, 45.0), [one], at(0.0, 25.0, 50.0), at(0.0, 25.0, 50.0))
    found = [
        [contact.id for contact in watch.update(contacts, number / FPS)]
        for number, contacts in enumerate(frames)
    ]
    assert found == [[0, 1], [0], [0, 2, 1], [0, 2, 1]]


def test_a_contact_that_was_not_found_in_time_is_a_new_one() -> None:
    """Frames in between may have been missed, or unreadable."""
    watch = ContactTracker(spacing_mm=10.0)
    assert [contact.id for contact in watch.update(at(20.0), 0.0)] == [0]
    assert watch.update([], 0.1) == []
    (soon,) = watch.update(at(20.0), SETTINGS.hold_s)
    assert (soon.id, soon.since_s) == (0, 0.0)
    assert watch.update([], SETTINGS.hold_s + 0.1) == []
    (late,) = watch.update(at(20.0), 60.0)
    assert (late.id, late.since_s) == (1, 60.0)
