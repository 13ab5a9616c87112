"""Standard deviations that ``phytac evaluate`` holds against true forces."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.locator import ContactLocator
from phytac_design.datasets.samples import FAILED, Samples
from phytac_design.training.evaluation.contact_scores import interval_coverage
from phytac_design.training.evaluation.decoded_contacts import DecodedContacts, decode_contacts
from phytac_design.training.evaluation.interval_scores import interval_scores, intervals_text
from phytac_design.training.locator_calibration import calibrate_locator, matches_by_switch
from phytac_shapes.arrays import FloatArray, IntArray
from tests.decoder.flat_samples import PLACE_MM, pressed
from tests.decoder.flat_sensor import flat_locator
from tests.refusals import refused


class Flat:
    """A decoder with ``auto`` alone."""

    estimators = ("auto",)

    def __init__(self, locator: ContactLocator) -> None:
        self.locator = locator

    def contacts(self, shift_px: FloatArray, koi: IntArray) -> ContactDetection:
        return self.locator.find(shift_px, koi)

    def forces(self, _: str, shift_px: FloatArray, koi: IntArray) -> FloatArray:
        assert not len(koi)
        return np.zeros(len(shift_px))


class Doubtful(Flat):
    """One whose standard deviations are no numbers."""

    def contacts(self, shift_px: FloatArray, koi: IntArray) -> ContactDetection:
        found = super().contacts(shift_px, koi)
        return replace(found, contacts=[replace(one, sd_N=np.nan) for one in found.contacts])


@cache
def decoded_model() -> Flat:
    """A sensor that learnt from samples."""
    plain = flat_locator(place_mm=PLACE_MM, noise_px=0.1)
    training = pressed(120, seed=1, slope=0.08)
    return Flat(calibrate_locator(plain, training, np.arange(120), force_max_N=25.0)[0])


def decode(model: Any, samples: Samples) -> DecodedContacts:
    return decode_contacts(model, samples)


@cache
def judged() -> tuple[DecodedContacts, Samples]:
    """Contacts of 200 other samples."""
    fresh = pressed(200, seed=3, slope=0.08)
    return decode(decoded_model(), fresh), fresh


def scores_of(decoded: DecodedContacts) -> dict[str, Any]:
    scores = interval_scores(decoded)
    assert scores is not None
    return scores


def test_true_forces_are_counted_in_the_intervals_of_auto() -> None:
    decoded, samples = judged()
    assert samples.touches is not None
    scores = scores_of(decoded)
    touch, force, sd, truth = decoded.stated.T
    np.testing.assert_array_equal(truth, samples.touches.force_N[touch.astype(np.int64)])
    assert scores["within_90"]["value"] == pytest.approx(interval_coverage(force, sd, truth))
    assert 0.82 < scores["within_90"]["value"] < scores["within_95"]["value"] < 0.99
    share, low, high = (scores["within_90"][name] for name in ("value", "low", "high"))
    assert low < share < high
    chance = np.sqrt(share * (1.0 - share) / len(force))
    assert high - low == pytest.approx(2.0 * 1.96 * chance, rel=0.1)
    assert scores["sd_factor"] == pytest.approx(1.0, abs=0.25)
    assert scores["contacts"] + scores["unmatched"] == decoded.read.sum()
    assert scores["sd_N"] == pytest.approx(np.median(sd))
    assert intervals_text(scores).endswith("%)")


def test_standard_deviations_of_another_size_are_named() -> None:
    decoded, _ = judged()
    usual = scores_of(decoded)["sd_factor"]
    half, wide = (
        scores_of(replace(decoded, stated=decoded.stated * [1.0, 1.0, by, 1.0]))
        for by in (0.5, 4.0)
    )
    assert half["sd_factor"] == pytest.approx(2.0 * usual)
    assert f"too small for these data, by a factor of {2.0 * usual:.2g}" in intervals_text(half)
    assert "larger than need be" in intervals_text(wide)


def test_few_contacts_are_not_judged() -> None:
    decoded, _ = judged()
    few = replace(decoded, stated=decoded.stated[:60] * [1.0, 1.0, 0.2, 1.0])
    assert "fewer than 100 contacts" in intervals_text(scores_of(few))


def test_contacts_of_one_sample_are_drawn_together() -> None:
    """Contacts that err alike tell as little as there are samples."""
    decoded, _ = judged()
    ten = decoded.sample // 10
    stated = decoded.stated.copy()
    wrong = (ten % 2)[np.searchsorted(decoded.touch, stated[:, 0])]
    stated[:, 2] = np.where(wrong, 1e-6, 1e6)
    each = replace(decoded, stated=stated)
    width = [
        np.ptp([scores_of(one)["within_90"][end] for end in ("low", "high")])
        for one in (each, replace(each, sample=ten))
    ]
    assert width[1] > 2.0 * width[0]


def test_the_own_force_counts_where_a_switch_is_shared() -> None:
    """A switch belongs to the contact that presses most: its force there is not that of one."""
    decoded, samples = judged()
    assert samples.truth is not None
    assert samples.touches is not None
    more = replace(samples, truth=replace(samples.truth, force_N=1.2 * samples.truth.force_N))
    again = decode(decoded_model(), more)
    np.testing.assert_allclose(again.force_N[again.tripped], 1.2 * decoded.force_N[again.tripped])
    np.testing.assert_array_equal(again.stated, decoded.stated)


def test_failed_samples_are_not_judged_and_no_number_is_refused() -> None:
    decoded, samples = judged()
    status = np.where(np.arange(samples.count) < 40, FAILED, samples.status)
    fewer = decode(decoded_model(), replace(samples, status=status))
    first = int(np.searchsorted(decoded.sample, 40))
    np.testing.assert_array_equal(fewer.stated, decoded.stated[decoded.stated[:, 0] >= first])
    assert scores_of(fewer)["contacts"] == len(fewer.stated)
    with refused("estimator-not-finite"):
        decode(Doubtful(decoded_model().locator), samples)


def test_a_contact_without_a_match_is_counted_and_none_is_no_score() -> None:
    decoded, _ = judged()
    fewer = replace(decoded, stated=decoded.stated[3:])
    assert scores_of(fewer)["unmatched"] == scores_of(decoded)["unmatched"] + 3
    assert interval_scores(replace(decoded, stated=np.empty((0, 4)))) is None


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        ([[4, 5]], [(7, 0)]),
        ([[4], [9]], [(7, 0), (8, 1)]),
        ([[4], [5]], []),  # one as two
        ([[4, 9]], []),  # two as one
        ([[1]], []),  # nothing is pressed there
    ],
)
def test_contacts_match_by_their_switches(
    found: list[list[int]], expected: list[tuple[int, int]]
) -> None:
    contacts = [SimpleNamespace(markers=np.array(markers)) for markers in found]
    one: Any = SimpleNamespace(contacts=contacts)
    matches = matches_by_switch(one, np.array([4, 5, 9]), np.array([7, 7, 8]))
    number = {id(contact): k for k, contact in enumerate(contacts)}
    assert [(touch, number[id(contact)]) for touch, contact in matches] == expected
