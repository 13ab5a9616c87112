"""Descriptions of solids as meshes (manifold3d)."""

from typing import Any

import numpy as np

from phytac_design.fabrication.hardware.solid_nodes import (
    Circle,
    Difference,
    Intersection,
    Node,
    Outline,
    Prism,
    Rect,
    Rod,
    Slab,
    Union,
)
from phytac_design.geometry.triangles import prisms, sides_for, widening
from phytac_design.solids.solid_mesh import SLIVER_mm, extruded_manifold, to_manifold, united
from phytac_design.solids.wall_mesh import wall_mesh
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray


class MeshKernel:
    """Evaluates descriptions around one surface, within ``tolerance_mm`` of the true faces."""

    def __init__(self, surface: Surface, tolerance_mm: float) -> None:
        self.surface = surface
        self.tolerance_mm = tolerance_mm

    def solid(self, node: Node) -> Any:
        """Return the solid as a ``manifold3d.Manifold``."""
        return self._raw(node).simplify(SLIVER_mm)

    def _raw(self, node: Node) -> Any:
        if isinstance(node, Prism | Rod | Slab):
            return self._simple(node)
        if isinstance(node, Union):
            return united([self._raw(part) for part in node.parts])
        if isinstance(node, Difference):
            return self._raw(node.body) - united([self._raw(t) for t in node.tools])
        if isinstance(node, Intersection):
            return self._raw(node.first) ^ self._raw(node.second)
        turned = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        shift = np.array([[0.0], [0.0], [node.z_mm]])
        return self._raw(node.node).transform(np.hstack([turned, shift]))

    def _simple(self, node: Prism | Rod | Slab) -> Any:
        if isinstance(node, Prism):
            return extruded_manifold(self.corners_mm(node.outline), node.low_mm, node.high_mm)
        if isinstance(node, Rod):
            start, end = np.array([node.start_mm]), np.array([node.end_mm])
            sides = sides_for(node.radius_mm, self.tolerance_mm)
            return to_manifold(prisms(start, end, node.radius_mm, sides))
        return to_manifold(wall_mesh(self.surface, node.wall, tolerance_mm=self.tolerance_mm))

    def corners_mm(self, outline: Outline) -> FloatArray:
        """Corners (n, 2) of an outline: arcs as polygons of equal area."""
        if isinstance(outline, Circle):
            sides = sides_for(outline.radius_mm, self.tolerance_mm)
            turn = 2.0 * np.pi * np.arange(sides) / sides
            ring = outline.radius_mm * widening(sides) * _unit(turn)
            return np.asarray(ring + np.array(outline.centre_mm))
        if isinstance(outline, Rect):
            return _rounded(outline, self.tolerance_mm)
        return np.array(outline.points_mm)


def _unit(turn: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(turn), np.sin(turn)])


def _rounded(outline: Rect, tolerance_mm: float) -> FloatArray:
    """Corners of a rounded rectangle: arcs of equal area, as those of a circle."""
    radius = outline.corner_mm
    if radius <= 0.0:
        return outline.arc_centres()
    steps = sides_for(radius, tolerance_mm) // 4
    out = []
    for number, centre in enumerate(outline.arc_centres()):
        turn = 0.5 * np.pi * (number + np.arange(steps + 1) / steps)
        arc = _unit(turn)
        # Ends stay on the straight sides; the corners between make up for their area too: a
        # quarter's area is 2 outer triangles (q·s/2) and n - 2 inner ones (q²·s/2), s = sin(π/2n).
        arc[1:-1] *= _equal_area(steps)
        out.append(centre + radius * arc)
    return np.concatenate(out)


def _equal_area(steps: int) -> float:
    """Factor q of the inner corners of a quarter circle in ``steps`` sides of the same area."""
    if steps < 3:
        return 1.0
    inner, whole = (steps - 2) / 2.0, np.pi / (4.0 * np.sin(0.5 * np.pi / steps))
    return float((np.sqrt(1.0 + 4.0 * inner * whole) - 1.0) / (2.0 * inner))
