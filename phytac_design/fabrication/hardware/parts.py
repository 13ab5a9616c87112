"""Parts of the hardware, printed and bought, and what a builder of parts hands back."""

from dataclasses import dataclass, field, replace

import numpy as np

from phytac_design.fabrication.hardware.screws import Joint
from phytac_design.fabrication.hardware.solid_nodes import Far, Node, Point3, Union
from phytac_shapes.arrays import FloatArray

COLOURS: dict[str, tuple[float, float, float]] = {
    "resin": (0.84, 0.82, 0.77),
    "shell": (0.62, 0.74, 0.86),
    "tpu": (0.85, 0.20, 0.18),
    "electronics": (0.16, 0.42, 0.25),
    "light": (0.98, 0.90, 0.45),
    "steel": (0.55, 0.56, 0.58),
}
"""Display colours by material, red, green, blue from 0 to 1."""


@dataclass(frozen=True)
class HardwarePart:
    """One body of the assembly.

    Attributes
    ----------
    name : str
        As in the assembly; printed ones are ``fixtures/NAME.stl``.
    node : Node
        Its solid.
    material : str
        ``resin`` if printed, else ``electronics``, ``light`` or ``steel``.
    step_mm : point
        Way that it moves in an exploded picture, along its assembly direction.
    note : str
        What it is, for the bill of materials.
    """

    name: str
    node: Node
    material: str
    step_mm: Point3 = (0.0, 0.0, 0.0)
    note: str = ""

    @property
    def printed(self) -> bool:
        """Whether it gets files of its own."""
        return self.material == "resin"


@dataclass(frozen=True, kw_only=True)
class HardwareAssembly:
    """Parts and joints together; ``left_out`` says what could not be made, and why.

    ``clearances_mm`` are gaps between parts that go together, by what they are between;
    ``openings_mm`` are points in gaps and holes through which light might find a way.
    """

    parts: tuple[HardwarePart, ...] = ()
    joints: tuple[Joint, ...] = ()
    left_out: dict[str, str] = field(default_factory=dict)
    clearances_mm: dict[str, float] = field(default_factory=dict)
    openings_mm: tuple[Point3, ...] = ()

    def __add__(self, other: "HardwareAssembly") -> "HardwareAssembly":
        return HardwareAssembly(
            parts=self.parts + other.parts,
            joints=self.joints + other.joints,
            left_out=self.left_out | other.left_out,
            clearances_mm=self.clearances_mm | other.clearances_mm,
            openings_mm=self.openings_mm + other.openings_mm,
        )

    def at_far(self, z_mm: float) -> "HardwareAssembly":
        """Return the kit at the far end whose rim's root lies at ``z_mm``."""
        turn = np.array([1.0, -1.0, -1.0])

        def point(p: Point3, shift: float) -> Point3:
            x, y, z = (np.array(p) * turn + np.array([0.0, 0.0, shift])).tolist()
            return (x, y, z)

        parts = tuple(
            replace(part, node=Far(part.node, z_mm), step_mm=point(part.step_mm, 0.0))
            for part in self.parts
        )
        joints = tuple(
            replace(
                joint,
                seats_mm=tuple(point(p, z_mm) for p in joint.seats_mm),
                directions=tuple(point(p, 0.0) for p in joint.directions),
            )
            for joint in self.joints
        )
        openings = tuple(point(p, z_mm) for p in self.openings_mm)
        return replace(self, parts=parts, joints=joints, openings_mm=openings)

    def screws(self) -> tuple[HardwarePart, ...]:
        """Screws of all joints as parts."""
        out = []
        for joint in self.joints:
            step = 1.6 * joint.length_mm + 8.0
            for number, bodies in enumerate(joint.screws(), start=1):
                way: FloatArray = -step * np.array(joint.directions[number - 1])
                x, y, z = (way + np.array(self._step(joint))).tolist()
                out.append(
                    HardwarePart(
                        f"screw_{joint.name}_{number}",
                        Union(bodies),
                        "steel",
                        (x, y, z),
                        screw_name(joint),
                    )
                )
        return tuple(out)

    def _step(self, joint: Joint) -> Point3:
        """Movement of the part that carries a joint's heads, or its set screws."""
        name = joint.head_part if joint.thread != "set" else joint.thread_part
        return next((part.step_mm for part in self.parts if part.name == name), (0.0, 0.0, 0.0))


def screw_name(joint: Joint) -> str:
    """Standard name of a joint's screws."""
    standard = "ISO 4026" if joint.thread == "set" else "ISO 4762"
    return f"{standard} {joint.screw.name} x {joint.length_mm:g}"
