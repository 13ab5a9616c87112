"""Large displacements at the extremes: rigid turns, any frame and numbering, units, thickness."""

import numpy as np
import pytest

from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.large.corotational import Configuration, Corotational
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Equilibrium, Loading
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.verification import large_cases
from phytac_design.mechanics.verification.cases import at, hold, no_support, patch
from phytac_shapes.errors import NumericalError

KIND = {"modulus_MPa": 2200.0, "poisson": 0.38}
SHAPES = {
    "square": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
    "skewed": [[0, 0, 0], [1, 0.2, 0], [1.7, 1.1, 0], [0.4, 0.9, 0]],
    "trapezoid": [[0, 0, 0], [1, 0, 0], [0.6, 1, 0], [0.4, 1, 0]],
    "needle 1 : 100": [[0, 0, 0], [100, 0, 0], [100, 1, 0], [0, 1, 0]],
    "warped": [[0, 0, 0.2], [1, 0, -0.2], [1, 1, 0.2], [0, 1, -0.2]],
    "almost a triangle": [[0, 0, 0], [1, 0, 0], [0.51, 1, 0], [0.49, 1, 0]],
}


@pytest.mark.parametrize("angle", [np.radians(170.0), np.radians(-170.0), np.pi])
@pytest.mark.parametrize("name", SHAPES)
def test_a_rigid_turn_stresses_no_element(name: str, angle: float) -> None:
    nodes = np.array(SHAPES[name], dtype=float)
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    fixed = np.zeros((4, 6), dtype=bool)
    fixed[0] = True
    quads = np.array([[0, 1, 2, 3]])
    model = ShellModel(nodes, quads, normals, thickness_mm=0.1, fixed=fixed, **KIND)
    shell = Corotational(model)
    q = rot.exponential(angle * np.array([0.6, -0.48, 0.64]))
    move = nodes @ rot.deviation(q).T + [3.0, -1.0, 2.0]
    state = Configuration(displacement_mm=move, quaternion=np.tile(q, (4, 1)))
    force = shell.internal(shell.local(state))
    extent = np.ptp(nodes, axis=0).max()
    assert np.abs(force).max() < 1e-12 * extent * abs(model.stiffness).max()
    # Two of its corners moved apart by 1 % of its size do stress it.
    state.displacement_mm[2] += 0.01 * rot.matrix(q) @ (nodes[2] - nodes[0])
    assert np.abs(shell.internal(shell.local(state))).max() > 1e-5 * abs(model.stiffness).max()


def test_frame_and_numbering_do_not_matter_on_a_curved_shell() -> None:
    model, load, middle = large_cases.hinged_roof(8, thickness=12.7)
    rng = np.random.default_rng(3)
    Q = rot.matrix(rot.exponential(np.array([2.0, -1.0, 0.5])))
    new = rng.permutation(len(model.nodes_mm))
    old = np.argsort(new)
    # Supports along the old axes cannot be said in new ones: ends clamped here and there.
    clamped = np.repeat(model.fixed.any(axis=1)[:, None], 6, axis=1)
    clamped[middle] = False
    parts = (model.nodes_mm, model.quads, model.directors)
    section = {"thickness_mm": 12.7, "modulus_MPa": 3102.75, "poisson": 0.3}
    plain = ShellModel(*parts, **section, fixed=clamped)
    turned = ShellModel(
        (model.nodes_mm @ Q.T)[old],
        np.roll(new[model.quads], 2, axis=1),
        (model.directors @ Q.T)[old],
        **section,
        fixed=clamped[old],
    )
    force = 20.0 * load
    there = (force.reshape(-1, 2, 3) @ Q.T)[old]
    a = solve_large(plain, Loading(force=force))[0].state.displacement_mm
    b = solve_large(turned, Loading(force=there.ravel()))[0].state.displacement_mm
    np.testing.assert_allclose(b[new] @ Q, a, atol=1e-6 * np.abs(a).max())
    assert np.abs(a).max() > 3.0


def test_metres_and_kilonewtons_give_the_same_answer() -> None:
    model, load, middle = large_cases.hinged_roof(8, thickness=12.7)
    metres = ShellModel(
        1e-3 * model.nodes_mm,
        model.quads,
        model.directors,
        thickness_mm=12.7e-3,
        modulus_MPa=1e3 * 3102.75,  # kN/m²
        poisson=0.3,
        fixed=model.fixed,
    )
    for share in (1e-9, 0.3, 0.7):
        one = solve_large(model, Loading(force=share * load))[0].state.displacement_mm
        two = solve_large(metres, Loading(force=1e-3 * share * load))[0].state.displacement_mm
        np.testing.assert_allclose(1e3 * two, one, atol=1e-8 * np.abs(one[middle]).max())


def pressed_tube(ratio: float) -> tuple[Equilibrium, float, float]:
    """Quarter of a clamped tube of t/R ``ratio`` pressed at a node; motion there, and linearly."""
    radius = 30.0
    mesh = patch(
        lambda a, b: np.column_stack(
            [radius * np.cos(np.pi * a), radius * np.sin(np.pi * a), 60.0 * b]
        ),
        16,
        12,
    )
    fixed = no_support(mesh)
    hold(fixed, mesh.ab[:, 1] == 0.0, (0, 1, 2, 3, 4, 5))
    hold(fixed, (mesh.ab[:, 0] == 0.0) | (mesh.ab[:, 0] == 1.0), (1, 3, 5))
    hold(fixed, mesh.ab[:, 1] == 1.0, (2, 3, 4))
    load = np.zeros(fixed.shape)
    node = at(mesh, 0.0, 1.0)
    load[node, 0] = -1.0
    parts = (mesh.nodes, mesh.quads, mesh.normals)
    model = ShellModel(*parts, thickness_mm=ratio * radius, fixed=fixed, **KIND)
    linear = float(np.abs(model.solve(load.ravel()).motion[node, 0, 0]))
    wanted = 2.0 * min(ratio, 0.05) * radius
    end = solve_large(model, Loading(force=wanted / linear * load.ravel()))[0]
    return end, float(-end.state.displacement_mm[node, 0]), wanted


@pytest.mark.parametrize("ratio", [0.3, 0.1, 1e-2, 1e-3, 1e-4, 1e-6])
def test_tubes_of_any_thickness_are_pressed_by_twice_their_wall(ratio: float) -> None:
    end, moved, linear = pressed_tube(ratio)
    assert end.residual <= 1e-6
    assert 0.3 * linear < moved < 3.0 * linear
    assert (end.stable, end.jumped) == (True, False)


def test_a_load_that_is_not_a_number_is_refused_everywhere() -> None:
    model, load, _ = large_cases.hinged_roof(4, thickness=12.7)
    for bad in (np.nan, np.inf, -np.inf):
        force = load.copy()
        force[7] = bad
        with pytest.raises(NumericalError, match="finite"):
            solve_large(model, Loading(force=force))
