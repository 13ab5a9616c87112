"""The compliance inverse, of markers that are seen and others that are not."""

import numpy as np
import pytest
from scipy.optimize import nnls

from phytac_decoder.estimation.estimators import KEPT_RESULTS, ForceModel

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


def test_results_of_a_frame_are_kept_and_belong_to_those_who_ask() -> None:
    forces, koi = model(), np.array([4, 11, 31])
    shifts = np.random.default_rng(4).normal(size=(KEPT_RESULTS + 2, COUNT, 2))
    fresh = [model().forces("koi_inverse", shift, koi) for shift in shifts]
    for shift, right in zip(shifts, fresh, strict=True):
        for _ in range(2):
            np.testing.assert_array_equal(forces.forces("koi_inverse", shift, koi), right)
        own = forces.key_node_forces(shift, koi)
        own[:] = -1.0
        assert (forces.key_node_forces(shift, koi) >= 0.0).all()
    assert len(forces._kept) == KEPT_RESULTS
    # Other key nodes, and the weight of their own shifts, are other results.
    assert (forces.forces("koi_inverse", shifts[-1], koi[:2]) != fresh[-1]).any()
    own = forces.key_node_forces(shifts[-1], koi)
    assert (own != forces.forces("koi_inverse", shifts[-1], koi)[koi]).any()
    # The same array with other shifts is another frame.
    shift = shifts[0].copy()
    forces.forces("koi_inverse", shift, koi)
    shift[:] = shifts[1]
    np.testing.assert_array_equal(forces.forces("koi_inverse", shift, koi), fresh[1])
