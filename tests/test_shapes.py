"""The surface contract, over every registered family, on designs drawn at random."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import phytac_shapes
from tests.refusals import refused

seeds = st.integers(0, 2**32 - 1)
Maker = Callable[[np.random.Generator], phytac_shapes.Surface]


def drawn_patch(rng: np.random.Generator) -> phytac_shapes.Surface:
    """Patch of 3 to 5 by 3 to 5 points, gently waved and evenly spaced up to a jitter."""
    rows, columns = rng.integers(3, 6, size=2)
    size = rng.uniform(2.0, 40.0)
    grid = np.zeros((rows, columns, 3))
    grid[..., 1] = size * np.arange(rows)[:, None]
    grid[..., 0] = size * np.arange(columns)
    grid += rng.uniform(-0.08, 0.08, grid.shape) * size
    return phytac_shapes.Patch(points_mm=tuple(tuple(map(tuple, row)) for row in grid.tolist()))


def drawn_cuboid(rng: np.random.Generator) -> phytac_shapes.Surface:
    width, depth = rng.uniform(5.0, 200.0, 2)
    return phytac_shapes.Cuboid(
        width_mm=width,
        depth_mm=depth,
        length_mm=rng.uniform(5.0, 400.0),
        edge_radius_mm=rng.uniform(0.05, 0.45) * min(width, depth),
    )


def drawn_cone(rng: np.random.Generator) -> phytac_shapes.Surface:
    return phytac_shapes.Cone(
        diameter_near_mm=rng.uniform(5.0, 200.0),
        diameter_far_mm=rng.uniform(5.0, 200.0),
        length_mm=rng.uniform(5.0, 300.0),
        end="cap" if rng.random() < 0.5 else "open",
    )


def drawn_grip(rng: np.random.Generator) -> phytac_shapes.Surface:
    return phytac_shapes.Grip(
        diameters_mm=tuple(rng.uniform(30.0, 45.0, int(rng.integers(2, 7))).tolist()),
        length_mm=rng.uniform(80.0, 300.0),
    )


DRAWN: dict[str, Maker] = {
    "cylinder": lambda rng: phytac_shapes.Cylinder(
        diameter_outer_mm=rng.uniform(1.0, 500.0), length_mm=rng.uniform(1.0, 500.0)
    ),
    "cone": drawn_cone,
    "plane": lambda rng: phytac_shapes.Plane(
        width_mm=rng.uniform(5.0, 200.0),
        height_mm=rng.uniform(5.0, 200.0),
        tilt_deg=rng.uniform(-60.0, 60.0),
    ),
    "cuboid": drawn_cuboid,
    "hemisphere": lambda rng: phytac_shapes.Hemisphere(
        diameter_outer_mm=rng.uniform(5.0, 300.0),
        skirt_mm=float(rng.choice([0.0, rng.uniform(1.0, 50.0)])),
    ),
    "grip": drawn_grip,
    "patch": drawn_patch,
}
every_shape = pytest.mark.parametrize("kind", sorted(phytac_shapes.REGISTRY))


def draw(kind: str, seed: int) -> tuple[phytac_shapes.Surface, np.ndarray, float]:
    """Surface, 60 chart points (a little off the poles) and its size."""
    rng = np.random.default_rng(seed)
    surface = DRAWN[kind](rng)
    (u0, u1), (v0, v1) = surface.domain
    share = rng.uniform(0.0, 0.999, (60, 2))
    uv = np.array([u0, v0]) + share * np.array([u1 - u0, v1 - v0])
    return surface, uv, float(np.linalg.norm(np.diff(surface.bounds_mm(), axis=0)))


def safe_depth(surface: phytac_shapes.Surface) -> float:
    return 0.3 * min(surface.inner_reach_mm(), 10.0)


def test_every_family_is_drawn() -> None:
    assert set(DRAWN) == set(phytac_shapes.REGISTRY)


@every_shape
@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_chart_inverts_point(kind: str, seed: int) -> None:
    surface, uv, size = draw(kind, seed)
    for offset in (0.0, -safe_depth(surface), 0.1 * safe_depth(surface)):
        point = surface.point(uv, offset)
        back = surface.chart(point)
        # Compared in space: at a pole every angle names the same point.
        assert np.abs(surface.point(back, offset) - point).max() < 1e-9 * size
        at = np.linalg.norm(surface.tangents(uv)[:, 1], axis=1) > 1e-3 * size
        assert np.allclose(back[at], uv[at], atol=1e-6 * np.ptp(surface.domain, axis=1))


@every_shape
@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_normals_are_unit_square_and_outward(kind: str, seed: int) -> None:
    surface, uv, size = draw(kind, seed)
    normal, tangents = surface.normal(uv), surface.tangents(uv)
    assert np.allclose(np.linalg.norm(normal, axis=1), 1.0)
    length = np.linalg.norm(tangents, axis=2)
    lean = np.abs(np.einsum("nai,ni->na", tangents, normal))
    assert (lean <= 1e-9 * length.max()).all()
    # (around, along, outward) is the right-handed triad of every chart.
    turn = np.einsum("ni,ni->n", np.cross(tangents[:, 1], tangents[:, 0]), normal)
    assert (turn > 0).all()
    step = 1e-3 * min(size, 1.0)
    assert np.allclose(surface.point(uv, step) - surface.point(uv), step * normal, atol=1e-9 * size)


@every_shape
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
@example(seed=1301)
def test_tangents_and_metric_match_differences(kind: str, seed: int) -> None:
    surface, uv, _ = draw(kind, seed)
    slopes = []
    for axis in range(2):
        # A kink of curvature (line into arc) costs first order, so that the step is short.
        move = 1e-7 * np.ptp(surface.domain[axis]) * np.eye(2)[axis]
        slope = (surface.point(uv + move) - surface.point(uv - move)) / (2 * move[axis])
        size = np.abs(slope).max()
        assert np.allclose(slope, surface.tangents(uv)[:, axis], atol=2e-4 * size)
        slopes.append(slope)
    metric = np.einsum("ani,bni->nab", slopes, slopes)
    assert np.allclose(metric, surface.metric(uv), atol=1e-3 * np.abs(metric).max())


def quadrature(surface: phytac_shapes.Surface, offset: float, cells: int = 160) -> float:
    """Area of an offset face from its points alone: flat triangles over a fine grid."""
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.linspace(u0, u1, cells + 1), np.linspace(v0, v1, 2 * cells + 1)
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)
    p = surface.point(grid.reshape(-1, 2), offset).reshape(*grid.shape[:2], 3)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]
    one = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    two = np.linalg.norm(np.cross(c - a, d - a), axis=-1)
    return float((one.sum() + two.sum()) / 2.0)


@every_shape
@settings(max_examples=4, deadline=None)
@given(seed=seeds)
def test_area_and_wall_volume_match_quadrature(kind: str, seed: int) -> None:
    surface, _, _ = draw(kind, seed)
    depth = safe_depth(surface)
    areas = [surface.area_mm2(-s * depth) for s in (0.0, 0.5, 1.0)]
    for s, area in zip((0.0, 0.5, 1.0), areas, strict=True):
        assert area == pytest.approx(quadrature(surface, -s * depth), rel=3e-3)
    # Steiner: the area of an offset face is quadratic in the offset.
    quarter = surface.area_mm2(-0.25 * depth)
    assert quarter == pytest.approx(0.375 * areas[0] + 0.75 * areas[1] - 0.125 * areas[2], rel=1e-9)
    assert dict(surface.facts())["area_outer_mm2"] == areas[0]


@every_shape
def test_poles_and_edges(kind: str) -> None:
    surface, _, size = draw(kind, 7)
    (u0, u1), (v0, v1) = surface.domain
    v = np.linspace(v0, v1, 9)
    for end, pole in enumerate(surface.poles):
        ring = surface.point(np.column_stack([np.full(9, (u0, u1)[end]), v]))
        assert (np.ptp(ring, axis=0).max() < 1e-12 * size) == pole
    for axis, end in surface.edges():
        assert not surface.periodic[axis]
        assert axis == 1 or not surface.poles[end]


def test_closed_forms() -> None:
    dome = phytac_shapes.Hemisphere(diameter_outer_mm=40.0)
    assert dome.area_mm2() == pytest.approx(2 * np.pi * 20.0**2, rel=1e-14)
    assert dome.area_mm2(-1.0) == pytest.approx(2 * np.pi * 19.0**2, rel=1e-14)
    cone = phytac_shapes.Cone(diameter_near_mm=60.0, diameter_far_mm=30.0, length_mm=80.0)
    assert cone.area_mm2() == pytest.approx(np.pi * 45.0 * np.hypot(15.0, 80.0), rel=1e-14)
    # A very long frustum of one diameter is a cylinder; with a cap, a capsule's half.
    tube = phytac_shapes.Cone(
        diameter_near_mm=30.0, diameter_far_mm=30.0, length_mm=50.0, end="cap"
    )
    assert tube.area_mm2() == pytest.approx(2 * np.pi * 15 * 50 + 2 * np.pi * 15**2, rel=1e-14)
    grip = phytac_shapes.Grip(diameters_mm=(60.0, 60.0, 60.0), length_mm=120.0)
    assert grip.area_mm2() == pytest.approx(2 * np.pi * 30 * 120, rel=1e-13)
    box = phytac_shapes.Cuboid(width_mm=50.0, depth_mm=40.0, length_mm=10.0, edge_radius_mm=5.0)
    assert box.perimeter_mm == pytest.approx(2 * (40 + 30) + 2 * np.pi * 5, rel=1e-14)


def test_patch_passes_through_its_points() -> None:
    surface = drawn_patch(np.random.default_rng(5))
    assert isinstance(surface, phytac_shapes.Patch)
    grid = np.array(surface.points_mm)
    at = np.stack(np.meshgrid(*map(np.arange, grid.shape[:2]), indexing="ij"), axis=-1)
    assert np.allclose(surface.point(at.reshape(-1, 2).astype(float)), grid.reshape(-1, 3))


@pytest.mark.parametrize("half_angle_deg", [0.5, 45.0, 89.0])
def test_cones_from_needle_to_disc(half_angle_deg: float) -> None:
    slope, far = float(np.tan(np.radians(half_angle_deg))), 4.0
    length = min(30.0, 900.0 / slope)
    near = far + 2.0 * length * slope
    cone = phytac_shapes.Cone(
        diameter_near_mm=near, diameter_far_mm=far, length_mm=length, end="cap"
    )
    assert np.degrees(cone.half_angle_rad) == pytest.approx(half_angle_deg)
    uv = np.column_stack([np.linspace(0.0, cone.domain[0, 1], 50), np.linspace(0.0, 6.2, 50)])
    assert np.allclose(cone.chart(cone.point(uv, 0.1))[:, 0], uv[:, 0], atol=1e-9 * near)


def test_only_the_chosen_cuboid_faces_sense() -> None:
    box = phytac_shapes.Cuboid(
        width_mm=50.0, depth_mm=40.0, length_mm=10.0, edge_radius_mm=5.0, faces=("+y",)
    )
    uv = box.chart(np.array([[0.0, 20.0, 5.0], [25.0, 0.0, 5.0], [0.0, -20.0, 5.0]]))
    assert box.sensing(uv).tolist() == [True, False, False]
    assert box.reach_mm(uv).tolist() == [20.0, 25.0, 20.0]


def test_unknown_family_names_the_nearest() -> None:
    with refused("shape-unknown") as caught:
        phytac_shapes.family("cilinder")
    caught.match("did you mean 'cylinder'")


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_absurd_sizes_are_refused(bad: float) -> None:
    with refused("shape-variable-range"):
        phytac_shapes.Cylinder(diameter_outer_mm=60.0, length_mm=bad)
    with refused("shape-variable-range"):
        phytac_shapes.Cone(diameter_near_mm=60.0, diameter_far_mm=30.0, length_mm=bad)


FLAT = (((0.0, 0.0, 0.0), (9.0, 0.0, 0.0)), ((0.0, 9.0, 0.0), (9.0, 9.0, 0.0)))


@pytest.mark.parametrize(
    ("kind", "data", "code"),
    [
        ("cuboid", {"edge_radius_mm": 25.0}, "cuboid-edge-radius"),
        ("cuboid", {"faces": ("+z",)}, "cuboid-faces"),
        ("cuboid", {"faces": ()}, "cuboid-faces"),
        ("grip", {"diameters_mm": (60.0, 1.0, 60.0, 1.0, 60.0, 1.0)}, "grip-profile-meets-axis"),
        ("grip", {"diameters_mm": (60.0,)}, "grip-diameter-count"),
        ("patch", {"points_mm": FLAT[::-1]}, "patch-inside-out"),
        ("patch", {"points_mm": (FLAT[0], FLAT[0])}, "patch-folds"),
        ("patch", {"points_mm": (FLAT[0],)}, "patch-grid-invalid"),
        ("plane", {"tilt_deg": 89.0}, "shape-variable-range"),
    ],
)
def test_shapes_that_cannot_be(kind: str, data: dict[str, object], code: str) -> None:
    base: dict[str, dict[str, object]] = {
        "cuboid": {"width_mm": 50.0, "depth_mm": 50.0, "length_mm": 9.0, "edge_radius_mm": 5.0},
        "grip": {"length_mm": 100.0},
        "patch": {},
        "plane": {"width_mm": 9.0, "height_mm": 9.0},
    }
    with refused(code):
        phytac_shapes.family(kind)(**(base[kind] | data))
