"""Force against travel of a cup's tip: threshold, force at the stop, strain, clearance, bulge."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.mechanics.switch import switch_path
from phytac_design.mechanics.switch.hyperelastic import Material
from phytac_design.mechanics.switch.soft_cup import CupModel, SoftCup, cup_model
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class CupCurve:
    """Equilibria of a cup whose pressed face is pushed in; arrays run along the path.

    Attributes
    ----------
    pad_mm, tip_mm : (m,) float
        Ways of the pressed face and of the red tip, inward.
    force_N, slope_N_per_mm : (m,) float
        Force on the pressed face, and its slope by the tip's way.
    strain : (m,) float
        Largest principal stretch at the Gauss points, less 1.
    bore_mm, bulge_mm : (m,) float
        Smallest inner and largest outer radius of the side wall.
    negatives : (m,) int
        Negative eigenvalues of the axisymmetric tangent under dead load; −1 where unknown.
    points : list of PathPoint
        The equilibria themselves.
    body : CupModel
        The cup they are of.
    complete : bool
        Whether the path was followed to its end.
    """

    pad_mm: FloatArray
    tip_mm: FloatArray
    force_N: FloatArray
    slope_N_per_mm: FloatArray
    strain: FloatArray
    bore_mm: FloatArray
    bulge_mm: FloatArray
    negatives: IntArray
    points: list[switch_path.PathPoint]
    body: CupModel
    complete: bool

    @property
    def rising(self) -> int:
        """Number of points up to which force and travel of the tip grow."""
        falls = np.flatnonzero((self.slope_N_per_mm <= 0.0) | (self.negatives > 0))
        return int(falls[0]) if len(falls) else len(self.tip_mm)

    @property
    def reach_mm(self) -> float:
        """Travel of the tip up to which the force grows."""
        return float(self.tip_mm[self.rising - 1])

    def _force(self) -> Any:
        from scipy.interpolate import CubicHermiteSpline

        n = self.rising
        return CubicHermiteSpline(self.tip_mm[:n], self.force_N[:n], self.slope_N_per_mm[:n])

    def force_at(self, travel_mm: FloatArray | float) -> FloatArray:
        """Force, N, at travels of the tip within ``reach_mm``; NaN beyond."""
        travel = np.asarray(travel_mm, dtype=np.float64)
        within = (travel >= 0.0) & (travel <= self.reach_mm + 1e-9)
        return np.where(within, self._force()(travel), np.nan)

    def at(self, name: str, travel_mm: float) -> float:
        """Value of another array at a travel of the tip."""
        n = self.rising
        return float(np.interp(travel_mm, self.tip_mm[:n], getattr(self, name)[:n]))


def press_cup(
    cup: SoftCup, material: Material, *, travel_mm: float, refine: int = 1, steps: int = 12
) -> CupCurve:
    """Press a cup until its tip has made a way, or as far as its path can be followed.

    Parameters
    ----------
    cup : SoftCup
        The cup.
    material : Material
        Its rubber.
    travel_mm : float
        Way of the tip.
    refine : int
        Multiplies the elements each way.
    steps : int
        Steps to the end of the way; the path shortens them where it bends.

    Raises
    ------
    NumericalError
        If the cup cannot be pressed at all.
    """
    body = cup_model(cup, material, refine=refine)
    control = switch_path.PathControl(unknown=body.tip, end_mm=-travel_mm, steps=steps)
    complete = True
    try:
        points = switch_path.trace(body.model, body.load, control)
    except switch_path.PathError as error:
        points, complete = error.points, False
    if len(points) < 2:
        raise NumericalError(
            "switch-not-pressable",
            f"a {cup.family} {cup.diameter_mm:g} mm wide with a roof of {cup.roof_mm:.3g} and a "
            f"side wall of {cup.side_mm:.3g} mm cannot be pressed at all in the model; ask for "
            "another wall",
        )
    radius = body.model.mesh.nodes_mm[:, 0]
    moved = [radius + body.model.full(p.unknowns)[:, 0] for p in points]
    return CupCurve(
        pad_mm=np.array([-p.unknowns[body.pad] for p in points]),
        tip_mm=np.array([-p.unknowns[body.tip] for p in points]),
        force_N=np.array([p.load_factor for p in points]),
        slope_N_per_mm=np.array([-1.0 / p.drive[body.tip] for p in points]),
        strain=np.array([float(p.state.response.stretch.max()) - 1.0 for p in points]),
        bore_mm=np.array([float(r[body.inner].min()) for r in moved]),
        bulge_mm=np.array([float(r[body.outer].max()) for r in moved]),
        negatives=np.array([-1 if p.negatives is None else p.negatives for p in points]),
        points=points,
        body=body,
        complete=complete,
    )
