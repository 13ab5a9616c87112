"""Switches whose thresholds are known better say more about contacts."""

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest

from phytac_decoder.estimation.contact_fit import initial_state
from phytac_decoder.estimation.locator import SETTINGS
from tests.decoder.flat_sensor import MARKERS, flat_locator

if TYPE_CHECKING:
    from phytac_decoder.estimation.contact_fit import ContactFit

LOCATOR = flat_locator()
COUNT = len(MARKERS)


def test_share_of_switches_that_a_force_turns_on() -> None:
    ids, spread = np.arange(2), SETTINGS.threshold_spread
    sure = replace(LOCATOR, threshold_sd=np.full(COUNT, 0.1))
    for locator, sd in ((LOCATOR, spread), (sure, 0.1)):
        carried = 0.5 * np.exp(sd * np.array([[0.0, 1.0], [-1.0, 2.0]]))
        # Standard deviations of a normal distribution.
        expected = np.array([[0.5, 0.841], [0.159, 0.977]])
        assert locator._share_on(carried, ids) == pytest.approx(expected, abs=0.012)
    # Each switch has a threshold of its own.
    own = replace(LOCATOR, threshold_N=np.where(np.arange(COUNT) == 1, 1.0, 0.5))
    share = own._share_on(np.array([0.5, 0.5]), ids)
    assert share[0] == pytest.approx(0.5)
    assert share[1] < 0.05


def test_a_switch_that_is_off_bears_less_the_better_its_threshold_is_known() -> None:
    none = np.zeros(0, dtype=np.int64)
    sure = replace(LOCATOR, threshold_sd=np.full(COUNT, 0.1))
    for excess, agree in ((1.1, [True, True]), (1.6, [True, False]), (2.2, [False, False])):
        state = initial_state(LOCATOR.places, LOCATOR.prior, MARKERS[40], 1.0, place_sd_mm=1.0)
        force = excess * 0.5 / LOCATOR._carried(state).max()
        state = initial_state(LOCATOR.places, LOCATOR.prior, MARKERS[40], force, place_sd_mm=1.0)
        fit = cast("ContactFit", SimpleNamespace(states=[state]))
        assert [one._could_be_off(fit, none) for one in (LOCATOR, sure)] == agree
