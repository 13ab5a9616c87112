"""Settings chosen by what they lose: the cheapest whose predicted error is within a tolerance."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from typing import Any

from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.spec import Design
from phytac_design.study.tradeoff.cost import Work, machine_factor, predict
from phytac_design.study.tradeoff.force import ForceError, rms
from phytac_design.study.tradeoff.pilot import ForcePilot
from phytac_design.study.tradeoff.settings import Quantity
from phytac_design.study.tradeoff.sight import SightPilot
from phytac_design.study.tradeoff.volume import VolumePilot
from phytac_shapes.errors import DesignError

Progress = Callable[[str], None]
REFINES = (2, 3, 4, 5, 6, 8, 10, 12)
SHARES = (1.2, 0.8, 0.55, 0.4)
ORDERS = (1, 3, 4, 5)
TOLERANCES_mm = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
PRESS_TOLERANCES = (1.0, 0.1, 0.05, 0.02)


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A setting with what it is expected to lose and cost.

    Attributes
    ----------
    accuracy : Accuracy
        The setting.
    quantity : str
        What the error is of; ``time`` where a budget was given.
    wanted : float
        The tolerance, or the budget in seconds.
    predicted_error : float or None
        With the pilot's safety; None where only time was asked for.
    predicted_s : dict
        Wall seconds of each stage.
    achieved_error : float or None
        Of the audit.
    achieved_s : dict
        Wall seconds of each stage, as it ran.
    """

    accuracy: Accuracy
    quantity: Quantity | str
    wanted: float
    predicted_error: float | None
    predicted_s: dict[str, float]
    achieved_error: float | None = None
    achieved_s: dict[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Predicted, in all."""
        return sum(self.predicted_s.values())

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return asdict(self) | {
            "predicted_total_s": self.seconds,
            "achieved_total_s": sum(self.achieved_s.values()) if self.achieved_s else None,
        }


def refuse_bad(value: float, name: str, high: float) -> None:
    """Refuse a tolerance or budget that is no positive number."""
    if not 0.0 < value <= high:
        raise DesignError(f"{name} must be above 0 and at most {high:g} (got {value:g})")


def choose_tolerance(
    design: Design,
    tolerance: float,
    *,
    of: Quantity = "force",
    error: ForceError | None = None,
    cached: frozenset[str] = frozenset(),
    progress: Progress = lambda _: None,
) -> Choice:
    """Find the cheapest setting whose predicted error is within a tolerance.

    Knobs that the error does not depend on stay as in ``draft``.

    Parameters
    ----------
    design : Design
        The sensor.
    tolerance : float
        Relative error of force or volume, or a difference of visible fractions.
    of : str
        ``force``, ``visibility`` or ``volume``.
    error : ForceError, optional
        The design's, where solves of it are at hand.
    cached : frozenset of str
        Stages that cost nothing.

    Raises
    ------
    DesignError
        If no setting is within the tolerance; the best there is is named.
    """
    refuse_bad(tolerance, "the tolerance", 1.0)
    work = Work(design)
    factor = machine_factor()
    error = error or ForceError(design)
    judge, candidates = _judged(of, error)
    order = sorted(
        zip(
            (predict(work, s, factor=factor, cached=cached) for s in candidates),
            candidates,
            strict=True,
        ),
        key=lambda pair: sum(pair[0].values()),
    )
    best: tuple[float, Accuracy] | None = None
    for seconds, setting in order:
        found = judge(setting)
        progress(
            f"tolerance: {of} error {100.0 * found:.3g} % predicted for {said(setting)}, "
            f"{sum(seconds.values()):.0f} s"
        )
        if found <= tolerance:
            return Choice(
                accuracy=setting,
                quantity=of,
                wanted=tolerance,
                predicted_error=found,
                predicted_s=seconds,
            )
        if best is None or found < best[0]:
            best = found, setting
    least, setting = best or (float("nan"), PRESETS["fine"])
    raise DesignError(
        f"no setting has a predicted {of} error within {100.0 * tolerance:g} % on this design; the "
        f"best is {100.0 * least:.2g} %, with {said(setting)}: ask for no less than that"
    )


def said(setting: Accuracy) -> str:
    """Settings that differ from ``draft``, for people."""
    draft = PRESETS["draft"].as_dict()
    own = {key: value for key, value in setting.as_dict().items() if value != draft[key]}
    return ", ".join(f"{key} {value}" for key, value in own.items()) or "the settings of draft"


def _judged(
    of: Quantity, error: ForceError
) -> tuple[Callable[[Accuracy], float], Sequence[Accuracy]]:
    draft = PRESETS["draft"]
    if of == "force":
        meshes = (
            replace(draft, refine=refine, place_orders=orders, place_share=share)
            for refine, orders, share in product(REFINES, ORDERS, SHARES)
        )
        return ForcePilot(error).predict, list(meshes)
    if of == "volume":
        return VolumePilot(error).predict, [
            replace(draft, cad_tolerance_mm=t) for t in TOLERANCES_mm
        ]
    if of == "visibility":
        return SightPilot(error).predict, [
            replace(draft, refine=refine, press_tolerance=tolerance)
            for refine, tolerance in product(REFINES[:6], PRESS_TOLERANCES)
        ]
    raise DesignError(f"a tolerance of {of!r} is not known; choose force, visibility or volume")


def achieved(choice: Choice, error: ForceError) -> float | None:
    """Audit the error: hold the setting against one reference solve; None for a budget."""
    if choice.quantity == "force":
        return rms(error.errors(choice.accuracy))
    if choice.quantity == "volume":
        return VolumePilot(error).achieved(choice.accuracy)
    if choice.quantity == "visibility":
        return SightPilot(error).achieved(choice.accuracy)
    return None
