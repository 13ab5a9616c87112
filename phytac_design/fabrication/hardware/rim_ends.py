"""The rims of tubes and domes: outlines and lengths in the frame of the end.

In that frame the rim's root is the plane z = 0, the sensor lies at z > 0, and the rim at z < 0. For
the near end it is the sensor's own; for the far one it is turned about x.
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.solid_nodes import Circle, Outline, Rect, polygon
from phytac_design.geometry.boundary_loops import conormals
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

FLAT_mm = 1e-6


@dataclass(frozen=True, kw_only=True)
class End:
    """One rim of a tube or dome.

    Attributes
    ----------
    number : int
        0 near, 1 far.
    root_z_mm : float
        Plane of its root in the sensor's frame.
    stop_mm : float
        Lowest point of the rim in the end's frame; negative.
    outer, inner : outline
        Cylinders that just hold the rim, and that just pass it inside.
    edge : outline
        Inner edge of the rim's root, where the sensing wall begins.
    """

    number: int
    root_z_mm: float
    stop_mm: float
    outer: Outline
    inner: Outline
    edge: Outline

    def local(self, points_mm: FloatArray) -> FloatArray:
        """Points (n, 3) of the sensor's frame in the end's."""
        if self.number == 0:
            return np.asarray(points_mm - np.array([0.0, 0.0, self.root_z_mm]))
        turned = points_mm * np.array([1.0, -1.0, -1.0])
        return np.asarray(turned + np.array([0.0, 0.0, self.root_z_mm]))


def make_end(design: Design, surface: Surface, number: int) -> End:
    """End of a tube or dome.

    Raises
    ------
    DesignError
        If it has no rim, or its edge is not flat and square to the axis.
    """
    wall = design.wall
    if wall.rim_length_mm <= 0.0:
        raise DesignError(
            "hardware-needs-rim",
            "no hardware holds a sensor without rims (wall.rim_length_mm = 0); give it rims, or "
            'set hardware.parts = "none"',
        )
    root = _points(surface, number, -wall.thickness_mm, 0.0)
    place = float(surface.point(_stations(surface, number))[:, 2].mean())
    if float(np.ptp(root[:, 2])) > FLAT_mm * (1.0 + abs(place)):
        raise DesignError(
            "rim-end-not-flat",
            f"no mount fits the {surface.name}: the edge of its {'far' if number else 'near'} end "
            'is not flat; set hardware.parts = "none"',
        )
    sign = -1.0 if number else 1.0
    shift = np.array([0.0, 0.0, sign * place])

    def local(offset: float, extension: float) -> FloatArray:
        points = _points(surface, number, offset, extension)
        return np.asarray(points * np.array([1.0, sign, sign]) - shift)

    sides = {
        offset: [local(offset, way) for way in (0.0, wall.rim_length_mm)]
        for offset in (wall.rim_flange_mm, -wall.thickness_mm)
    }
    outer = [outline_of(points[:, :2]) for points in sides[wall.rim_flange_mm]]
    inner = [outline_of(points[:, :2]) for points in sides[-wall.thickness_mm]]
    stop = min(float(points[:, 2].min()) for pair in sides.values() for points in pair)
    return End(
        number=number,
        root_z_mm=place,
        stop_mm=stop,
        outer=max(outer, key=_reach),
        inner=min(inner, key=_reach),
        edge=outline_of(local(-wall.thickness_mm, 0.0)[:, :2]),
    )


def outline_of(points_mm: FloatArray) -> Outline:
    """Circle or rounded rectangle around the axis if points (n, 2) lie on one, else a polygon."""
    radius = np.linalg.norm(points_mm, axis=1)
    size = float(radius.max())
    if float(np.ptp(radius)) <= FLAT_mm * size:
        return Circle(float(radius.mean()))
    x, y = np.abs(points_mm).T
    half = np.array([x.max(), y.max()])
    # The arc through the point nearest the corner: (r - a)² + (r - b)² = r².
    a, b = half - np.array([x, y])[:, int((x + y).argmax())]
    corner = float(a + b + np.sqrt(max(2.0 * a * b, 0.0)))
    if 0.0 < corner < half.min():
        away = np.column_stack([x, y]) - (half - corner)
        off = np.linalg.norm(np.maximum(away, 0.0), axis=1) + np.minimum(away.max(axis=1), 0.0)
        if float(np.abs(off - corner).max()) <= FLAT_mm * size:
            width, height = (2.0 * half).tolist()
            return Rect(size_mm=(width, height), corner_mm=corner)
    return polygon(points_mm)


def rim_places(
    design: Design, surface: Surface, end: End, *, count: int, offset_mm: float, share: float
) -> tuple[FloatArray, FloatArray]:
    """Points (count, 3) around the rim at an offset and a share of its length, and normals there.

    Both in the end's frame.
    """
    low, high = surface.domain[1]
    uv = np.full((count, 2), surface.domain[0, end.number])
    uv[:, 1] = low + (high - low) * np.arange(count) / count
    way = share * design.wall.rim_length_mm * conormals(surface, uv, 0, end.number)
    turn = np.array([1.0, -1.0, -1.0] if end.number else [1.0, 1.0, 1.0])
    return end.local(surface.point(uv, offset_mm) + way), surface.normal(uv) * turn


def _stations(surface: Surface, end: int) -> FloatArray:
    stations = 256
    low, high = surface.domain[1]
    uv = np.full((stations, 2), surface.domain[0, end])
    uv[:, 1] = np.linspace(low, high, stations, endpoint=False)
    return uv


def _points(surface: Surface, end: int, offset_mm: float, extension_mm: float) -> FloatArray:
    uv = _stations(surface, end)
    out = extension_mm * conormals(surface, uv, 0, end)
    return np.asarray(surface.point(uv, offset_mm) + out)


def _reach(outline: Outline) -> float:
    if isinstance(outline, Circle):
        return outline.radius_mm
    if isinstance(outline, Rect):
        return max(outline.size_mm)
    return float(np.linalg.norm(np.array(outline.points_mm), axis=1).max())
