"""What a sensor's own samples teach the estimator ``auto``, on a sensor in closed form."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation.contact_fit import MarkerNoise, moved_share
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.datasets.samples import Samples, TouchRows
from phytac_design.training import locator_calibration
from phytac_design.training.data_agreement import check_agreement
from phytac_design.training.force_correction_fit import fit_correction, fit_spread
from phytac_design.training.join_datasets import select_samples
from phytac_design.training.locator_calibration import (
    calibrate_locator,
    error_of_first_order,
    match_contacts,
    pressure_moments,
    weighted_median,
)
from phytac_design.training.marker_gain import (
    PredictionResiduals,
    cross_validation_folds,
    estimate_marker_noise,
    fit_gains,
)
from phytac_design.training.uneven_wall import WallThickness
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, NumericalError, PhytacError
from tests.decoder.flat_samples import NOISE_PX, PLACE_MM, STIFFNESS, pressed
from tests.decoder.flat_sensor import MARKERS, flat_locator
from tests.refusals import refused

LOCATOR = flat_locator(place_mm=PLACE_MM, noise_px=0.1)


@cache
def training() -> Samples:
    """Presses that the sensor learns from."""
    return pressed(120, seed=1, slope=0.08)


@cache
def taught() -> tuple[ContactLocator, dict[str, Any]]:
    """What it learns, and the figures of that."""
    return calibrate_locator(LOCATOR, training(), np.arange(120), force_max_N=25.0)


def test_stiffness_noise_and_prior_are_found() -> None:
    assert taught()[1]["stiffness"] == pytest.approx(STIFFNESS, rel=0.03)
    assert taught()[1]["noise_px"] == pytest.approx(NOISE_PX, rel=0.15)
    assert taught()[0].prior.moments_sd_mm2[0] == pytest.approx(1.4, rel=0.3)
    rms_px = np.sqrt(np.mean(np.square(taught()[0].noise.each_px)))
    assert taught()[1]["noise_px"] == pytest.approx(rms_px)


class OddWall:
    """Stands for a wall's shell: a given thickness, none, or an error; tables stay as they are."""

    def __init__(self, found: WallThickness | PhytacError | None, *, solved: bool = True) -> None:
        self.found, self.solved = found, solved

    def fit(self, *_: Any, **__: Any) -> WallThickness | None:
        if isinstance(self.found, PhytacError):
            raise self.found
        return self.found

    def table(self, places: ResponseTable, _: WallThickness) -> ResponseTable:
        if not self.solved:
            raise NumericalError("stiffness-ill-conditioned", "the wall cannot be solved")
        return places


def fitted_with(found: WallThickness | PhytacError | None) -> tuple[ContactLocator, dict[str, Any]]:
    return calibrate_locator(
        LOCATOR, training(), np.arange(120), force_max_N=25.0, wall=lambda: OddWall(found)
    )


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (None, "held-out samples do not show it"),
        (DesignError("contact-off-surface", "contact 3 is off the surface"), "contact 3 is off"),
        (NumericalError("stiffness-ill-conditioned", "close to singular"), "close to singular"),
    ],
)
def test_a_wall_that_is_not_found_is_even(found: PhytacError | None, reason: str) -> None:
    learnt, facts = fitted_with(found)
    assert reason in facts["wall"]["even"]
    assert facts["uneven"]
    assert (learnt.places.shift_px == taught()[0].places.shift_px).all()


def test_a_wall_whose_tables_cannot_be_solved_is_even() -> None:
    thickness = WallThickness(factor=np.array([0.9, 1.1]), common=1.1, explained=0.5)
    wall = OddWall(thickness, solved=False)
    facts = calibrate_locator(
        LOCATOR, training(), np.arange(120), force_max_N=25.0, wall=lambda: wall
    )[1]
    assert "cannot be solved" in facts["wall"]["even"]
    assert facts["stiffness"] == taught()[1]["stiffness"]


def test_the_factor_beside_the_thickness_is_part_of_the_stiffness() -> None:
    """A wrong one is made up for by the gains of markers."""
    thickness = WallThickness(factor=np.array([0.9, 1.1]), common=1.1, explained=0.5)
    learnt, facts = fitted_with(thickness)
    assert facts["wall"]["thickest"] == 1.1
    # No field besides.
    assert not facts["uneven"]
    assert facts["stiffness"] == pytest.approx(STIFFNESS / 1.1, rel=0.03)
    assert facts["gain"] > 1.5 * taught()[1]["gain"] > 0.0
    size = np.linalg.norm(learnt.places.shift_px) / np.linalg.norm(taught()[0].places.shift_px)
    assert size == pytest.approx(1.0, abs=0.02)


def test_the_spread_has_the_prior_of_a_wall_that_was_found_or_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain, priors = locator_calibration.spread_with_prior, []

    def kept(*contacts: Any, prior: float, **others: Any) -> float:
        priors.append(prior)
        return plain(*contacts, prior=prior, **others)

    monkeypatch.setattr(locator_calibration, "spread_with_prior", kept)
    for found in (None, WallThickness(factor=np.ones(2), common=1.0, explained=0.5)):
        wall = OddWall(found)
        calibrate_locator(
            LOCATOR, training(), np.arange(20), force_max_N=25.0, wall=lambda wall=wall: wall
        )
    settings = locator_calibration.SETTINGS
    assert priors == [settings.spread_prior[0], settings.spread_own_wall]


def test_a_shell_is_made_for_five_samples_or_more_and_may_be_too_large() -> None:
    few = calibrate_locator(
        LOCATOR, training(), np.arange(4), force_max_N=25.0, wall=lambda: pytest.fail("made")
    )
    assert "fewer than 5 presses" in few[1]["wall"]["even"]
    large = calibrate_locator(
        LOCATOR, training(), np.arange(20), force_max_N=25.0, wall=lambda: None
    )
    assert "too large" in large[1]["wall"]["even"]


@pytest.mark.parametrize(("design_mm", "found_mm"), [(3.0, 3.0), (0.4, PLACE_MM)])
def test_places_are_not_expected_where_presses_were(design_mm: float, found_mm: float) -> None:
    """A list of presses hits receptors; a hand does not. Presses farther away are learnt from."""
    prior = replace(LOCATOR.prior, place_mm=design_mm)
    learnt, facts = calibrate_locator(
        replace(LOCATOR, prior=prior), training(), np.arange(60), force_max_N=25.0
    )
    assert learnt.prior.place_mm == facts["place_mm"] == pytest.approx(found_mm, rel=0.2)


def test_new_contacts_are_read_better_by_far() -> None:
    fresh = pressed(60, seed=2, slope=0.08)
    before = match_contacts(LOCATOR, fresh, np.arange(60))
    after = match_contacts(replace(taught()[0], correction=None), fresh, np.arange(60))
    assert taught()[0].correction is not None
    factor = taught()[0].correction.factor(after.point_mm, after.force_N, after.signal_px)
    error = [
        float(np.mean(np.abs(force / truth - 1.0)))
        for force, truth in (
            (before.force_N, before.truth_N),
            (after.force_N, after.truth_N),
            (after.force_N * factor, after.truth_N),
        )
    ]
    assert error[0] > 0.1
    # Gains of the markers make up for most of what varies over the wall.
    assert error[1] < 0.015
    assert error[2] < 0.95 * error[1]


def test_ninety_percent_lie_within_ninety_percent() -> None:
    fresh = pressed(200, seed=3, slope=0.08)
    matches = match_contacts(replace(taught()[0], correction=None), fresh, np.arange(200))
    correction = taught()[0].correction
    assert correction is not None
    force = matches.force_N * correction.factor(
        matches.point_mm, matches.force_N, matches.signal_px
    )
    inside = np.abs(force - matches.truth_N) < 1.6449 * correction.spread_N(force, matches.sd_N)
    assert 0.82 < inside.mean() < 0.97


def test_markers_gains_and_noise_are_found_and_forces_read_better_by_them() -> None:
    rng = np.random.default_rng(7)
    n = len(MARKERS)
    gain = rng.normal(0.0, 0.03, (n, 2, 2))
    noise = rng.uniform(0.01, 0.09, (n, 1))
    own, fresh = (pressed(k, seed=s, gain=gain, noise=noise) for k, s in ((150, 4), (80, 5)))
    learnt, facts = calibrate_locator(LOCATOR, own, np.arange(150), force_max_N=25.0)
    # Tables over those of the design, at the place beneath each marker and so for its own shift.
    at = learnt.places.nearest(MARKERS)
    rows, plain = (
        item.places.shift_px.reshape(len(item.places.point_mm), 2, n, 2)[at, 0, np.arange(n)]
        for item in (learnt, LOCATOR)
    )
    wanted = (plain + np.einsum("nab,nb->na", gain, plain)) / STIFFNESS
    size = np.linalg.norm(plain, axis=1) / STIFFNESS
    before = np.linalg.norm(plain / STIFFNESS - wanted, axis=1) / size
    after = np.linalg.norm(rows - wanted, axis=1) / size
    assert np.median(after) < 0.5 * np.median(before)
    assert facts["gain"] == pytest.approx(0.02, abs=0.008)
    assert learnt.noise.markers is not None
    found = learnt.noise.markers.still_px.reshape(n, 2)
    assert np.median(np.abs(found / noise - 1.0)) < 0.15
    error = []
    for locator in (learnt, replace(learnt, places=LOCATOR.places.scaled(facts["stiffness"]))):
        matches = match_contacts(replace(locator, correction=None), fresh, np.arange(80))
        error.append(float(np.mean(np.abs(matches.force_N / matches.truth_N - 1.0))))
    assert error[0] < 0.7 * error[1]


def test_noise_of_switches_that_are_on_is_that_of_the_data() -> None:
    own = pressed(60, seed=6)
    assert own.shift_px is not None
    more = np.random.default_rng(8).normal(0.0, 0.3, own.shift_px.shape)
    loud = replace(own, shift_px=own.shift_px + np.where(own.bits[:, :, None], more, 0.0))
    for samples, expected in ((own, NOISE_PX), (loud, 0.3)):
        _, facts = calibrate_locator(LOCATOR, samples, np.arange(60), force_max_N=25.0)
        assert facts["switched_px"] == pytest.approx(expected, rel=0.4)
        assert facts["noise_px"] == pytest.approx(NOISE_PX, rel=0.2)


def drawn_shown(explained: FloatArray, left: FloatArray) -> PredictionResiduals:
    on = np.zeros(explained.shape[:2], dtype=np.bool_)
    return PredictionResiduals(predicted_px=explained, residual_px=left, on=on)


@pytest.mark.parametrize("scale", [0.0, 0.1, 50.0])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_gains_and_noise_at_the_ends(scale: float, noise: float) -> None:
    """Nothing moves, or all does; no noise; a marker never found, one sample, none found."""
    rng = np.random.default_rng(9)
    explained = scale * rng.normal(size=(30, 6, 2))
    left = noise * rng.normal(size=explained.shape)
    left[:, 2] = np.nan
    lost = np.full_like(left, np.nan)
    one = slice(0, 1)
    for e, r in ((explained, left), (explained[one], left[one]), (explained, lost)):
        seen = drawn_shown(e, r)
        gain = fit_gains(seen)
        found, on = estimate_marker_noise(seen, cross_validation_folds(seen, 10), np.ones(12))
        assert np.abs(gain).max() < 0.02
        assert np.isfinite(found.still_px).all()
        assert np.isfinite(found.moved_px).all()
        assert (found.still_px > 0.0).all()
        assert on is None
    seen = drawn_shown(explained, left)
    found, _ = estimate_marker_noise(seen, cross_validation_folds(seen, 10), np.zeros(12))
    assert np.median(found.still_px) == pytest.approx(max(noise, 1e-4), rel=0.4)


def test_noise_of_moving_markers_is_distinguished() -> None:
    rng = np.random.default_rng(4)
    design_px, still_px = rng.uniform(0.02, 0.06, 12), rng.uniform(0.01, 0.03, 12)
    true = MarkerNoise(still_px=still_px, moved_px=2.0 * design_px)
    explained = rng.choice([0.0, 0.3], (400, 6, 1)) * rng.normal(size=(400, 6, 2))
    sd = np.sqrt([true.variance(one) for one in explained.reshape(400, -1)])
    seen = drawn_shown(explained, (sd * rng.normal(size=sd.shape)).reshape(explained.shape))
    found, _ = estimate_marker_noise(seen, cross_validation_folds(seen, 10), design_px)
    assert found.moved_px == pytest.approx(true.moved_px, rel=0.15)
    assert found.still_px == pytest.approx(true.still_px, rel=0.25)
    # Markers that a design expects to be still noisier when they move, and are not.
    calm = drawn_shown(explained, (still_px * rng.normal(size=sd.shape)).reshape(explained.shape))
    found, _ = estimate_marker_noise(calm, cross_validation_folds(calm, 10), design_px)
    assert (found.moved_px < 0.3 * design_px).all()


def test_noise_that_grows_with_motion_is_fitted_to_the_data() -> None:
    even = np.ones(2 * len(MARKERS))
    noise = MarkerNoise(still_px=0.02 * even, moved_px=0.04 * even)
    design = replace(LOCATOR, noise=replace(LOCATOR.noise, markers=noise))
    own = pressed(150, seed=4)
    assert own.shift_px is not None
    share = moved_share(own.shift_px)[:, :, None]
    more = 0.1 * np.sqrt(share) * np.random.default_rng(8).normal(size=own.shift_px.shape)
    for samples, grown in ((own, False), (replace(own, shift_px=own.shift_px + more), True)):
        learnt, _ = calibrate_locator(design, samples, np.arange(150), force_max_N=25.0)
        assert learnt.noise.fitted
        assert learnt.noise.markers is not None
        moved = float(np.sqrt(np.mean(learnt.noise.markers.moved_px**2)))
        assert moved == pytest.approx(0.1, rel=0.25) if grown else moved < 0.04
        # What a camera may have is still the design's.
        assert learnt.noise.centroid_px == design.noise.centroid_px


def test_few_samples_determine_the_stiffness_alone() -> None:
    learnt, facts = calibrate_locator(LOCATOR, training(), np.arange(4), force_max_N=25.0)
    assert facts["contacts"] == 6
    assert facts["stiffness"] == pytest.approx(STIFFNESS, rel=0.06)
    assert learnt.correction is not None
    at = np.array([[30.0, 30.0, 0.0]])
    assert learnt.correction.factor(at, np.array([5.0]), np.ones(1)) == pytest.approx(1.0)


@pytest.mark.parametrize("count", [3, 5, 7, 12])
def test_intervals_after_few_presses_hold_what_they_state(count: int) -> None:
    """Of 4 to 18 contacts, on two draws; the print's stiffness varies by ± 8 % over the wall."""
    inside = []
    for seed in (1, 2):
        own, fresh = (pressed(k, seed=s, slope=0.08) for k, s in ((count, 100 + seed), (60, seed)))
        learnt, _ = calibrate_locator(LOCATOR, own, np.arange(count), force_max_N=25.0)
        matches = match_contacts(replace(learnt, correction=None), fresh, np.arange(60))
        correction = learnt.correction
        assert correction is not None
        force = matches.force_N * correction.factor(
            matches.point_mm, matches.force_N, matches.signal_px
        )
        sd = correction.spread_N(force, matches.sd_N)
        inside.append(np.abs(force - matches.truth_N) < 1.6449 * sd)
    assert np.concatenate(inside).mean() > 0.8


def test_same_samples_same_locator() -> None:
    again, facts = calibrate_locator(LOCATOR, training(), np.arange(120), force_max_N=25.0)
    assert facts == taught()[1]
    assert again.correction is not None
    assert taught()[0].correction is not None
    assert (again.correction.weight == taught()[0].correction.weight).all()


def test_samples_without_contacts_or_switches_are_rejected() -> None:
    with refused("samples-without-points"):
        match_contacts(LOCATOR, replace(training(), touches=None), np.arange(3))
    dark = replace(training(), bits_read=np.zeros_like(training().bits))
    with refused("no-switch-tripped"):
        calibrate_locator(LOCATOR, dark, np.arange(120), force_max_N=25.0)


def test_forces_and_places_that_belong_to_the_pictures_are_accepted() -> None:
    assert not check_agreement(LOCATOR, training())
    assert not check_agreement(LOCATOR, select_samples(training(), np.arange(5)))


def test_samples_without_contacts_are_rejected() -> None:
    """As of a load cell that is not plugged in."""
    samples = training()
    assert samples.touches is not None
    assert samples.truth is not None
    none = replace(
        samples,
        touches=TouchRows(**{name: rows[:0] for name, rows in vars(samples.touches).items()}),
        truth=replace(samples.truth, touch=np.full(len(samples.truth.touch), -1)),
    )
    with refused("no-switch-tripped"):
        calibrate_locator(LOCATOR, none, np.arange(120), force_max_N=25.0)


def _with_forces(force_N: FloatArray) -> Samples:
    touches = training().touches
    assert touches is not None
    return replace(training(), touches=replace(touches, force_N=force_N))


def test_a_force_gauge_that_is_stuck_is_noticed() -> None:
    touches = training().touches
    assert touches is not None
    with refused("forces-all-equal") as caught:
        check_agreement(LOCATOR, _with_forces(np.full(len(touches.force_N), 5.0)))
    caught.match("the recorded force is 5 N in all contacts")


def test_forces_of_other_presses_are_noticed() -> None:
    touches = training().touches
    assert touches is not None
    other = np.random.default_rng(0).permutation(touches.force_N)
    assert "do not follow the motion" in check_agreement(LOCATOR, _with_forces(other))


@pytest.mark.parametrize("count", [12, 120])
def test_pictures_of_other_presses_are_refused(count: int) -> None:
    """Also where not one contact is found by chance."""
    samples = select_samples(training(), np.arange(count))
    assert samples.shift_px is not None
    assert samples.bits_read is not None
    late = replace(
        samples,
        shift_px=np.roll(samples.shift_px, 1, axis=0),
        bits_read=np.roll(samples.bits_read, 1, axis=0),
        bits=np.roll(samples.bits_read, 1, axis=0),
    )
    with refused("contacts-elsewhere") as caught:
        check_agreement(LOCATOR, late)
    caught.match("numbers of the frames")


def test_a_correction_fades_away_from_its_data() -> None:
    plain = ForceCorrection.plain(
        low_mm=np.zeros(3),
        size_mm=100.0,
        force_max_N=20.0,
    )
    assert plain.factor(np.zeros((2, 3)), np.ones(2), np.ones(2)).tolist() == [1.0, 1.0]
    rng = np.random.default_rng(0)
    point, force = rng.uniform(0.0, 20.0, (200, 3)), rng.uniform(1.0, 20.0, 200)
    learnt = fit_correction(
        plain,
        point_mm=point,
        force_N=force,
        signal_px=np.ones(200),
        sd_N=0.01 * force,
        truth_N=1.04 * force,
    )
    near, far = learnt.factor(
        np.array([[10.0] * 3, [300.0] * 3]), np.array([10.0, 10.0]), np.ones(2)
    )
    assert near == pytest.approx(1.04, abs=0.003)
    assert abs(far - 1.0) < 0.002


@pytest.mark.parametrize(("waves", "wanted"), [(0.25, 0.8), (1.5, 0.33)])
def test_a_correction_reaches_as_far_as_its_data_vary(waves: float, wanted: float) -> None:
    """Length scales are the likeliest: a slow error is learnt over the whole sensor."""
    rng = np.random.default_rng(1)

    def drawn(count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        point, force = rng.uniform(0.0, 100.0, (count, 3)), rng.uniform(1.0, 20.0, count)
        wave = np.sin(2.0 * np.pi * waves * point[:, 0] / 100.0)
        return point, force, force * np.exp(0.04 * wave + 0.004 * rng.normal(size=count))

    point, force, truth = drawn(700)
    learnt = fit_correction(
        ForceCorrection.plain(
            low_mm=np.zeros(3),
            size_mm=100.0,
            force_max_N=20.0,
        ),
        point_mm=point,
        force_N=force,
        signal_px=np.ones(700),
        sd_N=0.004 * force,
        truth_N=truth,
    )
    assert learnt.lengths[:2] == (wanted, 1.2)
    point, force, truth = drawn(300)
    error = np.log(force * learnt.factor(point, force, np.ones(300)) / truth)
    assert np.sqrt(np.mean(error**2)) < 0.0075  # 0.004 of it noise, 0.028 without


@pytest.mark.parametrize("true_share", [0.0, 0.05])
def test_spread_is_widened_by_a_share_where_noise_does_not_do(true_share: float) -> None:
    rng = np.random.default_rng(4)
    force, sd = rng.uniform(1.0, 25.0, 4000), np.full(4000, 0.1)
    error = np.abs(rng.normal(0.0, np.hypot(sd, true_share * force)))
    factor, share = fit_spread(error, sd, force)
    assert factor == pytest.approx(1.0, abs=0.1)
    assert share == pytest.approx(true_share, abs=0.006)


def test_moments_of_indenters_against_their_pressures() -> None:
    line = (np.arange(400) + 0.5) / 200.0 - 1.0
    x, y = np.meshgrid(line, line, indexing="ij")
    r2 = x**2 + y**2
    disc = np.where(r2 <= 1.0, 1.0, 0.0)
    ball = np.sqrt(np.maximum(1.0 - r2, 0.0))
    strip = np.sqrt(np.maximum(1.0 - y**2, 0.0))
    turn = 0.4
    got = pressure_moments(
        {
            "indenter": np.array([0, 1, 2]),
            "radius_mm": np.array([3.0, 3.0, 3.0]),
            "length_mm": np.array([0.0, 0.0, 8.0]),
            "turn_rad": np.array([0.0, 0.0, turn]),
        }
    )
    for row, pressure in zip(got[:2], (disc, ball), strict=True):
        wanted = 9.0 * np.sum(pressure * x**2) / np.sum(pressure)
        assert row == pytest.approx([wanted, 0.0, wanted], rel=2e-3, abs=1e-9)
    own = np.diag([16.0 * np.sum(strip * x**2), 9.0 * np.sum(strip * y**2)]) / np.sum(strip)
    c, s = np.cos(turn), np.sin(turn)
    turned = np.array([[c, -s], [s, c]]) @ own @ np.array([[c, s], [-s, c]])
    assert got[2] == pytest.approx([turned[0, 0], turned[0, 1], turned[1, 1]], rel=2e-3)


def test_weighted_median() -> None:
    values = np.array([3.0, 1.0, 2.0])
    assert weighted_median(values, np.array([1.0, 1.0, 1.0])) == 2.0
    assert weighted_median(values, np.array([5.0, 1.0, 1.0])) == 3.0


def test_the_error_of_the_first_order_is_that_of_the_force() -> None:
    first = LOCATOR.places.shift_px[:, :1]
    # At 20 N the shifts are 0.8 of the first order's: 20 N reads 16.
    curved = np.concatenate([first, -0.01 * first], axis=1)
    locator = replace(
        LOCATOR,
        places=replace(LOCATOR.places, shift_px=curved),
        prior=replace(LOCATOR.prior, force_N=20.0),
    )
    assert error_of_first_order(locator) == pytest.approx(0.25, rel=1e-3)
    assert error_of_first_order(locator.linear) == 0.0
