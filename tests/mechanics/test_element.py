"""The element alone: rigid motions, patch tests, invariance, and what it refuses."""

from collections.abc import Callable

import numpy as np
import pytest

from phytac_design.mechanics.shell import shell_element
from phytac_design.mechanics.shell.shell_element import element_stiffness
from phytac_design.mechanics.shell.sparse_assembly import assemble, make_pattern
from phytac_shapes.arrays import BoolArray, FloatArray
from tests.refusals import refused
from verification import shells as cases

Field = Callable[[FloatArray, FloatArray], FloatArray]
EXACT = 1e-10
ONE = np.array([[0, 1, 2, 3]])
WARPED = np.array([[0.0, 0, 0], [1.3, 0.1, 0.2], [1.1, 1.2, -0.3], [-0.1, 0.9, 0.4]])


def unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def rotation(seed: int) -> FloatArray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


@pytest.mark.parametrize("thickness", [1.0, 0.01])
@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_warped_element_has_six_zero_energy_modes_and_no_more(
    tilt: float, thickness: float
) -> None:
    rng = np.random.default_rng(1)
    directors = unit(np.array([0.0, 0, 1]) + tilt * rng.normal(size=(4, 3)))
    element = element_stiffness(WARPED, ONE, directors, poisson=0.3)
    K = element.combine(modulus_MPa=1.0, thickness_mm=thickness)[0]
    modes = cases.rigid_modes(WARPED).reshape(24, 6)
    values = np.linalg.eigvalsh(K)
    assert np.abs(K @ modes).max() < EXACT * np.abs(K).max()
    assert np.abs(values[:6]).max() < 1e-12 * values[-1]
    assert values[6] > 1e-9 * values[-1]


def distorted_plate() -> tuple[cases.Patch, BoolArray, FloatArray]:
    """Flat 5×4 plate with inner nodes moved by up to 0.3 elements, in a skew plane."""
    plate = cases.patch(lambda a, b: np.column_stack([2.0 * a, 1.5 * b, 0.0 * a]), 5, 4, jitter=0.3)
    boundary = np.any((plate.ab == 0.0) | (plate.ab == 1.0), axis=1)
    return plate, boundary, rotation(3)


def patch_error(
    field_u: Field, field_theta: Field, poisson: float = 0.3, thickness: float = 0.1
) -> tuple[float, float]:
    """Relative misfit of inner DOFs and of the energy under prescribed boundary motion."""
    plate, boundary, turn = distorted_plate()
    x, y = plate.nodes[:, 0], plate.nodes[:, 1]
    exact = np.hstack([field_u(x, y) @ turn.T, field_theta(x, y) @ turn.T]).ravel()
    nodes, normals = plate.nodes @ turn.T, plate.normals @ turn.T
    element = element_stiffness(nodes, plate.quads, normals, poisson=poisson)
    K = assemble(
        make_pattern(plate.quads, len(nodes)),
        element.combine(modulus_MPa=7.0, thickness_mm=thickness),
    ).toarray()
    free = np.repeat(~boundary, 6)
    inner = np.linalg.solve(K[np.ix_(free, free)], -K[np.ix_(free, ~free)] @ exact[~free])
    found = exact.copy()
    found[free] = inner
    misfit = np.abs(found - exact).max() / np.abs(exact).max()
    return misfit, 0.5 * found @ K @ found


def test_membrane_patch() -> None:
    strain, turn = np.array([[1.0, 0.35], [0.35, -0.4]]), 0.7

    def u(x: FloatArray, y: FloatArray) -> FloatArray:
        gradient = strain + turn * np.array([[0.0, -1.0], [1.0, 0.0]])
        return np.column_stack([np.column_stack([x, y]) @ gradient.T, 0.0 * x])

    def theta(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.column_stack([0 * x, 0 * x, np.full_like(x, turn)])

    misfit, energy = patch_error(u, theta)
    v, E, t = 0.3, 7.0, 0.1
    density = (1.0 + 0.16 + 2 * v * -0.4 + 2 * (1 - v) * 0.35**2) / (1 - v * v)
    assert misfit < EXACT
    assert energy == pytest.approx(0.5 * E * t * density * 3.0, rel=EXACT)


def test_bending_patch() -> None:
    kxx, kyy, kxy = 1.0, -0.6, 0.45

    def u(x: FloatArray, y: FloatArray) -> FloatArray:
        w = 0.5 * (kxx * x * x + kyy * y * y) + kxy * x * y
        return np.column_stack([0 * x, 0 * x, w])

    def theta(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.column_stack([kyy * y + kxy * x, -(kxx * x + kxy * y), 0 * x])

    misfit, energy = patch_error(u, theta)
    v, E, t = 0.3, 7.0, 0.1
    density = (kxx**2 + kyy**2 + 2 * v * kxx * kyy + 2 * (1 - v) * kxy**2) / (1 - v * v)
    assert misfit < EXACT
    assert energy == pytest.approx(0.5 * E * t**3 / 12 * density * 3.0, rel=EXACT)


def test_transverse_shear_patch_of_constant_shear() -> None:
    # u_z = γ x with no rotation: pure shear, energy from the shear modulus and the factor 5/6.
    def u(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.column_stack([0 * x, 0 * x, 0.3 * x])

    def theta(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.zeros((len(x), 3))

    plate, _, turn = distorted_plate()
    element = element_stiffness(
        plate.nodes @ turn.T, plate.quads, plate.normals @ turn.T, poisson=0
    )
    x, y = plate.nodes[:, 0], plate.nodes[:, 1]
    full = np.hstack([u(x, y) @ turn.T, theta(x, y)])[plate.quads].reshape(-1, 24)
    energy = 0.5 * np.einsum("ei,eij,ej->", full, element.shear, full)
    assert energy == pytest.approx(0.5 * 5 / 6 * 0.5 * 0.3**2 * 3.0, rel=EXACT)


def test_slender_beam_bends_in_its_plane_without_locking() -> None:
    # Enhanced modes make one row of rectangles exact in pure bending (aspect 10): u = M L²/2EI.
    # With bilinear displacements alone it would be some 30 times too stiff.
    beam = cases.patch(lambda a, b: np.column_stack([100.0 * a, b, 0 * a]), 10, 1)
    fixed = cases.no_support(beam)
    cases.hold(fixed, beam.ab[:, 0] == 0.0, (0, 2, 3, 4))
    fixed[0, 1] = True
    loads = np.zeros((len(beam.nodes), 6))
    loads[beam.ab[:, 0] == 1.0, 0] = [-1.0, 1.0]
    motion = cases.solve_case(beam, fixed, loads, modulus=1000.0, poisson=0.0, thickness=1.0)
    deflection = 1.0 * 100.0**2 / (2 * 1000.0 / 12)
    end = cases.at(beam, 1.0, 0.0)
    assert abs(motion[end, 1]) == pytest.approx(deflection, rel=1e-6)
    # The drilling rotation is the slope of the beam, up to the one pattern the tie leaves loose.
    mean = motion[beam.ab[:, 0] == 1.0, 5].mean()
    assert abs(mean) == pytest.approx(1.0 * 100.0 / (1000.0 / 12), rel=0.06)


def test_rotating_the_model_and_renumbering_its_nodes_change_nothing() -> None:
    rng = np.random.default_rng(5)
    roof = cases.patch(
        lambda a, b: np.column_stack([np.sin(a), b, np.cos(a) + 0.3 * a * b]), 5, 5, jitter=0.2
    )
    fixed = cases.no_support(roof)
    cases.hold(fixed, roof.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    loads = np.hstack([rng.normal(size=(len(roof.nodes), 3)), np.zeros((len(roof.nodes), 3))])
    settings = {"modulus": 50.0, "poisson": 0.3, "thickness": 0.02}
    plain = cases.solve_case(roof, fixed, loads, **settings)
    turn = rotation(8)
    order = rng.permutation(len(roof.nodes))
    place = np.argsort(order)
    other = cases.Patch(
        ab=roof.ab[order],
        nodes=(roof.nodes @ turn.T)[order],
        normals=(roof.normals @ turn.T)[order],
        quads=np.roll(place[roof.quads], 1, axis=1)[rng.permutation(len(roof.quads))],
    )
    turned = np.hstack([loads[:, :3] @ turn.T, loads[:, 3:]])[order]
    found = cases.solve_case(other, fixed[order], turned, **settings)[place]
    back = np.hstack([found[:, :3] @ turn, found[:, 3:] @ turn])
    assert np.abs(back - plain).max() < 1e-8 * np.abs(plain).max()


def test_thickness_and_modulus_are_exact_factors() -> None:
    element = element_stiffness(WARPED, ONE, np.tile([0.0, 0, 1], (4, 1)), poisson=0.3)
    per_element = element.combine(modulus_MPa=np.array([5.0]), thickness_mm=np.array([0.3]))
    expected = 5 * (0.3 * element.membrane + 0.027 * element.bending + 0.3 * element.shear)
    np.testing.assert_allclose(per_element, expected, rtol=1e-14)


@pytest.mark.parametrize(
    "corner", [(0.3, 0.3, 0.0), (0.0, 0.0, 0.0), (np.nan, 1.0, 0.0)], ids=["dart", "twin", "nan"]
)
def test_degenerate_elements_are_refused(corner: tuple[float, float, float]) -> None:
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    nodes[2] = corner
    with refused("element-degenerate"):
        element_stiffness(nodes, ONE, np.tile([0.0, 0, 1], (4, 1)), poisson=0.3)


def test_elements_do_not_depend_on_how_many_are_made_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plate, _, turn = distorted_plate()
    nodes = plate.nodes @ turn.T + np.random.default_rng(2).normal(0.0, 0.02, plate.nodes.shape)
    whole = element_stiffness(nodes, plate.quads, plate.normals @ turn.T, poisson=0.3)
    factors = {"modulus_MPa": np.arange(1.0, 21.0), "thickness_mm": 0.1}
    whole_sum = whole.combine(**factors)
    monkeypatch.setattr(shell_element, "CHUNK", 3)
    parts = element_stiffness(nodes, plate.quads, plate.normals @ turn.T, poisson=0.3)
    for name in ("membrane", "bending", "shear"):
        one, other = getattr(whole, name), getattr(parts, name)
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-13 * np.abs(one).max())
        assert np.array_equal(one, np.swapaxes(one, 1, 2))
    np.testing.assert_allclose(parts.combine(**factors), whole_sum, rtol=1e-11)


def test_assembly_sums_element_by_element_also_where_it_is_not_symmetric() -> None:
    # Three elements around a node, one with corners out of order, and a node in no element.
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [7, 6, 3, 4], [4, 5, 8, 7]])[:, [0, 1, 2, 3]]
    rng = np.random.default_rng(4)
    parts = rng.normal(size=(4, 24, 24))
    dense = np.zeros((60, 60))
    for corners, part in zip(quads, parts, strict=True):
        dof = (6 * corners[:, None] + np.arange(6)).ravel()
        dense[np.ix_(dof, dof)] += part
    pattern = make_pattern(quads, 10)
    found = assemble(pattern, parts)
    # Compressed rows are handed over as columns: the transpose of what is not symmetric.
    np.testing.assert_allclose(found.toarray(), dense.T, rtol=1e-14, atol=1e-14)
    pairs = len({(a, b) for corners in quads.tolist() for a in corners for b in corners})
    assert found.nnz == 36 * pairs
    assert found.has_sorted_indices
    check = found.copy()
    check.has_sorted_indices = False
    check.sort_indices()
    assert np.array_equal(check.indices, found.indices)
