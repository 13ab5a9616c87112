"""Solids of an assembly: shell, switches and hardware, and how it comes apart."""

from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.fabrication.hardware.assembly import make_hardware
from phytac_design.fabrication.hardware.by_mesh import MeshKernel
from phytac_design.fabrication.hardware.parts import HardwareAssembly
from phytac_design.fabrication.switch_set import SwitchSet, revolve
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout import Markers
from phytac_design.solids.receptor_tubes import rim_sag_mm
from phytac_design.solids.solid_mesh import shell_manifold, to_manifold, to_triangles
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray

FINE = 0.1
"""Meshes of hardware are this much finer than the gaps between parts."""
SWITCH_mm = 0.03
"""Accuracy of switches in an assembly."""
LIFT_mm = 0.02
"""Glue line under a bowl: bodies that touch are drawn apart."""
SHELL_mm = 0.01
"""Accuracy of the shell under the bowls: less than the glue line."""
SHELL, SWITCHES = "shell", "switches"


def mesh_tolerance_mm(design: Design, asked_mm: float) -> float:
    """Accuracy of hardware meshes: as asked, but always well within the clearances."""
    return min(asked_mm, FINE * max(design.print_rules.clearance_mm, 0.05))


def hardware_solids(
    design: Design, surface: Surface, kit: HardwareAssembly, *, tolerance_mm: float
) -> dict[str, Any]:
    """All parts of a kit as manifolds, by name."""
    kernel = MeshKernel(surface, mesh_tolerance_mm(design, tolerance_mm))
    return {part.name: kernel.solid(part.node) for part in kit.parts}


def switch_frames(
    surface: Surface, markers: Markers, switches: SwitchSet
) -> tuple[FloatArray, FloatArray]:
    """Origins (n, 3) a glue line above the outer face, and rotations (n, 3, 3) of all switches.

    Where the face rises around the hole the bowl stands on its edge. The third column of a
    rotation is the switch's z: out of the sensor along the receptor's axis.
    """
    axis = -markers.direction
    helper = np.where(np.abs(axis[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    turn = np.stack([first, np.cross(axis, first), axis], axis=2)
    origin = surface.point(markers.uv)
    lift = np.full(markers.count, LIFT_mm)
    for number, bowl in enumerate(switches.bowls):
        _, low = rim_sag_mm(surface, markers, origin, bowl.diameter_mm / 2.0)
        own = switches.bowl == number
        lift[own] += np.maximum(-low[own], 0.0)
    return origin + lift[:, None] * axis, turn


def switch_mesh(surface: Surface, markers: Markers, switches: SwitchSet) -> TriangleMesh:
    """All switches in their receptors as one mesh of separate components."""
    origin, turn = switch_frames(surface, markers, switches)
    points: list[FloatArray] = []
    faces: list[IntArray] = []
    used = 0
    for kind in switches.kinds:
        mesh = revolve(switches.profile(kind, SWITCH_mm), SWITCH_mm)
        own = switches.markers_of(kind)
        placed = np.einsum("nij,vj->nvi", turn[own], mesh.vertices_mm) + origin[own, None]
        count = len(mesh.vertices_mm)
        starts = used + count * np.arange(len(own))
        points.append(placed.reshape(-1, 3))
        faces.append((mesh.triangles[None] + starts[:, None, None]).reshape(-1, 3))
        used += count * len(own)
    return TriangleMesh(vertices_mm=np.concatenate(points), triangles=np.concatenate(faces))


def sensor_solids(
    design: Design,
    surface: Surface,
    markers: Markers,
    switches: SwitchSet,
    *,
    tolerance_mm: float,
) -> dict[str, Any]:
    """Shell and switches as manifolds."""
    return {
        SHELL: shell_manifold(design, surface, markers, tolerance_mm=min(tolerance_mm, SHELL_mm)),
        SWITCHES: to_manifold(switch_mesh(surface, markers, switches)),
    }


def exploded_bodies(context: Context) -> dict[str, tuple[TriangleMesh, FloatArray]]:
    """Each body of the assembly and how far it is pulled out, (3,) mm, in an exploded picture.

    The shell stays; the switches have no way of their own (each goes out along its receptor): they
    are left out. Empty if the design has no hardware.

    Raises
    ------
    DesignError
        If the hardware cannot be made.
    """
    design, surface = context.design, context.surface
    kit = make_hardware(design, surface)
    tolerance = context.accuracy.cad_tolerance_mm
    solids = hardware_solids(design, surface, kit, tolerance_mm=tolerance)
    bodies = {
        part.name: (to_triangles(solids[part.name]), np.array(part.step_mm)) for part in kit.parts
    }
    if bodies:
        shell = shell_manifold(design, surface, context.markers, tolerance_mm=tolerance)
        bodies[SHELL] = (to_triangles(shell), np.zeros(3))
    return bodies


def context_solids(context: Context, kit: HardwareAssembly, switches: SwitchSet) -> dict[str, Any]:
    """Shell, switches and hardware of a design."""
    design, surface, markers = context.design, context.surface, context.markers
    tolerance = context.accuracy.cad_tolerance_mm
    solids = sensor_solids(design, surface, markers, switches, tolerance_mm=tolerance)
    return solids | hardware_solids(design, surface, kit, tolerance_mm=tolerance)
