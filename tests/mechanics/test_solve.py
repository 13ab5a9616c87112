"""The model: balance with its supports, and refusal of what cannot be solved."""

from typing import Any

import numpy as np
import pytest

from phytac_design.mechanics.meshing.mesh import chart_mesh
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_shapes.arrays import FloatArray
from phytac_shapes.cylinder import Cylinder
from phytac_shapes.errors import NumericalError
from tests.refusals import refused
from verification import shells as cases

TUBE = chart_mesh(
    Cylinder(diameter_outer_mm=20.0, length_mm=30.0), thickness_mm=0.5, n_along=6, n_around=16
)
TUBE_DOFS = 6 * len(TUBE.nodes_mm)
SINGULAR = ("stiffness-not-factored", "stiffness-ill-conditioned")


def model(**changes: Any) -> ShellModel:
    settings = {
        "thickness_mm": 0.5,
        "modulus_MPa": 1000.0,
        "poisson": 0.3,
        "fixed": clamped_model(TUBE, modulus_MPa=1.0, poisson=0.3).fixed,
        "nodes_mm": TUBE.nodes_mm,
        "quads": TUBE.quads,
        "directors": TUBE.normals,
    } | changes
    return ShellModel(**settings)


def test_reactions_balance_forces_and_moments() -> None:
    rng = np.random.default_rng(0)
    loads = rng.normal(size=(len(TUBE.nodes_mm), 6, 3))
    solution = model().solve(loads.reshape(-1, 3))
    free = ~model().fixed
    assert np.all(solution.reactions[free] == 0.0)
    assert np.all(solution.motion[~free] == 0.0)
    total = loads + solution.reactions
    force = total[:, :3].sum(axis=0)
    moment = np.cross(TUBE.nodes_mm[:, :, None], total[:, :3], axis=1).sum(axis=0)
    moment += total[:, 3:].sum(axis=0)
    scale = np.abs(solution.reactions).sum()
    assert np.abs(force).max() < 1e-10 * scale
    assert np.abs(moment).max() < 1e-10 * scale * 30.0
    assert solution.error < 1e-9


def test_loads_may_be_sparse_dense_single_or_many() -> None:
    from scipy.sparse import csc_matrix

    loads = np.random.default_rng(1).normal(size=(6 * len(TUBE.nodes_mm), 70))
    tube = model()
    many = tube.solve(loads).motion
    np.testing.assert_allclose(tube.solve(csc_matrix(loads)).motion, many, rtol=1e-12)
    np.testing.assert_allclose(tube.solve(loads[:, 69]).motion[:, :, 0], many[:, :, 69], rtol=1e-9)


def test_compliance_scales_with_modulus_and_takes_values_per_element() -> None:
    load = np.random.default_rng(1).normal(size=6 * len(TUBE.nodes_mm))
    plain = model().solve(load).motion
    twice = model(modulus_MPa=np.full(len(TUBE.quads), 2000.0)).solve(load).motion
    np.testing.assert_allclose(2.0 * twice, plain, rtol=1e-8, atol=1e-12)
    thicker = np.where(TUBE.quads[:, 0] % 2, 0.5, 0.6)
    assert not np.allclose(model(thickness_mm=thicker).solve(load).motion, plain, rtol=1e-3)


def test_a_body_that_can_move_is_refused() -> None:
    loose, load = np.zeros_like(model().fixed), np.random.default_rng(1).normal(size=TUBE_DOFS)
    with refused("shell-not-held"):
        model(fixed=loose)
    loose[0, :3] = loose[3, :3] = True  # a hinge about the line of the two nodes is left
    with pytest.raises(NumericalError) as caught:
        model(fixed=loose).solve(load)
    assert caught.value.code in SINGULAR
    loose[8, 2] = True
    assert model(fixed=loose).solve(load).error < 1e-6


def test_a_second_loose_body_is_found() -> None:
    count = len(TUBE.nodes_mm)
    both = model(
        nodes_mm=np.concatenate([TUBE.nodes_mm, TUBE.nodes_mm + 100.0]),
        directors=np.concatenate([TUBE.normals, TUBE.normals]),
        quads=np.concatenate([TUBE.quads, TUBE.quads + count]),
        fixed=np.concatenate([model().fixed, np.zeros((count, 6), dtype=bool)]),
    )
    with pytest.raises(NumericalError) as caught:
        both.solve(np.random.default_rng(1).normal(size=2 * TUBE_DOFS))
    assert caught.value.code in SINGULAR


def test_a_node_without_elements_is_refused() -> None:
    with refused("stiffness-zero-diagonal"):
        model(
            nodes_mm=np.concatenate([TUBE.nodes_mm, [[0.0, 0, 0]]]),
            directors=np.concatenate([TUBE.normals, [[0.0, 0, 1]]]),
            fixed=np.concatenate([model().fixed, np.zeros((1, 6), dtype=bool)]),
        ).solve(np.zeros(TUBE_DOFS + 6))


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"thickness_mm": 0.0}, "material-value-invalid"),
        ({"thickness_mm": np.nan}, "material-value-invalid"),
        ({"modulus_MPa": -1.0}, "material-value-invalid"),
        ({"poisson": 0.5}, "poisson-out-of-range"),
        ({"poisson": np.nan}, "poisson-out-of-range"),
        (
            {"nodes_mm": np.where(TUBE.nodes_mm > 29.9, np.nan, TUBE.nodes_mm)},
            "material-value-invalid",
        ),
    ],
)
def test_bad_input_is_refused(changes: dict[str, Any], code: str) -> None:
    with refused(code):
        model(**changes)


def test_a_load_that_is_not_finite_is_refused() -> None:
    load = np.zeros(6 * len(TUBE.nodes_mm))
    load[100] = np.inf
    with refused("load-not-finite"):
        model().solve(load)


def test_a_result_dominated_by_rounding_is_refused() -> None:
    # A strip one element wide and 1e-7 of its length thick.
    strip = cases.patch(lambda a, b: np.column_stack([100.0 * a, b, 0 * a]), 40, 1)
    fixed = cases.no_support(strip)
    cases.hold(fixed, strip.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    loads = np.zeros((len(strip.nodes), 6))
    loads[-1, 2] = 1.0
    with refused("stiffness-ill-conditioned"):
        cases.solve_case(strip, fixed, loads, modulus=1.0, poisson=0.3, thickness=1e-7)


def turned(seed: int) -> FloatArray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def cantilever(
    surface: Any,
    sides: tuple[int, int],
    *,
    thickness: float,
    turn: FloatArray,
    size: float = 1.0,
    modulus: float = 1.0,
    poisson: float = 0.3,
) -> tuple[FloatArray, float]:
    """Motion of a shell clamped along a = 0 under 1 nN at a corner, turned back; its error."""
    part = cases.patch(surface, *sides)
    fixed = cases.no_support(part)
    cases.hold(fixed, part.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    loads = np.zeros((len(part.nodes), 6))
    loads[-1, :3] = 1e-9 * (turn @ [0.3, 0.2, 1.0])
    shell = ShellModel(
        size * part.nodes @ turn.T,
        part.quads,
        part.normals @ turn.T,
        thickness_mm=size * thickness,
        modulus_MPa=modulus,
        poisson=poisson,
        fixed=fixed,
    )
    solution = shell.solve(loads.reshape(-1, 1))
    return solution.motion[:, :3, 0] @ turn, solution.error


def panel(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.column_stack([np.sin(1.5 * a), b, np.cos(1.5 * a)])


def plate(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.column_stack([100.0 * a, b, 0.0 * a])


def hyperboloid(a: FloatArray, b: FloatArray) -> FloatArray:
    radius = np.sqrt(1.0 + b * b)
    return np.column_stack([radius * np.cos(1.5 * a), radius * np.sin(1.5 * a), b])


@pytest.mark.parametrize(
    ("surface", "sides", "settings"),
    [
        *((panel, (16, 16), {"thickness": t}) for t in (0.3, 0.1, 1e-2, 1e-3, 1e-4, 1e-5)),
        *((hyperboloid, (12, 12), {"thickness": t}) for t in (0.1, 1e-3)),
        (hyperboloid, (16, 16), {"thickness": 1e-5}),
        (plate, (40, 1), {"thickness": 0.3}),
        (plate, (40, 1), {"thickness": 0.01}),
        (plate, (10, 10), {"thickness": 0.1}),  # elements of aspect 100
        (panel, (12, 12), {"thickness": 0.01, "poisson": 0.0}),
        (panel, (12, 12), {"thickness": 0.01, "poisson": 0.4999}),
        (panel, (12, 12), {"thickness": 0.01, "modulus": 1e-3, "size": 1e4}),
        (panel, (12, 12), {"thickness": 0.01, "modulus": 1e6, "size": 1.0}),
    ],
)
def test_claimed_rounding_error_is_honest(
    surface: Any, sides: tuple[int, int], settings: dict[str, Any]
) -> None:
    # The truth: the same shell turned in space, where every number is rounded differently.
    motion, claimed = cantilever(surface, sides, turn=np.eye(3), **settings)
    true = (
        max(
            np.abs(cantilever(surface, sides, turn=turned(seed), **settings)[0] - motion).max()
            for seed in (1, 2, 3)
        )
        / np.abs(motion).max()
    )
    assert true < 1.5 * claimed
    assert claimed < 30.0 * max(true, 1e-12)  # not so careful that good results are refused


def test_a_solution_out_of_balance_is_refused() -> None:
    # A solver that returns rubbish: the residual, not the condition, must give it away.
    tube = model()
    load = np.ones(tube.fixed.size)
    good = tube.factor.backend
    assert tube.solve(load).error < 1e-9

    class Wrong:
        def solve(self, right: FloatArray) -> FloatArray:
            return np.asarray(good.solve(right) * (1.0 + 0.01 * np.arange(len(right))[:, None]))

    tube.factor.backend = Wrong()
    with refused("stiffness-ill-conditioned"):
        tube.solve(load)


def test_no_load_gives_no_motion_and_no_error() -> None:
    tube = model()
    solution = tube.solve(np.zeros((tube.fixed.size, 2)))
    assert np.all(solution.motion == 0.0)
    assert solution.error == 0.0
