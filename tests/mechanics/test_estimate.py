"""The estimate of linear theory's error against the truth, and the choice made from it."""

from functools import lru_cache

import numpy as np
import pytest

from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.mechanics.shell.solve import ShellModel
from tests.mechanics.conftest import Prototype
from verification import large_shells as large_cases


@lru_cache
def shell(name: str) -> tuple[ShellModel, np.ndarray]:
    if name == "roof":
        return large_cases.hinged_roof(8, thickness=12.7)[:2]
    return large_cases.cantilever(16, moment=name == "moment")[:2]


def true_error(model: ShellModel, load: np.ndarray) -> float:
    linear = model.solve(load).motion[:, :3, 0]
    large = solve_large(model, load)[0].state.displacement_mm
    off = np.linalg.norm(large - linear, axis=1).max()
    return float(off / np.linalg.norm(linear, axis=1).max())


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("force", 0.01),
        ("force", 0.1),
        ("moment", 0.01),
        ("roof", 0.01),
        ("roof", 0.3),
        ("roof", -1),
    ],
)
def test_estimate_is_within_a_factor_of_two_of_the_truth(name: str, factor: float) -> None:
    model, load = shell(name)
    truth = true_error(model, factor * load)
    assert 0.5 * truth < QuasiNewtonSolver(model).expand(factor * load).error < 2.0 * truth
    assert 1e-4 < truth < 0.6


def test_no_load_has_no_error() -> None:
    model, load = shell("roof")
    assert QuasiNewtonSolver(model).expand(0.0 * load).error == 0.0


def test_a_finger_on_the_prototype_needs_large_displacements(cylinder60: Prototype) -> None:
    from phytac_design.mechanics.shell.loads import patch_loads

    part = cylinder60
    load = patch_loads(part.mesh, part.surface, part.markers.uv[[184]], 6.0)
    estimate = [QuasiNewtonSolver(part.model).expand(force * load).error for force in (1.0, 10.0)]
    assert estimate[0] < 0.01
    assert 0.05 < estimate[1] < 0.2
