"""Shapes: points, normals, areas, rays and round trips of every family at the ends of its sizes."""

from collections.abc import Mapping
from dataclasses import fields, replace
from itertools import combinations, product
from typing import Any

import numpy as np

import phytac_shapes
from phytac_design.design.spec import SHAPE_MODELS
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError
from verification.case import Case, Cases, Evidence, Expect, Recorder, verify
from verification.designs import SHAPES, design_of, numbers_of
from verification.faces import Face, face_of, patch_point

EXACT = 1e-9
"""Relative to the size of the sensor: seven digits of twice the arithmetic's are left."""
SOUGHT = 1e-7
"""The same for what is found by iteration, or by differences."""
PLACES = 400
RAYS = ("as it is", "ripples")
"""Patches on which rays are marched: the slowest of all checks."""


def _surface(table: Mapping[str, Any]) -> Surface:
    """Shape of a table as the design file's reader makes it, ranges checked."""
    return design_of({"shape": table["kind"], "changes": {"shape": dict(table)}}).surface()


def _places(surface: Surface) -> FloatArray:
    """Chart places (m, 2), poles and edges left out by a little."""
    rng = np.random.default_rng(0)
    (u0, u1), (v0, v1) = surface.domain
    share = rng.uniform(0.001, 0.999, (PLACES, 2))
    return np.column_stack([u0 + (u1 - u0) * share[:, 0], v0 + (v1 - v0) * share[:, 1]])


def _size_mm(surface: Surface) -> float:
    low, high = surface.bounds_mm()
    return float(np.linalg.norm(high - low))


def check_face(values: Mapping[str, Any], found: Evidence) -> None:
    """All queries of a surface, against the text-book's face."""
    table = values["table"]
    surface = _surface(table)
    known = face_of(table["kind"], {**numbers_of(surface), **table})
    uv, size = _places(surface), _size_mm(surface)
    point, normal = surface.point(uv), surface.normal(uv)
    _on_face(surface, known, table, uv, point, normal, size, found)
    found.close("area: closed form or quadrature", surface.area_mm2(), known.area_mm2, 1e-8)
    # Deeper than where normals meet anywhere, another foot point may be nearer.
    depth = np.full(len(uv), 0.3 * min(surface.inner_reach_mm(), 0.2 * size))
    found.close(
        "offset point = point + offset·normal",
        surface.point(uv, -depth),
        point - depth[:, None] * normal,
        EXACT,
    )
    back = surface.chart(surface.point(uv, -depth))
    found.add("chart of a point gives its place back", (surface.point(back) - point) / size, SOUGHT)
    _maps(surface, table, uv, found)
    _units(surface, uv, found)


def _on_face(
    surface: Surface,
    known: Face,
    table: Mapping[str, Any],
    uv: FloatArray,
    point: FloatArray,
    normal: FloatArray,
    size: float,
    found: Evidence,
) -> None:
    found.add("normals are unit vectors", np.linalg.norm(normal, axis=1) - 1.0, 1e-12)
    if known.gap is None:
        grid = table["points_mm"]
        found.add("points: SciPy's spline", (point - patch_point(grid, uv)) / size, EXACT)
        cross = np.cross(patch_point(grid, uv, 0, 1), patch_point(grid, uv, 1, 0))
        cross /= np.linalg.norm(cross, axis=1, keepdims=True)
        found.add("normals: SciPy's spline", normal - cross, 1e-7)
        return
    found.add("points lie on the face's equation", known.gap(point) / size, EXACT)
    low, high = known.span_mm
    found.true(
        "points within the face's height",
        (point[:, 2] >= low - EXACT * size) & (point[:, 2] <= high + EXACT * size),
    )
    # Along the normal the gap grows by the distance; a step small against the curvature.
    step = 1e-6 * np.minimum(surface.reach_mm(uv), size)
    rise = known.gap(point + step[:, None] * normal) - known.gap(point - step[:, None] * normal)
    ahead = rise / (2.0 * step)
    noise = 1e-15 * size / float(step.min())
    found.add("normals: steepest ascent of the face's equation", ahead - 1.0, 1e-5 + noise)


def _maps(surface: Surface, table: Mapping[str, Any], uv: FloatArray, found: Evidence) -> None:
    """Metric from differences; the flat map keeps areas where it is meant to."""
    (u0, u1), (v0, v1) = surface.domain
    step = 1e-6 * np.array([u1 - u0, v1 - v0])
    inner = uv * 0.98 + 0.01 * np.array([u0 + u1, v0 + v1])
    move = np.diag(step)
    slope = np.stack(
        [
            (surface.point(inner + m) - surface.point(inner - m)) / (2.0 * s)
            for m, s in zip(move, step, strict=True)
        ],
        axis=1,
    )
    scale = np.linalg.norm(surface.tangents(inner), axis=2).max(axis=0)
    off = (slope - surface.tangents(inner)) / scale[None, :, None]
    # Joints of lines and arcs have a corner in the second derivative.
    found.add("tangents: differences of points", np.quantile(np.abs(off), 0.97), 1e-6)
    if table["kind"] == "patch":
        return
    flat = np.stack(
        [
            (surface.unwrap(inner + m) - surface.unwrap(inner - m)) / (2.0 * s)
            for m, s in zip(move, step, strict=True)
        ],
        axis=1,
    )
    metric = np.linalg.det(surface.metric(inner))
    area = np.sqrt(np.maximum(metric, 0.0))
    ratio = np.abs(np.linalg.det(flat)) / area - 1.0
    found.add("the flat map keeps areas", np.quantile(np.abs(ratio), 0.97), 1e-5)


def _units(surface: Surface, uv: FloatArray, found: Evidence) -> None:
    """The same surface in other units of length."""
    for name, factor in (("metres", 1e-3), ("micrometres", 1e3)):
        change = {
            field: _times(value, factor)
            for field, value in numbers_of(surface).items()
            if field.endswith("_mm")
        }
        family: Any = surface
        try:
            other = replace(family, **change)
        except DesignError:
            continue  # beyond the family's range in these units
        share = (uv - surface.domain[:, 0]) / np.ptp(surface.domain, axis=1)
        there = other.domain[:, 0] + share * np.ptp(other.domain, axis=1)
        found.close(
            f"in {name}", other.point(there) / factor, surface.point(uv), EXACT, kind="units"
        )


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, tuple | list):
        return tuple(_times(item, factor) for item in value)
    return float(value) * factor


def _ends(kind: str) -> dict[str, tuple[float, float]]:
    """Minimum and maximum of each of a family's numbers."""
    family: Any = phytac_shapes.REGISTRY[kind]
    return {
        item.name: (item.metadata["minimum"], item.metadata["maximum"])
        for item in fields(family)
        if item.type in (float, "float") and "minimum" in item.metadata
    }


def cases() -> Cases:  # noqa: C901 - a table
    """Every number of every family at, between and beyond its ends; pairs; grids and profiles."""
    out = Cases()

    def add(kind: str, name: str, change: Mapping[str, Any], expect: Expect = "right") -> None:
        table = {"kind": kind, **SHAPES[kind], **change}
        if kind == "cuboid" and expect == "right":
            # Within the ranges, but no cuboid.
            least = min(table["width_mm"], table["depth_mm"])
            expect = "refused" if 2.0 * table["edge_radius_mm"] >= least else "right"
        rays = kind != "patch" or name in RAYS
        out.add_design(kind, name, check_face, {}, expect, table=table, rays=rays)

    for kind in SHAPE_MODELS:
        add(kind, "as it is", {})
        ends = _ends(kind)
        for field, (low, high) in ends.items():
            add(kind, f"{field} {low:g}, its minimum", {field: low})
            add(kind, f"{field} {high:g}, its maximum", {field: high})
            for value in (low - 1e-3 * max(abs(low), 1.0), high * 1.001):
                add(kind, f"{field} {value:g}, beyond", {field: value}, "refused")
            add(kind, f"{field} not a number", {field: float("nan")}, "refused")
        for pair in combinations(ends, 2):
            for values in product(*(ends[field] for field in pair)):
                change = dict(zip(pair, values, strict=True))
                add(kind, ", ".join(f"{key} {value:g}" for key, value in change.items()), change)
    for near, far, length in ((40, 30, 30), (2000, 0.1, 0.1), (1, 0.1, 5000), (40, 0.1, 20)):
        change = {"diameter_near_mm": near, "diameter_far_mm": far, "length_mm": length}
        add("cone", f"capped, {near} to {far} over {length} mm", {**change, "end": "cap"})
    add("cone", "capped, widening", {"diameter_far_mm": 60.0, "end": "cap"}, "either")
    grips = {
        "two diameters": ([40.0, 41.0], 36.0),
        "thinnest and shortest": ([1.0, 1.0], 1.0),
        "widest and longest": ([2000.0, 2000.0], 5000.0),
        "widest and shortest": ([2000.0, 2000.0], 1.0),
        "thinnest and longest": ([1.0, 1.0], 5000.0),
        "64 diameters, a saw": ([40.0 + 0.2 * (-1) ** k for k in range(64)], 120.0),
        "a neck of 2 mm": ([40.0, 20.0, 4.0, 2.0, 4.0, 20.0, 40.0], 120.0),
        "a step of 1 to 2": ([20.0, 20.0, 40.0, 40.0], 60.0),
    }
    for name, (diameters, length) in grips.items():
        add("grip", name, {"diameters_mm": diameters, "length_mm": length}, "either")
    bad = {"a profile through the axis": [100.0, 1.0, 1.0, 100.0], "one diameter": [40.0]}
    for name, diameters in (*bad.items(), ("65 diameters", [40.0] * 65)):
        add("grip", name, {"diameters_mm": diameters}, "refused")
    for name, points, expect in _patches():
        add("patch", name, {"points_mm": points}, expect)
    return out


def _patches() -> list[tuple[str, Any, Expect]]:
    def grid(nu: int, nv: int, height: Any, size: float = 50.0, at: float = 0.0) -> Any:
        share = np.linspace(-0.5, 0.5, nu)[:, None], np.linspace(-0.5, 0.5, nv)[None]
        v, u = np.meshgrid(share[1].ravel(), share[0].ravel())
        return (at + np.stack([size * v, size * u, height(u, v) + 0.0 * u], axis=-1)).tolist()

    flat = grid(2, 2, lambda _u, _v: 0.0)
    same, line = [[[1.0, 1.0, 1.0]] * 3] * 3, [[[x, 0.0, 0.0] for x in (0.0, 1.0, 2.0)]] * 3
    return [
        ("two by two points", flat, "right"),
        ("two by nine points", grid(2, 9, lambda _u, v: 4.0 * v * v), "right"),
        ("12 by 12 points, a saddle", grid(12, 12, lambda u, v: 20.0 * (u * u - v * v)), "right"),
        ("a steep ridge", grid(7, 7, lambda u, _v: -20.0 * abs(u)), "right"),
        ("ripples", grid(9, 9, lambda u, v: np.sin(9.0 * u) * np.cos(9.0 * v)), "right"),
        ("a thousandth as large", grid(3, 3, lambda u, v: -0.01 * (u * u + v * v), 0.05), "right"),
        ("of maximum size", grid(3, 3, lambda u, v: -900.0 * (u * u + v * v), 1.9e4), "right"),
        ("5 m off the axis", grid(4, 4, lambda u, v: -9.0 * (u * u + v * v), 50.0, 5e3), "right"),
        ("beyond 10 m", grid(2, 2, lambda _u, _v: 0.0, 50.0, 1.1e4), "refused"),
        ("rows of unequal length", [flat[0], flat[1][:1]], "refused"),
        ("one row", flat[:1], "refused"),
        ("inside out", flat[::-1], "refused"),
        ("all points the same", same, "refused"),
        ("on a line", line, "refused"),
        ("two points of four the same", [[flat[0][0], flat[0][0]], flat[1]], "either"),
        ("not a number", [[[float("nan"), 0.0, 0.0], flat[0][1]], flat[1]], "refused"),
    ]


CASES = cases()


@CASES.parametrize
def test_surfaces(case: Case, record_property: Recorder) -> None:
    """Points, normals, areas, rays and round trips of every family."""
    verify(case, record_property)
