"""The corotational element: free of strain under rigid motion, and consistent to round-off."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.large.corotational import Configuration, Corotational
from phytac_design.mechanics.shell.solve import ShellModel
from tests.refusals import refused
from verification.pressure_load import pressure_forces

NODES = np.array(
    [
        [0, 0, 0],
        [1.3, 0.1, 0.2],
        [1.1, 1.2, -0.3],
        [-0.1, 0.9, 0.4],
        [2.4, 0.2, 0.1],
        [2.5, 1.3, 0.2],
    ]
)
QUADS = np.array([[0, 1, 2, 3], [1, 4, 5, 2]])


@pytest.fixture(scope="module")
def shell() -> Corotational:
    directors = np.random.default_rng(1).normal(size=(6, 3)) * 0.2 + [0.0, 0.0, 1.0]
    directors /= np.linalg.norm(directors, axis=1)[:, None]
    fixed = np.zeros((6, 6), dtype=bool)
    fixed[0] = True
    return Corotational(
        ShellModel(
            NODES, QUADS, directors, thickness_mm=0.1, modulus_MPa=1e3, poisson=0.3, fixed=fixed
        )
    )


def turned(shell: Corotational, theta: np.ndarray) -> Configuration:
    q = rot.exponential(theta)
    move = NODES @ rot.deviation(q).T + np.array([1.0, -2.0, 3.0])
    return Configuration(displacement_mm=move, quaternion=np.tile(q, (6, 1)))


def bent(shell: Corotational) -> Configuration:
    step = 0.2 * np.random.default_rng(2).normal(size=36)
    return turned(shell, np.array([1.0, -1.5, 0.7])).moved(step)


def energy(shell: Corotational, state: Configuration) -> float:
    local = shell.local(state)
    return 0.5 * float(np.sum(local.forces * local.motion))


def differences(
    function: Callable[[Configuration], Any], state: Configuration, e: float = 1e-5
) -> np.ndarray:
    columns = [
        (function(state.moved(e * dof)) - function(state.moved(-e * dof))) / (2 * e)
        for dof in np.eye(36)
    ]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("angle", [1e-3, 1.0, 3.0, 6.0])
def test_no_force_under_any_rigid_motion(shell: Corotational, angle: float) -> None:
    theta = angle * np.array([0.6, -0.48, 0.64])
    force = shell.internal(turned(shell, theta))
    assert np.abs(force).max() < 1e-11 * abs(shell.model.stiffness).max()


def test_forces_are_the_gradient_of_the_energy(shell: Corotational) -> None:
    state = bent(shell)
    force = shell.internal(state)
    np.testing.assert_allclose(
        force, differences(lambda s: energy(shell, s), state), atol=1e-8 * np.abs(force).max()
    )


def test_tangent_is_the_derivative_of_the_forces(shell: Corotational) -> None:
    state = bent(shell)
    K = shell.tangent(shell.local(state)).toarray()
    J = differences(shell.internal, state)
    np.testing.assert_allclose(K, J, atol=1e-8 * np.abs(K).max())


def test_forces_of_a_deformed_body_are_in_balance(shell: Corotational) -> None:
    state = bent(shell)
    force = shell.internal(state).reshape(6, 6)
    scale = np.abs(force).max()
    torque = np.cross(NODES + state.displacement_mm, force[:, :3]).sum(axis=0)
    assert np.abs(force[:, :3].sum(axis=0)).max() < 1e-12 * scale
    assert np.abs(torque + force[:, 3:].sum(axis=0)).max() < 1e-12 * scale


def test_tangent_at_rest_is_the_linear_stiffness(shell: Corotational) -> None:
    K = shell.tangent(shell.local(shell.rest()))
    assert abs(K - shell.model.stiffness).max() < 1e-14 * abs(K).max()


def test_foreseen_forces_are_right_to_first_order(shell: Corotational) -> None:
    state, local = bent(shell), shell.local(bent(shell))
    step = 1e-6 * np.random.default_rng(4).normal(size=36)
    true = shell.local(state.moved(step)).forces - local.forces
    np.testing.assert_allclose(
        shell.predicted_forces(local, step) - local.forces, true, atol=1e-4 * np.abs(true).max()
    )


def test_tiny_motions_keep_their_digits(shell: Corotational) -> None:
    step = 1e-12 * np.random.default_rng(5).normal(size=36)
    force = shell.internal(shell.rest().moved(step))
    linear = shell.model.stiffness @ step
    np.testing.assert_allclose(force, linear, atol=1e-9 * np.abs(linear).max())


def test_elements_that_no_rotation_fits_are_refused(shell: Corotational) -> None:
    # Corners pulled through each other while the nodes keep their rotations.
    move = np.random.default_rng(0).normal(size=(6, 3)) * 100.0
    move[0] = np.nan
    state = Configuration(displacement_mm=move, quaternion=rot.identity(6))
    with refused("element-distorted"):
        shell.local(state)


def test_pressure_on_a_flat_square_is_its_area_along_the_normal() -> None:
    square = np.array([[0.0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 3, 0]])
    force = pressure_forces(square, np.array([[0, 1, 2, 3]])).reshape(4, 6)
    np.testing.assert_allclose(force, np.tile([0, 0, 1.5, 0, 0, 0], (4, 1)), atol=1e-14)
