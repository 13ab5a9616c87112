"""The accelerated iteration: the states of Newton's method, and nothing soft or snapped unseen."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, eigsh

from phytac_design.mechanics.large import quasi_newton
from phytac_design.mechanics.large.corotational import Corotational
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.quasi_newton import (
    LINEAR_ERROR_SAFETY,
    AndersonAcceleration,
    LoadCaseSolution,
    QuasiNewtonSolver,
)
from phytac_design.mechanics.large.reference_configuration import ReferenceShell
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_shapes import Surface
from tests.designs import small
from tests.refusals import refused
from verification import large_shells as large_cases
from verification.pressure_load import pressure_forces

SURFACE = small().surface()
MIDDLE = [30.0, np.pi]
LIMIT = 0.7408
"""Limit load of the thick roof at 8 elements a side (its own arc-length path); at 6 nearly."""


def tube(thickness: float = 0.8, poisson: float = 0.38) -> tuple[Surface, ShellMesh, ShellModel]:
    mesh = chart_mesh(SURFACE, thickness_mm=thickness, n_along=14, n_around=40)
    return SURFACE, mesh, clamped_model(mesh, modulus_MPa=2200.0, poisson=poisson)


@pytest.fixture(scope="module")
def shell() -> tuple[ShellMesh, QuasiNewtonSolver]:
    _, mesh, model = tube()
    return mesh, QuasiNewtonSolver(model)


@pytest.fixture(scope="module")
def roof() -> tuple[QuasiNewtonSolver, np.ndarray]:
    model, load, _ = large_cases.hinged_roof(6, thickness=12.7)
    return QuasiNewtonSolver(model), load


def pressed(
    mesh: ShellMesh, uv: list[list[float]], force: list[float], radius: float
) -> np.ndarray:
    loads = patch_loads(mesh, SURFACE, np.array(uv), radius)
    return np.asarray(loads @ np.array(force)).ravel()


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of translations over the peak of ``b``."""
    return float(
        np.linalg.norm(a[:, :3] - b[:, :3], axis=1).max() / np.linalg.norm(b[:, :3], axis=1).max()
    )


def exact(model: ShellModel, load: np.ndarray) -> np.ndarray:
    return solve_large(model, load)[0].state.motion


def moved(found: LoadCaseSolution) -> np.ndarray:
    assert found.motion is not None
    return found.motion


def test_states_without_a_frame_are_refused() -> None:
    model = tube()[2]
    state = Corotational(model).rest()
    for bad in (np.nan, np.inf):
        state.displacement_mm[7] = bad
        with refused("element-distorted"):
            Corotational(model).internal(state)
    # All corners of an element in one place: no rotation fits.
    state.displacement_mm[7] = 0.0
    nodes = model.quads[3]
    state.displacement_mm[nodes] = -model.nodes_mm[nodes]
    with refused("element-distorted"):
        Corotational(model).internal(state)


PRESSES = {
    "light": ([MIDDLE], [0.05], 5.0),
    "one": ([MIDDLE], [25.0], 5.0),
    "pulled": ([MIDDLE], [-25.0], 5.0),
    "rim": ([[0.4, 1.0]], [25.0], 4.0),
    "seam": ([[30.0, 0.01], [20.0, 2 * np.pi - 0.3]], [12.0, 9.0], 4.0),
    "five": ([[10.0, k] for k in (0.5, 1.7, 2.9, 4.0, 5.2)], [25.0, 3.0, 20.0, 8.0, 15.0], 4.0),
    "strong": ([MIDDLE], [60.0], 6.0),
}


@pytest.mark.parametrize("name", PRESSES)
def test_the_end_is_newtons(shell: tuple[ShellMesh, QuasiNewtonSolver], name: str) -> None:
    mesh, solver = shell
    load = pressed(mesh, *PRESSES[name])
    found = solver.solve(load)
    assert found.status == "ok"
    assert found.large
    assert found.guarded == ""
    truth = exact(solver.model, load)
    gap = apart(moved(found), truth)
    assert gap < quasi_newton.SETTINGS.tolerance
    assert gap < 3.0 * found.error + 1e-9
    turned = moved(found)[:, 3:] - truth[:, 3:]
    assert np.abs(turned).max() < 3e-4 * np.abs(moved(found)[:, 3:]).max()


def test_loads_solved_together_move_as_each_alone(
    shell: tuple[ShellMesh, QuasiNewtonSolver], monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh, solver = shell
    loads = [pressed(mesh, [[20.0 + 5.0 * k, 1.0 + k]], [4.0 + k], 4.0) for k in range(4)]
    alone = [solver.solve(load) for load in loads]
    together = []
    inner = ReferenceShell._solve

    def counted(self: ReferenceShell, forces: np.ndarray) -> np.ndarray:
        together.append(1 if forces.ndim == 1 else forces.shape[1])
        return inner(self, forces)

    monkeypatch.setattr(ReferenceShell, "_solve", counted)
    found = solver.together([partial(solver.solve, load) for load in loads])
    for one, other in zip(found, alone, strict=True):
        assert (one.status, one.iterations) == (other.status, other.iterations)
        assert apart(moved(one), moved(other)) < 1e-10
    assert max(together) == 4
    assert len(together) < 0.5 * sum(together)


@pytest.mark.parametrize(
    ("thickness", "poisson", "force"), [(0.2, 0.38, 0.6), (4.0, 0.38, 400.0), (0.8, 0.499, 20.0)]
)
def test_thin_thick_and_near_incompressible_walls(
    thickness: float, poisson: float, force: float
) -> None:
    _, mesh, model = tube(thickness, poisson)
    load = pressed(mesh, [MIDDLE], [force], 5.0)
    found = QuasiNewtonSolver(model).solve(load)
    assert found.status == "ok"
    assert apart(moved(found), exact(model, load)) < quasi_newton.SETTINGS.tolerance


def test_past_a_limit_point_no_result_is_ok(
    roof: tuple[QuasiNewtonSolver, np.ndarray],
) -> None:
    solver, load = roof
    for share in (-0.5, 0.5, 0.95, 1.05):
        force = share * LIMIT * load
        found = solver.solve(force)
        if share > 1.0:
            assert found.status != "ok", share
        else:
            assert found.status == "ok", share
            assert apart(moved(found), exact(solver.model, force)) < quasi_newton.SETTINGS.tolerance
        assert bool(found.guarded) == (share > 0.9), share


def squeeze(mesh: ShellMesh, model: ShellModel) -> tuple[np.ndarray, float]:
    """Dead pressure all around, and the share of it at which the tube buckles by linear theory."""
    load = -0.2 * pressure_forces(model.nodes_mm, model.quads)
    shell, factor = Corotational(model), model.factor
    free = np.flatnonzero(~model.fixed.ravel())
    first = model.solve(load).motion.ravel()
    tangent = shell.tangent(shell.local(shell.rest().moved(1e-4 * first)))
    stress = (tangent - model.stiffness)[free][:, free] / 1e-4
    size = (len(free), len(free))
    inverse = LinearOperator(
        size, dtype=float, matvec=lambda b: factor.scale * factor.backend.solve(factor.scale * b)
    )
    K = model.stiffness[free][:, free]
    least = eigsh(
        0.5 * (stress + stress.T), 1, K, Minv=inverse, which="SA", return_eigenvectors=False
    )
    return load, float(-1.0 / least[0])


def test_buckling_that_linear_theory_misses(
    shell: tuple[ShellMesh, QuasiNewtonSolver],
) -> None:
    """Even pressure: the motion stays linear to the very load at which the tube buckles."""
    mesh, solver = shell
    load, critical = squeeze(mesh, solver.model)
    seen = {}
    for share in (0.2, 0.75, 0.9, 1.3):
        force = share * critical * load
        assert LINEAR_ERROR_SAFETY * solver.expand(force).error < 0.1
        seen[share] = solver.solve(force, tolerance=0.1)
    assert not seen[0.2].large
    assert seen[0.2].lowest_eigenvalue == pytest.approx(0.8, abs=0.05)
    assert seen[0.75].large
    assert seen[0.75].lowest_eigenvalue == pytest.approx(0.25, abs=0.05)
    assert seen[0.9].large
    assert seen[0.9].lowest_eigenvalue == pytest.approx(0.1, abs=0.05)
    assert seen[1.3].guarded
    assert seen[1.3].status == "flagged"
    assert "unstable" in seen[1.3].reason


def test_a_factor_of_the_tangent_tells_how_soft_a_shell_is(
    shell: tuple[ShellMesh, QuasiNewtonSolver], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where products with the tangent do not."""
    mesh, solver = shell
    load, critical = squeeze(mesh, solver.model)
    decided = solver.solve(0.75 * critical * load)
    motion = moved(decided).ravel()
    assert solver._shell.is_firmer(motion, decided.lowest_eigenvalue - 0.05)
    assert not solver._shell.is_firmer(motion, decided.lowest_eigenvalue + 0.05)
    settings = replace(quasi_newton.SETTINGS, max_products=1)
    monkeypatch.setattr(quasi_newton, "SETTINGS", settings)
    found = solver.solve(0.75 * critical * load)
    assert (found.status, found.guarded) == ("ok", "")
    assert found.lowest_eigenvalue == settings.factored_eigenvalue
    assert found.error <= settings.tolerance
    assert apart(moved(found), moved(decided)) < settings.tolerance
    soft = solver.solve(0.99 * critical * load)
    assert "soft" in soft.guarded


def test_linear_theory_where_it_suffices(
    shell: tuple[ShellMesh, QuasiNewtonSolver],
) -> None:
    mesh, solver = shell
    for force in (0.5, 12.0):
        load = pressed(mesh, [MIDDLE], [force], 5.0)
        check = solver.expand(load)
        for tolerance in (0.003, 0.03, 0.3):
            found = solver.solve(load, tolerance=tolerance)
            assert found.large == (check.error * LINEAR_ERROR_SAFETY > tolerance)
            if not found.large:
                np.testing.assert_array_equal(moved(found), check.first.reshape(-1, 6))
                assert apart(moved(found), exact(solver.model, load)) < tolerance


def test_same_bits_whatever_came_before(shell: tuple[ShellMesh, QuasiNewtonSolver]) -> None:
    mesh, solver = shell
    loads = [pressed(mesh, *PRESSES[name]) for name in ("one", "five", "rim")]
    forward = [moved(solver.solve(load)) for load in loads]
    other = QuasiNewtonSolver(tube()[2])
    backward = [moved(other.solve(load)) for load in loads[::-1]][::-1]
    for a, b in zip(forward, backward, strict=True):
        np.testing.assert_array_equal(a, b)


def test_no_load_and_no_number(shell: tuple[ShellMesh, QuasiNewtonSolver]) -> None:
    _, solver = shell
    load = np.zeros(solver.model.fixed.size)
    found = solver.solve(load)
    assert found.status == "ok"
    assert not found.large
    assert not moved(found).any()
    held = load.copy()
    held[solver.model.fixed.ravel()] = 5.0
    assert not moved(solver.solve(held)).any()
    for bad, why in ((np.nan, "not finite"), (1e300, "absurd")):
        load[600] = bad
        found = solver.solve(load)
        assert found.status == "failed"
        assert found.motion is None
        assert found.reason
        assert why in found.reason
    assert solver.solve(np.zeros(5)).status == "failed"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_iterations", 2),
        ("max_rotation_rad", 1e-3),
        ("soft_eigenvalue", 2.0),
        ("PATH_DEVIATION_MAX", 1e-6),
    ],
)
def test_an_unsafe_result_falls_back_to_path_following(
    shell: tuple[ShellMesh, QuasiNewtonSolver],
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    value: float,
) -> None:
    mesh, solver = shell
    load = pressed(mesh, *PRESSES["one"])
    if name.isupper():
        monkeypatch.setattr(quasi_newton, name, value)
    else:
        changed = replace(quasi_newton.SETTINGS, **{name: value})
        monkeypatch.setattr(quasi_newton, "SETTINGS", changed)
    found = solver.solve(load)
    assert found.guarded
    assert found.status == "ok"
    np.testing.assert_array_equal(moved(found), exact(solver.model, load))


def test_acceleration_solves_a_linear_system() -> None:
    """As many steps as distinct eigenvalues: it is a Krylov method."""
    rng = np.random.default_rng(2)
    Q = np.linalg.qr(rng.normal(size=(60, 60)))[0]
    A = (Q * np.repeat([0.3, 1.0, 2.5, 9.0], 15)) @ Q.T
    b, x = rng.normal(size=60), np.zeros(60)
    steps = AndersonAcceleration()
    for _ in range(6):
        r = b - A @ x
        x = steps.next(x, r, r)
    assert np.linalg.norm(b - A @ x) < 1e-9 * np.linalg.norm(b)
