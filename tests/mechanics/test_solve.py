"""The model: balance with its supports, and refusal of what cannot be solved."""

from typing import Any

import numpy as np
import pytest

from phytac_design.mechanics import cases
from phytac_design.mechanics.mesh import chart_mesh
from phytac_design.mechanics.solve import ShellModel, clamped_model
from shapes.cylinder import Cylinder
from shapes.errors import NumericalError

TUBE = chart_mesh(
    Cylinder(diameter_outer_mm=20.0, length_mm=30.0), thickness_mm=0.5, n_along=6, n_around=16
)


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


def test_a_body_that_can_move_is_refused_with_the_motions_blocked() -> None:
    loose = np.zeros_like(model().fixed)
    with pytest.raises(NumericalError, match=r"not held.*block 0 of 6"):
        model(fixed=loose)
    loose[0, :3] = True
    with pytest.raises(NumericalError, match="block 3 of"):
        model(fixed=loose)
    loose[3, :3] = True  # a hinge about the line of the two nodes is left
    with pytest.raises(NumericalError, match="block 5 of"):
        model(fixed=loose)
    loose[8, 2] = True
    assert model(fixed=loose).solve(np.ones(loose.size)).error < 1e-6


def test_a_second_loose_body_is_found() -> None:
    count = len(TUBE.nodes_mm)
    with pytest.raises(NumericalError, match="not held"):
        model(
            nodes_mm=np.concatenate([TUBE.nodes_mm, TUBE.nodes_mm + 100.0]),
            directors=np.concatenate([TUBE.normals, TUBE.normals]),
            quads=np.concatenate([TUBE.quads, TUBE.quads + count]),
            fixed=np.concatenate([model().fixed, np.zeros((count, 6), dtype=bool)]),
        )


def test_a_node_without_elements_is_refused() -> None:
    with pytest.raises(NumericalError, match="belongs to no element"):
        model(
            nodes_mm=np.concatenate([TUBE.nodes_mm, [[0.0, 0, 0]]]),
            directors=np.concatenate([TUBE.normals, [[0.0, 0, 1]]]),
            fixed=np.concatenate([model().fixed, np.zeros((1, 6), dtype=bool)]),
        )


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"thickness_mm": 0.0}, "thickness_mm"),
        ({"thickness_mm": np.nan}, "thickness_mm"),
        ({"modulus_MPa": -1.0}, "modulus_MPa"),
        ({"poisson": 0.5}, "poisson"),
        ({"poisson": np.nan}, "poisson"),
        ({"nodes_mm": np.where(TUBE.nodes_mm > 29.9, np.nan, TUBE.nodes_mm)}, "coordinates"),
        ({"fixed": np.zeros((3, 6), dtype=bool)}, "one flag per DOF"),
    ],
)
def test_bad_input_is_refused(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(NumericalError, match=reason):
        model(**changes)


def test_a_load_that_is_not_finite_is_refused() -> None:
    load = np.zeros(6 * len(TUBE.nodes_mm))
    load[100] = np.inf
    with pytest.raises(NumericalError, match="not finite"):
        model().solve(load)


def test_a_result_spoilt_by_rounding_is_refused() -> None:
    # A strip one element wide and 1e-7 of its length thick.
    strip = cases.patch(lambda a, b: np.column_stack([100.0 * a, b, 0 * a]), 40, 1)
    fixed = cases.no_support(strip)
    cases.hold(fixed, strip.ab[:, 0] == 0.0, (0, 1, 2, 3, 4, 5))
    loads = np.zeros((len(strip.nodes), 6))
    loads[-1, 2] = 1.0
    with pytest.raises(NumericalError, match="rounding"):
        cases.solve_case(strip, fixed, loads, modulus=1.0, poisson=0.3, thickness=1e-7)
