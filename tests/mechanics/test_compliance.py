"""Compliance of the prototype: reciprocal, symmetric around, the same by every path."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_design.mechanics.meshing.mesh import chart_mesh, marker_mesh
from phytac_design.mechanics.shell.compliance import (
    MarkerCompliance,
    column_turn,
    marker_compliance,
    point_motion,
    probe_loads,
    probe_motion,
)
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import sensor_model
from phytac_design.mechanics.shell.solve import clamped_model
from tests.mechanics.conftest import Prototype
from tests.refusals import refused


def compliance(part: Prototype, radius: float, **options: Any) -> MarkerCompliance:
    return marker_compliance(
        part.model, part.mesh, part.surface, part.markers, load_radius_mm=radius, **options
    )


def test_compliance_is_reciprocal_and_positive(cylinder60: Prototype) -> None:
    motion = compliance(cylinder60, 0.0).motion
    C = -np.einsum("nxm,nx->nm", motion[:, :3], cylinder60.markers.normal)
    np.testing.assert_allclose(C, C.T, atol=1e-9 * C.max())
    assert np.linalg.eigvalsh((C + C.T) / 2).min() > 0.0


def coarse(part: Prototype, uneven: float = 0.0) -> Prototype:
    """Return the prototype on a coarse mesh, one element's wall thinner by ``uneven`` mm."""
    mesh = marker_mesh(part.surface, part.markers, thickness_mm=0.8, refine=2)
    thickness = np.full(len(mesh.quads), 0.8)
    thickness[100] -= uneven
    model = clamped_model(
        mesh,
        modulus_MPa=2200.0,
        poisson=0.38,
        thickness_mm=thickness if uneven else 0.8,
    )
    return replace(part, mesh=mesh, model=model)


def test_solving_one_column_gives_the_same_as_solving_all(cylinder60: Prototype) -> None:
    part = coarse(cylinder60)
    some, full = (compliance(part, 6.0, use_symmetry=flag) for flag in (True, False))
    assert (some.solves, full.solves) == (23, 368)
    np.testing.assert_allclose(some.motion, full.motion, atol=1e-9 * np.abs(full.motion).max())


def test_symmetry_is_checked_not_assumed(cylinder60: Prototype) -> None:
    part = coarse(cylinder60, uneven=0.1)
    assert compliance(part, 6.0).solves == 368
    modulus = np.full(len(part.mesh.quads), 2200.0)
    modulus[7] = 2201.0
    model = clamped_model(part.mesh, modulus_MPa=modulus, poisson=0.38)
    assert column_turn(model, part.mesh, 16) is None


@pytest.mark.parametrize("refine", [2, 3])  # with 3, elements lie half-way between tubes
def test_receptors_repeat_around_too(cylinder60: Prototype, refine: int) -> None:
    surface, markers = cylinder60.surface, cylinder60.markers
    mesh = marker_mesh(surface, markers, thickness_mm=0.8, refine=refine)
    model = sensor_model(cylinder60.design, markers, mesh, receptors=True)
    assert np.ptp(model.thickness_mm) > 0.1
    assert column_turn(model, mesh, 16) is not None
    if refine == 2:
        part = replace(cylinder60, mesh=mesh, model=model)
        some, full = (compliance(part, 6.0, use_symmetry=flag) for flag in (True, False))
        assert (some.solves, full.solves) == (23, 368)
        np.testing.assert_allclose(some.motion, full.motion, atol=1e-9 * np.abs(full.motion).max())


def test_another_mesh_probed_at_the_markers_agrees(cylinder60: Prototype) -> None:
    markers = cylinder60.markers
    mesh = chart_mesh(cylinder60.surface, thickness_mm=0.8, n_along=60, n_around=80)
    model = clamped_model(mesh, modulus_MPa=2200.0, poisson=0.38)
    chosen = np.array([100, 184, 230])
    solution = model.solve(patch_loads(mesh, cylinder60.surface, markers.uv[chosen], 6.0))
    probed = probe_motion(mesh, solution, markers.uv)
    own = compliance(cylinder60, 6.0).motion[:, :, chosen]
    for part in (slice(0, 3), slice(3, 6)):
        gap = np.abs(probed[:, part] - own[:, part]).max(axis=(0, 1))
        assert np.all(gap < 0.05 * np.abs(own[:, part]).max(axis=(0, 1)))


def test_probing_in_batches_gives_the_same(cylinder60: Prototype) -> None:
    part = coarse(cylinder60)
    uv = part.markers.uv[:7]
    loads = patch_loads(part.mesh, part.surface, uv, 5.0)
    plain = probe_motion(part.mesh, part.model.solve(loads), uv)
    for given in (loads, loads.toarray()):
        found = probe_loads(part.model, part.mesh, given, uv, batch=3)
        np.testing.assert_allclose(found, plain, atol=1e-12 * np.abs(plain).max())


def test_points_off_the_shell_move_with_its_rotation(cylinder60: Prototype) -> None:
    # A small rigid turn about the axis through the origin: every point moves by ω × x.
    omega = np.array([0.01, -0.02, 0.03])
    markers = cylinder60.markers
    motion = np.concatenate(
        [np.cross(omega, markers.mid_mm), np.tile(omega, (markers.count, 1))], axis=1
    )[:, :, None]
    tip = point_motion(motion, markers.tip_mm - markers.mid_mm)
    np.testing.assert_allclose(tip[:, :, 0], np.cross(omega, markers.tip_mm), atol=1e-12)


def test_a_mesh_of_other_markers_is_refused(cylinder60: Prototype) -> None:
    mesh = chart_mesh(cylinder60.surface, thickness_mm=0.8, n_along=5, n_around=8)
    with refused("mesh-marker-count"):
        marker_compliance(
            cylinder60.model, mesh, cylinder60.surface, cylinder60.markers, load_radius_mm=1.0
        )
