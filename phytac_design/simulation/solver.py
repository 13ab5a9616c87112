"""How the wall of a virtual sensor moves under the touches of one sample."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.mechanics.large.quasi_newton import QuasiNewtonSolver
from phytac_design.mechanics.shell.pressure import Holes, indentation_loads
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.instance_shell import instance_shell
from phytac_design.simulation.receptor_kinematics import ReceptorKinematics
from phytac_design.simulation.sample_plan import ChartBox
from phytac_design.simulation.sensor_instance import SensorInstance
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import PhytacError

Displacement = Literal["linear", "large", "auto"]
Theory = Literal["rest", "linear", "large"]


@dataclass(frozen=True, kw_only=True)
class SampleMotion:
    """Motion of one sample.

    Attributes
    ----------
    motion : (n, 6) float or None
        Translation (mm) of the middle face under each marker, and rotation vector (rad) of the
        tube that stands there.
    status : str
        ``ok``; ``flagged``: an equilibrium that is unstable, not known to be stable, or reached
        by a jump, or linear motion by more than the wall's thickness; ``failed``: no motion.
    reason : str
        Why it is not ``ok``; else empty.
    theory : str
        ``rest``, ``linear`` or ``large``: what was solved.
    error_estimate : float
        Error of theory and iteration over the greatest translation; that of the mesh is not part
        of it. NaN where it was not looked for (``linear`` set) or nothing was found.
    guarded : str
        Why the slow, path-following method was taken; "" where it was not.
    """

    motion: FloatArray | None
    status: Literal["ok", "flagged", "failed"]
    reason: str
    theory: Theory
    error_estimate: float
    guarded: str = ""


class Solver:
    """The wall of one virtual sensor; built once, for many samples.

    What is found depends on the sample alone, bit for bit, not on those before it.

    Parameters
    ----------
    design, surface : Design, Surface
        The sensor as designed.
    unit : SensorInstance
        How this instance differs.
    refine : int
        Elements of the mesh per marker pitch (``accuracy.PRESETS``).
    displacement : str
        ``linear``, ``large``, or ``auto``: linear in the samples where its estimated error, with
        its safety, is within the tolerance, and large in the others.
    tolerance : float
        Error that ``auto`` leaves, over the greatest translation.
    region : ChartBox, optional
        The touched part of the chart; None: all of it.
    local : bool
        Whether the mesh is fine in that part alone.

    Attributes
    ----------
    kinematics : ReceptorKinematics
        How the receptors move with the wall.
    nodes : int
        Of the mesh.
    """

    def __init__(
        self,
        design: Design,
        surface: Surface,
        unit: SensorInstance,
        *,
        refine: int,
        displacement: Displacement = "auto",
        tolerance: float = 0.01,
        region: ChartBox | None = None,
        local: bool = True,
    ) -> None:
        self.surface = surface
        self.displacement, self.tolerance = displacement, tolerance
        self.mesh, self.model = instance_shell(design, surface, unit, refine, region, local=local)
        self.nodes = len(self.mesh.nodes_mm)
        self.count = unit.markers.count
        receptor = design.receptor
        self.kinematics = ReceptorKinematics(
            self.mesh, surface, unit.markers.uv, receptor.diameter_tube_mm / 2.0
        )
        self._holes = Holes.of(surface, unit.markers.uv, receptor.diameter_hole_mm / 2.0)
        self._shell = QuasiNewtonSolver(self.model)
        self.deepest_mm = float(np.sort(np.ptp(surface.bounds_mm(), axis=0))[1]) / 2.0

    def solve(self, touches: Contacts, felt_N: FloatArray) -> SampleMotion:
        """Motion under the touches of one sample, whatever becomes of it; never an exception.

        Parameters
        ----------
        touches : Contacts
            Contacts of the sample; their ``force_N`` is not used.
        felt_N : (c,) float
            Force that each presses with.
        """
        if len(felt_N) == 0 or not np.any(felt_N):
            return SampleMotion(
                motion=np.zeros((self.count, 6)),
                status="ok",
                reason="",
                theory="rest",
                error_estimate=0.0,
            )
        theory: Theory = "linear" if self.displacement == "linear" else "large"
        try:
            force = self.load(touches, felt_N)
            linear = self._shell.linear(force)
            dent = self._refuse_deep(linear)
        except (PhytacError, ArithmeticError, MemoryError, ValueError) as error:
            return _failed(str(error) or type(error).__name__, theory)
        if self.displacement == "linear":
            reason = self._too_deep(dent)
            return SampleMotion(
                motion=self.kinematics.linear(linear),
                status="flagged" if reason else "ok",
                reason=reason,
                theory="linear",
                error_estimate=float("nan"),
            )
        tolerance = self.tolerance if self.displacement == "auto" else None
        found = self._shell.solve(force, tolerance=tolerance, linear=linear)
        if found.motion is None or not np.all(np.isfinite(found.motion)):
            return _failed(found.reason or "the motion is not finite", theory, found.guarded)
        theory = "large" if found.large else "linear"
        moved = self.kinematics.large if found.large else self.kinematics.linear
        return SampleMotion(
            motion=moved(found.motion),
            status=found.status,
            reason=found.reason,
            theory=theory,
            error_estimate=found.error,
            guarded=found.guarded,
        )

    def load(self, touches: Contacts, felt_N: FloatArray) -> FloatArray:
        """Nodal load (6N,) of one sample; nothing presses on the receptors' holes."""
        unit = indentation_loads(self.mesh, self.surface, touches, holes=self._holes)
        return np.asarray(unit @ felt_N).ravel()

    def _too_deep(self, dent: float) -> str:
        """Why linear motion says little; "" where the wall moves by less than its thickness."""
        thickness = self.mesh.thickness_mm
        if dent <= thickness:
            return ""
        return (
            f"linear theory has the wall pressed in by {dent:.3g} mm, more than its thickness of "
            f"{thickness:.3g} mm, where it is far off; use displacement large or auto"
        )

    def _refuse_deep(self, linear: FloatArray) -> float:
        """How far loads press the wall in, mm; rejected if by more than the sensor has.

        Raises
        ------
        ArithmeticError
            If they would, by linear theory.
        """
        moved = linear.reshape(-1, 6)[:, :3]
        # Motions of any size are squared without an overflow.
        scale = float(np.abs(moved).max()) or 1.0
        dent = scale * float(np.linalg.norm(moved / scale, axis=1).max())
        if not dent <= self.deepest_mm:
            raise ArithmeticError(
                f"the touches are too strong for this wall: linear theory has it pressed in by "
                f"{dent:.3g} mm, and the sensor is {self.deepest_mm:.3g} mm from its middle to its "
                "side; lower the forces or raise wall.thickness_mm"
            )
        return dent


def _failed(reason: str, theory: Theory, guarded: str = "") -> SampleMotion:
    return SampleMotion(
        motion=None,
        status="failed",
        reason=reason,
        theory=theory,
        error_estimate=float("nan"),
        guarded=guarded,
    )
