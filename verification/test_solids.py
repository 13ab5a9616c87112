"""CAD meshes: closed, of the right genus, of the right volume, at every size."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.rules.check import check_design
from phytac_design.solids.solid_mesh import shell_manifold, to_triangles
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from verification.case import Case, Cases, Evidence, Expect, Recorder, verify
from verification.designs import AROUND, SHAPES, design_of, numbers_of
from verification.faces import face_of

FACETS = 1e-3
"""Volume that facets within the tolerance may cost, relative."""
STEP = 1e-4
"""Chart step of differences, relative to the chart."""


def wall_volume_mm3(surface: Surface, thickness_mm: float) -> float:
    """Volume between outer and inner face, edges cut square to it.

    The outer area is the text-book's; how areas shrink inward is Steiner's formula, with the
    total curvatures of revolution and of sheets by quadrature of the face's own normals.
    """
    table = numbers_of(surface)
    outer = face_of(surface.name, table).area_mm2
    t = thickness_mm
    one, two = _shrinks(surface)
    return outer * t - one * t**2 / 2.0 + two * t**3 / 3.0


def _shrinks(surface: Surface) -> tuple[float, float]:
    """Integrals of the sum and of the product of the principal curvatures over the face."""
    (u0, u1), (v0, v1) = surface.domain
    x, w = np.polynomial.legendre.leggauss(6)
    cells_u, cells_v = 64, 64 if not surface.periodic[1] or surface.name == "cuboid" else 4

    def stations(low: float, high: float, cells: int) -> tuple[FloatArray, FloatArray]:
        half = (high - low) / cells / 2.0
        middle = low + half * (2.0 * np.arange(cells) + 1.0)
        return (middle[:, None] + half * x).ravel(), np.tile(half * w, cells)

    u, du = stations(u0, u1, cells_u)
    v, dv = stations(v0, v1, cells_v)
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    step = STEP * np.array([u1 - u0, v1 - v0]) / 64.0
    xu, xv, nu, nv = (
        (f(uv + m) - f(uv - m)) / (2.0 * s)
        for f in (surface.point, surface.normal)
        for m, s in zip(np.diag(step), step, strict=True)
    )
    n = surface.normal(uv)

    def triple(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.asarray(np.sum(n * np.cross(a, b), axis=1))

    weight = np.outer(du, dv).ravel()
    sign = np.sign(triple(xu, xv).sum())
    first = sign * float(weight @ (triple(nu, xv) + triple(xu, nv)))
    return first, sign * float(weight @ triple(nu, nv))


def _receptors_mm3(design: Any, surface: Surface, heights: FloatArray) -> float:
    """Tubes on the wall's inner face less the holes through wall and tube, by quadrature.

    Exact on plane, cylinder and sphere; elsewhere as on a plane.
    """
    big, small = design.receptor.diameter_outer_mm / 2.0, design.receptor.diameter_hole_mm / 2.0
    t = design.wall.thickness_mm
    x, w = np.polynomial.legendre.leggauss(48)
    turn = 2.0 * np.pi * (np.arange(96) + 0.5) / 96
    out = surface.reach_mm(np.zeros((1, 2)) + surface.domain.mean(axis=1))[0]
    outer = out if surface.name in ("cylinder", "hemisphere") else np.inf

    def over(low: float, high: float, f: Any) -> float:
        r = (low + high) / 2.0 + (high - low) / 2.0 * x
        value = f(r[:, None], turn[None])
        return float(np.sum(value * r[:, None] * w[:, None]) * (high - low) / 2.0 * 2 * np.pi / 96)

    def sag(radius: float) -> Any:
        if not np.isfinite(radius):
            return lambda r, _a: 0.0 * r * np.ones_like(_a)
        if surface.name == "cylinder":
            return lambda r, a: radius - np.sqrt(radius**2 - (r * np.sin(a)) ** 2)
        return lambda r, a: radius - np.sqrt(radius**2 - r**2) + 0.0 * a

    inner, face = sag(outer - t), sag(outer)
    tube = sum(over(small, big, lambda r, a, h=h: h - inner(r, a)) for h in heights)
    hole = over(0.0, small, lambda r, a: t - face(r, a) + inner(r, a))
    return tube - hole * len(heights)


def check_solid(values: Mapping[str, Any], found: Evidence) -> None:
    """Every edge used twice, once each way; genus by Euler; volume by the divergence theorem."""
    design = design_of(values)
    sensor = check_design(design)
    surface, markers = sensor.surface, sensor.markers
    tolerance = float(values["tolerance_mm"])
    mesh = to_triangles(shell_manifold(sensor, tolerance_mm=tolerance))
    p, tri = mesh.vertices_mm, mesh.triangles
    found.true("every coordinate is finite", np.isfinite(p))
    edges = np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]])
    count = len(p) + 1
    there, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    found.true(
        "each edge once each way", np.array_equal(np.sort(there), np.sort(back)), kind="reference"
    )
    found.true("no edge twice the same way", len(np.unique(there)) == len(there), kind="reference")
    euler = len(np.unique(tri)) - len(edges) // 2 + len(tri)
    tunnel = int(surface.name in AROUND and not any(surface.poles))
    found.add(
        "handles: one for each hole, one for the bore (Euler)",
        euler - (2 - 2 * (markers.count + tunnel)),
        0.0,
    )
    a, b, c = p[tri[:, 0]], p[tri[:, 1]], p[tri[:, 2]]
    volume = float(np.sum(a * np.cross(b, c)) / 6.0)
    exact = wall_volume_mm3(surface, design.wall.thickness_mm)
    exact += _receptors_mm3(design, surface, markers.height_mm)
    found.add("volume: text-book's, relative", volume / exact - 1.0, values["share"])
    found.facts["triangles"] = float(len(tri))


def cases() -> Cases:
    """Every shape: thin and thick, one receptor and many, coarse and fine, small and large."""
    out = Cases()

    def add(
        shape: str,
        name: str,
        changes: dict[str, Any],
        expect: Expect = "right",
        tolerance_mm: float = 0.002,
        share: float = FACETS,
    ) -> None:
        changes = {**changes, "wall": {"rim_length_mm": 0.0} | changes.get("wall", {})}
        numbers = {"tolerance_mm": tolerance_mm, "share": share}
        out.add_design(shape, name, check_solid, changes, expect, **numbers)

    one: dict[str, Any] = {"kind": "straight", "rows": 1, "columns": 1}
    for shape in SHAPES:
        # Tubes on curved faces other than cylinder and sphere are taken as on a plane.
        share = FACETS if shape in ("plane", "cylinder", "hemisphere") else 4e-3
        add(shape, "as it is", {}, share=share)
        add(shape, "one receptor", {"layout": one})
        thin = {"wall": {"thickness_mm": 0.4}}
        add(shape, "as thin as may be printed", thin, "either", 5e-4, 4.0 * share)
        add(shape, "a wall of 3 mm", {"wall": {"thickness_mm": 3.0}}, share=share)
        tilted = {"direction": "tilted", "tilt_deg": 20.0}
        leaning = {"receptor": tilted, "layout": one, "wall": {"thickness_mm": 1.2}}
        add(shape, "leaning by 20°", leaning, "either", share=2e-3)
        add(shape, "coarse facets", {}, "right", 0.2, 0.08)
        add(shape, "fine facets", {"layout": one}, "right", 2e-4)
    one |= {"height_near_mm": 2.0}
    small = {
        "shape": {"diameter_outer_mm": 1.0, "length_mm": 1.0},
        "wall": {"thickness_mm": 0.02},
        "receptor": {"diameter_outer_mm": 0.06, "diameter_hole_mm": 0.03},
        "print_rules": dict.fromkeys(
            ("wall_min_mm", "hole_min_mm", "gap_min_mm", "wall_free_min_mm"), 0.0
        ),
        "switch": {"footprint_diameter_mm": 0.05, "tip_diameter_mm": 0.01},
        "training": {"patch_radius_min_mm": 0.1, "patch_radius_max_mm": 0.2, "force_max_N": 1e3},
        "layout": one | {"height_near_mm": 0.05},
    }
    add("cylinder", "ø1 mm, wall 0.02 mm", small, "either", 2e-5, 4e-3)
    many = {"layout": {"rows": 40, "columns": 40}, "shape": {"width_mm": 200, "height_mm": 200}}
    add("plane", "1600 receptors", many, "right", 0.01, 1e-2)
    steep = {"diameter_near_mm": 56.0, "diameter_far_mm": 13.0, "length_mm": 0.375}
    neck = {"diameters_mm": [40.0, 20.0, 40.0], "length_mm": 60.0}
    pipe, sheet = {"diameter_outer_mm": 2000.0}, {"width_mm": 5000.0, "height_mm": 5000.0}
    sizes: tuple[tuple[str, str, dict[str, Any], Expect, float, float], ...] = (
        ("cylinder", "ø2 m, 5 m long", pipe | {"length_mm": 5000.0}, "right", 0.05, 2e-3),
        ("hemisphere", "ø2 m", pipe | {"skirt_mm": 0.0}, "right", 0.05, 2e-3),
        ("cone", "half-angle 89°", steep, "either", 0.002, 2e-3),
        (
            "cuboid",
            "edges 1 % thicker than the wall",
            {"edge_radius_mm": 0.81},
            "right",
            2e-3,
            2e-3,
        ),
        ("grip", "a neck", neck, "either", 0.002, 2e-3),
        ("plane", "leaning 80°", {"tilt_deg": 80.0}, "right", 0.002, 1e-3),
        ("plane", "5 m", sheet, "right", 0.01, 1e-3),
    )
    for shape, name, table, expect, tolerance, share in sizes:
        add(shape, name, {"shape": table, "layout": one}, expect, tolerance, share)
    return out


CASES = cases()


@CASES.parametrize
def test_solids(case: Case, record_property: Recorder) -> None:
    """Print meshes: closed, genus, volume."""
    verify(case, record_property)
