"""Third derivatives of the elements' energies against other ways to them."""

from functools import cache

import numpy as np
import pytest

from phytac_design.layout import make_markers
from phytac_design.mechanics.large.corotational import Configuration, Corotational
from phytac_design.mechanics.large.cubic_stiffness import _copies, _of, cubic_stiffness
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.mechanics.large.reference_configuration import ReferenceShell
from phytac_design.mechanics.large.rotations import exponential
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray, IntArray
from tests.designs import drawn


@cache
def model(kind: str, refine: int = 2) -> ShellModel:
    design = drawn(kind, 3)
    surface = design.surface()
    markers = make_markers(design, surface)
    mesh = marker_mesh(surface, markers, thickness_mm=design.wall.thickness_mm, refine=refine)
    return sensor_model(design, markers, mesh, receptors=True)


@cache
def whole(kind: str) -> FloatArray:
    return np.concatenate([third for _, third in cubic_stiffness(model(kind))]).astype(float)


def dofs(own: ShellModel) -> IntArray:
    return np.asarray((6 * own.quads[:, :, None] + np.arange(6)).reshape(-1, 24))


def drawn_motions(own: ShellModel, count: int) -> FloatArray:
    """Smooth linear motions (k, 6N) under a newton on single nodes."""
    free = np.flatnonzero(~own.fixed.ravel().reshape(-1, 6)[:, 0])
    push = np.zeros((own.fixed.size, count))
    nodes = np.random.default_rng(2).choice(free, count, replace=False)
    push[6 * nodes + 1, np.arange(count)] = 1.0
    return np.asarray(own.solve(push).motion.reshape(push.shape).T)


def force(own: ShellModel, third: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    """Π‴(x, y) (6N,) of the whole shell."""
    rows, out = dofs(own), np.zeros(own.fixed.size)
    np.add.at(out, rows, np.einsum("eabc,ea,eb->ec", third, one[rows], two[rows]))
    return np.where(own.fixed.ravel(), 0.0, out)


@pytest.mark.parametrize("kind", ["cylinder", "hemisphere", "plane"])
def test_all_orders_of_its_indices_say_the_same(kind: str) -> None:
    third = whole(kind)
    size = np.abs(third).max()
    for order in ((0, 2, 1, 3), (0, 3, 2, 1)):
        np.testing.assert_allclose(third.transpose(order), third, atol=1e-5 * size)


@pytest.mark.parametrize("kind", ["cylinder", "hemisphere", "plane"])
def test_along_a_motion_it_is_the_expansion_of_koiter(kind: str) -> None:
    """K·x₂ = -Π‴(x, x)/2: the second term as large displacements' own expansion has it."""
    own = model(kind)
    (motion,) = drawn_motions(own, 1)
    load = own.stiffness @ motion
    load[own.fixed.ravel()] = 0.0
    second = QuasiNewtonSolver(own).expand(load, motion).second
    push = -0.5 * force(own, whole(kind), motion, motion)
    found = own.solve(push[:, None]).motion.reshape(-1)
    assert np.linalg.norm(found - second) < 5e-3 * np.linalg.norm(second)


def test_of_two_motions_it_is_the_second_difference_of_forces() -> None:
    own = model("cylinder")
    resting, (one, two) = ReferenceShell(own), drawn_motions(own, 2)
    x, y = 1e-3 / resting.motion_size(one) * one, 1e-3 / resting.motion_size(two) * two
    each = [resting.internal(a * x + b * y) for a, b in ((1, 1), (-1, -1), (1, -1), (-1, 1))]
    wanted = (each[0] + each[1] - each[2] - each[3]) / 4.0
    found = force(own, whole("cylinder"), x, y)
    # Forces on spins have a part more, which no disc's pressure has a share in.
    moved = own.solve(np.stack([wanted, found], axis=1)).motion.reshape(-1, 2)
    assert np.linalg.norm(moved[:, 0] - moved[:, 1]) < 1e-3 * np.linalg.norm(moved[:, 0])


def test_a_shift_of_an_element_as_a_whole_changes_nothing() -> None:
    third = whole("cylinder")
    for axis in range(3):
        shift = np.tile(np.eye(6)[axis], 4)
        left = np.einsum("eabc,a->ebc", third, shift)
        assert np.abs(left).max() < 1e-4 * np.abs(third).max()


def test_copies_of_an_element_are_turned_not_computed() -> None:
    own = model("cylinder")
    assert len(_copies(own)[0]) < len(own.quads) / 8
    each = _of(Corotational(own, apart=np.arange(len(own.quads)))).astype(float)
    np.testing.assert_allclose(whole("cylinder"), each, atol=3e-6 * np.abs(each).max())


def test_chunks_are_all_the_elements_in_their_order() -> None:
    own = model("cylinder")
    slices = [some for some, _ in cubic_stiffness(own, at_once=70)]
    assert len(slices) > 1
    assert [some.stop for some in slices[:-1]] == [some.start for some in slices[1:]]
    assert (slices[0].start, slices[-1].stop) == (0, len(own.quads))


def test_elements_apart_add_up_to_the_shell() -> None:
    own = model("cylinder")
    (motion,) = drawn_motions(own, 1)
    rows = dofs(own)
    parts = motion[rows].reshape(-1, 6)
    state = Configuration(displacement_mm=parts[:, :3].copy(), quaternion=exponential(parts[:, 3:]))
    total = np.zeros(own.fixed.size)
    apart = Corotational(own, apart=np.arange(len(own.quads)))
    assert apart.size == rows.size
    np.add.at(total, rows.ravel(), apart.internal(state))
    total[own.fixed.ravel()] = 0.0
    np.testing.assert_allclose(total, ReferenceShell(own).internal(motion), atol=1e-9)
