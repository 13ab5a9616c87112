"""Force at which switches turn on, and how far tips are out over the force."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_design.design.field_groups import fields_of
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.mechanics.switch import cup_design
from phytac_design.mechanics.switch.cup_press import press_cup
from phytac_design.mechanics.switch.rubbers import rubber
from phytac_design.mechanics.switch.soft_cup import SoftCup
from phytac_design.simulation import switch_law as law_module
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.scenario_file import parse_scenario
from phytac_design.simulation.switch_law import SwitchLaw, chosen_switches, switch_law
from phytac_design.workflows import simulate as simulate_module
from phytac_design.workflows.simulate import observe_rest
from tests.designs import small
from tests.refusals import refused

RUBBER = "mold-star-20t"


def of(design: Design) -> SwitchLaw:
    return switch_law(design, make_markers(design, design.surface()))


@pytest.fixture(scope="module")
def plunger() -> Design:
    return small(switch={"family": "plunger", "material": RUBBER})


@pytest.fixture(scope="module")
def law(plunger: Design) -> SwitchLaw:
    with pytest.MonkeyPatch.context() as patch:
        rules = replace(cup_design.RULES, plunger_heights=(3.0,), lands=(0.2,))
        patch.setattr(cup_design, "RULES", rules)
        # That it does not buckle is tested with the families; here it takes a third of the time.
        patch.setattr(cup_design, "first_buckling", lambda *_, **__: {})
        return of(plunger)


def test_bowls_snap_at_the_threshold_of_their_region() -> None:
    region = {"threshold_N": 0.8, "rows": [0, 1]}
    found = of(small(switch={"regions": [region]}))
    assert not found.gradual.any()
    assert sorted(set(found.on_N.tolist())) == [0.5, 0.8]
    bits = found.on_N > 0.6
    assert (found.out_share(np.full(len(bits), 3.0), bits, found.on_N) == bits).all()


def test_tips_of_plungers_follow_the_force(plunger: Design, law: SwitchLaw) -> None:
    (made,) = chosen_switches(plunger)
    cup, stroke = SoftCup(**made["cup"]), plunger.switch.stroke_mm
    curve = press_cup(cup, rubber(RUBBER).material, travel_mm=0.6, refine=2)
    carried = np.full(len(law.on_N), float(curve.force_at(0.6)))
    out = law.out_share(carried, carried > law.on_N, law.on_N)
    assert out * stroke == pytest.approx(0.6, rel=0.01)
    # Ten per cent stiffer, the same way takes ten per cent more force.
    stiff = law.out_share(1.1 * carried, carried > law.on_N, 1.1 * law.on_N)
    assert stiff == pytest.approx(out, rel=1e-9)
    none, most = (
        law.out_share(np.full(len(carried), force), carried > law.on_N, law.on_N)
        for force in (0.0, 100.0)
    )
    assert (none == 0.0).all()
    assert most * stroke == pytest.approx(made["stop_mm"])


def test_each_receptor_is_on_where_the_camera_counts_its_tip_as_out(
    plunger: Design, law: SwitchLaw
) -> None:
    (made,) = chosen_switches(plunger)
    assert law.gradual.all()
    assert np.median(law.on_N) == pytest.approx(0.5, rel=0.01)
    assert np.ptp(law.on_N) > 0.005
    assert law.on_N == pytest.approx(made["receptors_N"])
    red = made["red"]
    at = np.interp(red["threshold_px"], red["red_px"], red["force_N"])
    assert law.on_N[red["marker"]] == pytest.approx(at, rel=0.02)


def test_switches_are_solved_once(
    plunger: Design, law: SwitchLaw, monkeypatch: pytest.MonkeyPatch
) -> None:
    def again(*_: Any) -> None:
        raise AssertionError("solved again")

    monkeypatch.setattr(law_module, "_choose", again)
    assert (of(plunger).on_N == law.on_N).all()


def test_what_cannot_be_made_is_refused_and_assumed_to_snap(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rules = replace(cup_design.RULES, membrane_sides=(0.5,))
    monkeypatch.setattr(cup_design, "RULES", rules)
    hard = small(switch={"family": "membrane"})
    with refused("switch-infeasible") as error:
        chosen_switches(hard)
    error.match("0.5 N, membrane of tpu-8400n")
    assumed = of(hard)
    assert (assumed.on_N == 0.5).all()
    assert "membrane of tpu-8400n" in assumed.refused
    said: list[str] = []
    monkeypatch.setattr(simulate_module, "expected_views", _stop)
    scenario = parse_scenario({"name": "t"}, "t")
    with pytest.raises(StopIteration):
        observe_rest(Job(design=hard, scenario=scenario, seed=0, accuracy="draft"), said.append)
    assert any("tips are simulated as those of bowls that snap" in line for line in said)


def _stop(*_: object) -> None:
    raise StopIteration


def test_only_other_families_depend_on_the_view(plunger: Design) -> None:
    assert "switch.wall_min_mm" not in fields_of(small(), ("trips",))
    trips = fields_of(plunger, ("trips",))
    assert {"switch", "mold.draft_deg", "light", "camera.focal_px"} <= set(trips)
