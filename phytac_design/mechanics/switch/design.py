"""Inverse design: the bowl whose limit load is the threshold, within space, mold and rubber."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from phytac_design.mechanics.switch.bowl import Bowl
from phytac_design.mechanics.switch.bowl_check import (
    EXTRA_DEPTH_mm,
    UnsuitableBowlError,
    bowl_of,
    evaluate_bowl,
    fillets,
)
from phytac_design.mechanics.switch.buckling import first_buckling
from phytac_design.mechanics.switch.curve import ForceStrokeCurve, Snap, press_bowl, snap_of
from phytac_design.mechanics.switch.feasible_range import (
    WALL_EXPONENT,
    feasible_range,
    fit_words,
)
from phytac_design.mechanics.switch.rubbers import Rubber
from phytac_design.mechanics.switch.switch_space import SwitchSpace, Tolerance
from phytac_design.mechanics.switch.tolerance import Spread, limit_load, threshold_spread
from phytac_shapes.errors import DesignError, NumericalError


@dataclass(frozen=True, kw_only=True)
class SwitchDesign:
    """A switch that fits.

    Attributes
    ----------
    threshold_N : float
        The force at which it should snap.
    bowl : Bowl
        Its dimensions.
    rubber : Rubber
        What it is cast of.
    space : Space
        What it fits.
    curve : ForceStrokeCurve
        Force against stroke, on the fine mesh.
    snap : Snap
        Limit load, valley, stroke, strain.
    buckling : dict of int to float
        Waves around the axis to the stroke, mm, from which the path is unstable
        against them; all beyond the limit load.
    spread : Spread
        Of the threshold.
    tolerance : Tolerance
        Behind that spread.
    """

    threshold_N: float
    bowl: Bowl
    rubber: Rubber
    space: SwitchSpace
    curve: ForceStrokeCurve
    snap: Snap
    buckling: dict[int, float] = field(default_factory=dict)
    spread: Spread
    tolerance: Tolerance

    @property
    def error(self) -> float:
        """Limit load over the threshold, less 1."""
        return self.snap.limit_N / self.threshold_N - 1.0

    @property
    def visible_mm(self) -> float:
        """Red that comes out of the end face."""
        return self.snap.stroke_mm - self.space.recess_mm


def design_switch(
    threshold_N: float, rubber: Rubber, space: SwitchSpace, tolerance: Tolerance | None = None
) -> SwitchDesign:
    """Find wall, depth, diameter and fillets of the bowl whose limit load is the threshold.

    The widest bowl that fits is taken: it has the longest stroke and the thickest wall. Fillets
    are tried from sharp to round, depths from the least that the stroke needs.

    Raises
    ------
    DesignError
        If none fits; it says which thresholds do, and which moduli would.
    """
    made, reasons = find_bowl(threshold_N, rubber, space, tolerance)
    if made is None:
        raise DesignError("switch-infeasible", _refusal(threshold_N, rubber, space, reasons))
    return made


def check_threshold(threshold_N: float) -> None:
    """Raise a DesignError for a threshold that is no positive number."""
    if not (np.isfinite(threshold_N) and threshold_N > 0.0):
        raise DesignError(
            "threshold-not-positive",
            f"a switch's threshold must be a positive number of newtons (got {threshold_N:g}); "
            "0.5 is the published one",
        )


def find_bowl(
    threshold_N: float, rubber: Rubber, space: SwitchSpace, tolerance: Tolerance | None = None
) -> tuple[SwitchDesign | None, list[str]]:
    """Bowl as by :func:`design_switch` or None, and why the bowls that were tried do not fit."""
    check_threshold(threshold_N)
    reasons: list[str] = []
    for fillet in fillets(space):
        try:
            curve = _curve_of(threshold_N, rubber, space, fillet)
            snap = evaluate_bowl(curve, rubber, space)
            buckling = _buckling(curve, snap)
        except UnsuitableBowlError as error:
            reasons.append(f"with fillets of {fillet:.3g} mm {error}")
            if error.thin:
                break  # rounder fillets ask for thinner walls still
            continue
        except NumericalError as error:
            reasons.append(f"with fillets of {fillet:.3g} mm {error}")
            continue
        bowl, band = curve.body.bowl, tolerance or Tolerance()
        spread = threshold_spread(
            bowl,
            rubber.material,
            band,
            threshold_N=snap.limit_N,
            hole_diameter_mm=space.hole_diameter_mm,
        )
        made = SwitchDesign(
            threshold_N=threshold_N,
            bowl=bowl,
            rubber=rubber,
            space=space,
            curve=curve,
            snap=snap,
            buckling=buckling,
            spread=spread,
            tolerance=band,
        )
        return made, reasons
    return None, reasons


def _curve_of(
    threshold_N: float, rubber: Rubber, space: SwitchSpace, fillet_mm: float
) -> ForceStrokeCurve:
    """Curve of the bowl with the threshold as limit load, deep enough for its stroke.

    On the coarse mesh first, which finds the depth that is then confirmed on the fine one.
    """
    depth, wall, refine = space.stroke_mm + EXTRA_DEPTH_mm, 0.0, 1
    while True:
        wall = _wall(threshold_N, rubber, space, fillet_mm, depth, guess_mm=wall, refine=refine)
        if wall < (0.9 if refine == 1 else 1.0) * space.wall_min_mm:
            raise UnsuitableBowlError(
                "bowl-wall-too-thin",
                f"the wall would be {wall:.4f} mm, thinner than the {space.wall_min_mm:g} mm that "
                "the mold casts",
                thin=True,
            )
        bowl = bowl_of(space, fillet_mm, depth, wall)
        curve = press_bowl(
            bowl,
            rubber.material,
            hole_diameter_mm=space.hole_diameter_mm,
            refine=refine,
            steps=18,
        )
        snap = snap_of(curve)
        short = space.stroke_mm - (snap.stroke_mm if snap else 0.0)
        enough = short <= 0.0 or not curve.complete or bowl.depth_mm < depth
        if refine == 2 and enough:
            return curve
        if not enough and (snap or refine == 2):
            depth += short + 0.02
        refine = 2


def wall_guess_mm(threshold_N: float, rubber: Rubber, space: SwitchSpace) -> float:
    """Wall by F ≈ 1.2 E a² (t/a)^2.2, measured on such bowls."""
    half = 0.5 * space.diameter_mm
    unit = 1.2 * rubber.material.modulus_MPa * half**2
    return float(half * (threshold_N / unit) ** (1.0 / WALL_EXPONENT))


def _wall(
    threshold_N: float,
    rubber: Rubber,
    space: SwitchSpace,
    fillet_mm: float,
    depth_mm: float,
    *,
    guess_mm: float,
    refine: int,
) -> float:
    """Wall, mm, by the secant method on logarithms; to 2 % on the coarse mesh."""
    half = 0.5 * space.diameter_mm
    limit_wall = 0.4 * half

    def load(log_wall: float) -> float:
        wall = float(np.exp(log_wall))
        try:
            bowl = bowl_of(space, fillet_mm, depth_mm, wall)
            found = limit_load(
                bowl, rubber.material, hole_diameter_mm=space.hole_diameter_mm, refine=refine
            )
        except (DesignError, NumericalError):
            found = None
        # A wall too thick to snap counts as far too strong.
        return 0.5 if found is None else float(np.log(found / threshold_N))

    start = guess_mm or wall_guess_mm(threshold_N, rubber, space)
    bounds = (np.log(0.03 * half), np.log(limit_wall))
    x = float(np.clip(np.log(start), *bounds))
    # The fine mesh adds about as large an error as is tolerated there.
    return float(np.exp(_secant(load, x, bounds, tolerance=0.02 if refine == 1 else 2e-3)))


def _secant(
    function: Callable[[float], float],
    x: float,
    bounds: tuple[float, float],
    *,
    tolerance: float,
) -> float:
    slope, last = WALL_EXPONENT, None
    for _ in range(12):
        y = function(x)
        if abs(y) <= tolerance:
            return x
        if last is not None and x != last[0]:
            slope = float(np.clip((y - last[1]) / (x - last[0]), 1.0, 4.0))
        last = (x, y)
        x = float(np.clip(x - y / slope, *bounds))
        if x == last[0]:
            word = "thick" if y < 0.0 else "thin"
            raise UnsuitableBowlError(
                "bowl-threshold-not-reached",
                f"a wall of {np.exp(x):.3g} mm is as {word} as can be, and not enough",
            )
    raise UnsuitableBowlError(
        "bowl-threshold-not-reached", f"no wall near {np.exp(x):.3g} mm meets the threshold"
    )


def _buckling(curve: ForceStrokeCurve, snap: Snap) -> dict[int, float]:
    """Stroke from which each wave number is unstable; none may come before the limit."""
    ways = curve.stroke_mm
    keep = np.flatnonzero(ways <= snap.stroke_mm)
    before = keep[ways[keep] <= snap.limit_stroke_mm]
    # All the way to the limit, and every third point beyond it.
    chosen = np.unique(np.concatenate([before, keep[len(before) :: 3], keep[-1:]]))
    found = first_buckling(curve.body.model, [curve.points[k] for k in chosen])
    at = {mode: float(ways[chosen[index]]) for mode, index in found.items()}
    early = {mode: way for mode, way in at.items() if way <= snap.limit_stroke_mm}
    if early:
        mode = min(early, key=lambda n: early[n])
        raise UnsuitableBowlError(
            "bowl-buckles-early",
            f"the bowl buckles with {mode} waves around its axis at {early[mode]:.3g} mm, before "
            f"its limit load at {snap.limit_stroke_mm:.3g} mm",
        )
    return at


def _refusal(threshold_N: float, rubber: Rubber, space: SwitchSpace, reasons: list[str]) -> str:
    modulus = rubber.material.modulus_MPa
    intro = (
        f"a switch of {threshold_N:g} N does not fit a bowl {space.diameter_mm:.3g} mm wide of "
        f"{rubber.name} at {modulus:.3g} MPa: "
    )
    why = "; ".join(reasons) or "no bowl fits"
    found = feasible_range(rubber, space)
    if found is not None:
        return f"{intro}{why}. {fit_words(threshold_N, found)}"
    thinner = feasible_range(rubber, replace(space, wall_min_mm=0.5 * space.wall_min_mm))
    if thinner is None:
        return f"{intro}{why}. No wall fits: raise the footprint, or ask for less red"
    return (
        f"{intro}{why}. No wall of {space.wall_min_mm:g} mm or more snaps that far; if the mold "
        f"casts thinner ones, from {thinner.min_N:.3g} N ({thinner.min_wall_mm:.3g} mm) to "
        f"{thinner.max_N:.3g} N ({thinner.max_wall_mm:.3g} mm) fit"
    )
