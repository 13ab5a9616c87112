"""The compliance inverse, of markers that are seen and others that are not."""

import numpy as np
import pytest
from scipy.optimize import nnls

from phytac_decoder.estimation.estimators import ForceModel

COUNT = 40


def model() -> ForceModel:
    """Forces that move the markers near them, most of all their own."""
    rng = np.random.default_rng(2)
    gap = np.abs(np.arange(COUNT)[:, None] - np.arange(COUNT)[None])
    reach = np.exp(-gap / 2.0)[:, None] * rng.normal(1.0, 0.3, (COUNT, 2, COUNT))
    return ForceModel(
        shift_to_mm=np.ones((COUNT, 2)),
        stiffness=np.eye(COUNT),
        compliance_px=reach.reshape(2 * COUNT, COUNT),
        height_z_mm=np.zeros(COUNT),
        neighbours=np.full((COUNT, 8), -1),
        networks={},
    )


@pytest.mark.parametrize(
    "hidden", [(), (3, 20, 33), (9, 10, 11, 12, 13), tuple(range(2, 30))], ids=len
)
def test_forces_are_the_least_squares_over_what_is_seen(hidden: tuple[int, ...]) -> None:
    forces, koi = model(), np.array([4, 5, 11, 19, 20, 31, 32])
    shift = (forces.compliance_px[:, koi] @ np.array([1.0, 0.4, 2.0, 0.0, 0.7, 0.0, 3.0])).reshape(
        COUNT, 2
    ) + np.random.default_rng(3).normal(0.0, 0.05, (COUNT, 2))
    shift[list(hidden)] = np.nan
    given = shift.copy()
    found = forces.forces("koi_inverse", shift, koi)
    seen = np.isfinite(shift.reshape(-1))
    right = nnls(forces.compliance_px[seen][:, koi], shift.reshape(-1)[seen])[0]
    np.testing.assert_allclose(found[koi], right, rtol=1e-6, atol=1e-9)
    assert np.count_nonzero(found) <= len(koi)
    np.testing.assert_array_equal(shift, given)
