"""One family for each threshold, one rubber for all, and the reason of the choice."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_design.design.spec import Design
from phytac_design.mechanics.switch import family_choice
from phytac_design.mechanics.switch.family_choice import ChosenSwitch, choose_families
from phytac_design.mechanics.switch.family_spread import FamilySpread, FamilyTolerance
from phytac_design.mechanics.switch.rubbers import RUBBERS, Rubber, rubber
from phytac_design.mechanics.switch.switch_families import FAMILIES, Family, FamilyCandidate
from phytac_design.mechanics.switch.switch_inputs import families_of, rubbers_of, space_of
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from tests.designs import small
from tests.refusals import refused

SOFT, HARD = rubber("dragon-skin-20"), rubber("tpu-8400n")
SPREAD = FamilySpread(
    thickness=0.1,
    diameter=0.0,
    height=0.0,
    modulus=0.1,
    low_N=0.4,
    high_N=0.6,
    worst_low_N=0.3,
    worst_high_N=0.7,
    band=0.2,
)
BANDS: dict[tuple[float, str, str], float] = {
    (0.5, "plunger", "dragon-skin-20"): 0.13,
    (0.5, "bowl", "tpu-8400n"): 0.5,
    (0.5, "membrane", "tpu-8400n"): 0.4,
    (0.2, "membrane", "dragon-skin-20"): 0.3,
    (0.2, "bowl", "tpu-8400n"): 0.1,
}


def chosen(
    monkeypatch: pytest.MonkeyPatch, bands: dict[tuple[float, str, str], float], *forces: float
) -> list[ChosenSwitch]:
    """Choice among candidates with given bands; others do not fit."""

    def compare(
        force: float,
        rubbers: list[Rubber],
        space: SwitchSpace,
        travel: Any,
        *,
        families: tuple[Family, ...],
        **_: Any,
    ) -> list[FamilyCandidate]:
        assert travel[0] == force
        found = [
            FamilyCandidate(family=family, rubber=each, spread=replace(SPREAD, band=band))
            if (band := bands.get((force, family, each.name)))
            else FamilyCandidate(family=family, rubber=each, reason="too thin")
            for each in rubbers
            for family in families
        ]
        return sorted(found, key=lambda one: one.spread.band if one.spread else np.inf)

    monkeypatch.setattr(family_choice, "compare_families", compare)
    travels = [np.array([force]) for force in forces]
    return choose_families(
        forces, travels, [HARD, SOFT], FAMILIES, SwitchSpace(), FamilyTolerance()
    )


def test_smallest_spread_is_taken_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    (one,) = chosen(monkeypatch, BANDS, 0.5)
    assert (one.candidate.family, one.candidate.rubber.name) == ("plunger", "dragon-skin-20")
    for words in ("± 13 %", "next: membrane of tpu-8400n, ± 40 %", "do not fit: plunger of tpu"):
        assert words in one.reason.replace("%", " %")


def test_all_thresholds_are_cast_of_one_rubber(monkeypatch: pytest.MonkeyPatch) -> None:
    found = chosen(monkeypatch, BANDS, 0.2, 0.5)
    # Its largest spread is 30 %, that of the other rubber 40 %, though that has the smallest.
    assert [one.candidate.rubber.name for one in found] == ["dragon-skin-20"] * 2
    assert [one.candidate.family for one in found] == ["membrane", "plunger"]
    assert [one.threshold_N for one in found] == [0.2, 0.5]


def test_a_threshold_that_no_rubber_gives_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    only = {key: band for key, band in BANDS.items() if key[2] == "tpu-8400n" or key[0] == 0.2}
    del only[0.2, "bowl", "tpu-8400n"]
    with refused("switch-infeasible") as error:
        chosen(monkeypatch, only, 0.2, 0.5)
    error.match("0.2 N, bowl of tpu-8400n: too thin")


def test_the_design_says_what_is_compared() -> None:
    def of(**switch: Any) -> Design:
        return small(switch=switch)

    plain = of(family="plunger")
    assert families_of(plain) == ("plunger",)
    assert [one.name for one in rubbers_of(plain)] == ["tpu-8400n"]
    best = of(family="best", material="best")
    assert families_of(best) == FAMILIES
    assert rubbers_of(best) == list(RUBBERS.values())
    with refused("modulus-of-best"):
        rubbers_of(of(family="best", material="best", modulus_MPa=2.0))
    with refused("field-invalid"):
        of(material="best")


def test_the_mold_s_core_is_as_thick_as_the_printer_needs() -> None:
    coarse = small(print_rules={"wall_min_mm": 0.6})
    assert space_of(coarse).core_min_mm == pytest.approx(0.6)
    assert space_of(small()).core_min_mm == pytest.approx(0.4)
