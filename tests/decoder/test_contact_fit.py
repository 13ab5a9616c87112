"""The fit's statistics: errors of its tables in quadrature with noise, and its priors."""

import numpy as np
import pytest

from phytac_decoder.estimation.contact_fit import (
    ContactFit,
    ContactPrior,
    ShiftNoise,
    ShiftObservation,
    fit_contacts,
    initial_state,
    prior_cost,
    prior_weight,
)
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import DISC, MARKERS, flat_places, nearest, shifts

AT = np.array([27.0, 33.0, 0.0])
PLACES = flat_places()
NOISE_PX = 0.02


def fitted(
    shift_px: FloatArray, noise: ShiftNoise, prior: ContactPrior, *, found: bool = True
) -> ContactFit:
    """Fit of one contact at ``AT``, from 8 N on its switch."""
    markers = np.array([nearest(AT)])
    state = initial_state(PLACES, prior, AT, 8.0, markers=markers)
    seen = ShiftObservation(
        shift_px=shift_px, found=np.full(len(shift_px), found), koi=np.zeros(0, dtype=np.int64)
    )
    return fit_contacts(PLACES, [state], seen, prior=prior, noise=noise)


def test_tables_that_are_a_share_off_are_within_the_expected_noise() -> None:
    """Receptors that each respond 5 % more or less than the tables: χ² and intervals hold."""
    share, true = 0.05, shifts(AT, 10.0)
    noise = ShiftNoise(centroid_px=NOISE_PX, share=share, switched_px=0.0)
    prior = ContactPrior(place_mm=1.5)
    rng = np.random.default_rng(0)
    chi2, z = [], []
    for _ in range(60):
        off = rng.normal(0.0, share, len(true)) * true + rng.normal(0.0, NOISE_PX, len(true))
        fit = fitted(true + off, noise, prior)
        chi2.append(fit.reduced_chi2)
        z.append((fit.states[0].x[0] - 10.0) / np.sqrt(fit.covariance[0, 0]))
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.2)
    # Of 60 draws the standard deviation is known to 9 %; priors make it a little smaller.
    assert 0.6 < np.std(z) < 1.3


def test_a_contact_that_no_marker_shows_keeps_the_moments_of_its_prior() -> None:
    prior = ContactPrior(place_mm=1.5, moments_mm2=(4.0, -1.5, 2.5))
    fit = fitted(np.zeros(2 * len(MARKERS)), ShiftNoise(centroid_px=NOISE_PX), prior, found=False)
    np.testing.assert_allclose(fit.states[0].x[3:6], prior.moments_mm2, atol=1e-9)


def test_a_prior_of_large_indenters_helps_to_read_large_contacts() -> None:
    """Noise hides the size of a contact: a prior at its true size gives the best force."""
    more = 2.0 * DISC
    noise = ShiftNoise(centroid_px=0.5, share=0.0, switched_px=0.0)
    errors = []
    for mean in (more, -0.5 * more):
        prior = ContactPrior(place_mm=1.5, moments_mm2=tuple(mean), moments_sd_mm2=(1.0, 1.0, 1.0))
        rng = np.random.default_rng(1)
        off = []
        for _ in range(20):
            seen = shifts(AT, 10.0, DISC + more) + rng.normal(0.0, 0.5, 2 * len(MARKERS))
            off.append(fitted(seen, noise, prior).states[0].x[3:6] - more)
        errors.append(float(np.abs(np.mean(off, axis=0)).max()))
    assert errors[0] < 1.5
    assert errors[0] < 0.5 * errors[1]


def test_the_gain_by_a_contact_is_foreseen() -> None:
    """The score test against the drop of χ² when that contact is fitted."""
    noise, prior = ShiftNoise(centroid_px=NOISE_PX, share=0.0), ContactPrior(place_mm=1.5)
    other = AT + np.array([12.0, 6.0, 0.0])
    row = PLACES.shift_px[PLACES.nearest(other[None]), 0].astype(np.float64)
    seen = shifts(AT, 10.0) + shifts(other, 0.1, soft=0.0)
    alone = fitted(seen, noise, prior)
    true = fitted(shifts(AT, 10.0), noise, prior)
    # It lies between places, its tables are linear, and the prior takes a little of its force.
    drop = alone.cost - true.cost
    assert drop > 20.0
    assert alone.gain_by(row, seen, prior.force_N) == pytest.approx(drop, rel=0.1)
    assert true.gain_by(row, shifts(AT, 10.0), prior.force_N) < 0.01 * drop


@pytest.mark.parametrize("sds", [0.5, 2.5, 12.0])
def test_weights_of_priors_are_the_slopes_of_their_cost(sds: float) -> None:
    """Of a contact with a switch and of one without, near the prior, far, and beyond its growth."""
    prior = ContactPrior(place_mm=1.5, force_N=10.0)
    states = [
        initial_state(PLACES, prior, AT, 8.0, markers=np.array(markers, dtype=np.int64))
        for markers in ([nearest(AT)], [])
    ]
    one = np.array([10.0, 1.5, 1.5, 3.0, 2.0, 3.0, 0.4, 0.4])
    sign = np.array([1.0, -1.0, 0.5, 1.0, -0.7, 0.9, 1.0, -1.0])
    off = np.tile(sds * one * sign, 2)
    step = 1e-5 * np.tile(one, 2)
    ahead, behind = (prior_cost(states, off + side * np.diag(step), prior) for side in (1.0, -1.0))
    slope = (ahead - behind).sum(axis=1) / (2.0 * step)
    np.testing.assert_allclose(slope, 2.0 * prior_weight(states, off, prior) * off, rtol=1e-6)
