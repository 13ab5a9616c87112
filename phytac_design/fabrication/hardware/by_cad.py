"""Hardware, shell and switches as exact CAD (OpenCASCADE through CadQuery)."""

from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.parts import COLOURS, HardwareAssembly
from phytac_design.fabrication.hardware.sensor_solids import SHELL, SWITCH_mm, switch_frames
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
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.cad import CadBody, revolved_cad
from phytac_design.solids.cad_kernel import cadquery
from phytac_design.solids.cad_wall import wall_cad
from phytac_shapes import Surface
from phytac_shapes.errors import NumericalError


class CadKernel:
    """Evaluates descriptions around one surface."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self._cq = cadquery()

    def solid(self, node: Node) -> Any:
        """Return the solid as a CadQuery shape of one or more solids.

        Raises
        ------
        NumericalError
            If OpenCASCADE returns none.
        """
        solids = self._raw(node).Solids()
        if not solids:
            raise NumericalError(
                "hardware-without-solid",
                "a part of the hardware has no CAD solid; please report the design",
            )
        return solids[0] if len(solids) == 1 else self._cq.Compound.makeCompound(solids)

    def _raw(self, node: Node) -> Any:
        cq = self._cq
        if isinstance(node, Prism | Rod | Slab):
            return self._simple(node)
        if isinstance(node, Union):
            first, *rest = [self._raw(part) for part in node.parts]
            return first.fuse(*rest) if rest else first
        if isinstance(node, Difference):
            return self._raw(node.body).cut(*(self._raw(tool) for tool in node.tools))
        if isinstance(node, Intersection):
            return self._raw(node.first).intersect(self._raw(node.second))
        turned = self._raw(node.node).rotate(cq.Vector(0, 0, 0), cq.Vector(1, 0, 0), 180.0)
        return turned.translate(cq.Vector(0.0, 0.0, node.z_mm))

    def _simple(self, node: Prism | Rod | Slab) -> Any:
        cq = self._cq
        if isinstance(node, Prism):
            wire = self._wire(node.outline, node.low_mm)
            way = cq.Vector(0.0, 0.0, node.high_mm - node.low_mm)
            return cq.Solid.extrudeLinear(wire, [], way)
        if isinstance(node, Rod):
            start, end = np.array(node.start_mm), np.array(node.end_mm)
            way = end - start
            length = float(np.linalg.norm(way))
            return cq.Solid.makeCylinder(
                node.radius_mm, length, cq.Vector(*start.tolist()), cq.Vector(*way.tolist())
            )
        return wall_cad(self.surface, node.wall)

    def _wire(self, outline: Outline, z_mm: float) -> Any:
        cq = self._cq
        if isinstance(outline, Circle):
            centre = cq.Vector(*outline.centre_mm, z_mm)
            return cq.Wire.makeCircle(outline.radius_mm, centre, cq.Vector(0.0, 0.0, 1.0))
        if isinstance(outline, Rect):
            if outline.corner_mm > 0.0:
                return self._rounded(outline, z_mm)
            corners = outline.arc_centres()
        else:
            corners = np.array(outline.points_mm)
        points = [cq.Vector(x, y, z_mm) for x, y in corners.tolist()]
        return cq.Wire.makePolygon(points, close=True)

    def _rounded(self, outline: Rect, z_mm: float) -> Any:
        cq = self._cq
        edges, ends = [], []
        for number, centre in enumerate(outline.arc_centres()):
            turn = 0.5 * np.pi * (number + np.array([0.0, 0.5, 1.0]))
            arc = centre + outline.corner_mm * np.column_stack([np.cos(turn), np.sin(turn)])
            points = [cq.Vector(x, y, z_mm) for x, y in arc.tolist()]
            edges.append(cq.Edge.makeThreePointArc(*points))
            ends.append((points[0], points[2]))
        for number in range(4):
            start, end = ends[number][1], ends[(number + 1) % 4][0]
            if (end - start).Length > 1e-9:
                edges.append(cq.Edge.makeLine(start, end))
        return cq.Wire.assembleEdges(edges)


def hardware_bodies(kit: HardwareAssembly, shapes: dict[str, Any]) -> list[CadBody]:
    """Parts of a kit with their colours."""
    return [
        CadBody(name=part.name, shape=shapes[part.name], colour=COLOURS[part.material])
        for part in kit.parts
    ]


def wall_body(design: Design, surface: Surface) -> CadBody:
    """Wall and rims alone, for quick assemblies."""
    wall = "shell_without_receptors"
    return CadBody(name=wall, shape=wall_cad(surface, design.wall), colour=COLOURS["shell"])


def sensor_bodies(sensor: Sensor, switches: SwitchSet, shell: Any) -> list[CadBody]:
    """Whole shell, and each switch in its receptor; switches of one kind share a shape.

    ``shell`` is that of :func:`phytac_design.solids.cad.shell_cad`, with its inserts.
    """
    surface, markers = sensor.surface, sensor.markers
    bodies = [CadBody(name=SHELL, shape=shell, colour=COLOURS["shell"])]
    origin, turn = switch_frames(surface, markers, switches)
    for kind in switches.kinds:
        shape = revolved_cad(switches.profile(kind, SWITCH_mm))
        bodies.extend(
            CadBody(
                name=f"switch_{marker:04d}",
                shape=shape,
                colour=COLOURS["tpu"],
                frame=(origin[marker], turn[marker]),
            )
            for marker in switches.markers_of(kind).tolist()
        )
    return bodies
