"""Frames of one press are one press: what a decoder learns is not surer by there being more."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_design.training.force_correction_fit import fit_correction
from phytac_design.training.locator_calibration import press_blocks
from phytac_design.training.marker_gain import cross_validation_folds
from phytac_shapes.arrays import IntArray
from tests.decoder.flat_samples import pressed
from tests.decoder.test_calibrate import drawn_shown

HELD = 10


def test_frames_of_a_press_are_left_out_together() -> None:
    rng = np.random.default_rng(2)
    explained = rng.normal(size=(30, 6, 2))
    seen = drawn_shown(explained, 0.05 * rng.normal(size=explained.shape))
    sequence = np.repeat(np.arange(10)[::-1], 3)
    parts = cross_validation_folds(seen, 4, sequence)
    assert len(parts) == 4
    whole = np.sum([part.rows for part in parts], axis=0)
    assert (whole == 1).all()
    for part in parts:
        inside, outside = set(sequence[part.rows].tolist()), set(sequence[~part.rows].tolist())
        assert not inside & outside
    alone, unlike = (
        cross_validation_folds(seen, 4),
        cross_validation_folds(seen, 4, 100 + np.arange(30)),
    )
    for one, other in zip(alone, unlike, strict=True):
        assert (one.rows == other.rows).all()
        assert (one.gain == other.gain).all()


@pytest.mark.parametrize("known", [True, False])
def test_a_spread_is_that_of_presses_not_of_frames(known: bool) -> None:
    """Each press is off by 10 %, its frames by the same: the others say nothing of that."""
    rng = np.random.default_rng(3)
    count = 40
    point, force = rng.uniform(0.0, 100.0, (count, 3)), rng.uniform(2.0, 20.0, count)
    truth = force * np.exp(0.1 * rng.normal(size=count))
    press: IntArray = np.repeat(np.arange(count), HELD)
    jitter = np.exp(0.002 * rng.normal(size=count * HELD))
    learnt = fit_correction(
        ForceCorrection.plain(low_mm=np.zeros(3), size_mm=100.0, force_max_N=20.0),
        point_mm=point[press],
        force_N=force[press] * jitter,
        signal_px=np.ones(count * HELD),
        sd_N=0.004 * force[press],
        truth_N=truth[press],
        block=press if known else None,
    )
    got = float(learnt.spread_N(np.array([10.0]), np.array([0.04]))[0]) / 10.0
    assert got > 0.07 if known else got < 0.03


def test_intervals_are_no_narrower_than_the_fit_states() -> None:
    rng = np.random.default_rng(6)
    force = rng.uniform(2.0, 20.0, 60)
    learnt = fit_correction(
        ForceCorrection.plain(low_mm=np.zeros(3), size_mm=100.0, force_max_N=20.0),
        point_mm=rng.uniform(0.0, 100.0, (60, 3)),
        force_N=force,
        signal_px=np.ones(60),
        sd_N=0.05 * force,
        truth_N=force * np.exp(0.005 * rng.normal(size=60)),
    )
    assert learnt.spread_N(np.array([10.0]), np.array([0.5]))[0] == pytest.approx(0.5, rel=0.02)


def test_contacts_of_one_frame_are_no_frames_of_one_press() -> None:
    samples = pressed(12, seed=5)
    assert samples.touches is not None
    touch = np.arange(len(samples.touches.force_N))
    assert len(np.unique(press_blocks(samples, touch))) == len(touch)
    held = replace(samples, sequence=samples.sequence // 3)
    block = press_blocks(held, touch)
    assert (block == held.sequence[samples.touches.sample]).all()
