"""Descriptions of solids (CSG trees), evaluated by the mesh kernel and by the CAD kernel."""

from dataclasses import dataclass, replace

import numpy as np

from phytac_design.design.spec import WallSection
from phytac_shapes.arrays import FloatArray

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]


@dataclass(frozen=True)
class Circle:
    """A circle around ``centre_mm``."""

    radius_mm: float
    centre_mm: Point2 = (0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Rect:
    """A rectangle around ``centre_mm`` with sides along x and y and rounded corners."""

    size_mm: Point2
    corner_mm: float = 0.0
    centre_mm: Point2 = (0.0, 0.0)

    def arc_centres(self) -> FloatArray:
        """Centres (4, 2) of the corners' arcs, anticlockwise from (+x, +y)."""
        signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        return self.centre_mm + signs * (np.array(self.size_mm) / 2.0 - self.corner_mm)


@dataclass(frozen=True)
class Polygon:
    """A closed polygon, anticlockwise."""

    points_mm: tuple[Point2, ...]


Outline = Circle | Rect | Polygon


@dataclass(frozen=True)
class Prism:
    """An outline drawn out along z."""

    outline: Outline
    low_mm: float
    high_mm: float


@dataclass(frozen=True)
class Rod:
    """A round rod between two points."""

    start_mm: Point3
    end_mm: Point3
    radius_mm: float


@dataclass(frozen=True)
class Slab:
    """The design's wall and rims with other thicknesses, to cut a clearance around the real one."""

    wall: WallSection


@dataclass(frozen=True)
class Union:
    """Union of solids."""

    parts: tuple["Node", ...]


@dataclass(frozen=True)
class Difference:
    """A solid minus others."""

    body: "Node"
    tools: tuple["Node", ...]


@dataclass(frozen=True)
class Intersection:
    """Intersection of two solids."""

    first: "Node"
    second: "Node"


@dataclass(frozen=True)
class Far:
    """A solid of the far end: made as if at the near one, turned about x and moved to ``z_mm``."""

    node: "Node"
    z_mm: float


Node = Prism | Rod | Slab | Union | Difference | Intersection | Far


def grown(outline: Outline, by_mm: float) -> Outline:
    """Outline moved outward on all sides; rounded corners grow with it, sharp ones stay sharp."""
    if isinstance(outline, Circle):
        return replace(outline, radius_mm=outline.radius_mm + by_mm)
    if isinstance(outline, Rect):
        width, height = outline.size_mm
        corner = max(outline.corner_mm + by_mm, 0.0) if outline.corner_mm > 0.0 else 0.0
        return replace(
            outline, size_mm=(width + 2.0 * by_mm, height + 2.0 * by_mm), corner_mm=corner
        )
    points = np.array(outline.points_mm)
    along = np.roll(points, -1, axis=0) - points
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    out = np.column_stack([along[:, 1], -along[:, 0]])
    before = np.roll(out, 1, axis=0)
    mitre = (out + before) / (1.0 + np.sum(out * before, axis=1))[:, None]
    return polygon(points + by_mm * mitre)


def polygon(points_mm: FloatArray) -> Polygon:
    """Polygon of points (n, 2), turned anticlockwise; points that repeat are left out."""
    points = points_mm[np.linalg.norm(points_mm - np.roll(points_mm, 1, axis=0), axis=1) > 1e-6]
    x, y = points.T
    if float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) < 0.0:
        points = points[::-1]
    return Polygon(points_mm=tuple((float(a), float(b)) for a, b in points))


def half_mm(outline: Outline) -> float:
    """Least distance of an outline around the axis from it."""
    if isinstance(outline, Circle):
        return outline.radius_mm
    if isinstance(outline, Rect):
        return min(outline.size_mm) / 2.0
    points = np.array(outline.points_mm)
    after = np.roll(points, -1, axis=0)
    edge = after - points
    cross = points[:, 0] * edge[:, 1] - points[:, 1] * edge[:, 0]
    return float((cross / np.linalg.norm(edge, axis=1)).min())


def span_mm(outline: Outline) -> Point2:
    """Size of the box around an outline, along x and y."""
    if isinstance(outline, Circle):
        return (2.0 * outline.radius_mm, 2.0 * outline.radius_mm)
    if isinstance(outline, Rect):
        return outline.size_mm
    width, height = np.ptp(np.array(outline.points_mm), axis=0)
    return (float(width), float(height))


def disc(radius_mm: float, low_mm: float, high_mm: float, centre_mm: Point2 = (0.0, 0.0)) -> Prism:
    """Cylinder along z."""
    return Prism(Circle(radius_mm, centre_mm), low_mm, high_mm)


def block(size_mm: Point2, low_mm: float, high_mm: float, centre_mm: Point2 = (0.0, 0.0)) -> Prism:
    """Box with sides along x, y and z."""
    return Prism(Rect(size_mm=size_mm, centre_mm=centre_mm), low_mm, high_mm)


def tube(outer: Outline, inner: Outline, low_mm: float, high_mm: float) -> Node:
    """Ring between two outlines."""
    return Difference(Prism(outer, low_mm, high_mm), (Prism(inner, low_mm - 1.0, high_mm + 1.0),))


def triples(points_mm: FloatArray) -> tuple[Point3, ...]:
    """Points (n, 3) as plain tuples."""
    return tuple((float(x), float(y), float(z)) for x, y, z in points_mm)
