"""Ways along surfaces and nets laid flat, against closed forms."""

import numpy as np
import pytest

from phytac_design.geometry.development import laid_flat, relative_neighbours, ways
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from tests.fabrication.cases import family_design
from tests.refusals import refused


def surface(family: str) -> Surface:
    return family_design(family).surface()


def test_ways_around_a_cylinder_are_helices() -> None:
    tube = surface("cylinder")  # ø40
    uv = np.array([[10.0, 0.2], [10.0, 0.7], [16.0, 0.7], [10.0, 6.2]])
    pairs: IntArray = np.array([[0, 1], [0, 2], [1, 2], [0, 3]])
    for offset in (0.0, 0.3):
        found = ways(tube, uv, pairs, offset)
        radius = 20.0 + offset
        turn = np.array([0.5, 0.5, 0.0, 6.2 - 0.2 - 2.0 * np.pi])
        closed = np.hypot(radius * turn, [0.0, 6.0, 6.0, 0.0])
        assert found.length_mm == pytest.approx(closed, rel=5e-5)
        # Normal curvature of a helix: cos² of its slope over the radius.
        assert found.curvature_per_mm == pytest.approx(
            (radius * turn / closed) ** 2 / radius, rel=1.5e-2, abs=1e-9
        )


def test_ways_on_a_dome_are_great_circles() -> None:
    dome = surface("hemisphere")  # ø50
    rng = np.random.default_rng(0)
    low, high = dome.domain[0]
    u = low + (0.5 + 0.4 * rng.random(20)) * (high - low)
    uv = np.column_stack([u, rng.uniform(0.0, 0.6, 20)])
    pairs: IntArray = np.column_stack([np.arange(10), np.arange(10, 20)])
    n = dome.normal(uv)
    angle = np.arccos(np.einsum("nx,nx->n", n[pairs[:, 0]], n[pairs[:, 1]]))
    found = ways(dome, uv, pairs, 1.0)
    assert found.length_mm == pytest.approx(26.0 * angle, rel=1e-6)
    assert found.curvature_per_mm == pytest.approx(np.full(10, 1.0 / 26.0), rel=1e-6)


def test_rows_of_a_cone_become_arcs_of_its_sector() -> None:
    cone = surface("cone")  # ø50 to ø36 over 50
    v = np.linspace(0.0, 2.0, 9)
    uv = np.column_stack([np.full(9, cone.domain[0].mean()), v])
    net: IntArray = np.column_stack([np.arange(8), np.arange(1, 9)])
    flat, way = laid_flat(cone, uv, net)
    sine = 7.0 / np.hypot(7.0, 50.0)
    apex = 21.5 / sine  # distance of the row from the apex
    turned = 2.0 * sine  # angle of the sector between both ends
    assert np.hypot(*(flat[-1] - flat[0])) == pytest.approx(2.0 * apex * np.sin(0.5 * turned), 1e-5)
    bulge = np.hypot(*(flat[4] - 0.5 * (flat[0] + flat[-1])))
    assert bulge == pytest.approx(apex * (1.0 - np.cos(0.5 * turned)), rel=2e-3)
    size = np.hypot(*(flat[net[:, 0]] - flat[net[:, 1]]).T)
    assert size == pytest.approx(way.length_mm, rel=1e-7)


def test_a_net_on_a_dome_does_not_develop_but_a_path_does() -> None:
    dome = surface("hemisphere")
    low, high = dome.domain[0]
    u, v = np.meshgrid(low + np.array([0.45, 0.6, 0.75]) * (high - low), np.linspace(0, 1.0, 4))
    uv = np.column_stack([u.ravel(), v.ravel()])

    def stretch(uv: FloatArray, net: IntArray) -> float:
        flat, way = laid_flat(dome, uv, net)
        size = np.hypot(*(flat[net[:, 0]] - flat[net[:, 1]]).T)
        return float(np.abs(way.length_mm / size - 1.0).max())

    assert 2e-3 < stretch(uv, relative_neighbours(dome.point(uv))) < 0.1
    path: IntArray = np.column_stack([np.arange(2), np.arange(1, 3)])
    assert stretch(uv[:3], path) < 1e-9


def test_flat_places_are_seen_from_outside() -> None:
    """Around to the right and along upwards, or both turned: never mirrored."""
    tube = surface("cylinder")
    uv = np.array([[10.0, 0.0], [10.0, 0.3], [16.0, 0.0]])
    flat, _ = laid_flat(tube, uv, np.array([[0, 1], [0, 2]]))
    points, normal = tube.point(uv), tube.normal(uv[:1])[0]
    first, second = points[1] - points[0], points[2] - points[0]
    hand = float(np.sign(normal @ np.cross(first, second)))
    a, b = flat[1] - flat[0], flat[2] - flat[0]
    assert np.sign(a[0] * b[1] - a[1] * b[0]) == hand


def test_relative_neighbours_of_a_lattice_are_its_sides() -> None:
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0))
    points = np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()])
    pairs = relative_neighbours(points)
    assert len(pairs) == 3 * 3 + 4 * 2
    size = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    assert size == pytest.approx(1.0)
    assert len(relative_neighbours(points[:1])) == 0


def test_a_net_in_two_pieces_is_refused() -> None:
    uv = np.column_stack([np.full(4, 10.0), np.linspace(0.0, 1.0, 4)])
    with refused("net-not-connected"):
        laid_flat(surface("cylinder"), uv, np.array([[0, 1], [2, 3]]))
