"""Finite rotations against scipy, against differences, and for tiny angles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phytac_design.mechanics.large import rotations as rot

ANGLES = [1e-9, 1e-4, 0.05, 0.0999, 0.1001, 1.0, 3.0]


def vectors(angle: float) -> np.ndarray:
    v = np.random.default_rng(3).normal(size=(7, 3))
    return angle * v / np.linalg.norm(v, axis=1)[:, None]


@pytest.mark.parametrize("angle", ANGLES)
def test_exponential_matrix_and_product_agree_with_scipy(angle: float) -> None:
    a, b = vectors(angle), vectors(1.3)[::-1]
    ours = rot.matrix(rot.product(rot.exponential(a), rot.exponential(b)))
    theirs = (Rotation.from_rotvec(a) * Rotation.from_rotvec(b)).as_matrix()
    np.testing.assert_allclose(ours, theirs, atol=1e-14)


@pytest.mark.parametrize("angle", [1e-300, *ANGLES])
def test_logarithm_undoes_the_exponential_to_relative_precision(angle: float) -> None:
    theta = vectors(angle)
    np.testing.assert_allclose(rot.logarithm(rot.exponential(theta)), theta, rtol=1e-13)
    np.testing.assert_allclose(rot.logarithm(-rot.exponential(theta)), theta, rtol=1e-13)


@pytest.mark.parametrize("angle", ANGLES)
def test_spin_to_vector_is_the_derivative_of_the_logarithm(angle: float) -> None:
    theta, e = vectors(angle), 1e-6
    H = rot.spin_to_vector(theta)
    for axis in range(3):
        ahead, back = (
            rot.logarithm(
                rot.product(rot.exponential(s * e * np.eye(3)[axis]), rot.exponential(theta))
            )
            for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(H[:, :, axis], (ahead - back) / (2 * e), atol=2e-8)


@pytest.mark.parametrize("angle", ANGLES)
def test_moment_change_is_the_derivative_of_h_transposed_m(angle: float) -> None:
    theta, moment, e = vectors(angle), vectors(2.0)[::-1], 1e-6
    change = rot.moment_change(theta, moment)
    for axis in range(3):
        ahead, back = (
            np.einsum("nji,nj->ni", rot.spin_to_vector(theta + s * e * np.eye(3)[axis]), moment)
            for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(change[:, :, axis], (ahead - back) / (2 * e), atol=2e-8)
