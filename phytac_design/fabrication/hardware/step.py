"""Bodies of the STEP assembly: hardware, and the sensor with its switches."""

from typing import Any

from phytac_design.design.spec import Design
from phytac_design.fabrication.hardware.parts import COLOURS, HardwareAssembly
from phytac_design.fabrication.hardware.sensor_solids import SHELL, SWITCH_mm, switch_frames
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.cad import CadBody, revolved_cad, shell_cad, wall_cad
from phytac_shapes import Surface


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


def sensor_bodies(sensor: Sensor, switches: SwitchSet) -> list[CadBody]:
    """Whole shell, and each switch in its receptor; switches of one kind share a shape."""
    surface, markers = sensor.surface, sensor.markers
    bodies = [CadBody(name=SHELL, shape=shell_cad(sensor), colour=COLOURS["shell"])]
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
