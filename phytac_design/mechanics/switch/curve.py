"""Force–stroke curve of a bowl: limit load, valley, stroke at actuation, strain."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.mechanics.switch import switch_path
from phytac_design.mechanics.switch.bowl import Bowl, BowlModel, bowl_model
from phytac_design.mechanics.switch.hyperelastic import Material
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class ForceStrokeCurve:
    """Force and stroke of a bowl whose pad is pressed in; arrays run along the path.

    Attributes
    ----------
    way_mm : (m,) float
        Length of the path in the space of all unknowns: it grows where stroke and force do not.
    stroke_mm, force_N : (m,) float
        Pad's way inward, force on it.
    stroke_rate, force_rate_N_per_mm : (m,) float
        Their slopes by the way.
    strain : (m,) float
        Largest principal stretch at the Gauss points, less 1.
    clearance_mm : (m,) float
        Least height of the underside over the shell's face, outside the hole; the pad's underside
        counts too.
    negatives : (m,) int
        Negative eigenvalues of the axisymmetric tangent under dead load; −1 where unknown.
    points : list of path.PathPoint
        The equilibria themselves.
    body : BowlModel
        The bowl they are of.
    complete : bool
        Whether the path was followed to its end.
    """

    way_mm: FloatArray
    stroke_mm: FloatArray
    force_N: FloatArray
    stroke_rate: FloatArray
    force_rate_N_per_mm: FloatArray
    strain: FloatArray
    clearance_mm: FloatArray
    negatives: IntArray
    points: list[switch_path.PathPoint]
    body: BowlModel
    complete: bool

    def dense(self, per_step: int = 12) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Cubic through points and slopes: stroke, force and strain at many places, (M,) each."""
        way = np.interp(
            np.arange(per_step * (len(self.way_mm) - 1) + 1) / per_step,
            np.arange(len(self.way_mm)),
            self.way_mm,
        )
        stroke = _hermite(self.way_mm, self.stroke_mm, self.stroke_rate)(way)
        force = _hermite(self.way_mm, self.force_N, self.force_rate_N_per_mm)(way)
        return stroke, force, np.interp(way, self.way_mm, self.strain)


def _hermite(x: FloatArray, y: FloatArray, slope: FloatArray) -> Any:
    from scipy.interpolate import CubicHermiteSpline

    return CubicHermiteSpline(x, y, slope)


@dataclass(frozen=True, kw_only=True)
class Snap:
    """Characteristic points of a switch's curve.

    Attributes
    ----------
    limit_N, limit_stroke_mm : float
        Threshold: the first maximum of the force, and the pad's way to it.
    valley_N, valley_stroke_mm : float
        Least force between the limit and the end of the way: the switch releases below it.
    travel_mm : float
        Way until the underside rests on the shell, or the path ends.
    stroke_mm : float
        Way of the pad, and of the red tip, once it has snapped under the limit load.
    strain : float
        Peak strain until there.
    """

    limit_N: float
    limit_stroke_mm: float
    valley_N: float
    valley_stroke_mm: float
    travel_mm: float
    stroke_mm: float
    strain: float


def press_bowl(
    bowl: Bowl,
    material: Material,
    *,
    hole_diameter_mm: float = 1.6,
    refine: int = 1,
    steps: int = 24,
    end_mm: float | None = None,
    to_limit: bool = False,
) -> ForceStrokeCurve:
    """Press a bowl in as far as it is deep, or as far as its path can be followed.

    Parameters
    ----------
    bowl : Bowl
        The bowl.
    material : Material
        Its rubber.
    hole_diameter_mm : float
        Hole of the receptor; outside it the underside comes to rest on the shell.
    refine : int
        Multiplies the elements each way.
    steps : int
        Steps to the end of the way; the path shortens them where it bends.
    end_mm : float, optional
        Way of the pad; the depth if not given.
    to_limit : bool
        End just behind the limit load.
    """
    body = bowl_model(bowl, material, hole_diameter_mm=hole_diameter_mm, refine=refine)
    control = switch_path.PathControl(
        unknown=body.pad, end_mm=-(end_mm or bowl.depth_mm), steps=steps
    )
    complete = True
    try:
        points = switch_path.trace(body.model, body.load, control, to_limit=to_limit)
    except switch_path.PathError as error:
        points, complete = error.points, False
    if len(points) < 2:
        raise NumericalError(
            "switch-not-pressable",
            f"a bowl {bowl.diameter_mm:g} mm wide, {bowl.depth_mm:g} deep, {bowl.thickness_mm:g} "
            "thick cannot be pressed at all in the model; ask for a thinner wall",
        )
    z = body.model.mesh.nodes_mm[body.seat, 1]
    clear = [
        min(
            float((z + body.model.full(p.unknowns)[body.seat, 1]).min(initial=np.inf)),
            bowl.depth_mm + p.unknowns[body.pad],
        )
        for p in points
    ]
    move = np.diff([p.unknowns for p in points], axis=0)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(move, axis=1))])
    ahead = np.vstack([move[:1], move[:-1] + move[1:], move[-1:]])
    rate = np.array([1.0 / np.linalg.norm(p.drive) for p in points])
    rate *= np.sign([float(m @ p.drive) for m, p in zip(ahead, points, strict=True)])
    return ForceStrokeCurve(
        way_mm=way,
        stroke_mm=np.array([-p.unknowns[body.pad] for p in points]),
        force_N=np.array([p.load_factor for p in points]),
        stroke_rate=np.array([-p.drive[body.pad] for p in points]) * rate,
        force_rate_N_per_mm=rate,
        strain=np.array([float(p.state.response.stretch.max()) - 1.0 for p in points]),
        clearance_mm=np.array(clear),
        negatives=np.array([-1 if p.negatives is None else p.negatives for p in points]),
        points=points,
        body=body,
        complete=complete,
    )


def snap_of(curve: ForceStrokeCurve) -> Snap | None:
    """Limit load, valley and stroke of a curve; None where its force never falls."""
    from scipy.interpolate import PchipInterpolator

    force = _hermite(curve.way_mm, curve.force_N, curve.force_rate_N_per_mm)
    stroke = _hermite(curve.way_mm, curve.stroke_mm, curve.stroke_rate)
    last = float(curve.way_mm[-1])
    turns = [float(s) for s in force.derivative().roots() if 0.0 < s < last]
    tops = [s for s in turns if force(s, 2) < 0.0]
    if not tops:
        return None
    top = tops[0]
    clearance = PchipInterpolator(curve.way_mm, curve.clearance_mm)
    seats = [float(s) for s in clearance.roots() if top < s <= last]
    end = seats[0] if seats else last
    again = [float(s) for s in force.solve(float(force(top))) if top + 1e-6 < s <= end]
    low = min([s for s in turns if top < s <= end] + [end], key=lambda s: float(force(s)))
    on = again[0] if again else end
    strain = PchipInterpolator(curve.way_mm, curve.strain)
    way = np.append(curve.way_mm[curve.way_mm < on], on)
    return Snap(
        limit_N=float(force(top)),
        limit_stroke_mm=float(stroke(top)),
        valley_N=float(force(low)),
        valley_stroke_mm=float(stroke(low)),
        travel_mm=float(stroke(end)),
        stroke_mm=float(stroke(on)),
        strain=float(np.max(strain(way))),
    )
