"""Noise that a design predicts, frames that are noisier, and tips that cover other markers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.contact_fit import MarkerNoise
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle import load_bundle, save_bundle
from phytac_decoder.pipeline.decode import corrected_shift, noisy_rims
from phytac_decoder.vision.switch_detection import TipCovers
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import MARKERS, PITCH_MM, flat_locator, nearest, shifts, together
from tests.decoder.test_bundle_locator import bundle
from tests.refusals import refused

COUNT = len(MARKERS)


def noise_of(still_px: float, moved_px: float) -> MarkerNoise:
    ones = np.ones(2 * COUNT)
    return MarkerNoise(still_px=still_px * ones, moved_px=moved_px * ones)


def predicting(still_px: float = 0.02, moved_px: float = 0.01) -> ContactLocator:
    plain = flat_locator(noise_px=0.06)
    return replace(plain, noise=replace(plain.noise, markers=noise_of(still_px, moved_px)))


def point(x: float, y: float) -> FloatArray:
    return np.array([x, y, 0.0])


def test_noise_grows_with_a_marker_s_motion() -> None:
    shift = np.zeros((COUNT, 2))
    shift[1], shift[2] = (0.09, 0.12), (300.0, 400.0)
    found = noise_of(0.02, 0.04).variance(shift.reshape(-1)).reshape(-1, 2)
    still, moved = 0.02**2, 0.04**2
    assert found[0] == pytest.approx([still, still])
    assert found[1] == pytest.approx([still + moved / 2.0] * 2)
    assert found[2] == pytest.approx([still + moved] * 2, rel=1e-3)


def find(noise_px: float, seed: int = 0) -> ContactDetection:
    rng = np.random.default_rng(seed)
    at = MARKERS[44] + np.array([1.0, 0.5, 0.0])
    seen = shifts(at, 10.0) + rng.normal(0.0, noise_px, 2 * COUNT)
    return predicting().find(seen.reshape(-1, 2), np.array([44]))


def test_usual_noise_is_as_predicted_and_a_noisier_frame_is_noticed() -> None:
    usual, noisy = find(0.02), find(0.08)
    assert usual.noise_scale == 1.0
    assert usual.reduced_chi2 == pytest.approx(1.0, abs=0.3)
    assert noisy.noise_scale == pytest.approx(4.0 * 0.87, rel=0.3)
    assert noisy.chi2_of_usual > 4.0 * noisy.reduced_chi2
    assert noisy.contacts[0].raw_sd_N > 4.0 * usual.contacts[0].raw_sd_N


def test_motion_of_contacts_that_no_switch_shows_is_no_noise() -> None:
    rng = np.random.default_rng(2)
    blind = replace(predicting(), blind=np.arange(COUNT))
    seen = together([point(18.0, 18.0), point(45.0, 42.0)], [20.0, 15.0])
    # They move three markers in four by more than their noise.
    assert np.percentile(np.linalg.norm(seen.reshape(-1, 2), axis=1), 25.0) > 0.05
    found = blind.find(
        (seen + rng.normal(0.0, 0.02, 2 * COUNT)).reshape(-1, 2), np.zeros(0, dtype=np.int64)
    )
    assert found.noise_scale == 1.0
    assert [contact.force_N for contact in found.contacts] == pytest.approx([20.0, 15.0], rel=0.05)


def test_a_noisier_frame_shows_no_contacts_that_do_not_exist() -> None:
    for seed in range(5):
        assert len(find(0.2, seed).contacts) == 1


def test_noise_that_the_design_allows_is_not_warned_of() -> None:
    noisy, allowed = find(0.05), predicting().noise.chi2_allowed
    assert allowed == pytest.approx(0.06**2 / (0.02**2 + 0.5 * 0.01**2))
    # A force that is poorly determined.
    noisy = replace(noisy, contacts=[replace(noisy.contacts[0], sd_N=3.0)])
    assert noisy_rims(noisy)
    assert not noisy_rims(noisy, chi2_allowed=allowed)
    assert noisy_rims(replace(noisy, noise_scale=6.0), chi2_allowed=allowed)


def test_switches_out_of_reach_are_another_contact_however_faint() -> None:
    """One group of switches, and so much noise that χ² does not ask for a second contact."""
    places = [point(x, 30.0) for x in (12.0, 30.0)]
    koi = np.arange(nearest(places[0]), nearest(places[1]) + 10, 10)
    seen = together(places, [8.0, 1.0]).reshape(-1, 2)
    found = predicting(0.5, 0.1).find(seen, koi)
    assert found.reduced_chi2 < 1.0
    assert len(found.contacts) == 2
    faint = min(found.contacts, key=lambda contact: contact.force_N)
    assert faint.point_mm == pytest.approx(places[1], abs=PITCH_MM)


def test_a_contact_far_from_its_switch_is_sure_where_its_place_is() -> None:
    seen = shifts(point(13.0, 30.0), 5.0).reshape(-1, 2)
    (sure,) = predicting().find(seen, np.array([nearest(point(21.0, 30.0))])).contacts
    assert sure.raw_sd_N < 0.3


def test_bundles_keep_predicted_noise_and_covers(tmp_path: Path) -> None:
    plain = bundle()
    locator = plain.model.locator
    assert locator is not None
    rng = np.random.default_rng(0)
    still, moved = rng.uniform(0.01, 0.1, (2, 60))
    noise = replace(
        locator.noise, fitted=False, markers=MarkerNoise(still_px=still, moved_px=moved)
    )
    prior = replace(locator.prior, force_N=25.0)
    model = replace(plain.model, locator=replace(locator, noise=noise, prior=prior))
    covers = TipCovers(
        marker=np.array([3, 4]), tip=np.array([5, 6]), shift_px=rng.normal(size=(2, 2))
    )
    saved = replace(plain, model=model, covers=covers)
    save_bundle(saved, tmp_path)
    loaded = load_bundle(tmp_path)
    kept = loaded.model.locator
    assert kept is not None
    assert kept.noise.markers is not None
    assert kept.prior == prior
    np.testing.assert_array_equal(kept.noise.markers.still_px, still)
    np.testing.assert_array_equal(kept.noise.markers.moved_px, moved)
    on = rng.random(30) < 0.5
    np.testing.assert_array_equal(loaded.tip_shift_px(on), saved.tip_shift_px(on))
    wrong = replace(covers, tip=np.array([5, 30]))
    save_bundle(replace(saved, covers=wrong), tmp_path / "wrong")
    with refused("bundle-id-invalid"):
        load_bundle(tmp_path / "wrong")


def test_what_a_tip_covers_of_another_marker_is_taken_off_its_shift() -> None:
    cover = TipCovers(
        marker=np.array([3, 4]), tip=np.array([5, 3]), shift_px=np.array([[0.3, 0.1], [1.0, 1.0]])
    )
    plain = replace(bundle(), covers=cover)
    on = np.zeros(30, dtype=np.bool_)
    on[5] = True
    shift = corrected_shift(plain, on, np.zeros((30, 2)))[1]
    assert shift[3] == pytest.approx([-0.3, -0.1])
    assert shift[4] == pytest.approx([0.0, 0.0])


def test_covers_turn_with_the_shell() -> None:
    order = np.array([1, 2, 3, 0])
    cover = TipCovers(marker=np.array([0]), tip=np.array([3]), shift_px=np.array([[1.0, 2.0]]))
    # Marker 3 looks as 0 did, and 2 as 3 did.
    turned = cover.seen_in(order)
    assert (turned.marker.tolist(), turned.tip.tolist()) == ([3], [2])
