"""The compliance inverse, of markers that are seen and others that are not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from phytac_decoder.camera.camera_motion import CameraMotion
from phytac_decoder.estimation.estimators import KEPT_RESULTS, MODEL_SHARE, ForceModel
from phytac_shapes.arrays import FloatArray, IntArray

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
def test_forces_are_the_weighted_least_squares_over_what_is_seen(hidden: tuple[int, ...]) -> None:
    """Weights are by the noise, and by a share of the motion that is seen or foreseen."""
    forces, koi = model(), np.array([4, 5, 11, 19, 20, 31, 32])
    shift = (forces.compliance_px[:, koi] @ np.array([1.0, 0.4, 2.0, 0.0, 0.7, 0.0, 3.0])).reshape(
        COUNT, 2
    ) + np.random.default_rng(3).normal(0.0, 0.05, (COUNT, 2))
    shift[list(hidden)] = np.nan
    given = shift.copy()
    found = forces.forces("koi_inverse", shift, koi)
    seen = np.isfinite(shift.reshape(-1))
    rows, d = forces.compliance_px[:, koi], np.nan_to_num(shift.reshape(-1))
    linear = rows @ nnls(rows[seen], d[seen])[0]
    moved = np.maximum(*(np.hypot(px[::2], px[1::2]) for px in (d, linear)))
    sd = np.repeat(np.hypot(forces.noise_px, MODEL_SHARE * moved), 2)[seen]
    right = nnls(rows[seen] / sd[:, None], d[seen] / sd)[0]
    np.testing.assert_allclose(found[koi], right, rtol=1e-6, atol=1e-9)
    assert np.count_nonzero(found) <= len(koi)
    np.testing.assert_array_equal(shift, given)


def noisy(forces: ForceModel, koi: IntArray, force_N: FloatArray) -> FloatArray:
    """Shifts (n, 2) px with noise."""
    moved = (forces.compliance_px[:, koi] @ force_N).reshape(COUNT, 2)
    return np.asarray(moved + np.random.default_rng(3).normal(0.0, 0.03, (COUNT, 2)))


@pytest.mark.parametrize("misread", [(12,), (2, 12, 28)])
def test_markers_that_were_misread_are_left_out(misread: tuple[int, ...]) -> None:
    forces, koi, force_N = model(), np.array([4, 11, 31]), np.array([3.0, 2.0, 4.0])
    shift = noisy(forces, koi, force_N)
    clean = forces.forces("koi_inverse", shift, koi)
    np.testing.assert_allclose(clean[koi], force_N, atol=0.05)
    shift[list(misread)] += [9.0, 6.0]
    found = forces.forces("koi_inverse", shift, koi)
    np.testing.assert_allclose(found, clean, atol=0.03)
    shift[list(misread)] = np.nan
    np.testing.assert_array_equal(found, model().forces("koi_inverse", shift, koi))
    # Without that, one of them changes a force by a tenth.
    shift[list(misread)] = [9.0, 6.0]
    assert np.abs(model()._least_squares(shift, koi, 0.0) / clean[koi] - 1.0).max() > 0.1


@pytest.mark.parametrize("misread", [(5, 12, 30), (10, 12, 30), (3, 5, 10)])
def test_misread_markers_do_not_hide_each_other(misread: tuple[int, ...]) -> None:
    """They pull forces until more markers than may be left out are off."""
    forces, koi = model(), np.array([4, 11, 31])
    shift = noisy(forces, koi, np.array([3.0, 2.0, 4.0]))
    clean = forces.forces("koi_inverse", shift, koi)
    shift[list(misread)] = [-2.0, -1.5]
    pulled = forces._least_squares(shift, koi, 0.0)
    assert not forces.misread(shift, koi, pulled).any()
    np.testing.assert_allclose(forces.forces("koi_inverse", shift, koi), clean, atol=0.05)


@pytest.mark.parametrize("wrong", [(28, 20, 21, 24), (31,)], ids=["many", "a key node"])
def test_what_is_not_modelled_is_not_left_out(wrong: tuple[int, ...]) -> None:
    """More than a few markers are something that presses; a contact dents the wall under itself."""
    forces, koi = model(), np.array([4, 11, 31])
    shift = noisy(forces, koi, np.array([3.0, 2.0, 4.0]))
    shift[list(wrong)] += [9.0, -6.0]
    found = forces.forces("koi_inverse", shift, koi)
    np.testing.assert_array_equal(found[koi], forces._least_squares(shift, koi, 0.0))


def test_a_motion_of_the_cameras_is_not_misread() -> None:
    """By it the last three markers are farther off than noise."""
    first = np.zeros((1, 2 * COUNT))
    first[0, ::2] = np.linspace(0.0, 0.66, COUNT)
    motion = CameraMotion(
        first=first,
        second=np.zeros((0, 2 * COUNT), dtype=np.float32),
        pair=np.zeros((2, 0), dtype=np.int64),
        sd=np.ones(1),
    )
    moving, koi = replace(model(), camera_motion=motion), np.array([4, 11, 25])
    shift = noisy(moving, koi, np.array([3.0, 2.0, 4.0])) + first.reshape(COUNT, 2)
    found = moving.forces("koi_inverse", shift, koi)
    np.testing.assert_allclose(found[koi], [3.0, 2.0, 4.0], atol=0.1)
    np.testing.assert_array_equal(found[koi], moving._least_squares(shift, koi, 0.0))
    still = (moving.compliance_px[:, koi] @ found[koi]).reshape(COUNT, 2)
    assert np.count_nonzero(moving.unexplained(shift - still, still)) in range(1, 4)


def test_a_marker_that_seems_to_stay_beside_a_contact_does_not_count_most() -> None:
    """By the shifts alone its weight would be 200 times its neighbours', and the force 2 N."""
    forces, koi = model(), np.array([11])
    shift = noisy(forces, koi, np.array([20.0]))
    shift[12] *= 0.02
    (found,) = forces._least_squares(shift, koi, 0.0)
    assert 16.0 < found < 20.0


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
