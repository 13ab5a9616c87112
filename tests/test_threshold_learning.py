"""Thresholds of gradual switches, learnt from samples with known ones."""

import numpy as np
import pytest

from phytac_design.training.threshold_learning import posterior

COUNT, SPREAD, COMMON = 300, 0.07, 1.15


def learnt(samples: int, *, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """True factors, learnt ones, their standard deviations, and the common factor."""
    rng = np.random.default_rng(seed)
    true = COMMON * np.exp(SPREAD * rng.standard_normal(COUNT))
    # Most footprints carry nothing; a tenth of them any force up to four thresholds.
    ratio = rng.uniform(0.0, 4.0, (samples, COUNT)) * (rng.random((samples, COUNT)) < 0.1)
    found, sd, common = posterior(ratio, ratio > true, np.full(COUNT, SPREAD))
    return true, found, sd, common


def test_two_hundred_samples_find_the_common_factor_and_each_switch() -> None:
    true, found, sd, common = learnt(200)
    assert common == pytest.approx(COMMON, rel=0.02)
    error = np.log(found / true)
    # Without the samples errors are 0.14 on average and 0.07 from switch to switch.
    assert np.abs(np.mean(error)) < 0.02
    assert np.std(error) < 0.9 * SPREAD
    assert np.mean(sd) < SPREAD
    # Standard deviations are what errors are.
    assert 0.6 < np.std(error / sd) < 1.4


def test_more_samples_find_more() -> None:
    few, many = (learnt(samples) for samples in (200, 2000))
    assert np.std(np.log(many[1] / many[0])) < 0.6 * np.std(np.log(few[1] / few[0]))


def test_nothing_is_learnt_from_nothing() -> None:
    ratio = np.zeros((5, 3))
    found, sd, common = posterior(ratio, ratio > 1.0, np.full(3, SPREAD))
    assert found == pytest.approx(1.0)
    assert sd == pytest.approx(SPREAD, rel=0.02)
    assert common == pytest.approx(1.0)


def test_a_misread_switch_is_no_proof() -> None:
    # On at a tenth of its threshold, as a camera may misread it.
    found, _, _ = posterior(np.array([[0.1]]), np.array([[True]]), np.full(1, SPREAD))
    assert found == pytest.approx(1.0, abs=0.02)
