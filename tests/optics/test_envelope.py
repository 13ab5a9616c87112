import numpy as np
import pytest

from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import bar_mesh, bar_span_mm, boundary_mm, edge_mm, shell_mesh
from phytac_design.geometry.triangles import TriangleMesh, grid_mesh
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from tests.fabrication.cases import FAMILIES, family_design
from tests.fabrication.walls import out_of

families = pytest.mark.parametrize("name", sorted(FAMILIES))
TUBES = {"cylinder", "cone", "cuboid", "grip"}


def areas(mesh: TriangleMesh) -> FloatArray:
    a, b, c = np.moveaxis(mesh.vertices_mm[mesh.triangles], 1, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0)


def strip_area(surface: Surface, axis: int, end: int, wall: tuple[float, float, float]) -> float:
    """Area of one edge's rim that a camera can see: its inner side, and its end if shown."""
    thickness, rim, flange = wall
    low, high = surface.domain[1 - axis]
    t = np.linspace(low, high, 2001)
    uv = np.full((len(t), 2), surface.domain[axis, end])
    uv[:, 1 - axis] = t
    out, foot = out_of(surface, uv, axis, end), surface.point(uv, -thickness)

    def length(points: FloatArray) -> float:
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    inner = rim * length(foot + rim / 2.0 * out)
    shown = not (surface.periodic[1] and end == 1)
    high = surface.point(uv, (flange - thickness) / 2.0) + rim * out
    return inner + shown * (thickness + flange) * length(high)


@families
def test_inner_face_and_rims_have_their_areas(name: str) -> None:
    case = family_design(name)
    surface = case.surface()
    mesh = shell_mesh(case, surface, tolerance_mm=0.002)
    assert areas(mesh).min() > 1e-9  # none degenerate, at a pole or in a mitre either
    sizes = (0.8, 4.0, 1.6)
    expected = surface.area_mm2(-0.8)
    expected += sum(strip_area(surface, axis, end, sizes) for axis, end in surface.edges())
    if not surface.periodic[1]:
        for eu in (0, 1):
            for ev in (0, 1):
                corner = np.array([[surface.domain[0, eu], surface.domain[1, ev]]])
                cosine = out_of(surface, corner, 0, eu)[0] @ out_of(surface, corner, 1, ev)[0]
                half = np.tan(np.arccos(cosine) / 2.0)
                expected += 4.0**2 * half + 2.0 * 4.0 * half * 2.4
    assert areas(mesh).sum() == pytest.approx(expected, rel=2e-3)
    without = case.model_copy(update={"wall": case.wall.model_copy(update={"rim_length_mm": 0.0})})
    bare = shell_mesh(without, surface, tolerance_mm=0.002)
    assert areas(bare).sum() == pytest.approx(surface.area_mm2(-0.8), rel=2e-3)


@families
def test_the_face_lies_at_the_inner_offset(name: str) -> None:
    case = family_design(name)
    without = case.model_copy(update={"wall": case.wall.model_copy(update={"rim_length_mm": 0.0})})
    surface = case.surface()
    mesh = shell_mesh(without, surface, tolerance_mm=0.01)
    for points, tolerance in (
        (mesh.vertices_mm, 1e-8),
        (mesh.vertices_mm[mesh.triangles].mean(axis=1), 0.025),
    ):
        foot = surface.chart(points)
        height = np.sum((points - surface.point(foot)) * surface.normal(foot), axis=1)
        assert np.abs(height + 0.8).max() <= tolerance


@families
def test_boundary_runs_along_every_open_edge(name: str) -> None:
    surface = family_design(name).surface()
    points = boundary_mm(surface, -0.8, 64)
    edges = {"hemisphere": 1, "capped cone": 1, "plane": 4, "patch": 4}.get(name, 2)
    assert points.shape == (64 * edges, 3)
    np.testing.assert_array_equal(points[:64], edge_mm(surface, 0, -0.8, 64))
    foot = surface.chart(points)
    span = np.ptp(surface.domain, axis=1)
    open_axes = {axis for axis, _ in surface.edges()}
    gap = np.min(
        [np.abs(foot[:, a, None] - surface.domain[a]).min(axis=1) / span[a] for a in open_axes],
        axis=0,
    )
    assert gap.max() < 1e-8


def with_bar(name: str, radius: float, start: float = 5.0) -> tuple[Design, Surface]:
    case = family_design(name)
    light = case.light.model_copy(update={"bar_radius_mm": radius, "bar_start_mm": start})
    return case.model_copy(update={"light": light}), case.surface()


@families
def test_the_bar_never_pierces_the_inner_face(name: str) -> None:
    case, surface = with_bar(name, 3.0, start=-30.0)
    near, far = bar_span_mm(case, surface)
    assert near == -30.0
    bar = bar_mesh(case, surface, tolerance_mm=0.01)
    assert bar.vertices_mm[:, 2].max() == pytest.approx(far)
    if name in TUBES:
        assert far == pytest.approx(edge_mm(surface, 1, -0.8)[:, 2].max())
        return
    foot = surface.chart(bar.vertices_mm)
    height = np.sum((bar.vertices_mm - surface.point(foot)) * surface.normal(foot), axis=1)
    assert -1.0 < height.max() < -0.8  # near the face, not through it
    assert areas(bar).min() > 0.0


def test_the_bar_ends_at_a_domes_face() -> None:
    case, surface = with_bar("hemisphere", 3.0)
    _, far = bar_span_mm(case, surface)
    # Inner radius 24.2 about z = 10: where the bar's side meets the dome, less a tenth of the wall.
    assert far == pytest.approx(10.0 + np.sqrt(24.2**2 - 3.0**2) - 0.08, abs=0.03)


@families
def test_no_bar_for_radius_zero_or_beyond_the_face(name: str) -> None:
    assert len(bar_mesh(*with_bar(name, 0.0), tolerance_mm=0.01).triangles) == 0
    assert len(bar_mesh(*with_bar(name, 3.0, start=500.0), tolerance_mm=0.01).triangles) == 0


def test_a_pole_has_one_triangle_per_cell() -> None:
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    points[-1] = points[-1, 0]
    mesh = grid_mesh(points, closed=True, poles=(False, True))
    assert len(mesh.triangles) == 2 * 2 * 5 + 5
    assert areas(mesh).min() > 0.0
    points[0] = points[0, 0]
    mesh = grid_mesh(points, closed=True, poles=(True, True))
    assert len(mesh.triangles) == 5 + 2 * 5 + 5
    assert areas(mesh).min() > 0.0


def test_a_saddle_with_straight_chart_lines_is_still_followed() -> None:
    grid = [[[-40.0, -40.0, 72.0], [40.0, -40.0, 8.0]], [[-40.0, 40.0, 8.0], [40.0, 40.0, 72.0]]]
    case = family_design("cylinder").model_dump()
    case = {**case, "shape": {"kind": "patch", "points_mm": grid}}
    case["wall"]["rim_length_mm"] = 0.0
    saddle = Design.model_validate(case)
    surface = saddle.surface()
    mesh = shell_mesh(saddle, surface, tolerance_mm=0.01)
    # The middle of each diagonal is where a twisted cell strays most.
    sides = mesh.vertices_mm[mesh.triangles]
    for k in range(3):
        points = (sides[:, k] + sides[:, (k + 1) % 3]) / 2.0
        foot = surface.chart(points)
        height = np.sum((points - surface.point(foot)) * surface.normal(foot), axis=1)
        assert np.abs(height + 0.8).max() <= 0.02
