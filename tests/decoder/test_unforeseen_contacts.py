"""Contacts that the priors of a decoder do not foresee: elsewhere, larger, on a softer wall."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation import contact_fit, place_average
from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.estimation.contact_fit import ShiftObservation
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.locator import SETTINGS, ContactLocator
from phytac_decoder.io.bundle import STIFFNESS_CHANGE, load_bundle, save_bundle
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import (
    DISC,
    MARKERS,
    flat_locator,
    nearest,
    shifts,
    with_fitted_noise,
)
from tests.decoder.test_bundle_locator import bundle

AT = np.array([27.0, 33.0, 0.0])


def find(locator: ContactLocator, at: FloatArray, moments: FloatArray = DISC) -> LocatedContact:
    """The contact of 10 N at a point, on the switch of marker 54."""
    seen = shifts(at, 10.0, moments) + np.random.default_rng(2).normal(0, 0.02, 2 * len(MARKERS))
    (found,) = locator.find(seen.reshape(-1, 2), np.array([nearest(AT)])).contacts
    return found


def rigid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Priors that count fully however far a contact is from them."""
    settings = replace(contact_fit.SETTINGS, place_sds=1e6, moments_sds=1e6)
    monkeypatch.setattr(contact_fit, "SETTINGS", settings)


def test_a_centre_far_from_its_prior_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    # The prior of a rig that presses on receptors, and noise as large as beside a rim.
    locator = replace(
        flat_locator(place_mm=0.15), noise=replace(flat_locator().noise, centroid_px=0.3)
    )
    # By the noise of the frame alone: residuals beside a contact that is held tell it is elsewhere.
    whole = replace(place_average.SETTINGS, usual_freedom=1e6)
    monkeypatch.setattr(place_average, "SETTINGS", whole)
    at = AT + np.array([3.0, 0.0, 0.0])
    free = find(locator, at)
    rigid(monkeypatch)
    held = find(locator, at)
    off = [float(np.linalg.norm(one.point_mm - at)) for one in (free, held)]
    assert off[0] < 0.5 * off[1]
    assert free.sd_mm[0] > 1.2 * held.sd_mm[0]


def test_a_missing_contact_is_tried_below_the_drop_that_is_demanded_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The one that was found may have stretched over it, so that its residual is small.

    On ``grip``, 2.3 N at 18 mm from 6.0 N left a drop of 40, and fitted together one of 294.
    """
    asked: list[float] = []
    search = ContactLocator._unswitched_start

    def spied(self: ContactLocator, *given: Any) -> Any:
        asked.append(given[-1])
        return search(self, *given)

    monkeypatch.setattr(ContactLocator, "_unswitched_start", spied)
    locator = with_fitted_noise(flat_locator(noise_px=0.05))
    far = AT + np.array([15.0, 9.0, 0.0])
    noise = np.random.default_rng(2).normal(0.0, 0.05, 2 * len(MARKERS))
    for force, tried in ((0.0, []), (0.7, [SETTINGS.foreseen_share * SETTINGS.chi2_drop])):
        asked.clear()
        seen = shifts(AT, 10.0) + shifts(far, force) + noise
        found = locator.find(seen.reshape(-1, 2), np.array([nearest(AT)]))
        assert asked[:1] == tried
        assert len(found.contacts) == 1 + len(tried)


@pytest.mark.parametrize("off_mm", [(12.0, 0.0), (0.0, 12.0), (-9.0, -8.0)])
def test_the_search_starts_where_a_contact_is_missing(off_mm: tuple[float, float]) -> None:
    """The plain residual is largest 6 to 8 mm away, where the found one has stretched least.

    On `cylinder60` a fit from 24 mm away ended 8 mm from a contact of 3 N.
    """
    locator, far = flat_locator(noise_px=0.05), AT + np.array([*off_mm, 0.0])
    noise = np.random.default_rng(2).normal(0.0, 0.05, 2 * len(MARKERS))
    seen = contact_fit.ShiftObservation(
        shift_px=shifts(AT, 10.0) + shifts(far, 1.0) + noise,
        found=np.ones(2 * len(MARKERS), dtype=np.bool_),
        koi=np.array([nearest(AT)]),
    )
    best = locator._fit_switched(seen)
    start = locator._unswitched_start(best, seen, 0.0)
    assert start is not None
    assert np.linalg.norm(start.start_mm - far) < 1.5
    assert start.x[0] == pytest.approx(1.0, abs=0.2)
    _, gain = locator._by_residual(best, seen, np.array([start.place]))
    row = locator.places.shift_px[start.place, :1].astype(np.float64)
    assert gain[0] == pytest.approx(best.gain_by(row, seen.shift_px, 1e3), rel=1e-3)


def test_a_larger_contact_than_learnt_is_read_right(monkeypatch: pytest.MonkeyPatch) -> None:
    prior = contact_fit.ContactPrior(place_mm=1.5, moments_sd_mm2=(0.5, 0.5, 0.5))
    locator = replace(flat_locator(noise_px=0.1), prior=prior)
    free = find(locator, AT, 3.0 * DISC)
    rigid(monkeypatch)
    held = find(locator, AT, 3.0 * DISC)
    assert abs(free.force_N - 10.0) < 0.6 * abs(held.force_N - 10.0)


def test_an_unknown_shape_widens_the_interval_of_a_large_contact() -> None:
    excess = []
    for moments in (DISC, 3.0 * DISC, np.array([3.0, 0.0, 1.0]) * DISC):
        found = find(flat_locator(), AT, moments)
        # Of a strip, its longer moment.
        excess.append(max(float(found.moments_mm2[0] / DISC[0]), 0.0))
        shape = SETTINGS.extent_error * excess[-1] * found.raw_N
        assert shape <= found.raw_sd_N < shape + 0.08
    assert excess == pytest.approx([0.0, 2.0, 2.0], abs=0.4)


@pytest.mark.parametrize("chi2", [1.0, 2.0])
def test_other_unknowns_are_fitted_again_while_motion_is_unexplained(chi2: float) -> None:
    """Else what the tables have wrong would look like contacts that hide behind others."""
    locator, noise = flat_locator(), np.random.default_rng(1).normal(0.0, 0.02, (len(MARKERS), 2))
    seen = ShiftObservation(
        koi=np.array([nearest(AT)]),
        shift_px=shifts(AT, 9.0) + noise.ravel(),
        found=np.ones(2 * len(MARKERS), dtype=np.bool_),
    )
    best = replace(locator._fit_switched(seen), reduced_chi2=chi2)
    weighted = best.inverse * (seen.shift_px - best.predicted_px)
    rows = locator._first.astype(np.float64)
    plain = np.maximum(rows @ weighted, 0.0) ** 2 / (rows**2 @ best.inverse)
    _, gain = locator._by_residual(best, seen, slice(None))
    # Near the contact, others take most of what one more would add.
    near = np.linalg.norm(locator.places.point_mm - AT, axis=1) < 6.0
    ratio = gain[near & (plain > 0.0)] / plain[near & (plain > 0.0)]
    if chi2 < SETTINGS.chi2_unexplained:
        np.testing.assert_allclose(ratio, 1.0, rtol=1e-3)
    else:
        assert ratio.min() > 0.99
        assert np.median(ratio) > 2.0


def test_only_contacts_on_switches_leave_their_prior_and_not_far() -> None:
    prior = contact_fit.ContactPrior(place_mm=1.0)
    switched = contact_fit.initial_state(
        flat_locator().places, prior, AT, 5.0, markers=np.array([nearest(AT)])
    )
    alone = replace(switched, markers=np.zeros(0, dtype=np.int64))
    usual = contact_fit._prior_sd([switched], prior).ravel() ** -2.0
    far = np.zeros(8)
    far[[1, 3]] = 100.0
    left = contact_fit.prior_weight([switched, alone], np.tile(far, 2), prior)
    np.testing.assert_array_equal(left[8:], usual)
    yields = np.r_[1.0, np.full(5, 1.0 + contact_fit.SETTINGS.prior_growth_max), 1.0, 1.0]
    np.testing.assert_allclose(left[:8], usual / yields)


def learnt(locator: ContactLocator) -> ContactLocator:
    """As fitted to data, exactly."""
    fitted = ForceCorrection.plain(low_mm=np.zeros(3), size_mm=60.0, force_max_N=25.0)
    return replace(locator, correction=fitted)


def test_a_wall_that_changes_after_training_widens_intervals() -> None:
    locator = learnt(flat_locator())
    found = [find(replace(locator, stiffness_change=share), AT) for share in (0.0, 0.06)]
    assert found[0].force_N == found[1].force_N
    wider = np.sqrt(found[1].sd_N ** 2 - found[0].sd_N ** 2)
    # The upper end of the 95 % interval of a log-normal factor.
    upper_N = found[0].force_N * np.expm1(1.96 * 0.06)
    assert wider == pytest.approx(upper_N / 1.96, rel=5e-3)


def test_a_bundle_expects_the_change_that_it_is_given(tmp_path: Path) -> None:
    save_bundle(bundle(), tmp_path)
    for given, expected in (({}, STIFFNESS_CHANGE), ({"stiffness_change": 0.1}, 0.1)):
        locator = load_bundle(tmp_path, **given).model.locator
        assert locator is not None
        assert locator.stiffness_change == expected


def test_an_unreadable_switch_needs_a_force_that_is_sure() -> None:
    """In another light a switch that cannot be read seems on."""
    marker = nearest(AT)
    locator = replace(flat_locator(noise_px=0.3), blind=np.array([marker]))
    noise = np.random.default_rng(3).normal(0, 0.3, (len(MARKERS), 2))
    seen = shifts(AT, 0.3).reshape(-1, 2) + noise
    assert not locator.find(seen, np.array([marker])).contacts
    (read,) = (
        replace(locator, blind=np.zeros(0, dtype=np.int64)).find(seen, np.array([marker])).contacts
    )
    assert 0.0 < read.force_N < SETTINGS.unreadable_sd_min * read.sd_N
    (sure,) = locator.find(shifts(AT, 10.0).reshape(-1, 2) + noise, np.array([marker])).contacts
    assert sure.markers.tolist() == [marker]
