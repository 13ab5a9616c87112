"""Solids of an assembly: shell, switches and hardware, and its exploded view."""

from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.by_mesh import MeshKernel
from phytac_design.fabrication.hardware.hardware_assembly import make_hardware
from phytac_design.fabrication.hardware.parts import HardwareAssembly
from phytac_design.fabrication.switch_set import SwitchSet, revolve
from phytac_design.geometry.triangles import TriangleMesh, copies, frames_along, merged
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.receptor_tubes import rim_sag_mm
from phytac_design.solids.solid_mesh import shell_manifold, to_manifold, to_triangles
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

SWITCH_mm = 0.03
"""Accuracy of switches in an assembly."""
SHELL, SWITCHES = "shell", "switches"


def mesh_tolerance_mm(design: Design, tolerance_mm: float) -> float:
    """Accuracy of hardware meshes: as requested, but well within the clearances."""
    fine = 0.1  # meshes of hardware are this much finer than the gaps between parts
    return min(tolerance_mm, fine * max(design.print_rules.clearance_mm, 0.05))


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
    lift_mm = 0.02  # glue line under a bowl: bodies that touch are drawn apart
    axis = -markers.direction
    origin = surface.point(markers.uv)
    lift = np.full(markers.count, lift_mm)
    for number, bowl in enumerate(switches.bowls):
        _, low = rim_sag_mm(surface, markers, origin, bowl.diameter_mm / 2.0)
        own = switches.bowl == number
        lift[own] += np.maximum(-low[own], 0.0)
    return origin + lift[:, None] * axis, frames_along(axis)


def switch_mesh(
    surface: Surface, markers: Markers, switches: SwitchSet, *, tolerance_mm: float = SWITCH_mm
) -> TriangleMesh:
    """All switches in their receptors as one mesh of separate components."""
    origin, turn = switch_frames(surface, markers, switches)
    meshes = []
    for kind in switches.kinds:
        own = switches.markers_of(kind)
        mesh = revolve(switches.profile(kind, tolerance_mm), tolerance_mm)
        meshes.append(copies(mesh, origin[own], turn[own]))
    return merged(meshes)


def sensor_solids(sensor: Sensor, switches: SwitchSet, *, tolerance_mm: float) -> dict[str, Any]:
    """Shell, and switches if there are any, as manifolds."""
    surface, markers = sensor.surface, sensor.markers
    shell_mm = 0.01  # accuracy of the shell under the bowls: less than the glue line
    fine = min(tolerance_mm, shell_mm)
    solids = {SHELL: shell_manifold(sensor, tolerance_mm=fine, glued=True)}
    if switches.kinds:
        solids[SWITCHES] = to_manifold(switch_mesh(surface, markers, switches))
    return solids


def exploded_bodies(
    sensor: Sensor, *, tolerance_mm: float
) -> dict[str, tuple[TriangleMesh, FloatArray]]:
    """Each body of the assembly and its shift (3,) mm in an exploded picture.

    The shell stays; the switches, each of which moves along its own receptor, are left out. Empty
    if the design has no hardware.

    Raises
    ------
    DesignError
        If the hardware cannot be made.
    """
    design, surface = sensor.design, sensor.surface
    kit = make_hardware(design, surface)
    solids = hardware_solids(design, surface, kit, tolerance_mm=tolerance_mm)
    bodies = {
        part.name: (to_triangles(solids[part.name]), np.array(part.step_mm)) for part in kit.parts
    }
    if bodies:
        shell = shell_manifold(sensor, tolerance_mm=tolerance_mm, glued=True)
        bodies[SHELL] = (to_triangles(shell), np.zeros(3))
    return bodies
