"""Results that cannot be: the frame is not valid, and no force of it is delivered."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.estimation.contact_estimates import ContactDetection, LocatedContact
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.pipeline.decode import noisy_rims
from phytac_decoder.pipeline.plausibility import implausible
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import MARKERS, flat_locator, nearest
from tests.decoder.test_follow import make_bundle

AT = np.array([28.2, 29.6, 0.0])


def flat_bundle(*, ratio: FloatArray | None = None) -> Bundle:
    base, locator = make_bundle(), flat_locator()
    noise = replace(locator.noise, ratio=ratio)
    return replace(base, model=replace(base.model, locator=replace(locator, noise=noise)))


def detection(
    force_N: float, point_mm: FloatArray = AT, *, sd_N: float = 0.1, chi2: float = 1.0
) -> ContactDetection:
    contact = LocatedContact(
        markers=np.array([nearest(AT)]),
        share=np.ones(1),
        force_N=force_N,
        sd_N=sd_N,
        raw_N=force_N,
        raw_sd_N=sd_N,
        point_mm=point_mm,
        radius_mm=5.0,
        sd_mm=np.array([0.1, 0.1]),
        moments_mm2=np.zeros(3),
        signal_px=1.0,
    )
    shift = np.zeros(2 * len(MARKERS))
    return ContactDetection(contacts=[contact], reduced_chi2=chi2, shift_px=shift)


def inverse(total_N: float) -> FloatArray:
    out = np.zeros(len(MARKERS))
    out[nearest(AT)] = total_N
    return out


def test_a_plain_contact_is_plausible() -> None:
    bundle = flat_bundle(ratio=np.ones(2 * len(MARKERS)))
    assert implausible(bundle, detection(20.0), inverse(16.0)) == []


@pytest.mark.parametrize(
    ("found", "inverse_N", "words"),
    [
        (detection(60.0), 50.0, "designed for 25 N"),
        # However wide the interval: nothing that a disturbed picture gives may reach a robot.
        (detection(300.0, sd_N=150.0), 280.0, "designed for 25 N"),
        (detection(48.4, sd_N=8.1), 40.0, "designed for 25 N"),
        (detection(9.0, np.array([62.7, 29.6, 0.0])), 9.0, "beyond the end of the surface"),
        (detection(24.0), 3.0, "by the compliance"),
        (detection(3.0), 24.0, "by the compliance"),
        (detection(9.0, chi2=30.0), 9.0, "5.5 times their noise"),
    ],
)
def test_each_contradiction_is_named(found: ContactDetection, inverse_N: float, words: str) -> None:
    bundle = flat_bundle(ratio=np.ones(2 * len(MARKERS)))
    (reason,) = implausible(bundle, found, inverse(inverse_N))
    assert words in reason


def test_a_wide_interval_or_unknown_noise_is_no_contradiction() -> None:
    bundle = flat_bundle()
    assert implausible(bundle, detection(50.0, sd_N=20.0), inverse(45.0)) == []
    assert implausible(bundle, detection(24.0, sd_N=5.0), inverse(3.0)) == []
    # Noise that was not fitted may be far too small.
    assert implausible(bundle, detection(9.0, chi2=30.0), inverse(9.0)) == []


def test_noise_above_the_expected_one_is_named_where_forces_are_doubtful() -> None:
    (words,) = noisy_rims(detection(9.0, sd_N=2.0, chi2=4.0))
    assert "2.0 times their noise" in words
    assert "above 5 %" in words
    assert noisy_rims(detection(9.0, sd_N=0.1, chi2=4.0)) == []
    assert noisy_rims(detection(9.0, sd_N=2.0, chi2=1.5)) == []
    assert noisy_rims(None) == []


def test_errors_beyond_a_frame_s_own_noise_are_named_whatever_noise_a_camera_may_have() -> None:
    for chi2, named in ((2.5, False), (3.5, True)):
        noisy = detection(9.0, sd_N=2.0, chi2=chi2)
        assert bool(noisy_rims(noisy, chi2_allowed=5.0)) == named
        # More noise in all markers is no such error.
        assert not noisy_rims(replace(noisy, reduced_chi2=1.0, noise_scale=2.0), chi2_allowed=5.0)
