"""Report of the hardware: parts, joints, gaps, and results of the checks."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.fabrication.bill import bill_part
from phytac_design.fabrication.hardware.checks import (
    JointHoles,
    hidden_rays,
    inside_places,
    light_leaks,
    meets,
    sides_of_joint,
)
from phytac_design.fabrication.hardware.parts import HardwareAssembly, HardwarePart, screw_name
from phytac_design.fabrication.hardware.sensor_solids import SHELL, SWITCHES
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.geometry.triangles import merged
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import to_triangles
from phytac_design.solids.wall_mesh import wall_mesh
from phytac_shapes.errors import DesignError

COARSE_mm = 0.05
"""Accuracy of the wall in the check for light leaks."""


@dataclass(frozen=True, kw_only=True)
class AssemblyChecks:
    """Results of all checks of one assembly.

    Attributes
    ----------
    bodies, pairs : int
        Bodies compared, and pairs of them.
    meets_mm3 : dict
        Common volume of each pair that shares any.
    sides : tuple of JointHoles
        Measured screw sizes of each joint.
    uncovered : int
        Receptors' holes that no bowl covers.
    leaks, rays : int
        Rays from inside that find a way out, and all that were sent.
    hidden, lines : int
        Lines from cameras to markers that hardware cuts, and all.
    """

    bodies: int
    pairs: int
    meets_mm3: dict[str, float]
    sides: tuple[JointHoles, ...]
    uncovered: int
    leaks: int
    rays: int
    hidden: int
    lines: int

    def raise_failure(self) -> None:
        """Raise a ``DesignError`` for the first failed check."""
        if self.meets_mm3:
            pair, volume = max(self.meets_mm3.items(), key=lambda item: item[1])
            one, other = pair.split(" / ")
            raise DesignError(
                "hardware-collides",
                f"{one} and {other} of the hardware collide (they share {volume:.3g} mm³); correct "
                "the sizes of board and lens in [hardware], or raise hardware.wall_mm or "
                "hardware.front_room_mm",
            )
        wrong = [sides for sides in self.sides if not sides.agree]
        if wrong:
            raise DesignError(
                "screw-holes-misaligned",
                f"the screw holes of the joint {wrong[0].joint!r} do not match: the part that "
                f"screws pass is made for {' '.join(sorted(set(wrong[0].passing))) or 'none'}, the "
                f"part that holds them for {' '.join(sorted(set(wrong[0].holding))) or 'none'}; "
                "please report this design",
            )
        if self.uncovered or self.leaks:
            raise DesignError(
                "light-leaks",
                f"light gets into the sensor: {self.uncovered} receptor holes that no bowl "
                f"covers, {self.leaks} of {self.rays} lines of sight to the outside; raise "
                "hardware.wall_mm, or switch.footprint_diameter_mm above the holes",
            )
        if self.hidden:
            raise DesignError(
                "hardware-hides-markers",
                f"the hardware hides markers: it cuts {self.hidden} of {self.lines} lines of sight "
                "from the camera; raise camera.stand_off_mm, or correct hardware.lens_length_mm",
            )


def verdict(
    sensor: Sensor,
    switches: SwitchSet,
    cameras: list[Camera],
    kit: HardwareAssembly,
    solids: Mapping[str, Any],
) -> AssemblyChecks:
    """Run all checks on an assembly of shell, switches and hardware."""
    design, surface = sensor.design, sensor.surface
    meshes = {
        name: to_triangles(body) for name, body in solids.items() if name not in (SHELL, SWITCHES)
    }
    places = inside_places(design, surface, kit, cameras)
    wall = wall_mesh(surface, design.wall, tolerance_mm=COARSE_mm)
    leaks, rays = light_leaks(merged([wall, *meshes.values()]), places)
    # A camera looks out through its own lens.
    opaque = [meshes[name] for name in meshes if not name.startswith("camera")]
    hidden, lines = hidden_rays(sensor, cameras, merged(opaque))
    bowl = [switches.bowls[k].diameter_mm for k in switches.bowl]
    count = len(solids)
    return AssemblyChecks(
        bodies=count,
        pairs=count * (count - 1) // 2,
        meets_mm3=meets(solids),
        sides=tuple(sides_of_joint(joint, meshes) for joint in kit.joints),
        uncovered=sum(size <= design.receptor.diameter_cover_mm for size in bowl),
        leaks=leaks,
        rays=rays,
        hidden=hidden,
        lines=lines,
    )


def hardware_facts(
    design: Design, kit: HardwareAssembly, found: AssemblyChecks, solids: Mapping[str, Any]
) -> dict[str, Any]:
    """Figures of a finished assembly as plain values."""
    return {
        "parts": parts_list(kit, solids),
        "joints": [
            {
                "joint": joint.name,
                "screw": screw_name(joint),
                "size": joint.screw.name,
                "length_mm": joint.length_mm,
                "count": len(joint.seats_mm),
                "thread": joint.thread,
                "head_part": joint.head_part,
                "thread_part": joint.thread_part,
                "measured_head_side": sorted(set(sides.passing)),
                "measured_thread_side": sorted(set(sides.holding)),
                "agree": sides.agree,
            }
            for joint, sides in zip(kit.joints, found.sides, strict=True)
        ],
        "clearances_mm": kit.clearances_mm,
        "interference": {
            "bodies": found.bodies,
            "pairs": found.pairs,
            "shared_mm3": sum(found.meets_mm3.values()),
        },
        "light": {
            "holes_uncovered": found.uncovered,
            "leaks": found.leaks,
            "lines_checked": found.rays,
        },
        "view": {"lines_cut": found.hidden, "lines_checked": found.lines},
        "left_out": kit.left_out,
        "hardware_board": design.hardware.board,
    }


def parts_list(kit: HardwareAssembly, solids: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Printed and bought parts with count, material and volume; equal bought ones are one entry."""
    groups: dict[str, list[HardwarePart]] = {}
    for part in kit.parts:
        groups.setdefault(part.name if part.printed else part.note, []).append(part)
    out = []
    for equal in groups.values():
        part = equal[0]
        steel = part.material == "steel"
        name = f"screw {part.note}" if steel else part.name.replace("_", " ")
        out.append(
            bill_part(
                name if len(equal) == 1 or steel else name.removesuffix(" 1"),
                file=f"fixtures/{part.name}.stl" if part.printed else "",
                count=len(equal),
                material="electronics" if part.material == "light" else part.material,
                volume_mm3=float(solids[part.name].volume()),
                note="hexagon socket" if steel else part.note,
            )
        )
    out.extend(
        bill_part(
            f"heat-set insert {joint.screw.name}",
            count=len(joint.seats_mm),
            material="brass",
            note=f"brass, hole {joint.screw.insert_mm:g} mm, for {joint.name}",
        )
        for joint in kit.joints
        if joint.thread == "heat-set"
    )
    return out
