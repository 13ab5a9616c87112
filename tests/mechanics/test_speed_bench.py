"""The parts that the speed benchmarks stand on."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks import mechanics_cost, mechanics_speed
from benchmarks.ccx_linear import run_linear
from phytac_design.mechanics.meshing.mesh import chart_mesh
from phytac_shapes import Cylinder
from verification.quadratic_shell import quadratic_mesh, quadratic_patch

needs_ccx = pytest.mark.skipif(shutil.which("ccx") is None, reason="ccx is not on PATH")


@needs_ccx
def test_ccx_steps_are_independent_linear_loads(tmp_path: Path) -> None:
    surface = Cylinder(diameter_outer_mm=60.0, length_mm=120.0)
    mesh = quadratic_mesh(chart_mesh(surface, thickness_mm=0.8, n_along=6, n_around=10), surface)
    ends = [np.array([40.0, 1.0]), np.array([70.0, 3.0])]
    one, other = (quadratic_patch(mesh, surface, at, 12.0) for at in ends)
    loads = np.stack([one, other, 2.0 * one - other])
    run = run_linear(tmp_path, mesh, loads, modulus_MPa=2200.0, poisson=0.38)
    first, second, both = run.displacement_mm
    # Printed with seven digits.
    assert np.abs(2.0 * first - second - both).max() < 1e-5 * np.abs(both).max()
    assert np.abs(first - second).max() > 0.1 * np.abs(first).max()
    assert run.equations > 3 * len(mesh.nodes_mm)
    dry = run_linear(tmp_path, mesh, loads, modulus_MPa=2200.0, poisson=0.38, analysis=False)
    assert dry.displacement_mm.size == 0
    assert 0.0 < dry.seconds < run.seconds


def test_the_cheapest_mesh_is_not_one_that_crosses_the_limit_by_chance() -> None:
    peaks = {(1, 1): 1.001, (2, 2): 1.2, (3, 3): 1.005, (4, 4): 1.002, (5, 5): 1.0}

    def solve(size: tuple[int, int]) -> mechanics_speed.MeshSolution:
        return mechanics_speed.MeshSolution(peak=peaks[size], seconds=1.0, unknowns=size[0])

    found = mechanics_speed._cheapest(solve, list(peaks), 1.0, 0.01)
    assert found is not None
    assert found[1] == (3, 3)
    assert mechanics_speed._cheapest(solve, [(1, 1), (2, 2)], 1.0, 0.01) is None


def test_extrapolation_and_exponent() -> None:
    # 3 + 2h² at h = 1 and 2, and 5·n^1.5.
    assert mechanics_speed._limit([5.0, 11.0]) == pytest.approx(3.0)
    n = [1e4, 1e5, 1e6]
    assert mechanics_cost.exponent(n, [5.0 * x**1.5 for x in n]) == pytest.approx(1.5)


def test_the_hundred_patches_lie_on_the_shell_and_apart() -> None:
    uv = mechanics_speed.sites(100)
    u, v = uv.T
    assert u.min() > 6.0
    assert u.max() < 114.0
    assert 0.0 <= v.min() <= v.max() < 2.0 * np.pi
    assert len(np.unique(np.round(v, 6))) == 100


def test_cost_is_measured() -> None:
    small, large = (mechanics_cost.measure(a, b) for a, b in ((4, 8), (8, 16)))
    assert small["dof"] == 6 * 3 * 8
    assert large["dof"] == 6 * 7 * 16
    assert set(small["seconds"]) == set(mechanics_cost.PARTS)
    assert small["peak_GiB"] > 0.01
