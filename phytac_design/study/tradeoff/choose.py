"""Settings chosen by their error: the cheapest whose predicted error is within a tolerance."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from typing import Any

from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.spec import Design
from phytac_design.study.planning.cost import Workload, features, machine_factor, predict
from phytac_design.study.planning.unit_costs import WALL_s
from phytac_design.study.tradeoff.force import ForceError
from phytac_design.study.tradeoff.pilot import ForcePilot, Pilot, VisibilityPilot, VolumePilot
from phytac_design.study.tradeoff.settings import Quantity
from phytac_shapes.errors import DesignError

BASE = replace(PRESETS["draft"], tools=True)
"""Settings of what an error does not depend on: as cheap as possible, but complete."""

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Choice:
    """A setting with its expected error and cost.

    Attributes
    ----------
    accuracy : Accuracy
        The setting.
    quantity : str
        Quantity of the error; ``time`` for a budget.
    wanted : float
        The tolerance, or the budget in seconds.
    predicted_error : float or None
        With the pilot's safety factor; None for a budget.
    predicted_s : dict
        Wall seconds of each stage.
    achieved_error : float or None
        Of the audit.
    achieved_s : dict
        Wall seconds of each stage that ran.
    """

    accuracy: Accuracy
    quantity: str
    wanted: float
    predicted_error: float | None
    predicted_s: dict[str, float]
    achieved_error: float | None = None
    achieved_s: dict[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Predicted total."""
        return sum(self.predicted_s.values())

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return asdict(self) | {
            "predicted_total_s": self.seconds,
            "achieved_total_s": sum(self.achieved_s.values()) if self.achieved_s else None,
        }


def wall_seconds(work: Workload, setting: Accuracy) -> dict[str, float]:
    """Wall seconds of each stage of a whole build, on the machine of the unit costs."""
    return predict(WALL_s, features(work.counts(setting), setting, work.design))


def choose_tolerance(
    design: Design,
    tolerance: float,
    *,
    of: Quantity = "force",
    error: ForceError | None = None,
    progress: Progress = lambda _: None,
) -> Choice:
    """Find the cheapest setting whose predicted error is within a tolerance.

    Fields that the error does not depend on stay as in ``draft``, but for ``tools``.

    Parameters
    ----------
    tolerance : float
        Relative error of force or volume, or a difference of visible fractions.
    of : str
        ``force``, ``visibility`` or ``volume``.
    error : ForceError, optional
        The design's, if it has solutions already.

    Raises
    ------
    DesignError
        If no setting is within the tolerance; the message names the best one.
    """
    if not 0.0 < tolerance <= 1.0:
        raise DesignError(
            "tolerance-invalid", f"the tolerance must be above 0 and at most 1 (got {tolerance:g})"
        )
    pilot, candidates = pilot_of(of, error or ForceError(design))
    work, factor = Workload(design), machine_factor()
    cost = [
        {name: factor * seconds for name, seconds in wall_seconds(work, setting).items()}
        for setting in candidates
    ]
    found = []
    for k in sorted(range(len(cost)), key=lambda k: sum(cost[k].values())):
        setting = candidates[k]
        predicted = pilot.predict(setting)
        found.append((predicted, k))
        progress(
            f"tolerance: {of} error {100.0 * predicted:.3g} % predicted for "
            f"{difference_from_draft(setting)}, {sum(cost[k].values()):.0f} s"
        )
        if predicted <= tolerance:
            return Choice(
                accuracy=setting,
                quantity=of,
                wanted=tolerance,
                predicted_error=predicted,
                predicted_s=cost[k],
            )
    best, k = min(found)
    raise DesignError(
        "tolerance-not-reachable",
        f"no setting has a predicted {of} error within {100.0 * tolerance:g} % on this design; the "
        f"best is {100.0 * best:.2g} %, with {difference_from_draft(candidates[k])}: allow at "
        "least that",
    )


def difference_from_draft(setting: Accuracy) -> str:
    """Settings that differ from ``draft``, as text."""
    draft = BASE.as_dict()
    own = {key: value for key, value in setting.as_dict().items() if value != draft[key]}
    return ", ".join(f"{key} {value}" for key, value in own.items()) or "the settings of draft"


def pilot_of(of: str, error: ForceError) -> tuple[Pilot, Sequence[Accuracy]]:
    """Pilot of a quantity, and the settings that are tried for it."""
    draft, refines = BASE, (2, 3, 4, 5, 6, 8, 10, 12)
    if of == "force":
        return ForcePilot(error), [
            replace(draft, refine=refine, place_orders=orders, place_share=share)
            for refine, orders, share in product(refines, (1, 3, 4, 5), (1.2, 0.8, 0.55, 0.4))
        ]
    if of == "volume":
        tolerances = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002)
        return VolumePilot(error), [replace(draft, cad_tolerance_mm=mm) for mm in tolerances]
    if of == "visibility":
        return VisibilityPilot(error), [
            replace(draft, refine=refine, press_tolerance=tolerance)
            for refine, tolerance in product(refines[:6], (1.0, 0.1, 0.05, 0.02))
        ]
    raise DesignError(
        "tolerance-kind-unknown",
        f"a tolerance of {of!r} is not known; choose force, visibility or volume",
    )


def achieved(choice: Choice, error: ForceError) -> float:
    """Error of a choice against the reference."""
    return pilot_of(choice.quantity, error)[0].achieved(choice.accuracy)
