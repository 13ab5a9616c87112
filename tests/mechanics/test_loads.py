"""Patch loads: total, place, size, seam, rims; and shares of footprints."""

import numpy as np
import pytest

from phytac_design.mechanics.indenter import FLAT, Indentations
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh
from phytac_design.mechanics.shell.footprints import footprint_shares
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.pressure_sharing import on_shell_share
from phytac_shapes.arrays import FloatArray
from phytac_shapes.cylinder import Cylinder
from phytac_shapes.discs import disc_overlap_share
from tests.mechanics.conftest import Prototype
from tests.mechanics.touches import make_touches
from tests.refusals import refused

SURFACE = Cylinder(diameter_outer_mm=60.0, length_mm=120.0)
MESH = chart_mesh(SURFACE, thickness_mm=0.8, n_along=46, n_around=64)


def forces(uv: tuple[float, float], radius: float, mesh: ShellMesh = MESH) -> FloatArray:
    return patch_loads(mesh, SURFACE, np.array([uv]), radius).toarray().reshape(-1, 6)


@pytest.mark.parametrize("radius", [0.0, 0.05, 0.5, 2.0, 6.0, 15.0])
@pytest.mark.parametrize("uv", [(60.0, 1.0), (33.3, 0.01), (33.3, 6.28), (1.5, 2.0), (120.0, 3.0)])
def test_one_newton_inward_at_the_centre(uv: tuple[float, float], radius: float) -> None:
    load = forces(uv, radius)
    inward = -SURFACE.normal(np.array([uv]))[0]
    assert load[:, :3].sum(axis=0) @ inward == pytest.approx(1.0, abs=1e-12)
    side = load[:, :3].sum(axis=0) - inward
    assert np.abs(side).max() < 0.01
    assert np.all(load[:, 3:] == 0.0)
    if 15.0 < uv[0] < 105.0:
        weight = -np.sum(load[:, :3] * MESH.normals, axis=1)
        angle = np.angle(np.exp(1j * (MESH.uv[:, 1] - uv[1])))
        assert weight @ angle / weight.sum() * 30.0 == pytest.approx(0.0, abs=0.02)
        assert weight @ MESH.uv[:, 0] / weight.sum() == pytest.approx(uv[0], abs=0.02)


def test_second_moment_of_a_disc() -> None:
    # Σ F z² = F r²/4 for a uniform disc; bilinear weights add h²/6 at most on this fine mesh.
    fine = chart_mesh(SURFACE, thickness_mm=0.8, n_along=240, n_around=320)
    load = forces((60.0, 1.0), 6.0, fine)
    weight = -np.sum(load[:, :3] * fine.normals, axis=1)
    z = fine.nodes_mm[:, 2] - 60.0
    assert weight @ z**2 / weight.sum() == pytest.approx(6.0**2 / 4, rel=0.015)


def test_the_load_moves_smoothly() -> None:
    steps = np.linspace(30.0, 36.0, 121)
    loads = patch_loads(MESH, SURFACE, np.column_stack([steps, 0 * steps]), 4.0).toarray()
    jump = np.abs(np.diff(loads, axis=1)).max()
    assert jump < 0.05 * np.abs(loads).max()


def test_a_rim_takes_part_of_the_patch_away() -> None:
    load = forces((0.0, 1.0), 6.0)
    weight = -np.sum(load[:, :3] * MESH.normals, axis=1)
    # Centroid of a half disc: 4r/3π from its straight side.
    assert weight @ MESH.uv[:, 0] / weight.sum() == pytest.approx(8.0 / np.pi, rel=0.01)
    assert on_shell_share(SURFACE, np.array([[0.0, 1.0]]), 6.0) == pytest.approx(0.5)


def test_bad_patches_are_refused() -> None:
    with refused("position-outside-mesh"):
        forces((-1.0, 0.0), 5.0)
    with refused("load-radius-invalid"):
        forces((10.0, 0.0), -1.0)
    with refused("load-radius-invalid"):
        forces((10.0, 0.0), np.nan)


def test_lens_of_two_discs() -> None:
    assert disc_overlap_share(9.0, 4.0, 5.0) == pytest.approx(0.0, abs=1e-9)
    assert disc_overlap_share(0.0, 4.0, 5.0) == 1.0
    assert disc_overlap_share(1.0, 5.0, 2.0) == pytest.approx(4 / 25, rel=1e-12)
    # Two equal unit discs, centres one apart: 2π/3 − √3/2.
    lens = 2 * np.pi / 3 - np.sqrt(3) / 2
    assert disc_overlap_share(1.0, 1.0, 1.0) == pytest.approx(lens / np.pi, rel=1e-12)
    rng = np.random.default_rng(0)
    points = rng.uniform(-3, 3, (400_000, 2))
    for d, a, b in ((2.5, 3.0, 1.2), (1.0, 2.0, 2.3)):
        inside = np.hypot(*points.T) < a
        both = inside & (np.hypot(points[:, 0] - d, points[:, 1]) < b)
        share = disc_overlap_share(d, a, b)
        assert share == pytest.approx(both.sum() / inside.sum(), abs=0.004)


def flat(uv: FloatArray, radius_mm: float) -> Indentations:
    return make_touches(uv, FLAT, radius_mm=radius_mm)


def test_footprint_shares_tile_and_wrap(cylinder60: Prototype) -> None:
    marker, surface = cylinder60.markers.uv, cylinder60.surface
    inner = np.flatnonzero((marker[:, 0] > 10) & (marker[:, 0] < 110))
    share = footprint_shares(surface, flat(marker[inner], 6.0), marker, 2.3)
    own = share[np.arange(len(inner)), inner]
    np.testing.assert_allclose(own, (2.3 / 6.0) ** 2, rtol=1e-12)
    assert np.ptp(share.sum(axis=1)) < 1e-9  # the same at the seam as everywhere
    turned = marker[inner] + [0.0, 2 * np.pi]
    np.testing.assert_allclose(
        footprint_shares(surface, flat(turned, 6.0), marker, 2.3), share, atol=1e-9
    )
    # A small contact between columns trips nothing.
    between = marker[inner] + [0.0, cylinder60.markers.lattice.pitch_v / 2]
    assert footprint_shares(surface, flat(between, 1.0), marker, 1.0).max() == 0.0


def test_force_of_a_contact_over_the_rim_is_carried_by_the_shell() -> None:
    at_rim = np.array([[0.0, 1.0]])
    share = footprint_shares(SURFACE, flat(at_rim, 6.0), np.array([[3.0, 1.0]]), 1.0)
    assert share == pytest.approx(2.0 / 36.0, rel=1e-9)
