"""A sphere pressed on a sensor in MuJoCo with a known force, and how its decoder reads that."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from phytac_decoder.pipeline.frame_reading import Reading
from phytac_design.design.spec import Design
from phytac_design.fabrication.simulators.simulator_part import base_z_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.shell.pressure import tangent_frame
from phytac_design.simulation.contacts import Contacts
from phytac_design.workflows.export_simulator import export_simulator
from phytac_shapes.arrays import FloatArray

BALL_m = 0.003
"""Radius of the sphere."""
STEPS = 250
"""Of a millisecond: what rings after the ball has touched has then decayed."""


@dataclass(kw_only=True)
class PressRig:
    """A model in which a ball slides along an axis that can be set anywhere.

    Attributes
    ----------
    sensor : Sensor
        The sensor as designed.
    model, data : mujoco.MjModel, mujoco.MjData
        Its part as ``palm/base``, and the ball.
    radius_mm : float
        Patch of the next press.
    """

    sensor: Sensor
    model: Any
    data: Any
    radius_mm: float = 5.0

    @classmethod
    def of(cls, design: Design) -> "PressRig":
        """Export the design and put the ball beside it."""
        spec = mujoco.MjSpec.from_string(
            '<mujoco><option gravity="0 0 0" timestep="0.001"/></mujoco>'
        )
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "part"
            export_simulator(design, out, to="mjcf", progress=lambda _: None)
            part = mujoco.MjSpec.from_file(str(out / f"{design.name}.xml"))
            spec.attach(part, prefix="palm/", frame=spec.worldbody.add_frame())
            pusher = spec.worldbody.add_body(name="pusher", mocap=True, pos=[1.0, 0.0, 0.0])
            ball = pusher.add_body(name="ball")
            joint = ball.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
            joint.damping[0] = 100.0
            # MuJoCo's contacts are soft: a light ball would sink in by millimetres.
            ball.add_geom(size=[BALL_m, 0.0, 0.0], mass=1.0, solref=[0.004, 1.0], solmix=1e6)
            model = spec.compile()
        return cls(sensor=Sensor(design), model=model, data=mujoco.MjData(model))

    def press(self, uv: FloatArray, force_N: float, radius_mm: float) -> None:
        """Press along the normal at a chart position (2,), until nothing moves."""
        surface, data = self.sensor.surface, self.data
        point, normal = surface.point(uv[None])[0], surface.normal(uv[None])[0]
        along = tangent_frame(surface, uv[None])[0]
        mujoco.mj_resetData(self.model, data)
        base = np.array([0.0, 0.0, base_z_mm(Sensor(self.sensor.design))])
        data.mocap_pos[0] = 1e-3 * (point - base) + (BALL_m + 2e-4) * normal
        axes = np.stack([along[0], np.cross(normal, along[0]), normal], axis=1)
        mujoco.mju_mat2Quat(data.mocap_quat[0], axes.ravel())
        data.qfrc_applied[0] = -force_N
        self.radius_mm = radius_mm
        mujoco.mj_step(self.model, data, nstep=STEPS)


def found_beside(reading: Reading, point_mm: FloatArray, near_mm: float) -> tuple[float, float]:
    """Force and standard deviation of what was found nearest to a point; NaN if nothing near."""
    if not reading.found or not reading.found.contacts:
        return np.nan, np.nan
    each = reading.found.contacts
    gap = [float(np.linalg.norm(one.point_mm - point_mm)) for one in each]
    best = int(np.argmin(gap))
    if gap[best] > near_mm:
        return np.nan, np.nan
    return each[best].force_N, each[best].sd_N


def only(contacts: Contacts, row: int) -> Contacts:
    """One contact, as the only one."""
    return contacts.pick(np.array([row]), [int(contacts.sample[row])])
