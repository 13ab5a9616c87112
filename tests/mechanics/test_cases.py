"""Published shell problems; their sources are in ``verification.shells``."""

import numpy as np
import pytest

from verification import shells as cases
from verification.shells import edge_lines, line_weights, plate_case


@pytest.mark.parametrize(("n", "tolerance"), [(16, 0.03), (32, 0.015)])
@pytest.mark.parametrize("case", ["scordelis_lo", "hemisphere_with_hole"])
def test_curved_shells(case: str, n: int, tolerance: float) -> None:
    assert getattr(cases, f"{case}_case")(n).ratio() == pytest.approx(1.0, abs=tolerance)


@pytest.mark.parametrize(("n", "tolerance"), [(16, 0.07), (32, 0.015)])
def test_pinched_cylinder(n: int, tolerance: float) -> None:
    assert cases.pinched_cylinder_case(n).ratio() == pytest.approx(1.0, abs=tolerance)


@pytest.mark.parametrize("in_plane", [True, False])
@pytest.mark.parametrize("thickness", [0.32, 0.0032])
def test_twisted_beam(thickness: float, in_plane: bool) -> None:
    value = cases.twisted_beam_case(12, thickness=thickness, in_plane=in_plane).ratio()
    assert value == pytest.approx(1.0, abs=0.02)


def test_full_hemisphere_needs_no_triangle_at_its_pole() -> None:
    case = cases.full_hemisphere_case(16)
    assert case.mesh.quads.shape == (3 * 8 * 8, 4)
    assert len(case.mesh.nodes) == 3 * 64 + 3 * 8 + 1
    assert case.ratio() == pytest.approx(1.0, abs=0.01)


def test_raasch_hook() -> None:
    assert cases.raasch_hook_case(32).ratio() == pytest.approx(1.0, abs=0.015)


@pytest.mark.parametrize("thickness", cases.HYPERBOLOID)
def test_free_hyperboloid_bends_without_locking_however_thin(thickness: float) -> None:
    assert cases.hyperboloid_case(32, thickness=thickness).ratio() == pytest.approx(1.0, abs=0.015)


def test_second_order_convergence_of_the_roof() -> None:
    fine = cases.scordelis_lo_case(48).ratio()
    errors = [abs(cases.scordelis_lo_case(n).ratio() - fine) for n in (6, 12)]
    assert np.log2(errors[0] / errors[1]) > 1.7


def slope(errors: list[float]) -> float:
    return -float(np.polyfit(np.log([8, 16, 32]), np.log(errors), 1)[0])


@pytest.mark.parametrize("thickness", [0.1, 0.001])
def test_second_order_convergence_to_the_exact_plate_on_jittered_meshes(thickness: float) -> None:
    cases_ = [plate_case(n, thickness=thickness, jitter=0.25) for n in (8, 16, 32)]
    assert slope([abs(case.ratio() - 1.0) for case in cases_]) == pytest.approx(2.0, abs=0.25)


def test_second_order_convergence_of_energy_in_the_hyperboloid() -> None:
    def energy(n: int) -> float:
        case = cases.hyperboloid_case(n, thickness=1.0)
        return float(np.sum(case.loads * case.motion()))

    fine, half = energy(64), energy(32)
    limit = fine + (fine - half) / 3.0
    assert slope([limit - energy(n) for n in (8, 16)] + [limit - half]) == pytest.approx(
        2.0, abs=0.1
    )


def test_lines_towards_a_free_edge() -> None:
    lines = edge_lines(8, 0.01, ends=(False, True))
    assert np.all(np.diff(lines) > 0.0)
    assert lines[[0, -1]].tolist() == [0.0, 1.0]
    assert np.isin(np.linspace(0.0, 1.0, 9), lines).all()
    assert np.diff(lines)[-1] == pytest.approx(0.01 / 6.0)
    assert np.diff(lines)[0] == pytest.approx(0.125)
    assert line_weights(lines).sum() == pytest.approx(1.0)
    np.testing.assert_allclose(line_weights(np.array([0.0, 0.5, 1.0])), [0.25, 0.5, 0.25])


@pytest.mark.parametrize("case", ["scordelis_lo", "hemisphere_with_hole"])
def test_a_jittered_mesh_stays_close(case: str) -> None:
    assert getattr(cases, f"{case}_case")(24, jitter=0.25).ratio() == pytest.approx(1.0, abs=0.03)


def test_value_of_the_design_page() -> None:
    # Design study: middle face R 30, L 120, t 0.8, E 2200, ν 0.38, clamped, 1 N at one node of the
    # middle: 0.0326 mm with *quadratic* shells 64 × 46. Ours are linear: twice as many, and a
    # quarter of the shell.
    mesh = cases.patch(
        lambda a, b: np.column_stack([30 * np.cos(np.pi * a), 30 * np.sin(np.pi * a), 60.0 * b]),
        64,
        46,
    )
    fixed = cases.no_support(mesh)
    cases.hold(fixed, (mesh.ab[:, 0] == 0.0) | (mesh.ab[:, 0] == 1.0), cases.SYMMETRY[1])
    cases.hold(fixed, mesh.ab[:, 1] == 0.0, (0, 1, 2, 3, 4, 5))
    cases.hold(fixed, mesh.ab[:, 1] == 1.0, cases.SYMMETRY[2])
    loads = np.zeros((len(mesh.nodes), 6))
    node = cases.at(mesh, 0.0, 1.0)
    loads[node, 0] = -0.25
    motion = cases.solve_case(mesh, fixed, loads, modulus=2200.0, poisson=0.38, thickness=0.8)
    assert -motion[node, 0] == pytest.approx(0.0326, rel=0.01)
