"""Warm starts: contacts followed from frame to frame equal those of each frame alone, sooner."""

from collections.abc import Callable
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

from phytac_decoder.estimation import contact_fit
from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.locator import SETTINGS
from phytac_shapes.arrays import FloatArray, IntArray
from tests.decoder.flat_sensor import flat_locator, nearest, together

LOCATOR = flat_locator()
NOISE_PX = 0.02
FIRST, SECOND = np.array([16.0, 17.0, 0.0]), np.array([44.0, 41.0, 0.0])
KOI = np.array(sorted([nearest(FIRST), nearest(SECOND)]))


def frame(number: int, forces_N: tuple[float, float], slid_mm: float = 0.0) -> FloatArray:
    """Noisy shifts (n, 2) of two contacts, the first of which slides."""
    clean = together([FIRST + np.array([slid_mm, 0.0, 0.0]), SECOND], list(forces_N))
    noise = np.random.default_rng(number).normal(scale=NOISE_PX, size=len(clean))
    return (clean + noise).reshape(-1, 2)


def age_of(found: ContactDetection) -> int:
    """Frames since its contacts were searched for."""
    assert found.state is not None
    return found.state.age


def followed(
    shifts: Callable[[int], FloatArray], count: int, koi: IntArray = KOI
) -> tuple[list[ContactDetection], list[int]]:
    """Frames in their order, and how many rounds of fits each took."""
    out: list[ContactDetection] = []
    rounds = []
    for k in range(count):
        with mock.patch.object(
            contact_fit, "predicted_shifts", wraps=contact_fit.predicted_shifts
        ) as asked:
            out.append(LOCATOR.find(shifts(k), koi, before=out[-1] if out else None))
        rounds.append(asked.call_count)
    return out, rounds


def test_contacts_that_move_and_grow_are_as_by_themselves() -> None:
    def shifts(k: int) -> FloatArray:
        return frame(k, (6.0 + 0.3 * k, 12.0 - 0.2 * k), slid_mm=0.1 * k)

    found, rounds = followed(shifts, 12)
    assert [age_of(each) for each in found] == list(range(12))
    alone = [LOCATOR.find(shifts(k), KOI) for k in range(12)]
    for one, other in zip(found, alone, strict=True):
        for a, b in zip(one.contacts, other.contacts, strict=True):
            assert abs(a.raw_N - b.raw_N) < 0.2 * b.raw_sd_N
            assert np.linalg.norm(a.point_mm - b.point_mm) < 0.2 * np.linalg.norm(b.sd_mm)
            assert a.markers.tolist() == b.markers.tolist()
    assert max(rounds[1:]) < rounds[0]


def test_switches_that_come_and_go_beside_their_contact_are_its_own() -> None:
    first = LOCATOR.find(frame(0, (8.0, 8.0)), KOI)
    beside = int(LOCATOR.neighbours[nearest(FIRST)].max())
    more = np.array(sorted([*KOI, beside]))
    grown = LOCATOR.find(frame(1, (8.0, 8.0)), more, before=first)
    assert age_of(grown) == 1
    assert beside in grown.contacts[0].markers or beside in grown.contacts[1].markers
    assert age_of(LOCATOR.find(frame(2, (8.0, 8.0)), KOI, before=grown)) == 2


def test_other_switches_are_searched_again() -> None:
    first = LOCATOR.find(frame(0, (8.0, 8.0)), KOI)
    away = np.array(sorted([*KOI, nearest(np.array([30.0, 6.0, 0.0]))]))
    for koi in (away, KOI[:1]):
        assert age_of(LOCATOR.find(frame(1, (8.0, 8.0)), koi, before=first)) == 0


def test_a_switch_between_two_contacts_is_searched_again() -> None:
    middle, arm = np.array([30.0, 30.0, 0.0]), np.array([6.0, 0.0, 0.0])
    close = [middle - arm, middle + arm]
    clean = together(close, [8.0, 8.0]).reshape(-1, 2)
    own = np.array(sorted(nearest(each) for each in close))
    first = LOCATOR.find(clean, own)
    assert age_of(LOCATOR.find(clean, own, before=first)) == 1
    both = np.array(sorted([*own, nearest(middle)]))
    assert age_of(LOCATOR.find(clean, both, before=first)) == 0


def test_what_they_no_longer_explain_is_searched_again() -> None:
    """A third contact under the same switches, as strong as another's would be."""
    first = LOCATOR.find(frame(0, (8.0, 8.0)), KOI)
    third = np.array([45.0, 12.0, 0.0])
    both = together([FIRST, SECOND, third], [8.0, 8.0, 2.5])
    noise = np.random.default_rng(1).normal(scale=NOISE_PX, size=len(both))
    shift = (both + noise).reshape(-1, 2)
    found = LOCATOR.find(shift, KOI, before=first)
    assert age_of(found) == 0
    assert len(found.contacts) == 3
    assert first.state is not None
    assert found.state is not None
    assert found.state.reduced_chi2 < SETTINGS.chi2_growth_max * max(first.state.reduced_chi2, 1.0)


def test_a_faint_contact_is_seen_within_a_few_frames() -> None:
    """It hardly changes the total residual."""
    third = np.array([45.0, 12.0, 0.0])

    def shifts(k: int) -> FloatArray:
        clean = together([FIRST, SECOND, third], [8.0, 8.0, 0.0 if k < 2 else 0.35])
        noise = np.random.default_rng(k).normal(scale=NOISE_PX, size=len(clean))
        return (clean + noise).reshape(-1, 2)

    # Of many more markers it would change even less.
    with mock.patch(
        "phytac_decoder.estimation.locator.SETTINGS", replace(SETTINGS, chi2_growth_max=100.0)
    ):
        found, rounds = followed(shifts, 2 + SETTINGS.search_every_frames)
    assert [len(each.state.fit.states) for each in found if each.state][-1] == 3
    assert age_of(found[1]) == 1
    # The fit that shows it is kept: it is as in the frame alone, in fewer rounds.
    seen_at = SETTINGS.search_every_frames
    assert age_of(found[seen_at]) == 0
    with mock.patch.object(
        contact_fit, "predicted_shifts", wraps=contact_fit.predicted_shifts
    ) as asked:
        alone = LOCATOR.find(shifts(seen_at), KOI)
    assert rounds[seen_at] < asked.call_count
    for one, other in zip(found[seen_at].contacts, alone.contacts, strict=True):
        assert one.raw_N == pytest.approx(other.raw_N, abs=0.05 * other.raw_sd_N)


def test_a_contact_without_a_switch_that_is_lifted_is_gone() -> None:
    only = KOI[:1] if KOI[0] == nearest(FIRST) else KOI[1:]
    first = LOCATOR.find(frame(0, (8.0, 2.0)), only)
    assert [len(contact.markers) for contact in first.contacts] == [1, 0]
    held = LOCATOR.find(frame(1, (8.0, 2.0)), only, before=first)
    assert age_of(held) == 1
    assert len(held.contacts) == 2
    lifted = LOCATOR.find(frame(2, (8.0, 0.0)), only, before=held)
    assert age_of(lifted) == 0
    assert len(lifted.contacts) == 1


@pytest.mark.parametrize("switched", [True, False])
def test_after_a_while_contacts_are_searched_for_again(switched: bool) -> None:
    only = KOI if switched else KOI[:1] if KOI[0] == nearest(FIRST) else KOI[1:]
    often = replace(SETTINGS, reinitialise_after_frames=(5, 3))
    with mock.patch("phytac_decoder.estimation.locator.SETTINGS", often):
        ages, before = [], None
        for k in range(7):
            before = LOCATOR.find(frame(k, (8.0, 8.0 if switched else 2.0)), only, before=before)
            ages.append(age_of(before))
    assert ages == ([0, 1, 2, 3, 4, 5, 0] if switched else [0, 1, 2, 3, 0, 1, 2])


def test_nothing_pressed_is_nothing() -> None:
    first = LOCATOR.find(frame(0, (8.0, 8.0)), KOI)
    none = np.zeros(0, dtype=np.int64)
    lifted = LOCATOR.find(frame(1, (0.0, 0.0)), none, before=first)
    assert lifted.contacts == []
    assert LOCATOR.find(frame(2, (0.0, 0.0)), none, before=lifted).contacts == []
    again = LOCATOR.find(frame(3, (8.0, 8.0)), KOI, before=lifted)
    assert len(again.contacts) == 2
