"""Receptors turn with the wall's face: exact for rigid motion, second order for shear."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phytac_design.mechanics.meshing.mesh import ShellMesh, _shell, plain_mesh
from phytac_design.mechanics.meshing.quad_grid import product_grid
from phytac_design.simulation.receptor_kinematics import ReceptorKinematics
from phytac_shapes import Plane, Surface
from phytac_shapes.arrays import FloatArray
from tests.mechanics.families import FAMILIES, WALL_MM

SHEET = Plane(width_mm=60.0, height_mm=60.0)
RADIUS = 1.5


def places(surface: Surface) -> FloatArray:
    share = np.array([[0.5, 0.5], [0.31, 0.77], [0.01, 0.2], [0.0, 0.6], [1.0, 0.0]])
    low, high = surface.domain.T
    return np.asarray(low + share * (high - low))


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_rigid_motion_is_exact(name: str) -> None:
    surface = FAMILIES[name]
    mesh = plain_mesh(surface, thickness_mm=WALL_MM, size_mm=3.0)
    uv = places(surface)
    receptors = ReceptorKinematics(mesh, surface, uv, RADIUS)
    where = np.asarray(
        receptors.linear(np.column_stack([mesh.nodes_mm, 0 * mesh.nodes_mm]).ravel())
    )
    for angle in (1e-6, 0.7):
        spin = angle * np.array([2.0, -1.0, 2.0]) / 3.0
        shift = np.array([0.3, 4.0, -1.0])
        theta = np.broadcast_to(spin, mesh.nodes_mm.shape)
        small = np.column_stack([shift + np.cross(spin, mesh.nodes_mm), theta]).ravel()
        moved = receptors.linear(small)
        np.testing.assert_allclose(moved[:, 3:], np.tile(spin, (5, 1)), atol=1e-9 * angle)
        expected = shift + np.cross(spin, where[:, :3])
        np.testing.assert_allclose(moved[:, :3], expected, atol=1e-9)
        turn = Rotation.from_rotvec(spin)
        whole = np.column_stack([shift + turn.apply(mesh.nodes_mm) - mesh.nodes_mm, theta]).ravel()
        np.testing.assert_allclose(
            receptors.large(whole)[:, 3:], np.tile(spin, (5, 1)), atol=1e-9 * angle
        )


def bent(mesh: ShellMesh, shear: float) -> FloatArray:
    """A sheet whose height is a cubic of x and whose director lags its slope by ``shear`` x/30."""
    x = mesh.nodes_mm[:, 0]
    out = np.zeros((len(x), 6))
    out[:, 2] = 1e-5 * x**3
    slope = 3e-5 * x**2 - shear * x / 30.0
    out[:, 4] = -slope
    return out


@pytest.mark.parametrize("graded", [False, True])
def test_the_face_leans_by_the_shear_as_well(graded: bool) -> None:
    mesh = plain_mesh(SHEET, thickness_mm=WALL_MM, size_mm=1.0)
    if graded:
        fine = np.unique(mesh.uv[:, 1])  # v runs along x
        lines = np.sort(np.concatenate([fine, (fine[:-1] + fine[1:])[::3] / 2.0]))
        mesh = _shell(SHEET, product_grid(SHEET, np.unique(mesh.uv[:, 0]), lines), WALL_MM)
    uv = np.array([[0.0, 0.0], [7.3, 2.0], [-20.2, 11.0]])
    receptors = ReceptorKinematics(mesh, SHEET, uv, RADIUS)
    field, sheared = bent(mesh, 0.01), bent(mesh, 1.0)
    x = SHEET.point(uv)[:, 0]
    slope = 3e-5 * (x**2 + (0.5 * RADIUS) ** 2 / 2.0)
    for moved in (receptors.linear(sheared.ravel()), receptors.large(field.ravel())):
        np.testing.assert_allclose(moved[:, 4], -slope, atol=2e-5)
        np.testing.assert_allclose(moved[:, [3, 5]], 0.0, atol=1e-6)
    # The director alone misses the shear.
    plain = receptors.linear(bent(mesh, 0.0).ravel())
    np.testing.assert_allclose(plain, receptors.linear(field.ravel()), atol=1e-12)


def test_large_is_linear_where_small_and_shear_turns_with_the_wall() -> None:
    mesh = plain_mesh(SHEET, thickness_mm=WALL_MM, size_mm=1.5)
    uv = np.array([[7.3, 2.0], [-20.2, 11.0]])
    receptors = ReceptorKinematics(mesh, SHEET, uv, RADIUS)
    field = bent(mesh, 0.01)
    tiny = 1e-4 * field.ravel()
    np.testing.assert_allclose(receptors.large(tiny), receptors.linear(tiny), atol=1e-10)
    # The same bent sheet, carried around by a finite rotation.
    turn = Rotation.from_rotvec([0.4, -0.9, 0.6])
    where = mesh.nodes_mm + field[:, :3]
    both = (turn * Rotation.from_rotvec(field[:, 3:])).as_rotvec()
    carried = np.column_stack([turn.apply(where) - mesh.nodes_mm, both]).ravel()
    expected = (turn * Rotation.from_rotvec(receptors.large(field.ravel())[:, 3:])).as_rotvec()
    np.testing.assert_allclose(receptors.large(carried)[:, 3:], expected, atol=2e-5)
