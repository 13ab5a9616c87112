"""Results that cannot be: the frame is not valid, and no force of it is delivered."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.estimation.contact_estimates import ContactDetection, LocatedContact
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_decoder.pipeline.decode import FrameMeasurement, noisy_rims, over_rims
from phytac_decoder.pipeline.plausibility import implausible
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import MARKERS, flat_locator, nearest, with_fitted_noise
from tests.decoder.test_bundle_locator import bundle as toy_with_locator
from tests.decoder.test_follow import make_bundle

AT = np.array([28.2, 29.6, 0.0])


def flat_bundle(*, trained: bool = False) -> Bundle:
    base, locator = make_bundle(), flat_locator()
    if trained:
        locator = with_fitted_noise(locator)
    return replace(base, model=replace(base.model, locator=locator))


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
    bundle = flat_bundle(trained=True)
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
        (detection(9.0, sd_N=np.nan), 9.0, "not determined"),
    ],
)
def test_each_contradiction_is_named(found: ContactDetection, inverse_N: float, words: str) -> None:
    bundle = flat_bundle(trained=True)
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


def test_motion_that_noise_does_not_explain_is_named_where_no_contact_is_found() -> None:
    """A strong contact at a rim whose switch a blurred picture does not show."""
    nothing = replace(detection(9.0, chi2=4.0), contacts=[])
    (words,) = noisy_rims(nothing)
    assert "may be missing" in words
    assert noisy_rims(replace(nothing, reduced_chi2=1.5)) == []


def test_errors_beyond_a_frame_s_own_noise_are_named_whatever_noise_a_camera_may_have() -> None:
    for chi2, named in ((2.5, False), (3.5, True)):
        noisy = detection(9.0, sd_N=2.0, chi2=chi2)
        assert bool(noisy_rims(noisy, chi2_allowed=5.0)) == named
        # More noise in all markers is no such error.
        assert not noisy_rims(replace(noisy, reduced_chi2=1.0, noise_scale=2.0), chi2_allowed=5.0)


def at_end(point_mm: FloatArray, radius_mm: float) -> ContactDetection:
    found = detection(9.0, point_mm)
    (contact,) = found.contacts
    found.contacts[:] = [replace(contact, radius_mm=radius_mm, sd_mm=np.full(2, 0.3))]
    return found


@pytest.mark.parametrize(
    ("x", "y", "radius_mm", "over"),
    [
        (30.0, 30.0, 5.0, False),
        (5.0, 30.0, 5.0, False),
        (3.0, 30.0, 5.0, True),
        (3.0, 30.0, 3.0, False),
        (31.5, 58.5, 5.0, True),
        (2.0, 58.0, 4.0, True),
    ],
)
def test_contacts_that_reach_over_the_end_of_the_surface_are_named(
    x: float, y: float, radius_mm: float, over: bool
) -> None:
    words = over_rims(at_end(np.array([x, y, 0.0]), radius_mm), flat_locator().places)
    assert len(words) == over
    assert all("a contact of 9.0 N reaches over the end" in text for text in words)


def test_contacts_that_may_reach_over_the_end_are_named_too() -> None:
    """A press over the rim that noise has moved inwards: 95 % of where it may be counts."""
    found = at_end(np.array([5.0, 30.0, 0.0]), 5.0)
    (contact,) = found.contacts
    for sd_mm, over in ((0.4, False), (0.6, True)):
        found.contacts[:] = [replace(contact, sd_mm=np.array([0.1, sd_mm]))]
        assert bool(over_rims(found, flat_locator().places)) == over


def test_a_frame_warns_of_them() -> None:
    sensor = toy_with_locator()
    count, locator = len(sensor.colour), sensor.model.locator
    assert locator is not None
    frame = FrameMeasurement(
        koi=np.zeros(0, dtype=np.int64),
        shift_px=np.zeros((count, 2)),
        found=np.ones(count, dtype=np.bool_),
    )
    end, inward = (each[0] for each in locator.places.ends)
    for inside_mm, over in ((0.0, True), (6.0, False)):
        found = replace(at_end(end + inside_mm * inward, 4.0), shift_px=np.zeros(2 * count))
        words = frame.warnings(sensor, np.zeros(count), estimator="auto", found=found)
        assert any("over the end of the sensing surface" in text for text in words) == over


def table_of(point_mm: FloatArray, along: FloatArray, around: FloatArray) -> ResponseTable:
    rows = np.zeros((len(point_mm), 1, 2), dtype=np.float32)
    return ResponseTable(
        point_mm=point_mm, along=along, around=around, shift_px=rows, radius_mm=5.0
    )


def test_the_end_of_a_tube_is_at_its_rims_and_that_of_a_dome_not_at_its_pole() -> None:
    z, angle = (x.ravel() for x in np.meshgrid(np.arange(0.0, 41.0, 4.0), np.arange(24) * 0.2618))
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(z))])
    up = np.tile([0.0, 0.0, 1.0], (len(z), 1))
    tube = table_of(15.0 * ring + z[:, None] * up, up, np.cross(up, ring))
    probe = np.array([[15.0, 0.0, h] for h in (0.0, 1.5, 18.0, 38.0)])
    np.testing.assert_allclose(tube.end_distance_mm(probe), [0.0, 1.5, 18.0, 2.0], atol=1e-9)
    # A dome of the same radius, its pole once.
    polar = np.concatenate([[0.0], np.repeat(np.linspace(0.26, np.pi / 2.0, 6), 24)])
    angle = np.concatenate([[0.0], np.tile(np.arange(24) * 0.2618, 6)])
    normal = np.column_stack(
        [np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)]
    )
    around = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(len(angle))])
    dome = table_of(15.0 * normal, np.cross(around, normal), around)
    assert {round(float(h), 6) for h in dome.ends[0][:, 2]} == {0.0}
    assert dome.end_distance_mm(np.array([[0.0, 0.0, 15.0]]))[0] > 14.0


def test_a_closed_surface_has_no_end() -> None:
    golden = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(200)
    height = 1.0 - (np.arange(200) + 0.5) / 100.0
    size = np.sqrt(1.0 - height**2)
    normal = np.column_stack([size * np.cos(golden), size * np.sin(golden), height])
    around = np.column_stack([-np.sin(golden), np.cos(golden), np.zeros(200)])
    ball = table_of(15.0 * normal, np.cross(around, normal), around)
    assert np.isinf(ball.end_distance_mm(normal[:3])).all()
    assert (ball.towards_end(normal[:3])[1] == 0.0).all()
    without_end = replace(flat_locator(), places=ball)
    assert (without_end._error_by_rim(normal[:3], np.ones((3, 2))) == 0.0).all()
