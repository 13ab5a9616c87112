"""The estimate of the mesh's error: honest where the truth is known, and what it refuses."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from phytac_design.mechanics.shell.discretisation import (
    SETTINGS,
    DiscretisationError,
    ProbedShell,
    estimate_error,
)
from phytac_shapes.arrays import FloatArray
from tests.mechanics.conftest import Prototype
from tests.refusals import refused
from verification import shells as cases
from verification.free_edge import FreeEdgeShell, free_edge_force, free_edges
from verification.mesh_error import error_cases, judge
from verification.shells import ShellProblem, Sides, edge_lines, probed


def factor(estimate: DiscretisationError, truth: FloatArray) -> float:
    true = np.linalg.norm(truth - estimate.motion, axis=1).max()
    return float(estimate.error.max() / true)


def hyperboloid(n: Sides) -> ShellProblem:
    return cases.hyperboloid_case(n, thickness=0.1)


@pytest.mark.parametrize(
    ("build", "width", "ends"),
    [
        # Lines for the truth are refined where the shell is free: it needs no edge term.
        (lambda n: cases.scordelis_lo_case(n[::-1] if isinstance(n, tuple) else n), 0.014, (0, 1)),
        (cases.hemisphere_with_hole_case, 0.0032, (1, 1)),
        (hyperboloid, 0.08, (0, 1)),
    ],
    ids=["roof", "hemisphere", "hyperboloid"],
)
def test_estimate_is_within_a_factor_of_two_of_a_resolved_mesh(
    build: Callable[[Sides], ShellProblem], width: float, ends: tuple[int, int]
) -> None:
    points = build(4).mesh.nodes

    def resolved(n: int) -> ProbedShell:
        return probed(build((n, edge_lines(n, width, ends=(bool(ends[0]), bool(ends[1]))))), points)

    truth = estimate_error(resolved, (48, 24)).extrapolated
    for n in (8, 16, 32):
        found = estimate_error(lambda m: probed(build(m), points), (n, n // 2, n // 4))
        assert found.elements == (n * n, n * n // 4, n * n // 16)
        assert found.asymptotic.all() == (n > 8)  # two elements a side are no shell
        assert 0.5 < factor(found, truth) < (2.0 if n > 8 else 6.0)


@pytest.mark.long
def test_two_meshes_that_agree_by_chance_are_no_estimate() -> None:
    """A layer that neither resolves: they differ by 1 %, and are 3 % off."""
    case = next(c for c in error_cases() if c.name.endswith("not halved, t/L 0.001"))
    (at_16,) = judge(replace(case, elements=(16,)))
    assert at_16.true > 0.03
    assert not at_16.asymptotic
    assert at_16.rate > SETTINGS.rate_max
    # By the rate of theory, and without a safety factor, the two finer meshes would claim less
    # than an eighth of the error.
    two = estimate_error(case.make, (16, 8))
    assert two.relative[0] / SETTINGS.safety_outside < at_16.true / 8.0
    assert not two.asymptotic.any()


def series(*errors: float) -> Callable[[int], ProbedShell]:
    """Shells whose motion at three probes is 1 and these errors, on 64, 16, 4 elements."""

    class Given(ProbedShell):
        def read(self, motion: FloatArray) -> FloatArray:
            found = np.zeros((3, 3, motion.shape[2]))
            found[:, 2, 0] = 1.0 + errors[(64, 16, 4).index(len(self.model.quads))]
            return found

    def make(n: int) -> ProbedShell:
        case = cases.scordelis_lo_case(n)
        return Given(
            model=case.model(),
            loads=case.loads.reshape(-1, 1),
            nodes=np.zeros((3, 1), dtype=np.int64),
            weights=np.ones((3, 1)),
        )

    return make


@pytest.mark.parametrize("rate", [0.5, 1.5, 2.0, 3.0, 4.0])
def test_the_rate_of_a_known_series_is_measured(rate: float) -> None:
    found = estimate_error(series(*(0.001 * 2.0 ** (rate * k) for k in range(3))), (8, 4, 2))
    assert found.rate[0] == pytest.approx(rate, abs=1e-6)
    assert found.asymptotic[0] == (rate in (1.5, 2.0, 3.0))
    # By the rate of theory, whatever rate is measured.
    step = 0.001 * (2.0**rate - 1.0)
    np.testing.assert_allclose(found.extrapolated[:, 2], 1.001 - step / 3.0, atol=1e-9)
    if rate in (1.5, 2.0):
        np.testing.assert_allclose(found.error, 1.25 * 0.001, rtol=1e-6)
    assert found.error.max() >= 0.001


def test_errors_that_change_sign_from_mesh_to_mesh_are_not_asymptotic() -> None:
    found = estimate_error(series(0.001, -0.004, 0.016), (8, 4, 2))
    assert not found.asymptotic.any()
    assert found.rate[0] == pytest.approx(2.0, abs=1e-6)


def test_two_meshes_alone_would_miss_the_free_edges_of_the_hemisphere() -> None:
    points = cases.hemisphere_with_hole_case(16).mesh.nodes
    found = estimate_error(
        lambda m: probed(cases.hemisphere_with_hole_case(m), points), (32, 16, 8)
    )
    fine = probed(
        cases.hemisphere_with_hole_case((48, edge_lines(48, 0.0032, ends=(True, True)))), points
    )
    truth = fine.read(fine.model.solve(fine.loads).motion)
    true = np.linalg.norm(truth - found.motion, axis=1).max()
    assert 0.5 < found.error.max() / true < 2.0
    coarse = probed(cases.hemisphere_with_hole_case(16), points)
    step = found.motion - coarse.read(coarse.model.solve(coarse.loads).motion)
    assert np.linalg.norm(step, axis=1).max() / 3.0 < 0.5 * true


def test_torsion_of_a_strip_gains_what_the_exact_torsion_constant_says() -> None:
    # Twist of a strip by two corner forces; Timoshenko and Goodier: J = b t³/3 (1 − 0.63 t/b).
    b, t, length = 10.0, 0.4, 200.0
    strip = cases.patch(lambda a, c: np.column_stack([length * a, b * c, 0 * a]), 40, 4)
    fixed = cases.no_support(strip)
    root = strip.ab[:, 0] == 0.0
    cases.hold(fixed, root, (0, 2, 3))
    fixed[0, 1] = True
    fixed[cases.at(strip, 0.0, 0.5), 4] = True
    loads = np.zeros((len(strip.nodes), 6))
    loads[cases.at(strip, 1.0, 1.0), 2], loads[cases.at(strip, 1.0, 0.0), 2] = 1.0, -1.0
    case = ShellProblem(
        mesh=strip,
        fixed=fixed,
        loads=loads,
        read=cases.weights(strip, (cases.at(strip, 0.5, 1.0), 2, 1.0)),
        reference=1.0,
        modulus=1000.0,
        poisson=0.3,
        thickness=t,
    )
    model = case.model()
    motion = model.solve(loads.reshape(-1, 1)).motion
    force = free_edge_force(model, motion)
    assert force is not None
    more = model.solve(force.reshape(-1, 1)).motion
    plain, missing = (float(np.sum(case.read * m[:, :, 0])) for m in (motion, more))
    rigidity = 1000.0 / 2.6 * b * t**3 / 3.0
    exact = b / rigidity / (1.0 - 0.63 * t / b) * (length / 2.0) * (b / 2.0)
    captured = 1.0 / np.sqrt(1.0 + (b / 4.0 / t) ** 2 * 10.0 / 12.0)
    assert captured < 0.2
    assert plain / exact == pytest.approx(1.0 - 0.63 * t / b * (1.0 - captured), rel=0.001)
    assert (plain + missing) / exact == pytest.approx(1.0, rel=0.002)


def test_clamped_rims_and_planes_of_symmetry_are_not_free(cylinder60: Prototype) -> None:
    assert not len(free_edges(cylinder60.mesh.quads, cylinder60.model.fixed)[0])
    motion = np.ones((len(cylinder60.mesh.nodes_mm), 6, 1))
    assert free_edge_force(cylinder60.model, motion) is None
    quarter = cases.hemisphere_with_hole_case(4)
    assert len(free_edges(quarter.mesh.quads, quarter.fixed)[0]) == 8


def sensor(part: Prototype, *, refine: tuple[int, ...] = (4, 2)) -> DiscretisationError:
    material = part.design.material
    make = cases.sensor_shell(
        part.surface,
        part.markers,
        thickness_mm=part.design.wall.thickness_mm,
        modulus_MPa=material.modulus_MPa,
        poisson=material.poisson,
        centres_uv=np.array([[60.0, np.pi], [17.3, 4.4]]),
        radii_mm=6.0,
    )
    return estimate_error(make, refine)


TRUTH = np.array([0.0485, 0.0735])
"""Errors of a sensor's mesh against 16 and 8 elements to a pitch, extrapolated."""


def test_sensor_under_fingertips(cylinder60: Prototype) -> None:
    found = sensor(cylinder60)
    assert found.motion.shape == (2 * cylinder60.markers.count + 2, 3, 2)
    # Two meshes give a bound.
    assert np.all(found.relative > TRUTH)
    assert np.all(found.relative < 3.0 * TRUTH)
    assert found.asymptotic.tolist() == [False, False]


@pytest.mark.long
def test_finer_meshes_of_a_sensor_are_asymptotic(cylinder60: Prototype) -> None:
    found = sensor(cylinder60)
    finer = sensor(cylinder60, refine=(8, 4, 2))
    assert finer.asymptotic.tolist() == [True, True]
    off = np.linalg.norm(finer.extrapolated - found.motion, axis=1).max(axis=0)
    size = np.linalg.norm(finer.extrapolated, axis=1).max(axis=0)
    np.testing.assert_allclose(off / size, TRUTH, rtol=0.25)


def test_tips_move_with_the_rotation_of_the_face(cylinder60: Prototype) -> None:
    material = cylinder60.design.material
    part = cases.sensor_shell(
        cylinder60.surface,
        cylinder60.markers,
        thickness_mm=cylinder60.design.wall.thickness_mm,
        modulus_MPa=material.modulus_MPa,
        poisson=material.poisson,
        centres_uv=cylinder60.markers.uv[:1],
        radii_mm=6.0,
    )(2)
    spin = np.zeros((len(part.model.nodes_mm), 6, 1))
    spin[:, 5] = 0.01
    arm = cylinder60.markers.tip_mm - cylinder60.markers.mid_mm
    moved = part.read(spin)[:, :, 0]
    np.testing.assert_allclose(moved[: len(arm), 0], -0.01 * arm[:, 1], atol=1e-12)
    assert np.all(moved[len(arm) :] == 0.0)


def roof(n: int) -> ProbedShell:
    return probed(cases.scordelis_lo_case(n), cases.scordelis_lo_case(3).mesh.nodes)


def test_a_mesh_too_coarse_is_said_to_be_so() -> None:
    case = cases.pinched_cylinder_case(4)
    top = case.mesh.nodes[[0]]
    found = estimate_error(lambda n: probed(cases.pinched_cylinder_case(n), top), (8, 4, 2))
    assert not found.asymptotic.any()
    off = abs(found.motion[0, 2, 0] / -1.82488e-5 - 1.0)
    assert found.rate[0] < SETTINGS.rate_min
    # Cautious: no estimate.
    assert 1.0 < found.error[0, 0] / 1.82488e-5 / off < 9.0


def test_no_load_has_no_error() -> None:
    def idle(n: int) -> ProbedShell:
        part = roof(n)
        return FreeEdgeShell(
            model=part.model, loads=0.0 * part.loads, nodes=part.nodes, weights=part.weights
        )

    found = estimate_error(idle, (12, 6))
    assert np.all(found.error == 0.0)
    assert np.all(found.relative == 0.0)


@pytest.mark.parametrize(
    ("refine", "code"),
    [
        ((8,), "mesh-error-one-mesh"),
        ((16, 8, 7), "mesh-error-size-ratio"),
        ((6, 12), "mesh-error-size-ratio"),
        ((8, 7), "mesh-error-size-ratio"),
    ],
)
def test_unsuitable_meshes_are_refused(refine: tuple[int, ...], code: str) -> None:
    with refused(code):
        estimate_error(roof, refine)


def test_meshes_with_different_probes_are_refused() -> None:
    with refused("mesh-error-results-differ"):
        estimate_error(lambda n: probed(cases.scordelis_lo_case(n), np.zeros((n, 3))), (12, 6))
