"""A fingertip on the prototype, large displacements, against quadratic shells of CalculiX."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_shapes import Surface
from tests.mechanics.conftest import Prototype
from tests.refusals import refused
from verification.contact_mesh import contact_mesh
from verification.quadratic_shell import _serendipity, quadratic_mesh, quadratic_patch, run_ccx

CENTRE = np.array([60.0, np.pi])
RADIUS = 6.0


def graded(surface: Surface, size_mm: float = 2.0) -> ShellMesh:
    return contact_mesh(
        surface,
        thickness_mm=0.8,
        centre_uv=CENTRE,
        core_mm=12.0,
        size_mm=size_mm,
        growth=0.15,
    )


def test_contact_mesh_is_fine_at_the_contact_and_closed(cylinder60: Prototype) -> None:
    mesh = graded(cylinder60.surface)
    nodes = mesh.nodes_mm[mesh.quads]
    side = np.linalg.norm(nodes - np.roll(nodes, -1, axis=1), axis=2)
    near = np.linalg.norm(nodes.mean(axis=1) - cylinder60.surface.point(CENTRE[None])[0], axis=1)
    assert side[near < 8.0].max() < 2.1
    assert side.max() > 5.0
    area = 0.5 * np.linalg.norm(
        np.cross(nodes[:, 2] - nodes[:, 0], nodes[:, 3] - nodes[:, 1]), axis=1
    )
    assert area.sum() == pytest.approx(2.0 * np.pi * 29.6 * 120.0, rel=0.01)
    outward = np.cross(nodes[:, 2] - nodes[:, 0], nodes[:, 3] - nodes[:, 1])
    assert np.all(np.sum(outward * mesh.normals[mesh.quads].mean(axis=1), axis=1) > 0.0)
    assert np.abs(mesh.uv - CENTRE).sum(axis=1).min() < 1e-12
    # Every edge belongs to two elements but for the rims.
    edges = np.sort(np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], -1), axis=2)
    counts = np.unique(edges.reshape(-1, 2), axis=0, return_counts=True)[1]
    assert np.sum(counts == 1) == 2 * len(mesh.sets["TOP"])
    assert counts.max() == 2


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"size_mm": 0.0}, "contact-mesh-size"),
        ({"growth": -0.1}, "contact-mesh-size"),
        ({"centre_uv": np.array([130.0, 0.0])}, "contact-mesh-position"),
    ],
)
def test_bad_contact_meshes_are_refused(cylinder60: Prototype, change: dict, code: str) -> None:
    values = {"thickness_mm": 0.8, "centre_uv": CENTRE, "core_mm": 12.0, "size_mm": 2.0} | change
    with refused(code):
        contact_mesh(cylinder60.surface, **values)


def test_quadratic_shape_functions_are_one_at_their_node_and_sum_to_one() -> None:
    r = np.array([-1.0, 1, 1, -1, 0, 1, 0, -1])
    s = np.array([-1.0, -1, 1, 1, -1, 0, 1, 0])
    np.testing.assert_allclose(_serendipity(r, s), np.eye(8), atol=1e-15)
    np.testing.assert_allclose(_serendipity(0.3 * r, 0.7 * s).sum(axis=1), 1.0)


def test_quadratic_patch_has_its_resultant_and_place(cylinder60: Prototype) -> None:
    surface = cylinder60.surface
    mesh = quadratic_mesh(chart_mesh(surface, thickness_mm=0.8, n_along=24, n_around=28), surface)
    radius = np.hypot(mesh.nodes_mm[:, 0], mesh.nodes_mm[:, 1])
    np.testing.assert_allclose(radius, 29.6, rtol=1e-12)
    assert len(mesh.held) == 2 * 2 * 28
    force = quadratic_patch(mesh, surface, CENTRE, RADIUS)
    np.testing.assert_allclose(force.sum(axis=0), -surface.normal(CENTRE[None])[0], atol=1e-9)
    linear = patch_loads(mesh.linear, surface, CENTRE[None], RADIUS).toarray().reshape(-1, 6)
    moment = np.einsum("nx,ny->xy", mesh.nodes_mm - [0, 0, 60.0], force)
    other = np.einsum("nx,ny->xy", mesh.linear.nodes_mm - [0, 0, 60.0], linear[:, :3])
    np.testing.assert_allclose(moment, other, atol=0.02 * np.abs(other).max())
    with refused("patch-without-element"):
        quadratic_patch(mesh, surface, np.array([300.0, 0.0]), RADIUS)


@pytest.mark.long
def test_25_n_on_a_fingertip_against_ccx_nlgeom(cylinder60: Prototype, tmp_path: Path) -> None:
    # Meshes of a test: both are 1–2 % from converged; the benchmark holds the 1 % of the issue.
    # Linear theory is 27 % below.
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not on PATH; apt install calculix-ccx")
    surface, material = cylinder60.surface, cylinder60.design.material
    kind = {"modulus_MPa": material.modulus_MPa, "poisson": material.poisson}
    coarse = quadratic_mesh(chart_mesh(surface, thickness_mm=0.8, n_along=20, n_around=24), surface)
    theirs = run_ccx(
        tmp_path, coarse, 25.0 * quadratic_patch(coarse, surface, CENTRE, RADIUS), **kind
    )
    mesh = graded(surface)
    model = clamped_model(mesh, **kind)
    load = 25.0 * patch_loads(mesh, surface, CENTRE[None], RADIUS)
    end = solve_large(model, load)[0]
    assert (end.stable, end.jumped) == (True, False)
    ours = end.state.displacement_mm
    peak = np.linalg.norm(theirs, axis=1).max()
    assert np.linalg.norm(ours, axis=1).max() == pytest.approx(peak, rel=0.03)
    assert np.linalg.norm(model.solve(load).motion[:, :3, 0], axis=1).max() < 0.8 * peak
