"""The surface contract, over every registered family."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shapes
from shapes.errors import DesignError

sizes = st.floats(1.0, 500.0)
seeds = st.integers(0, 2**32 - 1)


def chart_points(surface: shapes.Surface, seed: int, count: int = 40) -> np.ndarray:
    low, high = surface.domain.T
    return np.random.default_rng(seed).uniform(low, high, (count, 2))


@settings(max_examples=30, deadline=None)
@given(diameter=sizes, length=sizes, seed=seeds)
def test_chart_inverts_point(diameter: float, length: float, seed: int) -> None:
    surface = shapes.Cylinder(diameter_outer_mm=diameter, length_mm=length)
    uv = chart_points(surface, seed)
    back = surface.chart(surface.point(uv, -0.3 * surface.inner_reach_mm()))
    assert np.allclose(back, uv, atol=1e-9 * max(length, 1.0))


@settings(max_examples=30, deadline=None)
@given(diameter=sizes, length=sizes, seed=seeds)
def test_normals_are_unit_and_perpendicular(diameter: float, length: float, seed: int) -> None:
    surface = shapes.Cylinder(diameter_outer_mm=diameter, length_mm=length)
    uv = chart_points(surface, seed)
    normal, tangents = surface.normal(uv), surface.tangents(uv)
    assert np.allclose(np.linalg.norm(normal, axis=1), 1.0)
    assert np.abs(np.einsum("nai,ni->na", tangents, normal)).max() < 1e-9 * diameter
    # The chart is right-handed seen from outside: d/du × d/dv points inward on a cylinder (u = z,
    # v = angle), so that (around, along, outward) is the right-handed triad.
    assert (np.einsum("ni,ni->n", np.cross(tangents[:, 1], tangents[:, 0]), normal) > 0).all()


def test_tangents_match_differences() -> None:
    surface = shapes.Cylinder(diameter_outer_mm=60.0, length_mm=120.0)
    uv, step = chart_points(surface, 3), 1e-6
    for axis in range(2):
        move = step * np.eye(2)[axis]
        slope = (surface.point(uv + move) - surface.point(uv - move)) / (2 * step)
        assert np.allclose(slope, surface.tangents(uv)[:, axis], atol=1e-6)


def test_area_is_the_integral_of_the_metric() -> None:
    surface = shapes.Cylinder(diameter_outer_mm=60.0, length_mm=120.0)
    uv = chart_points(surface, 4, 200)
    density = np.sqrt(np.linalg.det(surface.metric(uv)))
    domain = np.prod(np.diff(surface.domain, axis=1))
    assert density.mean() * domain == pytest.approx(2 * np.pi * 30 * 120, rel=1e-12)
    assert surface.area_mm2() == pytest.approx(2 * np.pi * 30 * 120, rel=1e-12)


def test_rays_hit_where_they_should() -> None:
    surface = shapes.Cylinder(diameter_outer_mm=60.0, length_mm=120.0)
    origin = np.array([[0.0, 0.0, -30.0], [0.0, 0.0, 60.0], [0.0, 0.0, -30.0]])
    direction = np.array([[30.0, 0.0, 60.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.allclose(surface.intersect(origin, direction), [1.0, 30.0, np.inf])
    assert surface.intersect(origin[1:2], direction[1:2], -0.8)[0] == pytest.approx(29.2)


def test_unknown_family_names_the_nearest() -> None:
    with pytest.raises(DesignError, match="did you mean 'cylinder'"):
        shapes.family("cilinder")


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_absurd_sizes_are_refused(bad: float) -> None:
    with pytest.raises(DesignError, match="length_mm must be a positive length"):
        shapes.Cylinder(diameter_outer_mm=60.0, length_mm=bad)
