"""Errors of forces, their intervals, and the intervals that an estimator claims."""

import numpy as np
import pytest

from phytac_design.training.evaluation.contact_scores import (
    MEDIANS,
    Bootstrap,
    error_summary,
    interval_coverage,
)


def test_errors_are_those_by_hand() -> None:
    found = error_summary(np.array([1.5, 3.0, 8.0, 10.0]), np.array([1.0, 4.0, 8.0, 20.0]))
    assert found["relative_error"] == pytest.approx((0.5 + 0.25 + 0.0 + 0.5) / 4)
    assert found["accuracy"] == pytest.approx(1.0 - 0.3125)
    assert found["relative_error_median"] == pytest.approx(0.375)
    assert found["absolute_error_mean_N"] == pytest.approx(11.5 / 4)
    assert found["absolute_error_median_N"] == pytest.approx(0.75)
    assert found["absolute_error_sd_N"] == pytest.approx(np.std([0.5, 1.0, 0.0, 10.0]))
    assert found["bias_N"] == pytest.approx(-10.5 / 4)
    assert found["rmse_N"] == pytest.approx(np.sqrt(101.25 / 4))
    assert found["error_sd_N"] == pytest.approx(np.std([0.5, -1.0, 0.0, -10.0]))
    assert np.isnan(error_summary(np.zeros(0), np.zeros(0))["relative_error"])


def test_intervals_of_the_mean_are_those_of_theory() -> None:
    rng = np.random.default_rng(0)
    truth = np.full(400, 10.0)
    estimate = truth + rng.normal(0.3, 1.0, 400)
    everything = np.ones(400, dtype=np.bool_)
    score = Bootstrap(sample=np.arange(400), seed=0).score(estimate, truth, everything)
    bias = score["bias_N"]
    error = (estimate - truth).std() / np.sqrt(400)
    assert bias["high"] - bias["low"] == pytest.approx(2.0 * 1.96 * error, rel=0.1)
    assert bias["low"] < bias["value"] < bias["high"]
    assert score["samples"] == score["contacts"] == 400
    # Four contacts that always err alike are one: the interval is that of a hundred.
    alike = np.repeat(rng.normal(0.3, 1.0, 100), 4) + truth
    together = Bootstrap(sample=np.repeat(np.arange(100), 4), seed=0)
    wide = together.score(alike, truth, everything)["bias_N"]
    expected = 2.0 * 1.96 * (alike - truth).std() / np.sqrt(100)
    assert wide["high"] - wide["low"] == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("together", [10, 10**6])
def test_resampled_measures_are_those_of_the_drawn_contacts(together: int) -> None:
    rng = np.random.default_rng(1)
    sample = np.sort(rng.integers(0, 12, 40))
    truth = rng.uniform(1.0, 20.0, 40)
    estimate = truth + rng.normal(size=40)
    chosen = rng.random(40) < 0.6
    bootstrap = Bootstrap(sample=sample, seed=3, resamples=50, together=together)
    score = bootstrap.score(estimate, truth, chosen)
    rows = [np.flatnonzero(bootstrap.groups[1] == k) for k in range(bootstrap.groups[0])]
    drawn = []
    for weight in bootstrap.weights:
        index = np.concatenate([np.tile(rows[k], w) for k, w in enumerate(weight) if w])
        index = index[chosen[index]]
        if len(index):
            drawn.append(error_summary(estimate[index], truth[index]))
    assert (bootstrap.weights.sum(axis=1) == bootstrap.groups[0]).all()
    for name in ("relative_error", "absolute_error_sd_N", "rmse_N", "error_sd_N", *MEDIANS):
        values = [item[name] for item in drawn]
        assert score[name]["low"] == pytest.approx(np.percentile(values, 2.5), rel=1e-9), name
        assert score[name]["high"] == pytest.approx(np.percentile(values, 97.5), rel=1e-9), name


def test_one_sample_has_no_interval() -> None:
    bootstrap = Bootstrap(sample=np.array([5, 5, 6]), seed=0)
    score = bootstrap.score(np.ones(3), np.ones(3), np.array([True, True, False]))
    assert score["contacts"] == 2
    assert np.isnan(score["bias_N"]["low"])


def test_claimed_intervals_are_counted() -> None:
    rng = np.random.default_rng(2)
    truth = rng.uniform(1.0, 20.0, 20_000)
    sd = rng.uniform(0.1, 1.0, 20_000)
    force = truth + sd * rng.normal(size=20_000)
    assert interval_coverage(force, sd, truth) == pytest.approx(0.90, abs=0.01)
    assert interval_coverage(force, sd, truth, level=0.5) == pytest.approx(0.50, abs=0.01)
    assert interval_coverage(force, 0.5 * sd, truth) == pytest.approx(0.589, abs=0.01)
    assert np.isnan(interval_coverage(force[:0], sd[:0], truth[:0]))
