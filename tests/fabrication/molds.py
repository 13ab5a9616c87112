"""A small set of switches that the mold tests cast."""

from typing import Any

import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.design.switch_table import MoldSection
from phytac_design.fabrication.molds.make import MoldSet, make_molds
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.mechanics.switch.bowl import Bowl

BOWL: dict[str, float] = {
    "diameter_mm": 4.6,
    "depth_mm": 1.77,
    "thickness_mm": 0.22,
    "stem_diameter_mm": 1.45,
    "pad_diameter_mm": 1.45,
    "pad_height_mm": 0.02,
    "fillet_mm": 0.24,
}
WAYS = ("rigid", "silicone-master")


def switch_set(
    reach_mm: tuple[float, ...] = (1.0, 1.0, 1.0, 3.0, 3.0, 8.0, 8.0, 8.0, 8.0),
    bowl: tuple[int, ...] | None = None,
    *changes: dict[str, float],
) -> SwitchSet:
    """Switches of given lengths, bowls by number; ``changes`` to the standard bowl for each."""
    lengths, length = np.unique(np.array(reach_mm), return_inverse=True)
    bowls = tuple(Bowl(**{**BOWL, **change}) for change in (changes or ({},)))
    return SwitchSet(
        bowls=bowls,
        threshold_N=0.5 + 0.1 * np.arange(len(bowls)),
        tip_diameter_mm=1.2,
        bowl=np.array(bowl or [0] * len(reach_mm)),
        reach_mm=np.array(reach_mm),
        length=length,
        lengths_mm=lengths,
        row=None,
    )


def molds(
    switches: SwitchSet | None = None,
    *,
    rules: dict[str, Any] | None = None,
    tolerance_mm: float = 0.02,
    **section: Any,
) -> list[MoldSet]:
    """Mold sets of switches, by default of the small set."""
    return make_molds(
        MoldSection(**section),
        PrintSection(**(rules or {})),
        switches or switch_set(),
        tolerance_mm=tolerance_mm,
    )
