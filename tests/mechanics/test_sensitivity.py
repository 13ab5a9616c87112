"""Derivatives of stiffness, motion and compliance: against complex steps and whole solutions."""

from typing import Any

import numpy as np
import pytest

from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.shell_element import element_stiffness
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_design.mechanics.shell.stiffness_sensitivity import (
    StiffnessRates,
    element_poisson_rate,
    motion_rate,
    stiffness_rates,
)
from phytac_shapes import Cylinder
from phytac_shapes.arrays import FloatArray

BASE: dict[str, Any] = {"modulus_MPa": 2200.0, "poisson": 0.38, "thickness_mm": 0.8}
SURFACE = Cylinder(diameter_outer_mm=60.0, length_mm=60.0)
SOLVED_TOL = 1e-8  # whole solutions carry 1e-12, the difference formula divides it by its step
KEYS = (("modulus", "modulus_MPa"), ("poisson", "poisson"), ("thickness", "thickness_mm"))


def mesh() -> ShellMesh:
    return chart_mesh(SURFACE, thickness_mm=0.8, n_along=8, n_around=16)


def model(**change: Any) -> ShellModel:
    return clamped_model(mesh(), **(BASE | change))


def rates() -> StiffnessRates:
    return stiffness_rates(model())


def difference(values: list[FloatArray], step: float) -> FloatArray:
    """Fourth order, from values at -2, -1, 1, 2 steps."""
    return (values[0] - 8.0 * values[1] + 8.0 * values[2] - values[3]) / (12.0 * step)


@pytest.mark.parametrize("poisson", [0.02, 0.38, 0.48])
def test_element_rate_is_that_of_differences(poisson: float) -> None:
    part, grid = model(poisson=poisson), mesh()
    nodes = part.nodes_mm + np.random.default_rng(1).uniform(-0.5, 0.5, part.nodes_mm.shape)
    part.nodes_mm = nodes  # warped and sheared quads
    rate = element_poisson_rate(part)
    ends = [
        element_stiffness(nodes, grid.quads, grid.normals, poisson=poisson + k * 1e-3)
        for k in (-2, -1, 1, 2)
    ]
    for name in ("membrane", "bending", "shear"):
        true = difference([getattr(end, name) for end in ends], 1e-3)
        assert np.abs(getattr(rate, name) - true).max() < 1e-8 * np.abs(true).max()


@pytest.mark.parametrize(("name", "key"), KEYS)
def test_stiffness_rates_are_those_of_the_stiffness(name: str, key: str) -> None:
    h = 1e-3 * BASE[key]
    ends = [model(**{key: BASE[key] + k * h}).stiffness.data for k in (-2, -1, 1, 2)]
    rate = getattr(rates(), name).data
    np.testing.assert_allclose(rate, difference(ends, h), atol=1e-9 * np.abs(rate).max())


@pytest.mark.parametrize(("name", "key"), KEYS)
def test_motions_follow(name: str, key: str) -> None:
    loads = patch_loads(mesh(), SURFACE, np.array([[30.0, 0.1], [4.0, 2.0]]), 5.0)
    found = motion_rate(model(), getattr(rates(), name), model().solve(loads).motion)
    h = 1e-3 * BASE[key]
    ends = [model(**{key: BASE[key] + k * h}).solve(loads).motion for k in (-2, -1, 1, 2)]
    true = difference(ends, h)
    tol = SOLVED_TOL * np.abs(true).max() + 1e-12 * np.abs(ends[0]).max() / h
    np.testing.assert_allclose(found, true, atol=tol)


def test_a_stiffer_material_moves_less_in_proportion() -> None:
    part = model()
    loads = patch_loads(mesh(), SURFACE, np.array([[30.0, 0.1]]), 5.0)
    motion = part.solve(loads).motion
    rate = motion_rate(part, rates().modulus, motion)
    np.testing.assert_allclose(rate, -motion / 2200.0, atol=1e-11 * np.abs(rate).max())


def test_walls_that_vary_are_differentiated_as_a_whole() -> None:
    wall = np.linspace(0.6, 1.0, len(mesh().quads))
    part = model(thickness_mm=wall)
    rate = stiffness_rates(part).thickness
    ends = [model(thickness_mm=wall + k * 1e-3).stiffness.data for k in (-2, -1, 1, 2)]
    np.testing.assert_allclose(rate.data, difference(ends, 1e-3), atol=1e-9 * rate.data.max())
