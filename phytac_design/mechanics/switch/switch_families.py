"""Bowl, membrane and plunger of several rubbers side by side, and the one that spreads least."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from phytac_design.mechanics.switch.cup_design import CupDesign, design_cup
from phytac_design.mechanics.switch.design import SwitchDesign, find_bowl, wall_guess_mm
from phytac_design.mechanics.switch.family_spread import FamilySpread, FamilyTolerance, spread_of
from phytac_design.mechanics.switch.rubbers import Rubber
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_design.mechanics.switch.tolerance import limit_load
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, NumericalError

Family = Literal["bowl", "membrane", "plunger"]
FAMILIES: tuple[Family, ...] = ("bowl", "membrane", "plunger")


@dataclass(frozen=True, kw_only=True)
class FamilyCandidate:
    """One family cast of one rubber.

    Attributes
    ----------
    family : {"bowl", "membrane", "plunger"}
        Its family.
    rubber : Rubber
        What it is cast of.
    design : SwitchDesign or CupDesign, optional
        The switch; None if none fits.
    spread : FamilySpread, optional
        Of its threshold.
    receptors_N : (2,) float, optional
        Smallest and largest threshold of the design's receptors, whose tips the camera counts as
        out at different travels; both are the threshold of a switch that snaps.
    reason : str
        Why none fits.
    """

    family: Family
    rubber: Rubber
    design: SwitchDesign | CupDesign | None = None
    spread: FamilySpread | None = None
    receptors_N: tuple[float, float] | None = None
    reason: str = ""

    @property
    def height_mm(self) -> float:
        """Height over the shell's outer face; NaN if none fits."""
        if isinstance(self.design, CupDesign):
            return self.design.cup.top_mm
        if self.design is None:
            return float("nan")
        bowl = self.design.bowl
        return bowl.depth_mm + bowl.thickness_mm + bowl.pad_height_mm

    @property
    def wall_mm(self) -> float:
        """Thinnest wall; NaN if none fits."""
        if isinstance(self.design, CupDesign):
            return min(self.design.cup.side_mm, self.design.cup.roof_mm)
        return float("nan") if self.design is None else self.design.bowl.thickness_mm

    @property
    def release_N(self) -> float:
        """Force below which it is off again; the threshold where nothing snaps."""
        if isinstance(self.design, CupDesign):
            return self.design.limit_N
        return float("nan") if self.design is None else self.design.snap.valley_N

    @property
    def strain(self) -> float:
        """Peak strain up to the end of the stroke."""
        if isinstance(self.design, CupDesign):
            return self.design.strain
        return float("nan") if self.design is None else self.design.snap.strain


def compare_families(
    threshold_N: float,
    rubbers: Sequence[Rubber],
    space: SwitchSpace,
    travel_mm: FloatArray,
    *,
    families: Sequence[Family] = FAMILIES,
    tolerance: FamilyTolerance | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[FamilyCandidate]:
    """Every family cast of every rubber, smallest spread first, then those that do not fit.

    Parameters
    ----------
    threshold_N : float
        Force at which the switch should be on.
    rubbers : sequence of Rubber
        What they may be cast of.
    space : SwitchSpace
        What they must fit.
    travel_mm : (n,) float
        Travel of each tip at which the camera counts it as out; NaN where it cannot be read.
        Families that do not snap have the threshold at the median.
    families : sequence of str
        Families to design.
    tolerance : FamilyTolerance, optional
        What varies.
    progress : callable
        Takes one line per candidate.

    Raises
    ------
    DesignError
        If the camera can read no switch.
    """
    readable = travel_mm[np.isfinite(travel_mm)]
    if not len(readable):
        raise DesignError(
            "switch-unreadable",
            "the camera can read no switch of this design; raise switch.stroke_mm or the tip",
        )
    band = tolerance or FamilyTolerance()
    found = []
    for rubber in rubbers:
        for family in families:
            progress(f"{family} of {rubber.name}")
            try:
                if family == "bowl":
                    one = _bowl(threshold_N, rubber, space, band)
                else:
                    made = design_cup(
                        family,
                        threshold_N,
                        rubber,
                        space,
                        travel_mm=float(np.median(readable)),
                        travel_max_mm=float(readable.max()),
                        tolerance=band,
                    )
                    ends = made.curve.force_at(np.array([readable.min(), readable.max()]))
                    one = FamilyCandidate(
                        family=family,
                        rubber=rubber,
                        design=made,
                        spread=made.spread,
                        receptors_N=(float(ends[0]), float(ends[1])),
                    )
            except DesignError as error:
                if error.code == "threshold-not-positive":
                    raise
                one = FamilyCandidate(family=family, rubber=rubber, reason=str(error))
            found.append(one)
    return sorted(found, key=lambda item: item.spread.band if item.spread else np.inf)


def _bowl(
    threshold_N: float, rubber: Rubber, space: SwitchSpace, tolerance: FamilyTolerance
) -> FamilyCandidate:
    """Bowl of a rubber; where it is glued does not change its limit load."""
    half = 0.5 * space.diameter_mm
    guess = wall_guess_mm(threshold_N, rubber, space)
    # The thickest walls that snap are 0.15 of the radius.
    if guess > 0.25 * half:
        raise DesignError(
            "switch-infeasible", f"a wall of about {guess:.2g} mm is far too thick to snap"
        )
    made, reasons = find_bowl(threshold_N, rubber, space, tolerance)
    if made is None:
        raise DesignError("switch-infeasible", "; ".join(reasons) or "no bowl fits")

    def load(thickness_mm: float, diameter_mm: float) -> float | None:
        bowl = made.bowl
        # A bowl of nearly half a sphere grows inward.
        other = replace(
            bowl,
            thickness_mm=thickness_mm,
            diameter_mm=diameter_mm,
            depth_mm=min(bowl.depth_mm, 0.5 * diameter_mm - thickness_mm),
        )
        try:
            return limit_load(
                other, rubber.material, hole_diameter_mm=space.hole_diameter_mm, refine=1
            )
        except (DesignError, NumericalError):
            return None

    nominal = load(made.bowl.thickness_mm, made.bowl.diameter_mm)

    def factor(name: str, error: float) -> float | None:
        thickness = made.bowl.thickness_mm + (error if name == "thickness" else 0.0)
        diameter = made.bowl.diameter_mm + (error if name == "diameter" else 0.0)
        found = nominal if name == "height" else load(thickness, diameter)
        return None if found is None or nominal is None else found / nominal

    return FamilyCandidate(
        family="bowl",
        rubber=rubber,
        design=made,
        spread=spread_of(factor, tolerance, threshold_N=threshold_N),
        receptors_N=(made.snap.limit_N, made.snap.limit_N),
    )
