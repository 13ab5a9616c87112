"""Whether a bowl fits: its shape within the space, its curve within space and rubber."""

from phytac_design.mechanics.switch.bowl import Bowl
from phytac_design.mechanics.switch.curve import ForceStrokeCurve, Snap, snap_of
from phytac_design.mechanics.switch.rubbers import Rubber
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_shapes.errors import DesignError

FILLETS = (1.0 / 6.0, 1.0 / 4.0, 1.0 / 3.0, 5.0 / 12.0)
"""Fillets of pad and stem that are tried, in stem diameters: rounder ones bear more."""
EXTRA_DEPTH_mm = 0.15
"""A bowl is made this much deeper than its stroke; its underside lands a little early."""


class UnsuitableBowlError(DesignError):
    """One bowl does not fit; the message says why.

    Attributes
    ----------
    shallow : bool
        Whether a deeper bowl may fit.
    thin : bool
        Whether its wall is too thin.
    """

    def __init__(
        self, code: str, message: str, *, shallow: bool = False, thin: bool = False
    ) -> None:
        super().__init__(code, message)
        self.shallow, self.thin = shallow, thin


def fillets(space: SwitchSpace) -> list[float]:
    """Fillets to try, mm, from sharp to round."""
    return [factor * space.stem_diameter_mm for factor in FILLETS]


def bowl_of(space: SwitchSpace, fillet_mm: float, depth_mm: float, wall_mm: float) -> Bowl:
    """Bowl of a wall, as wide as fits, and as deep as given or as releases from its mold.

    Raises
    ------
    UnsuitableBowlError
        If there is none.
    """
    depth = min(depth_mm, space.depth_max_mm - wall_mm)
    try:
        return Bowl(
            diameter_mm=space.diameter_mm,
            depth_mm=depth,
            thickness_mm=wall_mm,
            stem_diameter_mm=space.stem_diameter_mm,
            pad_diameter_mm=space.stem_diameter_mm,
            fillet_mm=fillet_mm,
        )
    except DesignError as error:
        raise UnsuitableBowlError(error.code, str(error)) from None


def evaluate_bowl(curve: ForceStrokeCurve, rubber: Rubber, space: SwitchSpace) -> Snap:
    """Snap of a curve that fits space and rubber.

    Raises
    ------
    UnsuitableBowlError
        If it does not snap, does not return, shows too little red, or is strained too far.
    """
    snap = snap_of(curve)
    wall = curve.body.bowl.thickness_mm
    if snap is None or snap.valley_N > (1.0 - space.snap_min) * snap.limit_N:
        raise UnsuitableBowlError("bowl-no-snap", f"a wall of {wall:.3g} mm is too thick to snap")
    if snap.valley_N < space.release_margin * snap.limit_N:
        raise UnsuitableBowlError(
            "bowl-no-return",
            f"a wall of {wall:.3g} mm does not return (valley {snap.valley_N:.3g} N, margin "
            f"{space.release_margin * snap.limit_N:.3g} N)",
        )
    if snap.stroke_mm < space.stroke_mm:
        cause = "" if curve.complete else ", where the wall folds onto itself"
        raise UnsuitableBowlError(
            "bowl-stroke-too-short",
            f"a wall of {wall:.3g} mm moves the tip by {snap.stroke_mm:.3g} mm{cause}; "
            f"{space.stroke_mm:.3g} mm are needed",
            shallow=curve.complete,
        )
    if snap.strain > rubber.strain_max:
        raise UnsuitableBowlError(
            "bowl-strain-too-large",
            f"a wall of {wall:.3g} mm is strained by {snap.strain:.0%}, the rubber bears "
            f"{rubber.strain_max:.0%}",
        )
    return snap
