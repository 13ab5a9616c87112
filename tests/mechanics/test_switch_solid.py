"""The solid of revolution: element against energy, closed forms, a published cap, CalculiX."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from phytac_design.mechanics.switch.bowl import Bowl, bowl_model
from phytac_design.mechanics.switch.buckling import CircumferentialModes
from phytac_design.mechanics.switch.curve import press_bowl, snap_of
from phytac_design.mechanics.switch.hyperelastic import Material, Ogden, Yeoh, bulk_of, neo_hookean
from phytac_design.mechanics.switch.material_fit import uniaxial_stress
from phytac_design.mechanics.switch.model import AxiModel
from tests.refusals import refused
from verification import switch_cases
from verification.bowl_calculix import ccx_curve

SOFT = neo_hookean(modulus_MPa=10.0, poisson=0.49)
BOWL = Bowl(diameter_mm=4.6, depth_mm=1.65, thickness_mm=0.25)
LAWS = {
    "linear": switch_cases.StVenantKirchhoff(modulus_MPa=2.0, poisson=0.3),
    "neo-hookean": neo_hookean(modulus_MPa=2.0, poisson=0.499),
    "yeoh": Yeoh(coefficients_MPa=(0.4, -0.02, 0.004), bulk_MPa=40.0),
    "ogden": Ogden(
        shear_terms_MPa=(0.63, 0.0012, -0.01), exponents=(1.3, 5.0, -2.0), bulk_MPa=30.0
    ),
}
laws = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def ring(material: Material) -> AxiModel:
    mesh = switch_cases.rectangle(1.0, 2.0, 0.7, (2, 2))
    held = np.zeros((len(mesh.nodes_mm), 2), dtype=bool)
    return AxiModel(mesh=mesh, material=material, held=held, tied=switch_cases.NONE)


def strained(model: AxiModel) -> np.ndarray:
    """A smooth large strain with a little noise: every element differs."""
    r, z = model.mesh.nodes_mm.T
    moved = np.stack([0.2 * r + 0.15 * z * r, 0.1 * z - 0.2 * r * z], axis=1)
    rng = np.random.default_rng(3)
    return np.asarray((moved + 0.01 * rng.standard_normal(moved.shape)).ravel())


@laws
def test_force_is_the_slope_of_energy_and_tangent_that_of_force(law: Material) -> None:
    model = ring(law)
    q = strained(model)
    rng = np.random.default_rng(0)
    way = rng.standard_normal(q.shape)
    h = 1e-5
    states = [model.state(q + s * h * way) for s in (-1, 0, 1)]
    back, here, ahead = states
    assert back
    assert here
    assert ahead
    work = (ahead.response.energy_Nmm - back.response.energy_Nmm) / (2 * h)
    assert here.force @ way == pytest.approx(work, rel=1e-6)
    change = (ahead.force - back.force) / (2 * h)
    assert np.allclose(here.tangent @ way, change, rtol=1e-5, atol=1e-6 * np.abs(change).max())
    assert abs(here.tangent - here.tangent.T).max() < 1e-10 * abs(here.tangent).max()


@laws
def test_waves_feel_no_rigid_motion(law: Material) -> None:
    model = ring(law)
    state = model.state(strained(model))
    rest = model.state(np.zeros(model.count))
    assert state
    assert rest
    waves = CircumferentialModes(model=model)
    number, sign = waves.equations(1)
    r, z = model.mesh.nodes_mm.T
    one, none = np.ones_like(r), np.zeros_like(r)
    sideways = np.stack([one, none, -one], axis=1)
    turn = np.stack([z, -r, -z], axis=1)

    class At:
        def __init__(self, state: object) -> None:
            self.state = state

    for point, motion in ((At(state), sideways), (At(rest), turn)):
        K = waves.tangent(point, 1)  # type: ignore[arg-type]
        x = np.zeros(K.shape[0])
        x[number.ravel()] = (sign * motion).ravel()
        assert np.abs(K @ x).max() < 1e-10 * abs(K).max()
        assert np.abs(K @ (x + np.linspace(0, 1, len(x)))).max() > 1e-3 * abs(K).max()


@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.4999])
def test_thick_sphere_does_not_lock(poisson: float) -> None:
    coarse, fine = (switch_cases.thick_sphere(poisson, c).error for c in ((4, 3), (8, 6)))
    assert fine < 1e-4
    assert fine < 0.15 * coarse  # faster than third order


def test_inflated_sphere_at_large_strain() -> None:
    assert switch_cases.inflated_sphere(2.0).error < 5e-4


@pytest.mark.parametrize("law", [LAWS["yeoh"], LAWS["ogden"]], ids=["yeoh", "ogden"])
@pytest.mark.parametrize("stretch", [0.6, 2.5])
def test_pulled_bar(law: Yeoh | Ogden, stretch: float) -> None:
    stiff = type(law)(**vars(law) | {"bulk_MPa": bulk_of(law.shear_MPa, 0.4999)})
    exact = float(uniaxial_stress(stiff, np.array([stretch]))[0])
    assert switch_cases.pulled_bar(stiff, stretch) == pytest.approx(exact, rel=2e-3)


def test_neo_hookean_bar_by_hand() -> None:
    found = switch_cases.pulled_bar(neo_hookean(modulus_MPa=3.0, poisson=0.4999), 2.0)
    assert found == pytest.approx(2.0 - 0.25, rel=1e-3)


def test_clamped_plate() -> None:
    assert switch_cases.clamped_plate().error < 3e-3


@pytest.mark.parametrize("mode", [2, 3])
def test_squeezed_ring_buckles_with_its_waves(mode: int) -> None:
    assert switch_cases.squeezed_ring(mode).error < 3e-3


def test_cap_snaps_as_published() -> None:
    found = switch_cases.clamped_cap(cells=(50, 1), steps=20)
    (_, peak), (_, valley) = found.extremes()
    assert peak == pytest.approx(74.5, rel=0.02)
    assert valley == pytest.approx(37.4, rel=0.02)
    counts = [p.negatives for p in found.points]
    assert set(counts) == {0, 1}
    assert counts[0] == counts[-1] == 0
    by_arc = switch_cases.clamped_cap(cells=(50, 1), steps=30, arc=True)
    assert np.interp(0.03, by_arc.apex, by_arc.load) == pytest.approx(
        np.interp(0.03, found.apex, found.load), rel=0.01
    )


def test_cap_does_not_snap_under_a_point() -> None:
    found = switch_cases.clamped_cap(ring=False, end=0.065, steps=24)
    assert (np.diff(found.load) > 0.0).all()
    assert np.interp([0.0102, 0.0632], found.apex, found.load) == pytest.approx(
        [9.79, 25.7], rel=0.03
    )


def test_thin_cap_snaps_back() -> None:
    found = switch_cases.clamped_cap(scale=0.3, arc=True, steps=80)
    back = -np.diff(found.apex)
    assert back[back > 0.0].sum() > 5e-4  # the apex itself goes back on the way
    assert found.apex[-1] >= 0.09
    for point in found.points[1:]:
        left = point.state.force - point.load_factor * found.pattern
        assert np.linalg.norm(left) < 1e-8 * point.state.gross_N
    with refused("switch-path-ended"):
        switch_cases.clamped_cap(scale=0.3, steps=80)


def test_limit_load_converges_with_mesh_and_steps() -> None:
    def limit(refine: int, steps: int) -> float:
        snap = snap_of(press_bowl(BOWL, SOFT, refine=refine, steps=steps, end_mm=0.6))
        assert snap
        return snap.limit_N

    base = limit(2, 5)
    assert limit(2, 10) == pytest.approx(base, rel=1e-4)
    assert limit(3, 5) == pytest.approx(base, rel=2e-3)
    assert limit(1, 5) == pytest.approx(base, rel=1.5e-2)


def test_force_scales_with_modulus_and_size() -> None:
    base = snap_of(press_bowl(BOWL, SOFT, steps=12))
    other = snap_of(press_bowl(BOWL.scaled(2.0), SOFT.scaled(3.0), hole_diameter_mm=3.2, steps=12))
    assert base
    assert other
    assert other.limit_N == pytest.approx(12.0 * base.limit_N, rel=1e-6)
    assert other.stroke_mm == pytest.approx(2.0 * base.stroke_mm, rel=1e-6)


def test_calculix_finds_the_same_limit_load(tmp_path: Path) -> None:
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not on PATH; apt install calculix-ccx")
    body = bowl_model(BOWL, SOFT)
    _, force = ccx_curve(tmp_path, body, stroke_mm=0.64, steps=16)
    snap = snap_of(press_bowl(BOWL, SOFT, steps=12))
    assert snap
    assert force.max() == pytest.approx(snap.limit_N, rel=0.03)
