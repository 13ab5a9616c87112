"""Force along the surface: found, and no error of the normal force; on a flat sensor.

A force along the face drags the markers around it with it, by a Gaussian.
"""

from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.estimation import friction_prior
from phytac_decoder.estimation.contact_fit import initial_state
from phytac_decoder.estimation.contact_shifts import predicted_shifts
from phytac_decoder.estimation.friction_prior import average_over_friction
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.mechanics.response_table import ResponseTable, axes_turn
from phytac_design.datasets.samples import REAL
from phytac_design.training.marker_gain import predict_residuals
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_samples import STIFFNESS
from tests.decoder.flat_samples import pressed as pressed_samples
from tests.decoder.flat_sensor import (
    MARKERS,
    RADIUS_MM,
    flat_locator,
    flat_places,
    grid,
    nearest,
    shifts,
)
from tests.decoder.toy_sensor import toy_bundle

ONE, TWO = np.array([23.1, 31.4, 0.0]), np.array([44.2, 20.3, 0.0])


def dragged(point_mm: FloatArray) -> FloatArray:
    """Shifts (2, 2n) px by a newton along x and along y at a point (3,)."""
    size = np.exp(-0.5 * np.sum((MARKERS - point_mm) ** 2, axis=1) / 12.0**2)
    out = np.zeros((2, len(MARKERS), 2))
    out[0, :, 0] = out[1, :, 1] = 0.25 * size
    return out.reshape(2, -1)


def shear_table(step_mm: float = 5.0) -> ResponseTable:
    """Tables over fewer places, in axes that turn from place to place as around a pole."""
    points = grid(step_mm)
    angle = np.arctan2(points[:, 1] - 70.0, points[:, 0] - 70.0)
    along = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(points))])
    around = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(len(points))])
    plain = np.stack([dragged(point) for point in points])
    turned = np.einsum("pij,pjn->pin", np.stack([along, around], axis=1)[:, :, :2], plain)
    return ResponseTable(
        point_mm=points,
        along=along,
        around=around,
        shift_px=turned.astype(np.float32),
        radius_mm=RADIUS_MM,
    )


def sheared_locator() -> ContactLocator:
    plain = flat_locator()
    return replace(plain, places=replace(plain.places, shear=shear_table()))


def pressed(point_mm: FloatArray, force_N: float, ratio: FloatArray) -> FloatArray:
    return shifts(point_mm, force_N) + force_N * (ratio @ dragged(point_mm))


def test_tables_in_turning_axes_are_those_of_the_field() -> None:
    places = sheared_locator().places
    for place in (0, 77, 312):
        wanted = dragged(places.point_mm[place])
        np.testing.assert_allclose(places.shear_px[place], wanted, atol=2e-3)
        np.testing.assert_allclose(places.shear_cubic(place)[0], wanted, atol=2e-3)
    np.testing.assert_allclose(places.shear_at(ONE[None])[0], dragged(ONE), atol=2e-3)


def test_axes_turn_by_the_shortest_way() -> None:
    """Tilted axes: a force along the common line of both planes stays as it is."""
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(0.3), np.sin(0.3)]])
    np.testing.assert_allclose(axes_turn(np.eye(3)[:2], tilt), np.eye(2), atol=1e-12)
    c, s = np.cos(0.7), np.sin(0.7)
    turned = np.array([[c, s, 0.0], [-s, c, 0.0]])
    # What lies along the turned first axis has these components in the plain ones.
    np.testing.assert_allclose(axes_turn(np.eye(3)[:2], turned) @ [1.0, 0.0], [c, s], atol=1e-12)


def test_force_along_the_surface_is_found_and_does_not_change_the_normal_force() -> None:
    locator, ratio = sheared_locator(), np.array([0.35, -0.25])
    seen = pressed(ONE, 8.0, ratio).reshape(-1, 2)
    koi = np.array([nearest(ONE)])
    (contact,) = locator.find(seen, koi).contacts
    assert contact.force_N == pytest.approx(8.0, rel=0.01)
    assert contact.shear_observed
    np.testing.assert_allclose(contact.shear_N, [2.8, -2.0, 0.0], atol=0.1)
    assert np.all(np.abs(contact.shear_N[:2] - [2.8, -2.0]) < 3.0 * contact.shear_sd_N[:2])
    # Taken as 0, it is read as a twelfth of the force more.
    (blind,) = flat_locator().find(seen, koi).contacts
    assert blind.force_N > 8.4


def test_two_contacts_are_dragged_each_its_own_way() -> None:
    locator = sheared_locator()
    seen = pressed(ONE, 8.0, np.array([0.3, 0.0])) + pressed(TWO, 5.0, np.array([0.0, -0.4]))
    koi = np.array(sorted([nearest(ONE), nearest(TWO)]))
    found = sorted(locator.find(seen.reshape(-1, 2), koi).contacts, key=lambda one: one.force_N)
    assert [one.force_N for one in found] == pytest.approx([5.0, 8.0], rel=0.02)
    np.testing.assert_allclose(found[0].shear_N[:2], [0.0, -2.0], atol=0.2)
    np.testing.assert_allclose(found[1].shear_N[:2], [2.4, 0.0], atol=0.2)


def test_slopes_are_differences() -> None:
    locator = sheared_locator()
    state = initial_state(locator.places, locator.prior, ONE, 8.0)
    state.x[3:] = (1.0, -0.5, 0.7, 0.3, -0.2)
    ((_, slope),) = predicted_shifts(locator.places, [state])
    for unknown, step in enumerate((1e-2, 1e-2, 1e-2, 0.1, 0.1, 0.1, 1e-2, 1e-2)):
        sides = []
        for sign in (1.0, -1.0):
            moved = state.copy()
            moved.x[unknown] += sign * step
            sides.append(predicted_shifts(locator.places, [moved])[0][0])
        numeric = (sides[0] - sides[1]) / (2.0 * step)
        np.testing.assert_allclose(slope[unknown], numeric, atol=3e-3 * np.abs(numeric).max())


def test_a_stiffer_sensor_is_dragged_less() -> None:
    places = sheared_locator().places
    np.testing.assert_allclose(places.scaled(2.0).shear_px, places.shear_px / 2.0, atol=1e-7)


def posterior(
    slope: FloatArray, seen: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Mean, covariance and log evidence of a linear measurement with noise of 1."""
    whole = slope @ spread @ slope.T + np.eye(len(seen))
    gain = np.linalg.solve(whole, slope @ spread).T
    evidence = -0.5 * (seen @ np.linalg.solve(whole, seen)) - 0.5 * np.linalg.slogdet(whole)[1]
    return gain @ seen, spread - gain @ slope @ spread, float(evidence)


def test_the_average_over_both_cases_is_that_of_bayes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a linear measurement with normal noise, whose two posteriors are known in closed form."""
    monkeypatch.setattr(friction_prior, "SHEAR_SPREAD", 1.0)
    rng = np.random.default_rng(3)
    slope, prior_sd = rng.normal(size=(20, 8)), 0.4
    prior = np.diag([10.0] * 6 + [prior_sd] * 2) ** 2
    for ratio in (0.0, 0.15, 0.3):
        truth = np.concatenate([rng.normal(size=6), [ratio, -ratio]])
        seen = slope @ truth + rng.normal(size=20)
        square = prior.copy()
        square[6:] = 0.0
        one, two = (posterior(slope, seen, spread) for spread in (prior, square))
        odds = np.exp(two[2] - one[2])
        share = odds / (1.0 + odds)
        mean = (1.0 - share) * one[0] + share * two[0]
        gap = one[0] - two[0]
        spread = (1.0 - share) * one[1] + share * two[1]
        spread += share * (1.0 - share) * np.outer(gap, gap)
        got = average_over_friction(one[0], one[1], shear_sd=prior_sd)
        np.testing.assert_allclose(got[0], mean, atol=1e-8)
        np.testing.assert_allclose(got[1], spread, atol=1e-8)


def test_it_is_as_unsure_as_the_force_that_it_is_a_share_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By errors of the force that the tables do not describe."""
    seen = pressed(ONE, 10.0, np.array([0.35, -0.25])).reshape(-1, 2)
    variance_N2 = []
    for error in (0.0, 0.5):
        errors = np.array([error])
        monkeypatch.setattr(ContactLocator, "_errors_of_tables", lambda *_, e=errors: e)
        (one,) = sheared_locator().find(seen, np.array([nearest(ONE)])).contacts
        variance_N2.append(np.diag(one.shear_covariance_N2))
    more = np.sqrt(variance_N2[1] - variance_N2[0])[:2]
    assert more == pytest.approx(0.5 * np.array([3.5, 2.5]), rel=0.05)


def test_larger_errors_than_the_fit_s_are_a_larger_covariance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    root = np.random.default_rng(4).normal(size=(8, 8))
    covariance, x = 1e-3 * root @ root.T, np.array([3.0, *[0.1] * 5, 0.08, -0.05])
    monkeypatch.setattr(friction_prior, "SHEAR_SPREAD", 1.0)
    wider, _ = average_over_friction(x, 4.0 * covariance, shear_sd=0.4)
    narrow, _ = average_over_friction(x, covariance, shear_sd=0.4)
    monkeypatch.setattr(friction_prior, "SHEAR_SPREAD", 2.0)
    got, _ = average_over_friction(x, covariance, shear_sd=0.4)
    np.testing.assert_allclose(got, wider, rtol=1e-12)
    assert np.abs(got - narrow).max() > 1e-3


def test_what_markers_do_not_show_is_not_reported() -> None:
    places = flat_places()
    nothing = replace(shear_table(), shift_px=np.zeros_like(shear_table().shift_px))
    locator = replace(flat_locator(), places=replace(places, shear=nothing))
    (contact,) = locator.find(shifts(ONE, 8.0).reshape(-1, 2), np.array([nearest(ONE)])).contacts
    assert not contact.shear_observed
    assert contact.force_N == pytest.approx(8.0, rel=0.01)


@pytest.mark.parametrize("known", ["friction is known", "a rig of one axis", "none is assumed"])
def test_residuals_of_training_samples_are_without_force_along_the_surface(known: str) -> None:
    samples = pressed_samples(30, seed=4, noise=0.01)
    touches, _, shift, _ = samples.points()
    ratio = np.random.default_rng(5).uniform(-0.4, 0.4, touches.friction.shape)
    moved = shift.copy()
    for row, sample in enumerate(touches.sample):
        drag = touches.force_N[row] / STIFFNESS * (ratio[row] @ dragged(touches.point_mm[row]))
        moved[sample] += drag.reshape(-1, 2)
    if known == "friction is known":
        touches = replace(touches, friction=ratio)
    theory = np.full(samples.count, REAL if known == "a rig of one axis" else 1)
    sheared = replace(samples, shift_px=moved, touches=touches, theory=theory)
    plain = sheared_locator()
    locator = replace(plain, places=plain.places.scaled(STIFFNESS))
    moments = np.tile(touches.radius_mm[:, None] ** 2 / 4.0 - RADIUS_MM**2 / 4.0, 3)
    moments[:, 1] = 0.0
    seen, _ = predict_residuals(locator, sheared, np.arange(samples.count), moments)
    rms = float(np.sqrt(np.mean(seen.residual_px**2)))
    assert (rms < 0.03) == (known != "none is assumed")


def test_a_decoder_that_takes_friction_as_normal_force_says_so() -> None:
    plain = toy_bundle()
    for locator, said in ((flat_locator(), True), (sheared_locator(), False)):
        bundle = replace(plain, model=replace(plain.model, locator=locator))
        assert any("friction is read as normal force" in text for text in bundle.limits()) == said
