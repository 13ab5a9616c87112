"""Thresholds that no bowl has are errors of ``phytac check``, and ``phytac new`` avoids them."""

import json
from pathlib import Path
from typing import Any

import pytest
import typer

from phytac_design.cli import check_command, new_command
from phytac_design.design.design_file import to_toml
from phytac_design.mechanics.switch.feasible_range import FeasibleRange, smallest_N
from phytac_design.mechanics.switch.switch_inputs import rubber_of, space_of
from phytac_design.mechanics.switch.threshold_bound import far_too_high
from phytac_design.study.advice import quick_repair
from phytac_design.study.advice.design_variables import with_fields
from phytac_design.study.advice.quick_repair import ReadableRepair
from phytac_design.study.advice.switch_changes import threshold_changes
from phytac_design.workflows import design_check, switch_feasibility
from phytac_design.workflows.design_check import full_check
from phytac_design.workflows.switch_feasibility import check_thresholds
from phytac_shapes.errors import DesignError
from tests.designs import small, tiny
from tests.refusals import refused
from tests.test_check_faults import READING

RANGE = FeasibleRange(modulus_MPa=10.0, min_N=0.4, max_N=0.9, min_wall_mm=0.2, max_wall_mm=0.28)
WEAK: dict[str, Any] = {"threshold_N": 0.1, "release_N": 0.08}


@pytest.fixture(autouse=True)
def solved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Thresholds whose bowls were solved for; they fit as the range says."""
    asked: list[float] = []

    def misfit(threshold_N: float, *_: object) -> str:
        asked.append(threshold_N)
        return "" if RANGE.min_N <= threshold_N < 0.8 else "it does not snap"

    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(switch_feasibility, "misfit", misfit)
    monkeypatch.setattr(switch_feasibility, "far_too_high", lambda *_: "")
    monkeypatch.setattr(switch_feasibility, "feasible_range", lambda *_: RANGE)
    return asked


def test_thresholds_without_a_bowl_are_refused(solved: list[float]) -> None:
    check_thresholds(small())
    check_thresholds(small(receptor={"diameter_hole_mm": 0.0}))
    # Near the thickest wall the range decides: it is solved in full.
    check_thresholds(small(switch={"threshold_N": 0.85}))
    regions = [{"threshold_N": 3.0, "rows": [0, 1]}]
    with refused("switch-infeasible") as caught:
        check_thresholds(small(switch={**WEAK, "regions": regions}))
    for words in (
        "a switch of 0.1 N does not fit .* From 0.4 to 0.9 N fit with walls of 0.2 to 0.28 mm",
        "a rubber of 1.11 to 2.5 MPa",
        "a switch of 3 N does not fit",
    ):
        caught.match(words)
    assert solved == [0.5, 0.85, 0.1, 3.0]
    with refused("bowl-no-room"):
        check_thresholds(small(switch={"wall_min_mm": 2.0}))


def test_far_too_high_thresholds_need_no_range(
    monkeypatch: pytest.MonkeyPatch, solved: list[float]
) -> None:
    def none(*_: object) -> None:
        raise AssertionError("solved the range")

    monkeypatch.setattr(switch_feasibility, "feasible_range", none)
    monkeypatch.setattr(switch_feasibility, "far_too_high", far_too_high)
    space = space_of(small())
    thinnest_N = smallest_N(rubber_of(small()), space)
    assert thinnest_N is not None
    # Within the range, and not far above it: the range decides.
    assert far_too_high(1.5 * thinnest_N, rubber_of(small()), space) == ""
    with refused("switch-infeasible") as caught:
        check_thresholds(small(switch={"threshold_N": 12.0}))
    caught.match("no wall gives it, nor does a wall for 7.2 N")
    assert solved == []
    snaps_N = float(str(caught.value).split("snaps at ")[1].split()[0])
    assert snaps_N == pytest.approx(thinnest_N, rel=0.03)
    # Of the largest modulus that the text names, the thinnest wall has the threshold.
    most_MPa = float(str(caught.value).split("less than ")[1].split()[0])
    assert most_MPa == pytest.approx(10.0 * 12.0 / snaps_N, rel=0.01)


def test_known_switches_are_not_solved_again(
    solved: list[float], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    check_thresholds(small())
    check_thresholds(small(camera=READING))
    assert solved == [0.5]
    check_thresholds(small(switch={"modulus_MPa": 9.0}))
    check_thresholds(small(switch={"footprint_diameter_mm": 3.9}))
    assert solved == [0.5] * 3
    # Without a cache that can be written, the check works all the same.
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "file" / "cache"))
    check_thresholds(small())
    assert solved == [0.5] * 4


def test_the_check_lists_thresholds_with_other_faults(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check_command, "_suggest_repair", lambda *_, **__: None)
    path = tmp_path / "mine.toml"

    def run(*, as_json: bool = False, **tables: Any) -> tuple[str, str]:
        path.write_text(to_toml(small(camera=READING, **tables)))
        with pytest.raises(typer.Exit):
            check_command.check(str(path), as_json=as_json)
        out = capsys.readouterr()
        return out.out, out.err

    out, err = run(switch=WEAK)
    assert "can be distinguished; its switches cannot be made" in out.splitlines()[-1]
    assert "error[switch-infeasible]: a switch of 0.1 N" in err
    facts = json.loads(run(as_json=True, switch=WEAK)[0])
    assert [fault["code"] for fault in facts["faults"]] == ["switch-infeasible"]
    assert (facts["clear"], facts["visibility"]["occluded"]) == (False, 0)
    err = run(switch=WEAK, wall={"thickness_mm": 0.3})[1]
    assert [line.split("]")[0] for line in err.splitlines() if line.startswith("error")] == [
        "error[wall-too-thin",
        "error[switch-infeasible",
    ]
    # Bowls of receptors that are too close are not judged.
    err = run(switch={**WEAK, "footprint_diameter_mm": 20.0})[1]
    assert "error[switches-overlap]" in err
    assert "switch-infeasible" not in err


def test_advice_tries_a_rubber_a_modulus_and_the_nearest_threshold() -> None:
    known, modulus, threshold = threshold_changes(small(switch=WEAK), {})
    assert known.words == (
        "switch.material tpu-8400n → silicone-a30, "
        "switch.threshold_N 0.1 → 0.094, switch.release_N 0.08 → 0.075"
    )
    assert known.reason == ""
    assert modulus.words == "switch.modulus_MPa 0 → 1.7"
    assert modulus.reason == ""
    assert threshold.words == "switch.threshold_N 0.1 → 0.42, switch.release_N 0.08 → 0.34"
    assert threshold.reason == ""
    assert threshold.design is not None
    check_thresholds(threshold.design)


def test_a_new_design_has_a_rubber_for_its_threshold(monkeypatch: pytest.MonkeyPatch) -> None:
    design, words = new_command._switches_of(small(switch=WEAK), 5.0)
    # The rubber whose thresholds, 0.044 to 0.099 N by its modulus of 1.1 MPa, come nearest.
    switch = design.switch
    assert (switch.material, switch.threshold_N, switch.release_N) == ("silicone-a30", 0.094, 0.075)
    assert words.endswith(
        "switch.threshold_N = 0.094; bowls of silicone-a30 have it (switch.material)"
    )
    # As wanted: no change.
    same, words = new_command._switches_of(small(), 3.0)
    assert same == small()
    assert words == (
        "a contact trips a switch from about 1.5 N on (wanted: 3 N), of which the bowl bears 33%: "
        "switch.threshold_N = 0.5"
    )
    # Without a known rubber the modulus is in the middle of 1.11 to 2.5 MPa, by logarithms.
    monkeypatch.setattr(switch_feasibility, "RUBBERS", {})
    design, words = new_command._switches_of(small(switch=WEAK), 5.0)
    assert design.switch.modulus_MPa == 1.7
    assert "rubber must have 1.7 MPa (switch.modulus_MPa), and none of those with data" in words


def test_a_new_design_has_switches_that_its_camera_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    def found(fields: dict[str, Any]) -> ReadableRepair:
        changed = with_fields(design, fields)
        return ReadableRepair(
            words=str(fields), fields=fields, design=changed, before=12, after=0, reason=""
        )

    # A camera that is too far from the tips.
    design = tiny(camera={"stand_off_mm": 60.0})
    lens, deeper = {"camera.focal_px": 300.0}, {"switch.tip_recess_mm": 0.4}
    cures = [found(lens), found(deeper)]
    monkeypatch.setattr(quick_repair, "readable_switches", lambda *_, **__: cures)
    same, words = new_command._switches_of(design, 5.0)
    assert same == with_fields(design, deeper)
    assert words.endswith(f"; so that the camera reads most switches: {deeper}")
    cures = [found(lens)]
    solid, words = new_command._switches_of(design, 5.0)
    assert not solid.has_switches
    assert f"cannot read 12 of 16 switches; it would with {lens}: receptors are solid" in words
    checked = full_check(solid)
    assert checked["visible"] == checked["clear"]
    assert "faults" not in checked


def test_a_new_design_has_thresholds_for_the_smallest_force() -> None:
    design, words = new_command._switches_of(small(), 0.3)
    assert (design.switch.threshold_N, design.switch.release_N) == (0.094, 0.075)
    assert words == (
        "a contact trips a switch from about 0.28 N on (wanted: 0.3 N), of which the bowl bears "
        "33%: switch.threshold_N = 0.094; bowls of silicone-a30 have it (switch.material)"
    )


def test_thresholds_that_no_rubber_has_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object, **__: object) -> None:
        raise DesignError("switch-infeasible", "no bowl fits; raise the footprint")

    monkeypatch.setattr(switch_feasibility, "RUBBERS", {})
    monkeypatch.setattr(switch_feasibility, "modulus_for", none)
    design, words = new_command._switches_of(small(), 0.3)
    assert design == small()
    assert "from about 1.5 N on (wanted: 0.3 N" in words


def test_the_check_names_family_and_rubber(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case = tiny(switch={"family": "best", "material": "best"})
    one = {
        "threshold_N": 0.5,
        "family": "plunger",
        "rubber": {"name": "rebound-25"},
        "spread": {"band": 0.134},
        "choice": "± 13 %, the smallest spread that fits",
    }
    for module in (design_check, switch_feasibility):
        monkeypatch.setattr(module, "chosen_switches", lambda *_: [one])
    report = full_check(case)
    (made,) = report["switches"]
    assert (made["family"], made["rubber"], made["band"]) == ("plunger", "rebound-25", 0.134)
    check_command._print_check(report)
    line = "switches of 0.5 N: plunger of rebound-25, ± 13 %, the smallest spread that fits"
    assert line in capsys.readouterr().out

    def refuse(*_: object) -> None:
        raise DesignError("switch-infeasible", "no switch fits")

    monkeypatch.setattr(switch_feasibility, "chosen_switches", refuse)
    refused_report = full_check(case)
    assert [fault["code"] for fault in refused_report["faults"]] == ["switch-infeasible"]
    assert "switches" not in refused_report
