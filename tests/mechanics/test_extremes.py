"""The shell where parameters are extreme, against closed solutions; or refused with the reason."""

import numpy as np
import pytest

from phytac_design.mechanics.shell.element import element_stiffness
from phytac_design.mechanics.shell.solve import rigid_modes
from phytac_design.mechanics.verification import cases
from phytac_design.mechanics.verification.case_parts import Case
from phytac_design.mechanics.verification.element_shapes import SHAPES, element_shape
from phytac_design.mechanics.verification.ring_case import ring_case, ring_deflection
from phytac_design.mechanics.verification.single_row import arch_case
from phytac_shapes.errors import NumericalError

NEAR = 0.005
"""What 48 elements over eight decay lengths leave of discretisation error."""


@pytest.mark.parametrize("ratio", [0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4, 1e-5])
def test_thickness_over_radius(ratio: float) -> None:
    # At 1e-5 the elements are 160 times wider than long.
    assert ring_case(48, thickness_over_radius=ratio).ratio() == pytest.approx(1.0, abs=NEAR)


def test_closed_solution_has_the_thin_limit() -> None:
    # Kirchhoff-Love: w = Q / (2 β³ D) with β⁴ = 3 (1 − ν²) / (R t)².
    t, v = 1e-6, 0.3
    beta, D = (3.0 * (1.0 - v * v)) ** 0.25 / np.sqrt(t), t**3 / 12.0 / (1.0 - v * v)
    exact = ring_deflection(radius=1.0, thickness=t, modulus=1.0, poisson=v)
    assert exact * 2.0 * beta**3 * D == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize("poisson", [0.0, 0.2, 0.45, 0.49, 0.4999])
def test_poisson(poisson: float) -> None:
    assert ring_case(48, poisson=poisson).ratio() == pytest.approx(1.0, abs=NEAR)


@pytest.mark.parametrize(
    ("modulus", "radius", "load"),
    [(1e-3, 30.0, 1e-9), (1e6, 30.0, 1.0), (2200.0, 0.5, 1e-9), (2200.0, 5000.0, 1e-9)],
)
def test_modulus_size_and_force_are_pure_scales(modulus: float, radius: float, load: float) -> None:
    one = ring_case(16).ratio()
    other = ring_case(16, modulus=modulus, radius=radius, load=load).ratio()
    assert other == pytest.approx(one, rel=1e-6)


@pytest.mark.parametrize(("ratio", "around"), [(0.1, 38), (0.01, 120)])
def test_jitter_on_a_curved_shell(ratio: float, around: int) -> None:
    case = ring_case(48, around=around, thickness_over_radius=ratio, jitter=0.25)
    assert case.ratio() == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("thickness", [0.1, 0.01])
def test_jitter_in_pure_bending(thickness: float) -> None:
    case = cases.hyperboloid_case(32, thickness=thickness, jitter=0.25)
    assert case.ratio() == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("thickness", "width"), [(0.1, 1.0), (1e-2, 1.0), (1e-3, 1.0), (1e-3, 65.0), (0.1, 0.05)]
)
def test_single_row_arch(thickness: float, width: float) -> None:
    # Elements of aspect 1/13 … 100 and an arch that would lock if its membrane could not bend.
    assert arch_case(24, thickness=thickness, width=width).ratio() == pytest.approx(1.0, abs=0.005)


@pytest.mark.parametrize("drilling", [1e-4, 1e-2])
def test_drilling_factor_is_without_effect(drilling: float) -> None:
    def value(factor: float, case: str) -> float:
        return float(getattr(cases, case)(16, drilling=factor))

    for case in ("scordelis_lo", "hemisphere_with_hole", "raasch_hook", "full_hemisphere"):
        assert value(drilling, case) == pytest.approx(value(1.0, case), rel=1e-3), case


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("thickness", [0.3, 1e-3])
def test_six_zero_energy_modes(name: str, thickness: float) -> None:
    nodes, directors = element_shape(name)
    element = element_stiffness(nodes, np.array([[0, 1, 2, 3]]), directors, poisson=0.3)
    K = element.combine(modulus_MPa=1.0, thickness_mm=thickness)[0]
    modes = rigid_modes(nodes).reshape(24, 6)
    assert np.abs(K @ modes).max() < 1e-10 * np.abs(K).max()
    scale = 1.0 / np.sqrt(np.diag(K))
    values = np.linalg.eigvalsh(scale[:, None] * K * scale)
    assert np.abs(values[:6]).max() < 1e-13
    assert values[6] > 1e-11


def turned(case: Case, seed: int) -> tuple[Case, np.ndarray]:
    """Case with all supports complete, turned in space and its nodes renumbered."""
    rng = np.random.default_rng(seed)
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    q *= np.linalg.det(q)
    order = rng.permutation(len(case.mesh.nodes))
    place = np.argsort(order)
    both = np.kron(np.eye(2), q.T)
    mesh = cases.Patch(
        ab=case.mesh.ab[order],
        nodes=(case.mesh.nodes @ q.T)[order],
        normals=(case.mesh.normals @ q.T)[order],
        quads=np.roll(place[case.mesh.quads], 1, axis=1),
    )
    return Case(
        mesh=mesh,
        fixed=case.fixed[order],
        loads=(case.loads @ both)[order],
        read=(case.read @ both)[order],
        reference=case.reference,
        modulus=case.modulus,
        poisson=case.poisson,
        thickness=case.thickness,
    ), q


@pytest.mark.parametrize("case", [cases.twisted_beam_case(12), cases.raasch_hook_case(20)])
def test_turning_and_renumbering_are_without_effect(case: Case) -> None:
    assert turned(case, 4)[0].ratio() == pytest.approx(case.ratio(), rel=1e-8)


def test_a_force_of_a_nanonewton_on_a_sensor_is_a_billionth_of_a_newton() -> None:
    case = cases.raasch_hook_case(8)
    model = case.model()
    one, tiny = (model.solve(f * case.loads.reshape(-1, 1)).motion for f in (1.0, 1e-9))
    assert np.abs(tiny - 1e-9 * one).max() < 1e-9 * 1e-10 * np.abs(one).max()


def test_what_rounding_would_spoil_is_refused() -> None:
    # Free at the far end too, the shell has motions that cost next to no energy.
    case = ring_case(48, thickness_over_radius=1e-6)
    case.fixed[case.mesh.ab[:, 1] == 1.0, :] = False
    case.fixed[case.mesh.ab[:, 1] == 1.0, 2] = True
    with pytest.raises(NumericalError, match="rounding"):
        case.ratio()
