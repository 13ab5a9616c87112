"""What the fidelity levels measure, and that candidates stop where a constraint says."""

import json

import numpy as np
import pytest

from phytac_design.design.design_file import design_hash
from phytac_design.fabrication.effort.effort import effort_of
from phytac_design.optics.visibility import check_visibility
from phytac_design.study.search import fidelity_levels
from phytac_design.study.search.fidelity_levels import Candidate
from phytac_design.study.search.measures import measures_up_to
from phytac_design.study.search.successive_halving import (
    OK,
    REFUSED,
    UNFIT,
    Outcome,
    evaluate_candidate,
    promoted,
    spec_of,
    task_of,
)
from tests.designs import drawn, small
from tests.study.search.studies import space_of, tiny

SEEN = [{"measure": "gap_px", "goal": "max"}]
PARAMS = {"layout.rows": 8, "layout.columns": 14, "wall.thickness_mm": 0.8}


def test_rules_and_sampled_measure_all_they_promise() -> None:
    candidate = Candidate(small(), tiny())
    found = fidelity_levels.rules(candidate) | fidelity_levels.sampled(candidate)
    assert set(found) == set(measures_up_to(("rules", "sampled")))
    assert found["marker_count"] == 112
    assert found["density_mean_per_cm2"] == pytest.approx(112 / (np.pi * 6.0 * 6.0))
    assert found["wall_mm"] == 0.8
    assert found["outside_markers"] == 0
    assert found["sampled_hidden"] == 0


def test_effort_is_that_of_a_check() -> None:
    candidate = Candidate(small(), tiny(objective=[{"measure": "hand_hours", "goal": "min"}]))
    assert candidate.study.levels == ("rules", "effort")
    found, effort = fidelity_levels.effort(candidate), effort_of(candidate.sensor)
    assert set(found) == set(measures_up_to(("effort",)))
    assert found["hand_hours"] == effort.hours_total > 0.0
    assert found["parts_handled"] == effort.parts_handled > 112


def test_mass_is_that_of_a_ring_with_tubes() -> None:
    design = small(wall={"rim_length_mm": 0.0})
    candidate = Candidate(design, tiny())
    ring = np.pi * (30.0**2 - 29.2**2) * 60.0
    tubes = np.pi * (1.5**2 - 0.8**2) * float(candidate.sensor.markers.height_mm.sum())
    holes = np.pi * 0.8**2 * 0.8 * 112
    assert fidelity_levels.rules(candidate)["mass_g"] == pytest.approx(
        1.15e-3 * (ring + tubes - holes), rel=1e-6
    )
    more = fidelity_levels.rules(Candidate(small(), tiny()))["mass_g"]
    rims = 2.0 * np.pi * (31.6**2 - 29.2**2) * 4.0
    assert more - fidelity_levels.rules(candidate)["mass_g"] == pytest.approx(
        1.15e-3 * rims, rel=1e-3
    )


def test_cost_is_of_resin_switches_and_cameras() -> None:
    study = tiny(prices={"resin_per_kg": 1000.0, "switch_each": 2.0, "camera_each": 30.0})
    found = fidelity_levels.rules(Candidate(small(), study))
    assert found["cost"] == pytest.approx(found["mass_g"] + 2.0 * 112 + 30.0)


def test_stack_reaches_from_the_lens_to_the_far_end() -> None:
    candidate = Candidate(small(camera={"stand_off_mm": 40.0, "focal_px": 400.0}), tiny())
    assert fidelity_levels.rules(candidate)["stack_mm"] == pytest.approx(100.0)


def test_exact_is_what_a_check_sees() -> None:
    rows = {"kind": "straight", "rows": 12, "colours": ["blue"]}
    candidate = Candidate(small(layout=rows, receptor={"band_marker_mm": 3.0}), tiny())
    found = fidelity_levels.exact(candidate)
    seen = check_visibility(
        candidate.sensor,
        rng=np.random.default_rng(3),
    ).summary()
    assert found["fused"] == seen["fused"] > 0
    assert found["gap_px"] == seen["min_gap_px"]
    assert found["visible_least"] == seen["min_visible_fraction"]


@pytest.mark.parametrize("kind", ["cone", "hemisphere", "plane"])
def test_sampled_gaps_are_near_rendered_ones(kind: str) -> None:
    candidate = Candidate(drawn(kind, 1), tiny())
    assert fidelity_levels.sampled(candidate)["sampled_gap_px"] == pytest.approx(
        fidelity_levels.exact(candidate)["gap_px"], abs=2.0
    )


def test_load_presses_and_looks() -> None:
    candidate = Candidate(small(), tiny())
    found = fidelity_levels.load(candidate)
    assert set(found) == set(measures_up_to(("load",)))
    assert 0.2 < found["dent_mm"] < 1.5
    assert found["load_gap_px"] <= fidelity_levels.exact(candidate)["gap_px"] + 1.0


def test_an_evaluation_gives_plain_figures_and_the_hash_of_its_design() -> None:
    study = tiny(objective=SEEN)
    space = space_of(study)
    task = task_of(spec_of(study, space), PARAMS, ("rules", "sampled", "exact"))
    outcome = Outcome(**json.loads(json.dumps(task.run())))
    assert outcome.status == OK
    assert outcome.design == design_hash(space.design(PARAMS))
    assert set(outcome.measures) == set(measures_up_to(("rules", "sampled", "exact")))
    assert set(outcome.seconds) == {"rules", "sampled", "exact"}
    assert min(outcome.seconds.values()) > 0.0


def test_an_evaluation_stops_where_a_constraint_is_missed() -> None:
    study = tiny(objective=SEEN, constraint=[{"measure": "marker_count", "max": 100}])
    outcome = evaluate_candidate(spec_of(study, space_of(study)), PARAMS, study.levels)
    assert (outcome.status, outcome.rung) == (UNFIT, "rules")
    assert outcome.reason == "marker_count is 112, must be at most 100"
    assert set(outcome.measures) == set(measures_up_to(("rules",)))
    # Two levels are not reached, and the count is off by 12 of 100.
    assert outcome.violation == pytest.approx(2.0 + 0.12 / 1.12)


def test_a_design_that_cannot_be_made_is_rejected_with_its_reason() -> None:
    study = tiny(objective=SEEN)
    thin = PARAMS | {"wall.thickness_mm": 0.1}
    outcome = evaluate_candidate(spec_of(study, space_of(study)), thin, study.levels)
    assert (outcome.status, outcome.rung) == (REFUSED, "rules")
    assert "too thin to print" in outcome.reason
    assert outcome.violation == 3.0


def test_nearer_to_the_goal_is_a_smaller_violation() -> None:
    study = tiny(
        objective=SEEN,
        constraint=[{"measure": "marker_count", "max": 100}, {"measure": "gap_px", "min": 90}],
    )
    spec = spec_of(study, space_of(study))
    many, few = (
        evaluate_candidate(spec, PARAMS | {"layout.columns": columns}, study.levels)
        for columns in (18, 14)
    )
    seen = evaluate_candidate(spec, PARAMS | {"layout.columns": 8}, study.levels)
    assert (many.rung, few.rung, seen.rung) == ("rules", "rules", "exact")
    assert many.violation > few.violation > seen.violation > 0.0


def test_the_better_share_is_promoted_by_what_predicts_the_goal() -> None:
    study = tiny(objective=SEEN, ladder={"share": {"sampled": 0.5}})
    gaps = [3.0, 9.0, 5.0, 7.0, 1.0]
    found = {
        number: Outcome(measures={"sampled_gap_px": gap, "pitch_least_mm": -gap})
        for number, gap in enumerate(gaps)
    }
    found[1].status = UNFIT
    assert promoted(study, "sampled", found) == {2, 3}


def test_keys_differ_by_values_levels_and_studies() -> None:
    study = tiny()
    spec = spec_of(study, space_of(study))
    other = spec_of(tiny(seed=9), space_of(tiny(seed=9)))
    keys = {
        task_of(spec, PARAMS, ("rules",)).key,
        task_of(spec, dict(PARAMS), ("rules",)).key,
        task_of(spec, PARAMS, ("rules", "sampled")).key,
        task_of(spec, PARAMS | {"layout.rows": 9}, ("rules",)).key,
        task_of(other, PARAMS, ("rules",)).key,
    }
    assert len(keys) == 4
