"""Molds of membranes and plungers: they release, close, and hold the shape that was solved."""

import numpy as np
import pytest

from phytac_design.fabrication.molds.mold_files import mold_files
from phytac_design.fabrication.switch_set import CupOutline, SwitchSet, revolved_volume_mm3
from phytac_design.mechanics.switch.hyperelastic import neo_hookean
from phytac_design.mechanics.switch.soft_cup import SoftCup, cup_model
from tests.fabrication.molds import WAYS, molds, switch_set

PLUNGER = SoftCup(
    family="plunger",
    diameter_mm=4.6,
    height_mm=4.1,
    side_mm=0.73,
    roof_mm=0.8,
    hub_diameter_mm=2.0,
    draft_deg=0.51,
)
MEMBRANE = SoftCup(
    family="membrane",
    diameter_mm=4.6,
    height_mm=1.5,
    side_mm=0.5,
    roof_mm=0.3,
    hub_diameter_mm=1.8,
    boss_mm=2.1,
    fillet_mm=0.3,
    draft_deg=0.51,
)


def cups(cup: SoftCup, stop_mm: float) -> SwitchSet:
    plain = switch_set((1.0, 1.0, 4.0))
    outline = CupOutline(cup=cup, stop_mm=stop_mm, stem_diameter_mm=1.45)
    return SwitchSet(**{**vars(plain), "bowls": (outline,)})


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("cup", "stop_mm"), [(PLUNGER, 1.2), (MEMBRANE, 1.5)])
def test_molds_release_and_hold_the_switch(cup: SoftCup, stop_mm: float, way: str) -> None:
    switches = cups(cup, stop_mm)
    files = mold_files(molds(switches, way=way), switches, progress=print)  # checks each
    assert "mold/cavities.csv" in files.contents
    plates = files.sets[0]["plates"].values()
    assert sum(plate["undercut_mm2"] for plate in plates) < 1e-2
    assert min(plate["least_draft_deg"] for plate in plates) >= 0.499


@pytest.mark.parametrize(("cup", "stop_mm"), [(PLUNGER, 1.2), (MEMBRANE, 1.5)])
def test_profile_is_what_was_solved(cup: SoftCup, stop_mm: float) -> None:
    switches = cups(cup, stop_mm)
    profile = switches.profile(switches.kinds[0])
    solved = cup_model(cup, neo_hookean(modulus_MPa=1.0, poisson=0.3)).model.geometry.weight_mm3
    r, r_tip, reach = 0.725, 0.6, float(switches.lengths_mm[0])
    stem = np.pi / 3.0 * (r**2 + r * r_tip + r_tip**2) * (reach + stop_mm)
    # The stem's wide part above the stop is not in the model.
    wide = np.pi * 1.0**2 * max(cup.height_mm - stop_mm, 0.0)
    assert revolved_volume_mm3(profile) == pytest.approx(solved.sum() + stem + wide, rel=0.02)
    assert profile[:, 1].max() == pytest.approx(cup.top_mm)
    assert profile[:, 0].max() == pytest.approx(0.5 * cup.diameter_mm)
    at_stop = profile[np.isclose(profile[:, 1], stop_mm)]
    if stop_mm < cup.height_mm:
        assert at_stop[:, 0] == pytest.approx([1.0, 0.725])
