"""A gripper in MuJoCo: a finger with a sensor closes on an object before a rigid pad, and lifts it.

The grip is along x, up is z. The sensor's face points along +x at the middle of its chart, with
its axis level. The object is two shells on springs, which give it its stiffness: one meets the
sensor, the other the pad. It slides along x and z alone, so that it does not tip, and stands on the
end of its slide.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.environments.grasped_objects import GraspedObject
from phytac_design.fabrication.simulators.simulator_part import base_z_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.shell.pressure import tangent_frame
from phytac_design.workflows.export_simulator import export_simulator
from phytac_design.workflows.mujoco_sensor import mujoco_library

PREFIX = "finger/"
"""Of the sensor's names in the model."""
GAP_mm, STROKE_mm, LIFT_mm = 8.0, 60.0, 100.0
"""From the open finger to the object; the longest closing and lift."""
CLOSING_mm_s, LIFTING_mm_s = 15.0, 60.0
"""Fastest closing and lifting."""
SHELL_kg = 0.01
"""Of each shell of an object, part of its mass."""

MODEL = """
<mujoco>
 <option timestep="0.001" integrator="implicitfast" cone="elliptic" impratio="10"/>
 <worldbody>
  <body name="hand">
   <joint name="lift" type="slide" axis="0 0 1"/>
   <geom type="box" size="0.005 0.03 0.03" pos="{pad} 0 0" mass="0.5" contype="2" conaffinity="0"/>
   <body name="finger" pos="{finger} 0 0">
    <joint name="close" type="slide" axis="1 0 0"/>
    <inertial pos="0 0 0" mass="0.3" diaginertia="1e-4 1e-4 1e-4"/>
   </body>
  </body>
  <body name="object">
   <joint name="rise" type="slide" axis="0 0 1" limited="true" range="0 1"/>
   <joint name="slide" type="slide" axis="1 0 0" damping="2"/>
   <inertial pos="0 0 0" mass="{core}" diaginertia="1e-4 1e-4 1e-4"/>
   <body name="near">
    <joint name="near" type="slide" axis="1 0 0" damping="10"/>
    <geom name="near" {shape} mass="{shell}" {contact} contype="0" conaffinity="1"/>
   </body>
   <body name="far">
    <joint name="far" type="slide" axis="1 0 0" damping="10"/>
    <geom name="far" {shape} mass="{shell}" {contact} contype="0" conaffinity="2"/>
   </body>
  </body>
 </worldbody>
 <actuator>
  <intvelocity name="close" joint="close" kp="50000" dampratio="1" actrange="0 {stroke}"/>
  <intvelocity name="lift" joint="lift" kp="50000" dampratio="1" actrange="0 {highest}"/>
 </actuator>
</mujoco>
"""


@dataclass(frozen=True, kw_only=True)
class GripperModel:
    """The gripper's simulation.

    Attributes
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
        With the sensor's body as :attr:`body`.
    """

    model: Any
    data: Any
    body: str = f"{PREFIX}base"

    @classmethod
    def of(cls, design: Design, thing: GraspedObject) -> "GripperModel":
        """Export a design and put an object before it."""
        mujoco, sensor = mujoco_library(), Sensor(design)
        radius = 1e-3 * thing.radius_mm
        sizes = {"cylinder": (radius, 0.05), "sphere": (radius, 0.0)}[thing.shape]
        spec = mujoco.MjSpec.from_string(
            MODEL.format(
                pad=radius + 0.006,
                finger=-radius - 1e-3 * GAP_mm,
                core=thing.mass_kg - 2.0 * SHELL_kg,
                shell=SHELL_kg,
                shape=f'type="{thing.shape}" size="{sizes[0]} {sizes[1]}"',
                # The object's friction counts, and no light shell sinks in.
                contact=f'friction="{thing.friction} 0.005 0.0001" priority="1" solref="0.004 1"',
                stroke=1e-3 * STROKE_mm,
                highest=1e-3 * LIFT_mm,
            )
        )
        uv = sensor.surface.domain.mean(axis=1)[None]
        point, normal = sensor.surface.point(uv)[0], sensor.surface.normal(uv)[0]
        along, across = (part[0] for part in tangent_frame(sensor.surface, uv))
        turn = np.stack([normal, along, across])
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, turn.ravel())
        origin = np.array([0.0, 0.0, base_z_mm(sensor)])
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "part"
            export_simulator(design, out, to="mjcf", receptors=False, progress=lambda _: None)
            part = mujoco.MjSpec.from_file(str(out / f"{design.name}.xml"))
            frame = spec.body("finger").add_frame(
                pos=1e-3 * turn @ (origin - point), quat=quaternion
            )
            spec.attach(part, prefix=PREFIX, frame=frame)
            model = spec.compile()
        return cls(model=model, data=mujoco.MjData(model))

    def reset(self, stiffness_N_mm: float) -> None:
        """Open the hand before an object of a stiffness."""
        for name in ("near", "far"):
            joint = self.model.joint(name).id
            # Two springs in series.
            self.model.jnt_stiffness[joint] = 2e3 * stiffness_N_mm
        mujoco = mujoco_library()
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)

    def command(self, closing: float, lifting: float, filling_N: float) -> None:
        """Set closing and lifting, as shares of the fastest, and the weight of what is inside."""
        self.data.ctrl[:] = (1e-3 * CLOSING_mm_s * closing, 1e-3 * LIFTING_mm_s * lifting)
        self.data.body("object").xfrc_applied[2] = -filling_N

    def moved_mm(self, joint: str) -> float:
        """How far a joint is from its start."""
        return 1e3 * float(self.data.joint(joint).qpos[0])
