"""Inverse design of membranes and plungers: walls for a threshold, the smallest spread."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any, NoReturn

import numpy as np

from phytac_design.mechanics.switch.buckling import first_buckling
from phytac_design.mechanics.switch.cup_press import CupCurve, press_cup
from phytac_design.mechanics.switch.design import check_threshold
from phytac_design.mechanics.switch.family_spread import FamilySpread, FamilyTolerance, spread_of
from phytac_design.mechanics.switch.rubbers import Rubber
from phytac_design.mechanics.switch.soft_cup import CupFamily, SoftCup
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_shapes.errors import DesignError, NumericalError


@dataclass(frozen=True, kw_only=True)
class CupRules:
    """Sizes that the search takes or keeps; lengths in mm. Chosen here, none is measured."""

    lands: tuple[float, ...] = (0.2, 0.15)
    """Widths of the ring of a plunger's stem that lands on the shell around the hole: the stop.
    The next is tried where nothing fits with the one before."""
    hub_land: float = 0.1
    """The same of a membrane's hub: a narrow one leaves more roof."""
    lean: float = 1.02
    """Slope of side walls over the mold's draft: the flats of its polygons lean less."""
    plunger_heights: tuple[float, ...] = (2.5, 2.625, 2.75, 3.0, 3.25, 3.5)
    """Inner heights of plungers, in strokes."""
    plunger_roof: float = 0.8
    """Roof of a plunger; its side wall does the work."""
    membrane_sides: tuple[float, ...] = (0.5, 0.7)
    """Side walls of membranes."""
    membrane_boss: float = 1.4
    """Height of a boss over its rim, in strokes: it gives way itself."""
    stop_red: float = 0.75
    """Least share of the design's red that is out at the stop: the camera's threshold lies at a
    half, and tips show an eighth more or less."""
    near_best: float = 1.1
    """Of cups whose spread is within this factor of the smallest, the lowest is taken."""
    roof_max: float = 1.2
    """Thickest roof of a membrane."""
    plunger_fillet: float = 0.15
    """Radius of a plunger's inner corner."""
    membrane_fillet: float = 0.3
    """Radius of a membrane's inner corners: sharper ones crease before the stop."""


RULES = CupRules()


class UnsuitableCupError(DesignError):
    """One cup does not fit; the message says why."""


@dataclass(frozen=True, kw_only=True)
class CupDesign:
    """A switch that fits and does not snap.

    Attributes
    ----------
    threshold_N : float
        The force at which it should be on.
    travel_mm : float
        Way of the tip at which the camera counts it as on.
    stop_mm : float
        Way of the tip at which its stop lands on the shell, at most the design's stroke.
    cup : SoftCup
        Its dimensions.
    rubber : Rubber
        What it is cast of.
    space : SwitchSpace
        What it fits.
    curve : CupCurve
        Force against stroke to the stop, on the fine mesh.
    buckling : dict of int to float
        Waves around the axis to the tip's way, mm, from which the path is unstable against them.
    spread : FamilySpread
        Of the threshold.
    tolerance : FamilyTolerance
        Behind that spread.
    """

    threshold_N: float
    travel_mm: float
    stop_mm: float
    cup: SoftCup
    rubber: Rubber
    space: SwitchSpace
    curve: CupCurve
    buckling: dict[int, float] = field(default_factory=dict)
    spread: FamilySpread
    tolerance: FamilyTolerance

    @property
    def limit_N(self) -> float:
        """Force at the travel; the switch releases at the same force, since it does not snap."""
        return float(self.curve.force_at(self.travel_mm))

    @property
    def error(self) -> float:
        """Threshold of the fine mesh over the one asked for, less 1."""
        return self.limit_N / self.threshold_N - 1.0

    @property
    def stop_N(self) -> float:
        """Force at which the stop lands."""
        return float(self.curve.force_at(self.stop_mm))

    @property
    def strain(self) -> float:
        """Peak strain up to the stop."""
        return self.curve.at("strain", self.stop_mm)

    @property
    def visible_mm(self) -> float:
        """Red that is out of the end face at the stop."""
        return self.stop_mm - self.space.recess_mm


def design_cup(
    family: CupFamily,
    threshold_N: float,
    rubber: Rubber,
    space: SwitchSpace,
    *,
    travel_mm: float,
    travel_max_mm: float | None = None,
    tolerance: FamilyTolerance | None = None,
) -> CupDesign:
    """Find the membrane or plunger with the smallest spread whose threshold is as asked.

    Parameters
    ----------
    family : {"membrane", "plunger"}
        What is sought.
    threshold_N : float
        Force at ``travel_mm``.
    rubber : Rubber
        What it is cast of.
    space : SwitchSpace
        What it must fit.
    travel_mm : float
        Way of the tip at which the camera counts the switch as on.
    travel_max_mm : float, optional
        The same where it must go farthest: until there, and 1.5 tolerances of height more, the cup
        must not buckle. ``travel_mm`` if not given.
    tolerance : FamilyTolerance, optional
        What varies; the defaults if not given.

    Raises
    ------
    DesignError
        If none fits; it gives the reason of each that was tried.
    """
    check_threshold(threshold_N)
    if not 0.0 < travel_mm < space.stroke_mm:
        raise DesignError(
            "switch-travel-invalid",
            f"the travel of the tip at which the switch is on must lie within 0 and the stroke of "
            f"{space.stroke_mm:g} mm (got {travel_mm:g}); raise switch.stroke_mm",
        )
    band = tolerance or FamilyTolerance()
    on = max(travel_mm, travel_max_mm or 0.0) + 1.5 * band.height_mm
    reasons: list[str] = []
    found: list[tuple[SoftCup, FamilySpread]] = []
    found_land = 0.0
    for land, cup_of, most in _sections(family, space):
        if found and land < found_land:
            break
        try:
            cup = _solved(cup_of, most, threshold_N, rubber, space, travel_mm)
            curve = press_cup(cup, rubber.material, travel_mm=_longest_mm(cup, space))
            _check(curve, rubber, space, on)
            found.append((cup, cup_spread(cup, rubber, band, threshold_N, travel_mm)))
            found_land = land
        except (UnsuitableCupError, NumericalError) as error:
            reasons.append(str(error))
        except DesignError as error:
            if error.code not in {"tolerance-prevents-switch", "cup-without-web"}:
                raise
            reasons.append(str(error))
    for cup, spread in sorted(found, key=lambda item: _rank(item, found)):
        end = _longest_mm(cup, space)
        curve = press_cup(cup, rubber.material, travel_mm=end, refine=2, steps=16)
        try:
            stop, buckling = _check(curve, rubber, space, on)
        except UnsuitableCupError as error:
            reasons.append(str(error))
            continue
        return CupDesign(
            threshold_N=threshold_N,
            travel_mm=travel_mm,
            stop_mm=stop,
            cup=cup,
            rubber=rubber,
            space=space,
            curve=curve,
            buckling=buckling,
            spread=spread,
            tolerance=band,
        )
    raise DesignError(
        "switch-infeasible",
        f"a {family} of {threshold_N:g} N does not fit {space.diameter_mm:.3g} mm of {rubber.name} "
        f"at {rubber.material.modulus_MPa:.3g} MPa: {'; '.join(dict.fromkeys(reasons))}; take "
        "another rubber or family (phytac switch --family auto compares them), or raise the "
        "footprint",
    )


def nominal_cup(family: CupFamily, space: SwitchSpace) -> SoftCup:
    """Cup that is typical of a space, in place of a solved one.

    Raises
    ------
    DesignError
        If there is no room for one.
    """
    # Solved plungers have nine tenths of the thickest wall, membranes a third.
    share = 0.9 if family == "plunger" else 0.35
    _, cup_of, most = next(_sections(family, space))
    return cup_of(max(share * most, space.wall_min_mm))


def _rank(
    item: tuple[SoftCup, FamilySpread], found: list[tuple[SoftCup, FamilySpread]]
) -> tuple[bool, float]:
    """Sorts cups near the smallest spread by height, then all others by spread."""
    cup, spread = item
    near = spread.band <= RULES.near_best * min(other.band for _, other in found)
    return not near, cup.top_mm if near else spread.band


def _stop_least_mm(space: SwitchSpace) -> float:
    return space.recess_mm + RULES.stop_red * space.visible_mm


def _longest_mm(cup: SoftCup, space: SwitchSpace) -> float:
    """Longest way of the tip: a membrane's hub lands on the shell."""
    return min(cup.height_mm, space.stroke_mm)


def cup_spread(
    cup: SoftCup,
    rubber: Rubber,
    tolerance: FamilyTolerance,
    threshold_N: float,
    travel_mm: float,
) -> FamilySpread:
    """Spread of a cup's threshold: thicker walls inward, other diameters, other heights.

    Errors of the wall are those of side wall and roof together. A switch that stands higher, or
    whose stem is shorter, must move its tip by so much more.

    Raises
    ------
    DesignError
        If the tolerance reaches cups that cannot be, or do not work.
    """
    beyond = travel_mm + 1.5 * tolerance.height_mm
    nominal = press_cup(cup, rubber.material, travel_mm=beyond, steps=8)
    force = float(nominal.force_at(travel_mm))

    def factor(name: str, error: float) -> float | None:
        if name == "height":
            return float(nominal.force_at(travel_mm + error)) / force
        changes = {"diameter": {"diameter_mm": cup.diameter_mm + error}}.get(
            name, {"side_mm": cup.side_mm + error, "roof_mm": cup.roof_mm + error}
        )
        try:
            other = replace(cup, **changes)  # type: ignore[arg-type]  # keywords of two types
            curve = press_cup(other, rubber.material, travel_mm=travel_mm, steps=6)
        except (DesignError, NumericalError):
            return None
        return float(curve.force_at(travel_mm)) / force

    return spread_of(factor, tolerance, threshold_N=threshold_N)


def _cup_of(name: str, fixed: dict[str, Any], wall_mm: float) -> SoftCup:
    """Cup of fixed sizes, and of a wall by its name."""
    return SoftCup(**fixed | {name: wall_mm})


def _sections(
    family: CupFamily, space: SwitchSpace
) -> Iterator[tuple[float, Callable[[float], SoftCup], float]]:
    """Width of the stop's ring, cups by the wall that sets their threshold, its largest value."""
    plunger = family == "plunger"
    sizes: dict[str, Any] = {
        "family": family,
        "diameter_mm": space.diameter_mm,
        "fillet_mm": RULES.plunger_fillet if plunger else RULES.membrane_fillet,
        "draft_deg": RULES.lean * space.draft_deg,
    }
    slope = float(np.tan(np.radians(RULES.lean * space.draft_deg)))
    if plunger:
        for land, share in product(RULES.lands, RULES.plunger_heights):
            hub, high = space.hole_diameter_mm + 2.0 * land, share * space.stroke_mm
            fixed = sizes | {"height_mm": high, "roof_mm": RULES.plunger_roof}
            fixed["hub_diameter_mm"] = hub
            most = 0.5 * (space.diameter_mm - hub) - space.core_min_mm - high * slope
            yield land, partial(_cup_of, "side_mm", fixed), most
    else:
        land = RULES.hub_land
        sizes["hub_diameter_mm"] = space.hole_diameter_mm + 2.0 * land
        for stop, side in product((space.stroke_mm, _stop_least_mm(space)), RULES.membrane_sides):
            fixed = sizes | {
                "height_mm": stop,
                "side_mm": side,
                "boss_mm": RULES.membrane_boss * stop,
            }
            yield land, partial(_cup_of, "roof_mm", fixed), RULES.roof_max


def _solved(
    cup_of: Callable[[float], SoftCup],
    most_mm: float,
    threshold_N: float,
    rubber: Rubber,
    space: SwitchSpace,
    travel_mm: float,
) -> SoftCup:
    """Cup whose wall, within the mold's minimum and ``most_mm``, gives the threshold."""
    from scipy.optimize import brentq

    least = np.log(space.wall_min_mm)
    if most_mm <= space.wall_min_mm:
        _refuse(
            "cup-no-wall",
            f"no wall of {space.wall_min_mm:g} mm fits between stop and outer diameter",
        )
    name = cup_of(most_mm).family

    def force(log_wall: float) -> float:
        """Force at the travel, N; NaN where the cup gives way before."""
        try:
            curve = press_cup(
                cup_of(float(np.exp(log_wall))), rubber.material, travel_mm=travel_mm, steps=6
            )
        except NumericalError:
            return np.nan
        return float(curve.force_at(travel_mm))

    def excess(log_wall: float) -> float:
        found = force(log_wall)
        # A thin wall that gives way before is too weak.
        return -1.0 if np.isnan(found) else float(np.log(found / threshold_N))

    # A roof nearly as thick as its web is wide cannot bend so far.
    most = next(
        (x for x in np.log(most_mm * 0.85 ** np.arange(5)) if x > least and np.isfinite(force(x))),
        None,
    )
    if most is None:
        _refuse(
            "cup-gives-way",
            f"a {name} with walls of {most_mm:.3g} mm or less gives way before {travel_mm:.3g} mm",
        )
    ends = (excess(most), excess(least))
    if ends[0] < 0.0:
        _refuse(
            "cup-too-soft",
            f"the thickest wall of a {name} that works, {np.exp(most):.3g} mm, gives "
            f"{threshold_N * np.exp(ends[0]):.3g} N",
        )
    if ends[1] > 0.0:
        _refuse(
            "cup-wall-too-thin",
            f"the thinnest wall that the mold casts, {space.wall_min_mm:g} mm, gives "
            f"{threshold_N * np.exp(ends[1]):.3g} N in a {name}",
        )
    wall = brentq(excess, least, most, xtol=1e-3, rtol=1e-6)
    return cup_of(float(np.exp(wall)))


def _refuse(code: str, message: str) -> NoReturn:
    raise UnsuitableCupError(code, message)


def _check(
    curve: CupCurve,
    rubber: Rubber,
    space: SwitchSpace,
    on_mm: float,
) -> tuple[float, dict[int, float]]:
    """Where a cup that fits stops, and the tip's way from which each wave number is unstable.

    At ``on_mm`` of travel the switch is on, whatever its receptor and its errors.

    Raises
    ------
    UnsuitableCupError
        If its force falls before the stop, it folds, touches its stop or neighbours, is strained
        too far, or its boss is pressed flush before it is on.
    """
    cup, stop = curve.body.cup, _longest_mm(curve.body.cup, space)
    what = (
        f"a {cup.family} {cup.height_mm:.3g} mm high with walls of {cup.side_mm:.3g} and "
        f"{cup.roof_mm:.3g} mm"
    )
    if curve.reach_mm < stop - 1e-6:
        stop = min(stop, _stop_least_mm(space))
    if curve.reach_mm < stop - 1e-6:
        _refuse(
            "cup-gives-way",
            f"{what} gives way at {curve.reach_mm:.3g} mm of travel, before a stop at "
            f"{stop:.3g} mm",
        )
    upto = curve.tip_mm <= stop + 1e-6
    strain = curve.at("strain", stop)
    if strain > rubber.strain_max:
        _refuse(
            "cup-strain-too-large",
            f"{what} is strained by {strain:.0%}, the rubber bears {rubber.strain_max:.0%}",
        )
    if cup.family == "plunger" and curve.bore_mm[upto].min() < 0.5 * cup.hub_diameter_mm:
        _refuse("cup-rubs", f"{what} is pressed against its own stem")
    bulge = 2.0 * float(curve.bulge_mm[upto].max())
    if bulge > space.pitch_mm:
        _refuse(
            "cup-touches-neighbour",
            f"{what} bulges to {bulge:.3g} mm, the neighbour stands {space.pitch_mm:.3g} mm away",
        )
    if on_mm > stop or (cup.boss_mm and curve.at("pad_mm", on_mm) > cup.boss_mm):
        _refuse(
            "cup-boss-flush",
            f"{what} lands, or its boss is pressed flush with its rim, before the switch is "
            f"surely on at {on_mm:.3g} mm",
        )
    points = [point for point, keep in zip(curve.points, upto, strict=True) if keep]
    found = first_buckling(curve.body.model, points)
    at = {mode: float(curve.tip_mm[index]) for mode, index in found.items()}
    early = {mode: way for mode, way in at.items() if way <= on_mm}
    if early:
        mode = min(early, key=lambda n: early[n])
        _refuse(
            "cup-buckles-early",
            f"{what} buckles with {mode} waves around its axis at {early[mode]:.3g} mm of travel, "
            f"before it is surely on at {on_mm:.3g} mm",
        )
    return stop, at
